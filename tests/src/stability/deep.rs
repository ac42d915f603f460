//! Grids as deep as there can be, and deeper.

use super::stage::{Found, examine, ground, over_meshers, view};
use super::{Case, Outcome};
use crate::measure::{check_cracks, plane_height, triangles};
use crate::terrain::FunctionSource;
use crate::terrain::TempDataset;
use escarp_client::mesh::{MeshOptions, MeshTree};
use escarp_proto::err8::Err8;
use escarp_proto::geometry::{
    GridLevels, MAX_GRID_LEVELS, PAGE_LEVELS, PAGE_SAMPLES, PAGE_SLOTS, PageId, Slot,
};
use escarp_proto::georef::{Georef, Plane};
use escarp_proto::page::{ChildSlot, PAGE_AREA, Page};
use escarp_tiles::build::Quantum;
use std::collections::HashMap;

/// Metres between samples: 26,844 km a side at the deepest.
const SPACING_M: f64 = 0.1;
/// Height of the bump, in quanta of a centimetre.
const BUMP: i32 = 900;

/// All cases.
pub fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for levels in [8, 16, 24, MAX_GRID_LEVELS] {
        for (name, slot) in [
            ("inside", (5, 9)),
            ("at the far corner", (15, 15)),
            ("at the near corner", (0, 0)),
        ] {
            cases.push(deep(levels, name, slot));
        }
    }
    cases.extend([deeper(), long()]);
    cases
}

/// A flat world with one bump, in a page of the finest level, and the pages above it alone.
struct Deep {
    grid: GridLevels,
    georef: Georef,
    pages: HashMap<PageId, Page>,
    /// Grid column and row of the bump.
    bump: (u32, u32),
}

impl Deep {
    fn new(levels: u8, (column, row): (usize, usize)) -> Option<Deep> {
        let grid = GridLevels::new(levels)?;
        let mut id = PageId::ROOT;
        while !grid.is_finest(id) {
            id = id.child(Slot::at(column, row))?;
        }
        let (x, y) = grid.page_origin(id);
        let mut heights = [0; PAGE_AREA];
        heights[7 * PAGE_SAMPLES + 9] = BUMP;
        let (mut page, mut slot) = Page::with_slot(id, Box::new(heights), None, None).ok()?;
        let mut pages = HashMap::new();
        while let Some((above, at)) = id.parent() {
            pages.insert(id, page);
            let mut slots = Box::new([ChildSlot::Full(Err8(0)); PAGE_SLOTS]);
            slots[at.index()] = slot;
            let flat = Box::new([0; PAGE_AREA]);
            (page, slot) = Page::with_slot(above, flat, None, Some(slots)).ok()?;
            id = above;
        }
        pages.insert(id, page);
        Some(Deep {
            grid,
            georef: Georef {
                origin_m: [-1e7, -1e7],
                sample_spacing_m: [SPACING_M; 2],
                quantum_m: 0.01,
                plane: Plane::Local,
            },
            pages,
            bump: (x + 9, y + 7),
        })
    }

    fn examine(&self, options: MeshOptions) -> Found {
        let mut found = Found::default();
        let mut tree = MeshTree::with_options(self.grid, self.georef.clone(), options);
        let (x, y) = self.bump;
        let bump = self.georef.world(x, y, BUMP);
        let near = view([bump[0] - 1.0, bump[1] - 1.5, 9.7], bump, 1.0);
        for _ in 0..200 {
            let stats = tree.update(&near);
            found.updates += 1;
            found.excess = stats.excess;
            let wishes = tree.wishes();
            if wishes.is_empty() {
                break;
            }
            for wish in wishes {
                match self.pages.get(&wish.page) {
                    Some(page) if tree.link(page.clone()).is_ok() => {}
                    _ => found.fault(format!("{wish:?} cannot be granted")),
                }
            }
        }
        let keeps = options.mesher.keeps_tolerance();
        if !tree.wishes().is_empty() || (keeps && (found.excess.is_nan() || found.excess > 1.0)) {
            found.fault(format!(
                "a bound of {} tolerances after {} updates",
                found.excess, found.updates
            ));
        }
        match check_cracks(&tree, self.grid.cells_per_side()) {
            Ok(triangles) => found.triangles = triangles,
            Err(why) => found.fault(why),
        }
        let deviation = self.deviation(&tree);
        if keeps && deviation > 0.0 {
            found.fault(format!("{deviation} quanta off around the bump"));
        }
        found
    }

    /// Largest distance from the surface at the samples of the bump's page, quanta.
    fn deviation(&self, tree: &MeshTree) -> f64 {
        let (x0, y0) = (self.bump.0 - 9, self.bump.1 - 7);
        let mut largest: f64 = 0.0;
        for triangle in triangles(tree) {
            for (x, y) in (0..17).flat_map(|x| (0..17).map(move |y| (x0 + x, y0 + y))) {
                if let Some(plane) = plane_height(&triangle, x, y) {
                    let height = if (x, y) == self.bump { BUMP } else { 0 };
                    largest = largest.max((plane - f64::from(height)).abs());
                }
            }
        }
        largest
    }
}

fn deep(levels: u8, name: &str, slot: (usize, usize)) -> Case {
    Case::new(
        format!("{levels} levels, a bump {name}, an eye beside it"),
        "no crack, converges within the tolerance, the bump is in the mesh",
        move || {
            let Some(deep) = Deep::new(levels, slot) else {
                return Outcome::of(false, "the pages cannot be made");
            };
            over_meshers(|options| {
                let found = deep.examine(options);
                let side_km = f64::from(deep.grid.cells_per_side()) * SPACING_M / 1e3;
                let measured = format!(
                    "{} triangles and {} updates for a side of {side_km:.3} km in steps of 10 cm",
                    found.triangles, found.updates
                );
                found.outcome_with(measured)
            })
        },
    )
}

/// A key has 28 levels' worth of bits; the mission's 31 are refused wherever they could come in.
fn deeper() -> Case {
    Case::new(
        "29 to 32 levels",
        "refused at every way in, where a text can be, with what is allowed",
        || {
            let mut found = Found::default();
            for levels in MAX_GRID_LEVELS + 1..=40 {
                if GridLevels::new(levels).is_some() {
                    found.fault(format!("a grid of {levels} levels"));
                }
                if let Ok(grid) = GridLevels::try_from(levels) {
                    found.fault(format!("{grid:?}"));
                }
                let level = levels - levels % PAGE_LEVELS;
                if PageId::new(level, 0, 0).is_some()
                    || PageId::from_key(u64::from(level) << 56).is_some()
                {
                    found.fault(format!("a page of level {level}"));
                }
            }
            if GridLevels::covering((1 << 28) + 2, 1).is_some() {
                found.fault("a grid of more than 2^28 + 1 samples");
            }
            let wide = FunctionSource::new((1 << 28) + 2, 1, |_, _| 0.0);
            match TempDataset::build_with(&mut { wide }, Quantum::Natural) {
                Err(error) if error.to_string().contains("allowed") => {}
                Err(error) => found.fault(format!("says no range: {error}")),
                Ok(_) => found.fault("a dataset of more than 2^28 + 1 samples a side"),
            }
            found.outcome_with(
                "28 levels are the most: 2^28 samples a side, 4 levels a page, keys of 64 bits",
            )
        },
    )
}

/// Depth from real files: one row of a million samples.
fn long() -> Case {
    Case::new(
        "one row of 1,048,600 samples (24 levels)",
        "no crack, converges; a row has no surface, so nothing is drawn",
        || {
            let data = ground(1_048_600, 1, |x, _| f64::from(x % 97));
            let middle = data.dataset.manifest().georef.world(524_300, 0, 0);
            let near = view([middle[0], middle[1] - 50.0, 20.0], middle, 1.0);
            over_meshers(|options| examine(&data, options, &[near]).outcome())
        },
    )
}
