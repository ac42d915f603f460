//! Displayed heights: from coarse to fine.

use super::super::place::PageSquare;
use super::super::surface::{Index, Surface};
use super::order::{NOWHERE, Step, TIERS, diagonal};
use super::{Morph, ROOT_CENTRE, Weights, page_level, weight};
use escarp_proto::geometry::{PAGE_CELLS, PAGE_SAMPLES, Quadrant};
use escarp_proto::page::{PAGE_AREA, Page};

/// How far each vertex is displayed above its height, quanta.
type Offsets = [f32; PAGE_AREA];

/// The corners of a page.
const CORNERS: [(usize, usize); 4] = [(0, 0), (1, 0), (0, 1), (1, 1)];

impl Morph {
    /// Moves the vertices of listed pages, and of the pages below them where those move with them.
    /// The lists are empty afterwards.
    pub(super) fn displace(&mut self, surface: &mut Surface) {
        for level in 0..self.lists.len() {
            let mut list = std::mem::take(&mut self.lists[level]);
            for page in list.drain(..) {
                self.places[page as usize].listed = false;
                if self.displace_page(surface, page) {
                    self.list_below(surface, page);
                }
            }
            self.lists[level] = list;
        }
    }

    fn list_below(&mut self, surface: &Surface, page: Index) {
        for &(_, child) in &surface.node(page).children {
            let known = self.places[child as usize].known.is_some();
            debug_assert_eq!(page_level(surface, child), page_level(surface, page) + 1);
            if known {
                self.list(surface, child);
            }
        }
    }

    /// Moves the vertices of a page. Whether any has moved.
    fn displace_page(&mut self, surface: &mut Surface, index: Index) -> bool {
        let place = &mut self.places[index as usize];
        let Some(known) = &place.known else {
            return false;
        };
        let (any, span_m) = (known.all[ROOT_CENTRE] > 0, known.span_m);
        let offsets = match any {
            true => offsets(surface, index, &known.all),
            false => None,
        };
        if !any {
            place.known = None;
        }
        let mesh = &surface.node(index).mesh;
        if mesh.offsets.as_deref() == offsets.as_ref().map(|offsets| &offsets[..]) {
            return false;
        }
        show(surface, index, offsets, span_m);
        true
    }
}

/// Gives a page's mesh its offsets, and bounds that hold them.
fn show(surface: &mut Surface, index: Index, offsets: Option<Offsets>, span_m: [f64; 2]) {
    let all = offsets.iter().flatten();
    let (low, high) = all.fold((0.0f32, 0.0f32), |(low, high), &offset| {
        (low.min(offset), high.max(offset))
    });
    let [low_m, high_m] = [low, high].map(|quanta| f64::from(quanta) * surface.georef.quantum_m);
    surface.stamps += 1;
    let stamp = surface.stamps;
    let mesh = &mut surface.node_mut(index).mesh;
    mesh.bounds.min[2] = span_m[0] + low_m;
    mesh.bounds.max[2] = span_m[1] + high_m;
    mesh.offsets = offsets.map(Vec::from);
    mesh.offset_stamp = stamp;
}

/// The offsets of a page's vertices; `None` if all are 0.
fn offsets(surface: &Surface, index: Index, weights: &Weights) -> Option<Offsets> {
    let node = surface.node(index);
    let mut offsets = [0.0; PAGE_AREA];
    let mut quadrant = Quadrant::SouthWest;
    if let Some((parent, slot)) = node.parent {
        let (column, row) = slot.position();
        quadrant = Quadrant::of(column as u32, row as u32);
        if let Some(above) = &surface.node(parent).mesh.offsets {
            for (x, y) in CORNERS {
                let sample = (row + y) * PAGE_SAMPLES + column + x;
                offsets[y * PAGE_CELLS * PAGE_SAMPLES + x * PAGE_CELLS] = above[sample];
            }
        }
    }
    let root = Step {
        ends: diagonal(PageSquare::ROOT, quadrant),
        ..TIERS[0].centres[0]
    };
    place(&node.page, weights, &root, &mut offsets);
    for tier in TIERS.iter() {
        let centres = tier.centres.iter().filter(|step| step.ends[0] != NOWHERE);
        let border = tier.border.iter().map(|(_, step)| step);
        for step in centres.chain(&tier.inner).chain(border) {
            place(&node.page, weights, step, &mut offsets);
        }
    }
    offsets
        .iter()
        .any(|&offset| offset != 0.0)
        .then_some(offsets)
}

/// `z(v) = (z(a) + z(b)) / 2 + m(v) s(v)`, as a difference to `h(v)`.
fn place(page: &Page, weights: &Weights, step: &Step, offsets: &mut Offsets) {
    let vertex = step.vertex as usize;
    let byte = weights[vertex];
    // What is not enabled is nowhere; with weight 1 a vertex, and all above it, is at its height.
    if byte == 0 || byte == u8::MAX {
        return;
    }
    let [a, b] = step.ends.map(usize::from);
    let height = |sample: usize| i64::from(page.height(sample));
    let surplus = (2 * height(vertex) - (height(a) + height(b))) as f64 / 2.0;
    let ends = (f64::from(offsets[a]) + f64::from(offsets[b])) / 2.0;
    offsets[vertex] = (ends - (1.0 - weight(byte)) * surplus) as f32;
}
