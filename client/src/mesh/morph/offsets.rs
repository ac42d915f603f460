//! Displayed heights and normals: from coarse to fine.
//!
//! `z(v) = (z(a) + z(b)) / 2 + m(v) s(v)`, as a difference to `h(v)`; and so for normals, which are
//! what shading goes by.

use super::super::page_mesh::{Offset, Vertex};
use super::super::place::PageSquare;
use super::super::surface::{Index, Node, Surface};
use super::order::{NOWHERE, Step, TIERS, diagonal};
use super::{Morph, ROOT_CENTRE, Weights, page_level, weight};
use escarp_proto::geometry::{PAGE_CELLS, PAGE_SAMPLES, Quadrant};
use escarp_proto::page::PAGE_AREA;

type Offsets = [Offset; PAGE_AREA];

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

    /// Turns the normals of displayed vertices, once the pages have their normals: of pages whose
    /// offsets or normals are new, and of those below them.
    pub(in super::super) fn turn(&mut self, surface: &mut Surface) {
        let mut pages: Vec<(u8, Index)> = (0..)
            .zip(&surface.nodes)
            .filter_map(|(index, node)| Some((index, node.as_ref()?)))
            .filter(|(_, node)| node.mesh.offsets.is_some() && !node.mesh.vertices.is_empty())
            .map(|(index, node)| (node.page.id().level(), index))
            .collect();
        pages.sort_unstable();
        for (_, index) in pages {
            let node = surface.node(index);
            let above = node
                .parent
                .map_or(0, |(parent, _)| surface.node(parent).mesh.offset_stamp);
            let stamps = [node.mesh.vertex_stamp, node.mesh.offset_stamp, above];
            let place = &mut self.places[index as usize];
            let Some(known) = place.known.as_ref().filter(|_| place.turned != stamps) else {
                continue;
            };
            let offsets = turns(surface, node, &known.all);
            surface.stamps += 1;
            let stamp = surface.stamps;
            place.turned = [stamps[0], stamp, stamps[2]];
            let mesh = &mut surface.node_mut(index).mesh;
            (mesh.offsets, mesh.offset_stamp) = (Some(offsets), stamp);
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
            self.known -= 1;
        }
        let shown = surface.node(index).mesh.offsets.as_deref();
        let same = match (shown, &offsets) {
            (Some(shown), Some(offsets)) => {
                shown.iter().zip(offsets).all(|(a, b)| a.rise == b.rise)
            }
            (shown, offsets) => shown.is_none() && offsets.is_none(),
        };
        if same {
            return false;
        }
        show(surface, index, offsets, span_m);
        true
    }
}

/// Gives a page's mesh its offsets, and bounds that hold them.
fn show(surface: &mut Surface, index: Index, offsets: Option<Offsets>, span_m: [f64; 2]) {
    let all = offsets.iter().flatten();
    let (low, high) = all.fold((0.0f32, 0.0f32), |(low, high), offset| {
        (low.min(offset.rise), high.max(offset.rise))
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

/// The offsets of a page's vertices, turns left out; `None` if all have weight 1.
fn offsets(surface: &Surface, index: Index, weights: &Weights) -> Option<Offsets> {
    if weights.iter().all(|&byte| byte == 0 || byte == u8::MAX) {
        return None;
    }
    let node = surface.node(index);
    let mut offsets = corners(surface, node);
    each_step(node, |step| {
        if let Some(share) = lacks(weights, step) {
            let [a, b] = step.ends.map(usize::from);
            let height = |sample: usize| i64::from(node.page.height(sample));
            let vertex = step.vertex as usize;
            let surplus = (2 * height(vertex) - (height(a) + height(b))) as f64 / 2.0;
            let ends = (f64::from(offsets[a].rise) + f64::from(offsets[b].rise)) / 2.0;
            offsets[vertex].rise = (ends - share * surplus) as f32;
        }
    });
    Some(offsets)
}

/// Turns of a page's vertices: what its normals lack, in the same way as heights.
fn turns(surface: &Surface, node: &Node, weights: &Weights) -> Vec<Offset> {
    let shown = node.mesh.offsets.iter().flatten();
    let mut offsets: Vec<Offset> = shown.copied().collect();
    let from = corners(surface, node);
    for sample in CORNERS.map(|(x, y)| (y * PAGE_SAMPLES + x) * PAGE_CELLS) {
        offsets[sample].half_turn = from[sample].half_turn;
    }
    let vertices: &[Vertex] = &node.mesh.vertices;
    each_step(node, |step| {
        if let Some(share) = lacks(weights, step) {
            let [a, b] = step.ends.map(usize::from);
            let vertex = step.vertex as usize;
            offsets[vertex].half_turn = std::array::from_fn(|axis| {
                let normal = |sample: usize| f64::from(vertices[sample].normal[axis]);
                let turn = |sample: usize| f64::from(offsets[sample].half_turn[axis]);
                let surplus = normal(vertex) - (normal(a) + normal(b)) / 2.0;
                ((turn(a) + turn(b)) / 2.0 - share * surplus / 2.0).round() as i16
            });
        }
    });
    offsets
}

/// The share of its surplus that a vertex lacks; `None` if it is not enabled, and so nowhere, or
/// has weight 1, so that it, and all above it, is where it belongs.
fn lacks(weights: &Weights, step: &Step) -> Option<f64> {
    let byte = weights[step.vertex as usize];
    (byte > 0 && byte < u8::MAX).then(|| 1.0 - weight(byte))
}

/// Offsets of a page's corners, as the page above has them.
fn corners(surface: &Surface, node: &Node) -> Offsets {
    let mut offsets = [Offset::default(); PAGE_AREA];
    let above = node.parent.and_then(|(parent, slot)| {
        let above = surface.node(parent).mesh.offsets.as_ref()?;
        Some((above, slot.position()))
    });
    if let Some((above, (column, row))) = above {
        for (x, y) in CORNERS {
            let sample = (row + y) * PAGE_SAMPLES + column + x;
            offsets[(y * PAGE_SAMPLES + x) * PAGE_CELLS] = above[sample];
        }
    }
    offsets
}

/// Visits a page's vertices, those that others come from first.
fn each_step(node: &Node, mut visit: impl FnMut(&Step)) {
    let slot = node.parent.map_or((0, 0), |(_, slot)| slot.position());
    let quadrant = Quadrant::of(slot.0 as u32, slot.1 as u32);
    visit(&Step {
        ends: diagonal(PageSquare::ROOT, quadrant),
        ..TIERS[0].centres[0]
    });
    for tier in TIERS.iter() {
        let centres = tier.centres.iter().filter(|step| step.ends[0] != NOWHERE);
        let border = tier.border.iter().map(|(_, step)| step);
        centres
            .chain(&tier.inner)
            .chain(border)
            .for_each(&mut visit);
    }
}
