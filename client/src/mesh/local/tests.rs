//! Held against errors and distances worked out anew from the heights, vertex by vertex.

use super::*;
use crate::mesh::quadtree::tests::{SPACING_M, georef, height, pages, surface_of};
use escarp_proto::geometry::PAGE_SAMPLES;
use escarp_proto::page::{PAGE_AREA, Page};

fn view(eye_m: [f64; 3], error_px: f32) -> View {
    View {
        eye_m,
        direction: [0.6, 0.8, -0.3],
        velocity_m_s: [0.0; 3],
        fov_y: 1.0,
        viewport_px: [1280, 720],
        max_screen_error_px: error_px,
    }
}

fn update(surface: &mut Surface, mesher: &mut LocalQuadtree, view: &View) -> Found {
    loop {
        surface.updates += 1;
        surface.wishes.clear();
        surface.enable_root();
        let found = mesher.update(surface, view);
        let implied = surface.wishes.take_implied();
        if implied.is_empty() {
            assert_eq!(surface.wishes.len(), 0, "all pages are there");
            return found;
        }
        for id in implied {
            if let Some(page) = surface.implied(id) {
                let index = surface.link(page).unwrap();
                mesher.linked(surface, index);
            }
        }
    }
}

fn whole() -> (Surface, LocalQuadtree) {
    let surface = surface_of(&pages());
    let mut mesher = LocalQuadtree::default();
    for page in 0..surface.nodes.len() {
        mesher.linked(&surface, page as Index);
    }
    (surface, mesher)
}

/// Error and distance of an edge vertex, metres.
fn plainly(node: &Node, square: PageSquare, edge: Edge, eye_m: [f64; 3]) -> Option<(f64, f64)> {
    let at = |sample: usize| {
        let place = [sample % PAGE_SAMPLES, sample / PAGE_SAMPLES];
        let [x, y] = [0, 1].map(|i| node.mesh.origin[i] + place[i] as u32 * node.mesh.stride);
        let z = f64::from(height(x, y)?) * georef().quantum_m;
        Some([
            georef().origin_m[0] + f64::from(x) * SPACING_M,
            georef().origin_m[1] + f64::from(y) * SPACING_M,
            z,
        ])
    };
    let vertex = at(square.edge(edge))?;
    let [from, to] = square.ends(edge).map(at);
    let error_m = (vertex[2] - (from?[2] + to?[2]) / 2.0).abs();
    let away = (0..3).map(|axis| (vertex[axis] - eye_m[axis]).abs());
    Some((error_m, away.fold(0.0, f64::max)))
}

#[test]
fn a_vertex_is_asked_for_just_where_its_own_error_reaches_the_eye() {
    let (mut surface, mut mesher) = whole();
    let (mut near, mut far) = (0, 0);
    for (eye_m, error_px) in [
        ([2103.0, 811.0, 333.0], 1.0),
        ([1500.0, 1500.0, 120.0], 4.0),
        ([9000.0, -2000.0, 900.0], 2.0),
    ] {
        let view = view(eye_m, error_px);
        update(&mut surface, &mut mesher, &view);
        for index in 0..surface.nodes.len() as Index {
            for place in &PLACES {
                for edge in Edge::ALL {
                    let node = surface.node(index);
                    if is_outline(node, place.square, edge) {
                        continue;
                    }
                    let Some((error_m, away_m)) = plainly(node, place.square, edge, eye_m) else {
                        continue;
                    };
                    let state = surface.state((index, place.edges[edge as usize]));
                    let reach_m = error_m * view.threshold();
                    if reach_m > away_m * (1.0 + 1e-9) {
                        assert!(state.is_asked_by(edge.into()), "{reach_m} m at {away_m} m");
                        near += 1;
                    }
                    // Rounded up, to a 128th at most.
                    if reach_m * (1.0 + 1.0 / 128.0) <= away_m {
                        assert!(!state.is_asked_by(edge.into()), "{reach_m} m at {away_m} m");
                        far += 1;
                    }
                }
            }
        }
    }
    assert!(near > 1000 && far > 1000, "{near} asked for, {far} not");
}

#[test]
fn after_any_way_the_mesh_is_that_of_an_update_from_nothing() {
    let (mut surface, mut mesher) = whole();
    let mut seen = std::collections::HashSet::new();
    for step in 0..12 {
        let along = f64::from(step);
        let eye_m = match step % 4 {
            3 => [1100.0, 1900.0, 60.0],
            _ => [1200.0 + 150.0 * along, 300.0 + 90.0 * along, 200.0],
        };
        let view = view(eye_m, 1.0 + (step % 3) as f32);
        let found = update(&mut surface, &mut mesher, &view);
        let mut fresh = whole();
        // What needs no record is resident there as well, and may be enabled or not.
        let again = update(&mut fresh.0, &mut fresh.1, &view);
        assert_eq!(surface.flags(), fresh.0.flags(), "step {step}");
        assert_eq!(found.excess, again.excess, "step {step}");
        seen.insert(surface.triangulate());
    }
    assert!(seen.len() > 5, "{seen:?}");
}

#[test]
fn a_square_has_the_largest_error_of_all_that_is_in_it_and_none_is_above_a_bound() {
    let surface = surface_of(&pages());
    let mut outlines = 0;
    for node in surface.nodes.iter().flatten() {
        let errors = Errors::of(node, georef().quantum_m);
        for (at, place) in PLACES.iter().enumerate() {
            let largest = errors.squares[at];
            assert!(largest <= node.squares.halves(at));
            for edge in Edge::ALL {
                let error = errors.edges[at][edge as usize];
                assert!(error <= largest);
                assert!(error <= node.squares.edges(at)[edge as usize]);
                outlines += u32::from(is_outline(node, place.square, edge));
            }
            for quadrant in Quadrant::ALL {
                assert!(errors.quadrant(node, at, quadrant) <= largest);
            }
        }
    }
    assert!(outlines > 100, "{outlines}");
}

#[test]
fn a_plane_has_no_errors_and_one_high_sample_is_seen_in_every_square_above_it() {
    let errors = |height: fn(i32, i32) -> i32| {
        let samples: [Option<i32>; PAGE_AREA] = std::array::from_fn(|sample| {
            let (x, y) = (sample % PAGE_SAMPLES, sample / PAGE_SAMPLES);
            Some(height(x as i32, y as i32))
        });
        let page = Page::new(PageId::ROOT, &samples, None).unwrap();
        let grid = escarp_proto::geometry::GridLevels::new(4).unwrap();
        let mut surface = Surface::new(grid, georef());
        let index = surface.link(page).unwrap();
        Errors::of(surface.node(index), georef().quantum_m)
    };
    let none = ErrorCode::default();
    let plane = errors(|x, y| 3 * x - 5 * y + 7);
    assert!(plane.squares.iter().all(|&error| error == none));
    // 40 quanta, of half a metre: the middle of the west edge of the square of level 3 from (2, 4) to (4, 6).
    let spike = errors(|x, y| if (x, y) == (2, 5) { 40 } else { 0 });
    for (at, place) in PLACES.iter().enumerate() {
        let square = place.square;
        let (side, [x, y]) = (square.side(), [square.column, square.row].map(usize::from));
        let holds =
            (x * side..=(x + 1) * side).contains(&2) && (y * side..=(y + 1) * side).contains(&5);
        let error = if holds { 20.0 } else { 0.0 };
        assert_eq!(spike.squares[at].metres(), error, "{square:?}");
    }
}
