//! A dataset against the files that it was built from.

use crate::build::BuildError;
use crate::dataset::{Dataset, PageReader};
use crate::dem::{DemInfo, DemSource};
use crate::frame::georef_of;
use escarp_proto::geometry::PAGE_CELLS;
use escarp_proto::georef::Plane;
use serde::Serialize;

/// How a dataset differs from its inputs.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Against {
    /// Samples with data in both.
    pub samples: u64,
    /// Largest difference of a sample, metres.
    pub largest_difference_m: f64,
    /// Samples of the input without data in the dataset. A sample that forms no triangle with its
    /// neighbours is part of no surface, and is not kept.
    pub missing: u64,
    /// Samples of the dataset without data in the input, that the dataset knows as fill.
    pub filled: u64,
    /// Other samples of the dataset without data in the input.
    pub invented: u64,
}

/// Compares every sample.
///
/// # Errors
/// [`BuildError::Unfit`] if the sizes or places differ; otherwise what reading either says.
pub fn compare(
    dataset: &Dataset,
    source: &mut dyn DemSource,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Result<Against, BuildError> {
    let info = source.info().clone();
    let [width, height] = dataset.manifest().samples;
    if [info.width, info.height] != [width, height] {
        return Err(BuildError::Unfit {
            path: info.path,
            why: format!(
                "{} x {} samples, but the dataset has {width} x {height}",
                info.width, info.height
            ),
        });
    }
    check_place(dataset, &info)?;
    let filled = dataset.filled()?;
    let mut reader = PageReader::new(dataset);
    let mut found = Against::default();
    let mut given = Vec::new();
    let mut shared = Vec::new();
    let page_rows = (height - 1).div_ceil(PAGE_CELLS as u32).max(1);
    // From north to south, as sources are read fastest.
    for page_row in (0..page_rows).rev() {
        let first = page_row * PAGE_CELLS as u32;
        let rows = (height - first).min(PAGE_CELLS as u32 + 1);
        let mut stored = reader.page_row(page_row)?;
        given.resize(rows as usize * width as usize, 0.0);
        source.read_rows(height - first - rows, rows, &mut given)?;
        let quantum_m = dataset.manifest().georef.quantum_m;
        // The southern row is shared with the next page row. Where a hole ends there, only one of
        // the two may have the sample.
        let northern = stored.len() - width as usize;
        for (ours, theirs) in stored[northern..].iter_mut().zip(&shared) {
            *ours = ours.or(*theirs);
        }
        shared = stored[..width as usize].to_vec();
        let own = if page_row == 0 { rows } else { rows - 1 };
        let stored = stored
            .chunks_exact(width as usize)
            .take(rows as usize)
            .rev();
        let given = given.chunks_exact(width as usize).zip(stored);
        for (i, (given, stored)) in given.take(own as usize).enumerate() {
            let y = first + rows - 1 - i as u32;
            found.row(given, stored, quantum_m, &|x| filled.contains(x, y));
        }
        progress(u64::from(page_rows - page_row), u64::from(page_rows));
    }
    Ok(found)
}

/// The same heights in another place are other data.
fn check_place(dataset: &Dataset, info: &DemInfo) -> Result<(), BuildError> {
    let stored = &dataset.manifest().georef;
    let given = georef_of(info, stored.quantum_m);
    let cell = stored.sample_spacing_m[0].min(stored.sample_spacing_m[1]);
    let differs = |a: [f64; 2], b: [f64; 2]| (0..2).any(|i| (a[i] - b[i]).abs() > 1e-6 * cell);
    if !is_same_plane(&stored.plane, &given.plane) {
        return Err(BuildError::Unfit {
            path: info.path.clone(),
            why: format!(
                "it has another place or coordinate system: {}, but the dataset {}; give the options \
                 of the build",
                words(&given.plane),
                words(&stored.plane)
            ),
        });
    }
    if !differs(stored.origin_m, given.origin_m)
        && !differs(stored.sample_spacing_m, given.sample_spacing_m)
    {
        return Ok(());
    }
    Err(BuildError::Unfit {
        path: info.path.clone(),
        why: format!(
            "it lies elsewhere: south-west sample at {:?}, spacing {:?} m, but in the dataset {:?}, \
             {:?} m",
            given.origin_m, given.sample_spacing_m, stored.origin_m, stored.sample_spacing_m
        ),
    })
}

fn words(plane: &Plane) -> String {
    match plane {
        Plane::Projected { crs, .. } => crs.clone(),
        Plane::Geographic {
            crs,
            middle_longitude_deg,
            middle_latitude_deg,
            ..
        } => format!(
            "{crs} around longitude {middle_longitude_deg:.6}, latitude {middle_latitude_deg:.6}"
        ),
        Plane::Local => "no georeference".into(),
    }
}

/// Equal but for what is lost when numbers are written and read in other formats.
fn is_same_plane(a: &Plane, b: &Plane) -> bool {
    let near = |a: f64, b: f64| (a - b).abs() <= 1e-9 * a.abs().max(1.0);
    match (a, b) {
        (
            Plane::Geographic {
                crs,
                radius_m,
                middle_longitude_deg,
                middle_latitude_deg,
            },
            Plane::Geographic {
                crs: other,
                radius_m: radius,
                middle_longitude_deg: longitude,
                middle_latitude_deg: latitude,
            },
        ) => {
            crs == other
                && near(*radius_m, *radius)
                && near(*middle_longitude_deg, *longitude)
                && near(*middle_latitude_deg, *latitude)
        }
        _ => a == b,
    }
}

impl Against {
    fn row(
        &mut self,
        given: &[f64],
        stored: &[Option<i32>],
        quantum_m: f64,
        is_fill: &dyn Fn(u32) -> bool,
    ) {
        for (x, (&given, stored)) in (0..).zip(given.iter().zip(stored)) {
            match stored {
                None if given.is_nan() => {}
                None => self.missing += 1,
                Some(_) if given.is_nan() && is_fill(x) => self.filled += 1,
                Some(_) if given.is_nan() => self.invented += 1,
                Some(units) => {
                    self.samples += 1;
                    let difference = (f64::from(*units) * quantum_m - given).abs();
                    self.largest_difference_m = self.largest_difference_m.max(difference);
                }
            }
        }
    }
}
