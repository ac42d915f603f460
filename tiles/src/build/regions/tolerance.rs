//! How far each sample may be moved, and by which wish.

use super::mask::Mask;
use super::polygon::Polygons;
use crate::dem::{DemError, DemInfo, Grain};
use escarp_proto::manifest::Tolerance;
use std::path::{Path, PathBuf};

/// Regions that can be given.
pub const MAX_REGIONS: usize = 64;

/// A tolerance, and where it counts.
#[derive(Debug, Clone, PartialEq)]
pub struct Wish {
    /// The most that a stored sample may differ from its source, metres.
    pub tolerance_m: f64,
    /// GeoJSON of polygons, or a raster that is not 0 in the region; `None` is everywhere else.
    pub region: Option<PathBuf>,
}

/// For some rows, which samples a region reaches, and which lie so far inside that all cells
/// around them are wholly in it.
pub(super) struct Marks<'a> {
    pub(super) touched: &'a mut [bool],
    pub(super) core: &'a mut [bool],
}

enum Outline {
    Polygons(Polygons),
    Mask(Mask),
}

struct Region {
    tolerance_m: f64,
    name: String,
    outline: Outline,
}

/// The tolerances of a build: regions, the first that holds a place counts, and what counts
/// everywhere else.
pub struct Tolerances {
    regions: Vec<Region>,
    elsewhere_m: f64,
    base: Option<Base>,
    width: u32,
    touched: Vec<bool>,
    core: Vec<bool>,
    settled: Vec<bool>,
}

impl Tolerances {
    /// Reads the outlines of regions, which lie in the CRS of the source.
    ///
    /// # Errors
    /// [`DemError`] if a tolerance is no length, more than one counts everywhere, there are more
    /// than [`MAX_REGIONS`], or an outline cannot be read, or does not meet the source.
    pub fn open(wishes: &[Wish], info: &DemInfo) -> Result<Tolerances, DemError> {
        let usage = |what: String, hint: &str| Err(DemError::usage(&info.path, what, hint));
        if let Some(wrong) = wishes.iter().find(|wish| !is_length(wish.tolerance_m)) {
            let what = format!("a tolerance of {} m", wrong.tolerance_m);
            return usage(what, "give a length in metres, 0 or more");
        }
        let mut everywhere = wishes.iter().filter(|wish| wish.region.is_none());
        let elsewhere_m = everywhere.next().map_or(0.0, |wish| wish.tolerance_m);
        if everywhere.next().is_some() {
            let what = "two tolerances that count everywhere".into();
            return usage(what, "give one, and files for the others: M:FILE");
        }
        let mut regions = Vec::new();
        for wish in wishes {
            if let Some(path) = &wish.region {
                regions.push(Region::open(wish.tolerance_m, path, info)?);
            }
        }
        if regions.len() > MAX_REGIONS {
            let what = format!("{} regions", regions.len());
            return usage(what, "give 64 at most; one file may have many polygons");
        }
        Ok(Tolerances {
            regions,
            elsewhere_m,
            base: None,
            width: info.width,
            touched: Vec::new(),
            core: Vec::new(),
            settled: Vec::new(),
        })
    }

    /// Regions, the one everywhere else included, and that of coarser inputs.
    pub(super) fn len(&self) -> usize {
        self.regions.len() + 1 + usize::from(self.base.is_some())
    }

    /// Where only inputs coarser than the grid count, and no region does, heights may be moved by
    /// `tolerance_m`. If that is `None`, samples of theirs that are page corners stay, and heights
    /// between these may be moved by as much as the format rounds there.
    ///
    /// # Errors
    /// [`DemError::Usage`] if it is no length.
    pub fn with_base(
        mut self,
        tolerance_m: Option<f64>,
        quantum_m: f64,
        info: &DemInfo,
    ) -> Result<Tolerances, DemError> {
        if let Some(wrong) = tolerance_m.filter(|m| !is_length(*m)) {
            let what = format!("a tolerance of {wrong} m where only coarser inputs count");
            let hint = "give a length in metres, 0 or more";
            return Err(DemError::usage(&info.path, what, hint));
        }
        self.base = Some(Base {
            wished_m: tolerance_m,
            rounding_m: ROUNDING_QUANTA * quantum_m,
            height: info.height,
        });
        Ok(self)
    }

    /// The tolerance of each sample of some rows of the source, and the region that it lies in. A
    /// triangle that reaches into several regions has the smallest of their tolerances.
    pub(super) fn rows(
        &mut self,
        first_row: u32,
        rows: u32,
        grains: &[Grain],
        out: &mut Vec<(f64, u8)>,
    ) -> Result<(), DemError> {
        let samples = rows as usize * self.width as usize;
        let elsewhere = self.regions.len() as u8;
        out.clear();
        out.resize(samples, (f64::INFINITY, elsewhere));
        self.settled.clear();
        self.settled.resize(samples, false);
        for (number, region) in self.regions.iter_mut().enumerate() {
            for marks in [&mut self.touched, &mut self.core] {
                marks.clear();
                marks.resize(samples, false);
            }
            let marks = Marks {
                touched: &mut self.touched,
                core: &mut self.core,
            };
            match &mut region.outline {
                Outline::Polygons(polygons) => polygons.mark(first_row, self.width, marks),
                Outline::Mask(mask) => mask.mark(first_row, rows, marks)?,
            }
            for (at, (allowed, which)) in out.iter_mut().enumerate() {
                if self.touched[at] && !self.settled[at] {
                    if *allowed == f64::INFINITY {
                        *which = number as u8;
                    }
                    *allowed = allowed.min(region.tolerance_m);
                    self.settled[at] = self.core[at];
                }
            }
        }
        for (at, (allowed, which)) in out.iter_mut().enumerate() {
            if self.settled[at] {
                continue;
            }
            let grain = grains.get(at).copied().unwrap_or_default();
            let base = self.base.filter(|_| grain != Grain::Finest);
            if base.is_some() && *allowed == f64::INFINITY {
                *which = elsewhere + 1;
            }
            let base_m = base.map_or(0.0, |base| {
                let (x, row) = (at as u32 % self.width, first_row + at as u32 / self.width);
                base.tolerance_m(grain, x, row)
            });
            *allowed = allowed.min(self.elsewhere_m.max(base_m));
        }
        Ok(())
    }

    /// What a manifest says, from the most that rounding took and the farthest moves, by region.
    pub(super) fn stated(&self, largest: &[(f64, u32)], quantum_m: f64) -> Vec<Tolerance> {
        let regions = self.regions.iter().map(|region| {
            let name = Some(region.name.clone());
            (region.tolerance_m, name)
        });
        let base = self.base.map(|base| {
            let most_m = self.elsewhere_m.max(base.most_m());
            (most_m, Some(BASE_REGION.to_owned()))
        });
        let all = regions.chain([(self.elsewhere_m, None)]).chain(base);
        let stated = all.zip(largest);
        let tolerance = |((tolerance_m, region), &(rounding_m, moved)): ((f64, _), &(f64, u32))| {
            let moved_m = f64::from(moved) * quantum_m;
            // No moved sample is beyond the tolerance, and no other is off by more than rounding.
            let most_m = tolerance_m.max(rounding_m);
            Tolerance {
                tolerance_m,
                region,
                largest_error_m: (moved_m + rounding_m).min(most_m),
            }
        };
        stated.map(tolerance).collect()
    }
}

/// What a manifest calls the samples of inputs that are coarser than the grid.
const BASE_REGION: &str = "coarser inputs";

/// Quanta by which a height on the triangles between page corners may differ from what the format
/// has there: half of one where it is rounded here, less than one for each level of pages there.
const ROUNDING_QUANTA: f64 = 2.0;

/// How far heights of coarser inputs may be moved.
#[derive(Debug, Clone, Copy)]
struct Base {
    wished_m: Option<f64>,
    rounding_m: f64,
    height: u32,
}

impl Base {
    fn most_m(&self) -> f64 {
        self.wished_m.unwrap_or(self.rounding_m)
    }

    fn tolerance_m(&self, grain: Grain, x: u32, row: u32) -> f64 {
        match (self.wished_m, grain) {
            (_, Grain::Finest) => 0.0,
            (Some(wished_m), _) => wished_m,
            (None, Grain::Between) => 0.0,
            (None, Grain::Facets(cells)) => {
                let y = self.height - 1 - row;
                match x.is_multiple_of(cells) && y.is_multiple_of(cells) {
                    true => 0.0,
                    false => self.rounding_m,
                }
            }
        }
    }
}

impl Region {
    fn open(tolerance_m: f64, path: &Path, info: &DemInfo) -> Result<Region, DemError> {
        let outline = match Polygons::is_json(path)? {
            true => Outline::Polygons(Polygons::open(path, info)?),
            false => Outline::Mask(Mask::open(path, info)?),
        };
        let name = path.file_name().unwrap_or_default();
        Ok(Region {
            tolerance_m,
            name: name.to_string_lossy().into_owned(),
            outline,
        })
    }
}

fn is_length(metres: f64) -> bool {
    metres.is_finite() && metres >= 0.0
}
