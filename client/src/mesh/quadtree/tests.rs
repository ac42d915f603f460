//! The mesher that skips, held against one that tests everything from nothing.

use super::*;
use crate::mesh::mesher::MeshOptions;
use crate::mesh::place::PageSquare;
use escarp_proto::geometry::{GridLevels, PAGE_CELLS, PAGE_SAMPLES, PAGE_SLOTS, Slot};
use escarp_proto::georef::{Georef, Plane};
use escarp_proto::page::{ChildSlot, PAGE_AREA, Page};
use proptest::prelude::*;

/// Tests every triangle whose square is enabled, in the plainest way.
struct Naive {
    sight: Sight,
    excess: f64,
}

impl Naive {
    fn page(&mut self, surface: &mut Surface, index: Index) {
        self.square(surface, index, PageSquare::ROOT);
        for (_, child) in surface.node(index).children.clone() {
            if surface.is_enabled((child, PageSquare::ROOT.centre() as u16)) {
                self.page(surface, child);
            }
        }
    }

    fn square(&mut self, surface: &mut Surface, index: Index, square: PageSquare) {
        for edge in Edge::ALL {
            let seen = self.sight.edge(surface.node(index), square, edge);
            let vertex = (index, square.edge(edge) as u16);
            surface.ask(vertex, edge.into(), seen.fails(), seen.excess());
            if !surface.is_enabled(vertex) {
                self.stands(&seen);
            }
        }
        for quadrant in Quadrant::ALL {
            let corner = |edge: Edge| surface.is_enabled((index, square.edge(edge) as u16));
            if !quadrant.edges().into_iter().any(corner) {
                continue;
            }
            let seen = self.sight.quadrant(surface.node(index), square, quadrant);
            if let Some((page, below)) = surface.square_below(index, square.child(quadrant)) {
                let centre = (page, below.centre() as u16);
                surface.ask(centre, Asker::First, seen.fails(), seen.excess());
                if surface.is_enabled(centre) {
                    if page == index {
                        self.square(surface, page, below);
                    }
                    continue;
                }
            }
            self.stands(&seen);
        }
    }

    fn stands(&mut self, seen: &Seen) {
        if self.sight.frustum.may_see(&seen.region) {
            self.excess = self.excess.max(seen.excess());
        }
    }
}

const GRID: u8 = 8;
pub(in crate::mesh) const SPACING_M: f64 = 10.0;

pub(in crate::mesh) fn georef() -> Georef {
    Georef {
        origin_m: [1000.0, -500.0],
        sample_spacing_m: [SPACING_M; 2],
        quantum_m: 0.5,
        plane: Plane::Local,
    }
}

pub(in crate::mesh) fn grid() -> GridLevels {
    GridLevels::new(GRID).unwrap()
}

fn hash(x: u32, y: u32) -> u32 {
    let mixed = (x ^ y.rotate_left(16)).wrapping_mul(0x9e37_79b9);
    (mixed ^ mixed >> 15).wrapping_mul(0x85eb_ca6b) >> 8
}

/// A ridge, a plain, roughness here and there, and a lake without data.
pub(in crate::mesh) fn height(x: u32, y: u32) -> Option<i32> {
    let (fx, fy) = (f64::from(x), f64::from(y));
    let lake = (fx - 60.0).hypot(fy - 190.0) < 25.0;
    let ridge = 400.0 * (-((fx - fy) / 40.0).powi(2)).exp();
    let rough = if (x / 64 + y / 64).is_multiple_of(2) {
        hash(x, y) % 60
    } else {
        0
    };
    (!lake).then(|| (ridge + 30.0 * (fx / 17.0).sin()) as i32 + rough as i32)
}

/// The root page and the 256 below it.
pub(in crate::mesh) fn pages() -> Vec<Page> {
    let cells = PAGE_CELLS as u32;
    let samples = |x: u32, y: u32, stride: u32| -> ([i32; PAGE_AREA], [bool; PAGE_AREA]) {
        let place = |i: usize| {
            let (column, row) = ((i % PAGE_SAMPLES) as u32, (i / PAGE_SAMPLES) as u32);
            height(x + column * stride, y + row * stride)
        };
        (
            std::array::from_fn(|i| place(i).unwrap_or(0)),
            std::array::from_fn(|i| place(i).is_some()),
        )
    };
    let page = |id, (heights, valid): ([i32; PAGE_AREA], [bool; PAGE_AREA]), slots| {
        let valid = valid.contains(&false).then(|| Box::new(valid));
        Page::with_slot(id, Box::new(heights), valid, slots).unwrap()
    };
    let mut slots = [ChildSlot::Empty; PAGE_SLOTS];
    let mut below = Vec::new();
    for (i, told) in slots.iter_mut().enumerate() {
        let slot = Slot::from_index(i as u8);
        let (column, row) = slot.position();
        let id = PageId::ROOT.child(slot).unwrap();
        let (finest, promise) = page(
            id,
            samples(column as u32 * cells, row as u32 * cells, 1),
            None,
        );
        *told = promise;
        if promise.has_record() {
            below.push(finest);
        }
    }
    let root = page(PageId::ROOT, samples(0, 0, cells), Some(Box::new(slots))).0;
    std::iter::once(root).chain(below).collect()
}

/// One frame of a flight.
#[derive(Debug, Clone, Copy)]
struct Step {
    /// Way of the eye, metres: or where it jumps to, from 0 to 1 across the terrain.
    way_m: [f64; 3],
    jump: Option<[f64; 3]>,
    turn: f32,
    error_px: f32,
    links: usize,
    unlinks: usize,
}

fn step() -> impl Strategy<Value = Step> {
    let way = prop_oneof![Just(0.0), Just(1e-7), Just(0.02), Just(3.0), Just(90.0),];
    let error_px = prop_oneof![8 => Just(None), 3 => (0.99f32..1.01).prop_map(Some), 1 => (0.5f32..2.0).prop_map(Some)];
    (
        (way, prop::array::uniform3(-1.0f64..1.0)),
        prop::option::weighted(0.08, prop::array::uniform3(0.0f64..1.0)),
        -3.0f32..3.0,
        error_px,
        0usize..8,
        prop_oneof![5 => Just(0usize), 1 => 0usize..6],
    )
        .prop_map(
            |((way_m, along), jump, turn, scaled, links, unlinks)| Step {
                way_m: along.map(|part| part * way_m),
                jump,
                turn,
                error_px: scaled.unwrap_or(1.0),
                links,
                unlinks,
            },
        )
}

pub(in crate::mesh) fn surface_of(pages: &[Page]) -> Surface {
    let mut surface = Surface::new(grid(), georef());
    for page in pages {
        surface.link(page.clone()).unwrap();
    }
    surface
}

/// Links what needs no record, as the tree does.
fn link_implied(surface: &mut Surface, mesher: &mut Quadtree) -> bool {
    let mut linked = false;
    for id in surface.wishes.take_implied() {
        if let Some(page) = surface.implied(id) {
            let index = surface.link(page).unwrap();
            mesher.linked(surface, index);
            linked = true;
        }
    }
    linked
}

fn fly(steps: &[Step], all: &[Page]) {
    let mut surface = surface_of(&all[..1]);
    let mut mesher = Quadtree::new(&MeshOptions::default());
    mesher.linked(&surface, 0);
    let side_m = f64::from(grid().cells_per_side()) * SPACING_M;
    let mut eye_m = [2000.0, 800.0, 300.0];
    let mut error_px = 2.0f32;
    for (frame, step) in steps.iter().enumerate() {
        for link in 0..step.links {
            let page = &all[1 + hash(frame as u32, link as u32) as usize % (all.len() - 1)];
            let index = surface.link(page.clone()).unwrap();
            mesher.linked(&surface, index);
        }
        for id in surface.idle().into_iter().take(step.unlinks) {
            let index = surface.unlink(id).unwrap();
            mesher.unlinked(index);
        }
        for (at_m, way_m) in eye_m.iter_mut().zip(step.way_m) {
            *at_m += way_m;
        }
        if let Some(jump) = step.jump {
            eye_m = [
                1000.0 + jump[0] * side_m,
                -500.0 + jump[1] * side_m,
                jump[2] * 3000.0,
            ];
        }
        error_px = (error_px * step.error_px).clamp(0.5, 32.0);
        let view = View {
            eye_m,
            direction: [step.turn.cos(), step.turn.sin(), -0.3],
            velocity_m_s: [0.0; 3],
            fov_y: 1.0,
            viewport_px: [1280, 720],
            max_screen_error_px: error_px,
        };
        let found = loop {
            surface.updates += 1;
            surface.wishes.clear();
            assert!(surface.enable_root());
            let found = mesher.update(&mut surface, &view);
            if !link_implied(&mut surface, &mut mesher) {
                break found;
            }
        };
        let mut resident: Vec<Page> = surface.pages().cloned().collect();
        resident.sort_by_key(|page| page.id().key());
        let mut anew = surface_of(&resident);
        anew.enable_root();
        let mut naive = Naive {
            sight: Sight::of(&anew, &view),
            excess: 0.0,
        };
        naive.page(&mut anew, 0);
        // Of the triangles that stand in the end, those that others split meanwhile left out.
        naive.excess = 0.0;
        naive.page(&mut anew, 0);
        assert_eq!(surface.flags(), anew.flags(), "frame {frame}");
        assert!(found.excess >= naive.excess, "frame {frame}");
        assert!(found.excess <= naive.excess.max(1.0), "frame {frame}");
        let triangles = surface.triangulate();
        assert_eq!(triangles, anew.triangulate(), "frame {frame}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn every_frame_of_any_flight_has_the_flags_of_a_full_update_from_nothing(
        steps in prop::collection::vec(step(), 1..40)
    ) {
        fly(&steps, &pages());
    }
}

#[test]
fn a_still_eye_and_a_turning_head_test_nothing_and_a_step_tests_little() {
    let all = pages();
    let mut surface = surface_of(&all);
    let mut mesher = Quadtree::new(&MeshOptions::default());
    for index in 0..all.len() {
        mesher.linked(&surface, index as Index);
    }
    let mut update = |eye_m, turn: f32, error_px| {
        let view = View {
            eye_m,
            direction: [turn.cos(), turn.sin(), -0.3],
            velocity_m_s: [0.0; 3],
            fov_y: 1.0,
            viewport_px: [1280, 720],
            max_screen_error_px: error_px,
        };
        loop {
            surface.wishes.clear();
            surface.enable_root();
            let found = mesher.update(&mut surface, &view);
            if !link_implied(&mut surface, &mut mesher) {
                return found.squares;
            }
        }
    };
    let eye_m = [2103.0, 811.0, 333.0];
    let cold = update(eye_m, 0.0, 4.0);
    // What came into the mesh for others' sake alone may be tested once.
    update(eye_m, 0.1, 4.0);
    for turn in 0..10 {
        assert_eq!(update(eye_m, turn as f32, 4.0), 0);
    }
    let steps = (1..=50).map(|i| update([2103.0 + 0.02 * f64::from(i), 811.0, 333.0], 0.0, 4.0));
    let tested: u64 = steps.sum();
    assert!(tested < cold, "{tested} in 50 steps of 2 cm, {cold} cold");
    let near = update([2104.0, 811.0, 333.0], 0.0, 4.004);
    assert!(
        near < cold / 4,
        "{near} after a tolerance a thousandth wider, {cold} cold"
    );
}
