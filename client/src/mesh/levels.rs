//! Blocks of fixed levels of detail, as the terrain makers for games have them: a block has all of
//! its samples (level 1), every second (2), fourth (3) or eighth (4) each way, chosen once for the
//! whole dataset or by distance, block by block.
//!
//! A block is a page: 16 x 16 cells, of the finest samples near the eye, of coarser ones farther
//! away, where the next level after 4 is level 1 of the page above. So the number of blocks is
//! bounded however large the dataset is. Borders between levels are closed by what the surface
//! enables for them, in the coarser block. It promises no error; what its mesh comes to is found
//! afterwards, and stated.

use super::mesher::{BLOCK_LEVELS, Found, MeshOptions, Mesher};
use super::place::PageSquare;
use super::size::{Sizes, split_ratio};
use super::standing::largest_excess;
use super::surface::{Index, Node, Surface};
use super::vertices::Asker;
use escarp_proto::geometry::{Edge, PAGE_LEVELS, PAGE_SLOTS, PageId, Quadrant, Slot};
use escarp_proto::view::View;

/// With a chosen level, blocks of one size reach this many of their sides from the eye; beyond,
/// there are those of the page above. At most `(2 * 64 + 2)^2 = 16,900` blocks of a size.
const BLOCKS_AROUND: f64 = 64.0;

/// The mesher.
#[derive(Debug)]
pub(super) struct Levels {
    options: MeshOptions,
    /// By page: how many levels of its squares are split, if that is all done.
    done: Vec<Option<u8>>,
}

impl Levels {
    pub(super) fn new(options: &MeshOptions) -> Levels {
        Levels {
            options: *options,
            done: Vec::new(),
        }
    }

    /// The level that was chosen, if one was.
    fn chosen(&self) -> Option<u8> {
        let [least, most] = BLOCK_LEVELS;
        self.options.level.map(|level| level.clamp(least, most))
    }

    /// How many levels of squares a block's level splits.
    fn depth(&self, nearness: f64) -> u8 {
        let near = |level: &u8| nearness > f64::from(1u8 << level);
        match self.chosen() {
            _ if nearness <= 1.0 => 0,
            Some(level) => PAGE_LEVELS + 1 - level,
            None => (0..PAGE_LEVELS).filter(near).count() as u8,
        }
    }
}

impl Mesher for Levels {
    fn update(&mut self, surface: &mut Surface, view: &View) -> Found {
        let ratio = match self.chosen() {
            Some(_) => BLOCKS_AROUND,
            None => split_ratio(&self.options, view),
        };
        let mut sizes = Sizes::of(surface, view, ratio);
        let mut blocks = Vec::new();
        if let Some(&root) = surface.by_id.get(&PageId::ROOT) {
            let near = sizes.near(surface.node(root), PageSquare::ROOT);
            blocks.push((root, near.times()));
        }
        while let Some((page, nearness)) = blocks.pop() {
            self.mesh_block(surface, page, nearness);
            self.blocks_below(surface, &mut sizes, (page, nearness), &mut blocks);
        }
        Found {
            excess: largest_excess(surface, &sizes.sight),
            squares: sizes.squares,
        }
    }

    fn linked(&mut self, _: &Surface, page: Index) {
        let page = page as usize;
        if self.done.len() <= page {
            self.done.resize(page + 1, None);
        }
        self.done[page] = None;
    }

    fn unlinked(&mut self, page: Index) {
        self.done[page as usize] = None;
    }
}

impl Levels {
    /// Gives a block its level.
    fn mesh_block(&mut self, surface: &mut Surface, page: Index, nearness: f64) {
        let depth = self.depth(nearness);
        surface.node_mut(page).last_use = surface.updates;
        if self.done[page as usize] == Some(depth) {
            return;
        }
        surface.wishes.in_view = true;
        surface.wishes.blocked = false;
        // As many parts as the level needs are wanted at once.
        let excess = nearness.max(f64::from(1u8 << depth));
        let is_done = split_squares(surface, (page, PageSquare::ROOT), depth, excess);
        self.done[page as usize] = is_done.then_some(depth);
    }

    /// Adds the blocks below a block that are to be meshed, or are no longer, and wants those that
    /// are missing.
    fn blocks_below(
        &self,
        surface: &mut Surface,
        sizes: &mut Sizes,
        (page, nearness): (Index, f64),
        blocks: &mut Vec<(Index, f64)>,
    ) {
        // No cell can be nearer than its block.
        let any_near = nearness > f64::from(1u8 << PAGE_LEVELS);
        let node = surface.node(page);
        if !any_near || node.page.is_finest() {
            let children = node.children.iter().map(|&(_, child)| child);
            let meshed = |&child: &Index| is_meshed(surface, child);
            blocks.extend(children.filter(meshed).map(|child| (child, 0.0)));
            return;
        }
        let mut children = [None; PAGE_SLOTS];
        for &(slot, child) in &node.children {
            children[slot.index()] = Some(child);
        }
        if !node.page.has_slots() {
            return surface.want_below(page, PageSquare::cell(Slot::at(0, 0)), nearness);
        }
        for slot in (0..=u8::MAX).map(Slot::from_index) {
            let cell = PageSquare::cell(slot);
            let nearness = self.cell_nearness(surface.node(page), slot, sizes);
            match children[slot.index()] {
                Some(child) if nearness > 1.0 || is_meshed(surface, child) => {
                    blocks.push((child, nearness));
                }
                None if nearness > 1.0 => {
                    let parts = f64::from(1u8 << self.depth(nearness));
                    surface.wishes.in_view = true;
                    surface.wishes.blocked = false;
                    surface.want_below(page, cell, nearness.max(parts));
                }
                _ => {}
            }
        }
    }

    /// Nearness of the block below a cell. By distance, a page without a record is not entered: it
    /// is what the page above says of it. A chosen level is taken at its word.
    fn cell_nearness(&self, node: &Node, slot: Slot, sizes: &mut Sizes) -> f64 {
        let enters = self.chosen().is_some() || node.page.slot(slot).has_record();
        match enters {
            true => sizes.near(node, PageSquare::cell(slot)).times(),
            false => 0.0,
        }
    }
}

fn is_meshed(surface: &Surface, page: Index) -> bool {
    surface.is_enabled((page, PageSquare::ROOT.centre() as u16))
}

/// Splits the squares of the first `depth` levels from a square downwards, and no others. Whether
/// all that was possible.
fn split_squares(
    surface: &mut Surface,
    (page, square): (Index, PageSquare),
    depth: u8,
    excess: f64,
) -> bool {
    let centre = (page, square.centre() as u16);
    let split = square.level < depth;
    surface.ask(centre, Asker::First, split, excess);
    if !surface.is_enabled(centre) {
        return !split;
    }
    let mut is_done = true;
    for edge in Edge::ALL {
        let vertex = (page, square.edge(edge) as u16);
        surface.ask(vertex, edge.into(), split, excess);
        is_done &= !split || surface.is_enabled(vertex);
    }
    if square.level + 1 < PAGE_LEVELS {
        for quadrant in Quadrant::ALL {
            let child = (page, square.child(quadrant));
            is_done &= split_squares(surface, child, depth, excess);
        }
    }
    is_done
}
