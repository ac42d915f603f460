//! Where the bytes are from that a view lists and its mesh does not use: the figures under Layers in
//! `docs/streaming.md`.
//!
//! `cargo run --release -p escarp-tests --example surplus -- DATASET...`

use anyhow::{Context, Result};
use escarp_proto::geometry::PageId;
use escarp_proto::georef::WorldBox;
use escarp_proto::page::Bounds;
use escarp_proto::select::{Eyes, Look, Need, Scope};
use escarp_proto::view::{Tests, View, error_m};
use escarp_tests::nets::convergence::views;
use escarp_tests::report::leave_out::parts_of;
use escarp_tests::selected::{AllPages, decoded, part_bytes, select, select_for, tree_of};
use escarp_tiles::dataset::Dataset;
use std::collections::HashMap;
use std::path::Path;

const NO_LIMIT: usize = 1 << 20;
const CAUSES: [&str; 5] = [
    "for the sake of other pages",
    "a bound in one byte, rounded up",
    "one bound for four quarters of a page",
    "one bound for all squares of a quarter",
    "bounds of squares whose vertices are not enabled",
];

fn main() -> Result<()> {
    for path in std::env::args_os().skip(1) {
        let path = Path::new(&path);
        let dataset = Dataset::open(path)?;
        let name = path.file_stem().context("a file name")?.to_string_lossy();
        let [first, second] = views(&dataset, 2.0)?;
        let mut known = AllPages::new(&dataset);
        let way = way(&mut known, &dataset, &first);
        println!(
            "{name}: half a second at 150 m/s lists {way:.3} times the bytes of where it begins"
        );
        let mut needs = |view: &View| select(&mut known, view, Scope::All, NO_LIMIT).0;
        let (before, after) = (needs(&first), needs(&second));
        let had = before
            .iter()
            .map(|need| (need.page, need.last_part))
            .collect();
        show(
            &format!("{name}, from nothing"),
            &dataset,
            &first,
            &before,
            &HashMap::new(),
        );
        show(
            &format!("{name}, after a teleport"),
            &dataset,
            &second,
            &after,
            &had,
        );
    }
    Ok(())
}

/// What is listed for the next 75 m and a quarter of that beside them, over what is for one place.
fn way(known: &mut AllPages<'_>, dataset: &Dataset, view: &View) -> f64 {
    let length = view
        .direction
        .iter()
        .map(|v| f64::from(v * v))
        .sum::<f64>()
        .sqrt();
    let end_m =
        std::array::from_fn(|i| view.eye_m[i] + f64::from(view.direction[i]) / length * 75.0);
    let mut bytes = |eyes: Eyes| {
        let scope = Scope::All;
        let (needs, _) = select_for(known, Look { view, eyes, scope }, NO_LIMIT);
        let bytes = needs
            .iter()
            .map(|need| part_bytes(dataset, need.page, need.last_part));
        bytes.sum::<usize>() as f64
    };
    bytes(Eyes::between(view.eye_m, end_m, 75.0 / 4.0)) / bytes(Eyes::at(view.eye_m))
}

fn show(title: &str, dataset: &Dataset, view: &View, needs: &[Need], had: &HashMap<PageId, u8>) {
    let mut known = AllPages::new(dataset);
    let mut tree = tree_of(dataset, needs);
    tree.update(view);
    let used = parts_of(&tree);
    let (mut received, mut surplus) = (0, [0; CAUSES.len()]);
    for need in needs {
        let first = had.get(&need.page).map_or(0, |&last| last + 1);
        let bytes = |part: i32| match part < i32::from(first) {
            true => match first {
                0 => 0,
                first => part_bytes(dataset, need.page, first - 1),
            },
            false => part_bytes(dataset, need.page, part as u8),
        };
        received += bytes(need.last_part.into()) - bytes(-1);
        let used = used.last_used(need.page).map_or(-1, i32::from);
        let mut last = i32::from(need.last_part);
        for (cause, bytes_of) in surplus.iter_mut().enumerate() {
            let enough = match cause {
                4 => used,
                _ => enough(dataset, &mut known, view, need, cause).into(),
            };
            let next = enough.clamp(used, last.max(used));
            *bytes_of += bytes(last.max(used)) - bytes(next);
            last = next;
        }
    }
    let all: usize = surplus.iter().sum();
    let over = |bytes: usize| bytes as f64 / (received - all) as f64;
    println!(
        "{title}: {received} bytes, {:.3} of those used",
        1.0 + over(all)
    );
    for (cause, bytes) in CAUSES.iter().zip(surplus) {
        println!("  {:.3} {cause}", over(bytes));
    }
}

/// The fewest parts of a page that would be within the tolerance, if its bounds were as coarse as
/// this: rounded, exact, by quarter, by square.
fn enough(
    dataset: &Dataset,
    known: &mut AllPages<'_>,
    view: &View,
    need: &Need,
    exact: usize,
) -> u8 {
    let Some(bounds) = known.bounds(need.page) else {
        return need.last_part;
    };
    let page = decoded(dataset, need.page, None).expect("a record");
    if page.has_holes() {
        return need.last_part;
    }
    let passes = |part: u8| {
        let squares = 1usize << part;
        let most = |quarter: Option<[usize; 2]>| {
            let halves = |i: usize| 2 * i / squares;
            let within = |c, r| quarter.is_none_or(|[x, y]| halves(c) == x && halves(r) == y);
            let all = (0..squares * squares).map(|i| (i % squares, i / squares));
            let all = all.filter(|&(c, r)| within(c, r));
            all.map(|(c, r)| bounds.box_error(part, c, r).error)
                .max()
                .unwrap_or(0)
        };
        (0..squares * squares).all(|i| {
            let (column, row) = (i % squares, i / squares);
            let error = match exact {
                0 => page.rest_bound(part),
                1 => most(None),
                2 => most(Some([2 * column / squares, 2 * row / squares])),
                _ => bounds.box_error(part, column, row).error,
            };
            is_within(
                dataset,
                &bounds,
                view,
                need.page,
                (part, column, row),
                error,
            )
        })
    };
    (1..need.last_part.min(5))
        .find(|&part| passes(part))
        .unwrap_or(need.last_part)
}

/// Whether a square of a page passes with an error.
fn is_within(
    dataset: &Dataset,
    bounds: &Bounds,
    view: &View,
    page: PageId,
    (level, column, row): (u8, usize, usize),
    error: u32,
) -> bool {
    let (grid, georef) = (dataset.grid(), &dataset.manifest().georef);
    let known = bounds.box_error(level, column, row);
    let below = page.level() + level;
    if below >= grid.get() {
        return true;
    }
    let side = grid.square_cells(below);
    let (x, y) = grid.page_origin(page);
    let (x, y) = (x + column as u32 * side, y + row as u32 * side);
    let region = WorldBox {
        min: [
            georef.world_x(x),
            georef.world_y(y),
            georef.world_z(known.range.lo),
        ],
        max: [
            georef.world_x(x + side),
            georef.world_y(y + side),
            georef.world_z(known.range.hi),
        ],
    };
    let error_m = error_m(
        error,
        known.kind,
        georef.quantum_m,
        georef.half_diagonal_m(side),
    );
    let (reach_m, distance_m) = Tests::of(view).sides(error_m, &region);
    reach_m <= distance_m
}
