//! What every mesher works on: the resident pages, how they hang together, and which of their
//! vertices are enabled.

use super::contradiction::{Contradiction, Known};
use super::page_mesh::{PageMesh, Vertex};
use super::place::PageSquare;
use super::squares::{PAGE_SQUARES, Squares};
use super::vertices::{VertexRef, VertexState};
use super::wants::Wishes;
use escarp_proto::geometry::{Edge, GridLevels, PAGE_SLOTS, PageId, Slot};
use escarp_proto::georef::{Georef, WorldBox};
use escarp_proto::page::{
    Bounds, BoxError, ChildSlot, PAGE_AREA, Page, PageError, Range, SquareErrors,
};
use std::collections::HashMap;
use thiserror::Error;

/// Place of a page in the tree's list.
pub(super) type Index = u32;

/// Why a page was not linked.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum LinkError {
    /// The page above it is not resident, or says that there is no such page. It came too late.
    #[error("page {0} hangs below nothing that is resident")]
    Orphan(PageId),
    /// It is not what the page above it says, or those beside it have.
    #[error("page {page} contradicts what is known of it: {what}")]
    Contradiction {
        /// The page.
        page: PageId,
        /// What it says that cannot be.
        what: Contradiction,
    },
    /// It was refused and asked for again, and came without the parts that are missing.
    #[error("page {0} came again with no more parts than are here")]
    Repeated(PageId),
    /// It does not decode.
    #[error(transparent)]
    Page(#[from] PageError),
}

/// Which vertices of a page's mesh are not up to date.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Stale(u8);

impl Stale {
    pub(super) const NONE: Stale = Stale(0);
    pub(super) const ALL: Stale = Stale(0x10);

    pub(super) fn is_all(self) -> bool {
        self.0 & Stale::ALL.0 != 0
    }

    /// The normals on an edge: the page across has come, gone or changed.
    pub(super) fn add_edge(&mut self, edge: Edge) {
        self.0 |= 1 << edge as u8;
    }

    pub(super) fn has_edge(self, edge: Edge) -> bool {
        self.0 & (1 << edge as u8) != 0
    }
}

/// A resident page.
#[derive(Debug)]
pub(super) struct Node {
    pub(super) page: Page,
    /// What its squares are tested by.
    pub(super) squares: Box<Squares>,
    /// Of a page with holes: what its triangles hold.
    pub(super) outlines: Option<Box<Bounds>>,
    pub(super) promise: Option<BoxError>,
    pub(super) parent: Option<(Index, Slot)>,
    pub(super) neighbours: [Option<Index>; 4],
    /// Resident children, by slot.
    pub(super) children: Vec<(Slot, Index)>,
    children_resident: SlotSet,
    /// Children whose centre is enabled.
    pub(super) children_enabled: SlotSet,
    pub(super) vertices: Box<[VertexState; PAGE_AREA]>,
    /// Squares whose centre is enabled: a bit each, by their places.
    pub(super) centres: u128,
    /// Enabled vertices.
    pub(super) enabled: u32,
    /// Update in which it was last of use.
    pub(super) last_use: u64,
    pub(super) mesh: PageMesh,
    /// The mesh's triangles are not up to date.
    pub(super) stale_triangles: bool,
    /// The mesh's vertices are not up to date: all, or those on some edges.
    pub(super) stale_vertices: Stale,
    /// Vertices have been enabled or disabled since the morph was updated.
    pub(super) flagged: bool,
    /// Whether it is in the list of those.
    listed: bool,
}

/// Some slots of a page.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SlotSet([u64; 4]);

impl SlotSet {
    pub(super) fn set(&mut self, slot: Slot, is_in: bool) {
        let bit = 1 << (slot.index() % 64);
        let word = &mut self.0[slot.index() / 64];
        *word = if is_in { *word | bit } else { *word & !bit };
    }

    pub(super) fn has(&self, slot: Slot) -> bool {
        self.0[slot.index() / 64] & 1 << (slot.index() % 64) != 0
    }

    /// How many of them come before a slot.
    fn before(&self, slot: Slot) -> usize {
        let (word, bit) = (slot.index() / 64, slot.index() % 64);
        let whole: u32 = self.0[..word].iter().map(|word| word.count_ones()).sum();
        (whole + (self.0[word] & ((1 << bit) - 1)).count_ones()) as usize
    }
}

/// What every page takes: its node, heights, states of vertices, bounds, and the mesh's vertices.
pub(super) const NODE_BYTES: usize = size_of::<Option<Node>>()
    + PAGE_AREA * (size_of::<i32>() + size_of::<VertexState>() + size_of::<Vertex>())
    + size_of::<Squares>()
    + MESHER_BYTES;
/// What a mesher keeps of a page, about.
const MESHER_BYTES: usize = 256;

impl Node {
    /// Memory beside [`NODE_BYTES`].
    fn more_bytes(&self) -> usize {
        let outlines = match self.outlines {
            Some(_) => {
                PAGE_SLOTS * size_of::<BoxError>() + PAGE_SQUARES * size_of::<SquareErrors>()
            }
            None => 0,
        };
        let slots = match self.page.has_slots() {
            true => size_of::<[ChildSlot; PAGE_SLOTS]>(),
            false => 0,
        };
        let indices = self.mesh.indices.capacity() * size_of::<u16>();
        self.squares.more_bytes() + outlines + slots + indices
    }
}

/// The resident pages, and the mesh that their enabled vertices make. Whatever a mesher does to
/// it, it covers the grid without a crack.
#[derive(Debug)]
pub(super) struct Surface {
    pub(super) grid: GridLevels,
    pub(super) georef: Georef,
    pub(super) nodes: Vec<Option<Node>>,
    free: Vec<Index>,
    pub(super) by_id: HashMap<PageId, Index>,
    pub(super) wishes: Wishes,
    pub(super) updates: u64,
    pub(super) changes: u64,
    /// Vertices that were enabled, and disabled.
    pub(super) splits: u64,
    pub(super) merges: u64,
    pub(super) stamps: u64,
    /// Pages whose mesh may not be up to date.
    pub(super) stale: Vec<Index>,
    /// Triangles of all meshes.
    pub(super) triangles: u64,
    /// Memory of what not all pages have alike.
    pub(super) more_bytes: usize,
    /// Vertices enabled (`true`) and disabled since they were taken, in order; `None` if nobody
    /// asks.
    pub(super) flips: Option<Vec<(VertexRef, bool)>>,
}

impl Surface {
    /// A surface without pages.
    pub(super) fn new(grid: GridLevels, georef: Georef) -> Surface {
        Surface {
            grid,
            georef,
            nodes: Vec::new(),
            free: Vec::new(),
            by_id: HashMap::new(),
            wishes: Wishes::default(),
            updates: 0,
            changes: 0,
            splits: 0,
            merges: 0,
            stamps: 0,
            stale: Vec::new(),
            triangles: 0,
            more_bytes: 0,
            flips: None,
        }
    }

    /// Changes, and of these vertices enabled, vertices disabled.
    pub(super) fn counts(&self) -> [u64; 3] {
        [self.changes, self.splits, self.merges]
    }

    pub(super) fn resident(&self) -> usize {
        self.by_id.len()
    }

    pub(super) fn page(&self, id: PageId) -> Option<&Page> {
        Some(&self.node(*self.by_id.get(&id)?).page)
    }

    pub(super) fn pages(&self) -> impl Iterator<Item = &Page> {
        self.nodes.iter().flatten().map(|node| &node.page)
    }

    pub(super) fn meshes(&self) -> impl Iterator<Item = &PageMesh> {
        let nodes = self.nodes.iter().flatten();
        nodes
            .map(|node| &node.mesh)
            .filter(|mesh| !mesh.indices.is_empty())
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.resident() * NODE_BYTES + self.more_bytes
    }

    /// Memory of the pages that the mesh uses, bytes: no page above one of these can go, either.
    pub(super) fn used_bytes(&self) -> usize {
        let nodes = self.nodes.iter().flatten();
        let used = nodes.filter(|node| node.enabled > 0);
        used.map(|node| NODE_BYTES + node.more_bytes()).sum()
    }

    pub(super) fn node(&self, index: Index) -> &Node {
        // An index is handed out for a linked page and forgotten when the page is unlinked.
        self.nodes[index as usize].as_ref().expect("a linked page")
    }

    pub(super) fn node_mut(&mut self, index: Index) -> &mut Node {
        self.nodes[index as usize].as_mut().expect("a linked page")
    }

    /// Links a page whose parent is resident, or more parts of one that is linked.
    ///
    /// # Errors
    /// [`LinkError`]; the surface is then as it was.
    pub(super) fn link(&mut self, page: Page) -> Result<Index, LinkError> {
        let id = page.id();
        if let Some(&index) = self.by_id.get(&id) {
            self.replace(index, page)?;
            return Ok(index);
        }
        let parent = self.parent_of(id)?;
        let promise = parent.map(|(index, slot)| {
            let above = self.node(index);
            Bounds::cell(&above.page, slot, above.promise)
        });
        let known = Known { parent, promise };
        let bounds = self.vetted_bounds(&page, known)?;
        let index = self.free.pop().unwrap_or(self.nodes.len() as Index);
        let node = self.new_node(page, bounds, known);
        self.more_bytes += node.more_bytes();
        match self.nodes.get_mut(index as usize) {
            Some(place) => *place = Some(node),
            None => self.nodes.push(Some(node)),
        }
        self.by_id.insert(id, index);
        if let Some((parent, slot)) = parent {
            let above = self.node_mut(parent);
            let place = above.children_resident.before(slot);
            above.children.insert(place, (slot, index));
            above.children_resident.set(slot, true);
        }
        for edge in Edge::ALL {
            let neighbour = id
                .neighbour(edge)
                .and_then(|id| self.by_id.get(&id).copied());
            self.node_mut(index).neighbours[edge as usize] = neighbour;
            if let Some(neighbour) = neighbour {
                let node = self.node_mut(neighbour);
                node.neighbours[edge.opposite() as usize] = Some(index);
            }
        }
        self.mark_around(index);
        self.mark_triangles(index);
        self.changes += 1;
        Ok(index)
    }

    fn new_node(&self, page: Page, bounds: Bounds, known: Known) -> Node {
        let Known { parent, promise } = known;
        let id = page.id();
        let (x, y) = self.grid.page_origin(id);
        let stride = self.grid.page_stride(id);
        let range = bounds.box_error(0, 0, 0).range;
        let bounds_m = self.world_box(id, range);
        Node {
            mesh: PageMesh {
                id,
                origin: [x, y],
                stride,
                bounds: bounds_m,
                vertices: Vec::new(),
                vertex_stamp: 0,
                offsets: None,
                offset_stamp: 0,
                indices: Vec::new(),
                index_stamp: 0,
            },
            squares: Box::new(Squares::of(&bounds, id, self.grid, &self.georef)),
            outlines: page.has_holes().then(|| Box::new(bounds)),
            page,
            promise,
            parent,
            neighbours: [None; 4],
            children: Vec::new(),
            children_resident: SlotSet::default(),
            children_enabled: SlotSet::default(),
            vertices: Box::new([VertexState::default(); PAGE_AREA]),
            centres: 0,
            enabled: 0,
            last_use: self.updates,
            stale_triangles: true,
            stale_vertices: Stale::ALL,
            flagged: false,
            listed: false,
        }
    }

    fn world_box(&self, page: PageId, range: Range) -> WorldBox {
        let (x, y) = self.grid.page_origin(page);
        let cells = self.grid.square_cells(page.level());
        self.georef.world_box([x, x + cells], [y, y + cells], range)
    }

    /// The page above, and its slot for this one.
    fn parent_of(&self, id: PageId) -> Result<Option<(Index, Slot)>, LinkError> {
        let Some((parent, slot)) = id.parent() else {
            return Ok(None);
        };
        let index = *self.by_id.get(&parent).ok_or(LinkError::Orphan(id))?;
        match self.node(index).page.has_slots() {
            true => Ok(Some((index, slot))),
            false => Err(LinkError::Orphan(id)),
        }
    }

    /// More parts of a page: its enabled vertices stay as they are.
    fn replace(&mut self, index: Index, page: Page) -> Result<(), LinkError> {
        let node = self.node(index);
        let known = Known {
            parent: node.parent,
            promise: node.promise,
        };
        let bounds = self.vetted_bounds(&page, known)?;
        let squares = Squares::of(&bounds, page.id(), self.grid, &self.georef);
        let range = bounds.box_error(0, 0, 0).range;
        let world_box = self.world_box(page.id(), range);
        let node = self.node_mut(index);
        node.mesh.bounds = world_box;
        let before = node.more_bytes();
        node.outlines = page.has_holes().then(|| Box::new(bounds));
        node.page = page;
        *node.squares = squares;
        node.stale_vertices = Stale::ALL;
        let more = node.more_bytes();
        self.more_bytes = self.more_bytes - before + more;
        self.mark_triangles(index);
        self.mark_around(index);
        self.changes += 1;
        Ok(())
    }

    /// A page's triangles are to be made anew.
    pub(super) fn mark_triangles(&mut self, index: Index) {
        self.node_mut(index).stale_triangles = true;
        self.list_stale(index);
    }

    fn mark_edge(&mut self, index: Index, edge: Edge) {
        self.node_mut(index).stale_vertices.add_edge(edge);
        self.list_stale(index);
    }

    fn list_stale(&mut self, index: Index) {
        let node = self.node_mut(index);
        if !std::mem::replace(&mut node.listed, true) {
            self.stale.push(index);
        }
    }

    /// The pages whose meshes may not be up to date, once each; from now on they are.
    pub(super) fn take_stale(&mut self) -> Vec<Index> {
        let mut stale = std::mem::take(&mut self.stale);
        stale.retain(|&index| {
            // Of pages that went, and whose place others took, either may be listed.
            let node = self.nodes[index as usize].as_mut();
            node.is_some_and(|node| std::mem::replace(&mut node.listed, false))
        });
        stale
    }

    /// A page has come, gone or changed: the vertices that the pages around share with it are
    /// stale. Those across a corner share one, on two of their edges.
    fn mark_around(&mut self, index: Index) {
        let neighbours = self.node(index).neighbours;
        for edge in Edge::ALL {
            let Some(neighbour) = neighbours[edge as usize] else {
                continue;
            };
            self.mark_edge(neighbour, edge.opposite());
            let beyond = self.node(neighbour).neighbours;
            for side in [Edge::South, Edge::North] {
                if matches!(edge, Edge::East | Edge::West)
                    && let Some(diagonal) = beyond[side as usize]
                {
                    self.mark_edge(diagonal, side.opposite());
                }
            }
        }
    }

    /// Pages that nothing on the screen needs, the longest unused first. Parents become idle when
    /// their children go.
    pub(super) fn idle(&self) -> Vec<PageId> {
        let nodes = self.nodes.iter().flatten();
        let mut idle: Vec<(u64, PageId)> = nodes
            .filter(|node| node.enabled == 0 && node.children.is_empty() && node.parent.is_some())
            .map(|node| (node.last_use, node.page.id()))
            .collect();
        idle.sort_unstable();
        idle.into_iter().map(|(_, id)| id).collect()
    }

    /// Unlinks an idle page; gives where it was.
    pub(super) fn unlink(&mut self, id: PageId) -> Option<Index> {
        let index = self.by_id.remove(&id)?;
        self.mark_around(index);
        let node = self.nodes[index as usize].take()?;
        self.free.push(index);
        self.triangles -= node.mesh.indices.len() as u64 / 3;
        self.more_bytes -= node.more_bytes();
        if let Some((parent, slot)) = node.parent {
            let above = self.node_mut(parent);
            above.children.retain(|&(_, child)| child != index);
            above.children_resident.set(slot, false);
        }
        for edge in Edge::ALL {
            if let Some(neighbour) = node.neighbours[edge as usize] {
                self.node_mut(neighbour).neighbours[edge.opposite() as usize] = None;
            }
        }
        self.changes += 1;
        Some(index)
    }

    /// The resident child in a slot.
    pub(super) fn child(&self, index: Index, slot: Slot) -> Option<Index> {
        let node = self.node(index);
        let place = node.children_resident.before(slot);
        let resident = node.children_resident.has(slot);
        resident.then(|| node.children[place].1)
    }

    /// A square by its parent's page: in that page, or the root of a resident child page.
    pub(super) fn square_below(
        &self,
        index: Index,
        child: PageSquare,
    ) -> Option<(Index, PageSquare)> {
        if child.level < 4 {
            return Some((index, child));
        }
        let slot = Slot::at(child.column as usize, child.row as usize);
        self.child(index, slot).map(|page| (page, PageSquare::ROOT))
    }

    /// Which vertices were enabled and disabled since the last time, of the two that are one across
    /// a border only one. They are to be given back emptied, for their room.
    pub(super) fn take_flips(&mut self) -> Vec<(VertexRef, bool)> {
        self.flips.as_mut().map(std::mem::take).unwrap_or_default()
    }

    pub(super) fn give_back_flips(&mut self, emptied: Vec<(VertexRef, bool)>) {
        if let Some(flips) = self.flips.as_mut().filter(|flips| flips.is_empty()) {
            *flips = emptied;
        }
    }

    /// A page that needs no record, as the page above has it; `None` if it is resident already.
    pub(super) fn implied(&self, id: PageId) -> Option<Page> {
        let (above, slot) = id.parent().filter(|_| !self.by_id.contains_key(&id))?;
        self.page(above)?.implied_child(slot, self.grid)
    }
}
