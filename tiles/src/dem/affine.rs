//! From GeoTIFF's model tags to a [`Placement`].
//!
//! After OGC 19-008r4, section 7.4: raster space counts cells from the corner of the north-west
//! cell (`PixelIsArea`) or from the centre of the north-west sample (`PixelIsPoint`).

use std::path::Path;

use super::error::in_and_out;
use super::{DemError, Placement, Registration};

/// The three tags that place a raster; empty where the file has none.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct ModelTags {
    /// Scale x, y, z.
    pub pixel_scale: Vec<f64>,
    /// Six numbers a point: raster column, row, 0, then x, y, z.
    pub tiepoints: Vec<f64>,
    /// A 4 x 4 matrix, row by row.
    pub transformation: Vec<f64>,
}

/// Where samples lie, and how rows are stored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Layout {
    /// Of the north-west sample, whichever way rows are stored.
    pub placement: Placement,
    /// The first stored row is the south one.
    pub south_up: bool,
}

impl ModelTags {
    /// The placement of a raster with `height` rows; `None` without georeference.
    ///
    /// # Errors
    /// [`DemError::Unsupported`] for rotated, sheared, mirrored or rubber-sheeted rasters,
    /// [`DemError::Damaged`] for steps that are zero or not finite.
    pub fn layout(
        &self,
        height: u32,
        registration: Registration,
        path: &Path,
    ) -> Result<Option<Layout>, DemError> {
        let shift = match registration {
            Registration::Grid => 0.0,
            Registration::Cell => 0.5,
        };
        let layout = match (
            &self.pixel_scale[..],
            &self.tiepoints[..],
            &self.transformation[..],
        ) {
            ([sx, sy, ..], [i, j, _, x, y, _, ..], _) if *sx != 0.0 && *sy != 0.0 => {
                // GDAL and its users hold that a negative y scale is a slip, so the sign of y
                // never flips here; a south-up raster says so by a transformation.
                let (dx, dy) = (*sx, sy.abs());
                Layout {
                    placement: Placement {
                        x0: x + (shift - i) * dx,
                        y0: y - (shift - j) * dy,
                        dx,
                        dy,
                    },
                    south_up: false,
                }
            }
            (_, _, [a, b, _, d, e, f, _, h, ..]) => {
                if b.abs() > 1e-9 * a.abs() || e.abs() > 1e-9 * f.abs() {
                    return Err(needs_warp(path, "a rotated or sheared raster"));
                }
                upright(*a, *f, d + shift * a, h + shift * f, height)
            }
            (_, [_, _, _, _, _, _, _, ..], _) => {
                return Err(needs_warp(path, "placement by ground control points"));
            }
            _ => return Ok(None),
        };
        check(layout, path).map(Some)
    }
}

/// The layout of a raster whose sample (column, row) lies at
/// x = a * column + b * row + c, y = d * column + e * row + f.
///
/// # Errors
/// As [`ModelTags::layout`].
pub(super) fn of_first_sample(
    [a, b, c, d, e, f]: [f64; 6],
    height: u32,
    path: &Path,
) -> Result<Layout, DemError> {
    if b.abs() > 1e-9 * a.abs() || d.abs() > 1e-9 * e.abs() {
        return Err(needs_warp(path, "a rotated or sheared raster"));
    }
    check(upright(a, e, c, f, height), path)
}

/// A raster whose first stored row has its sample at `(x, y)`; `step_y` is negative when north-up.
fn upright(step_x: f64, step_y: f64, x: f64, y: f64, height: u32) -> Layout {
    let south_up = step_y > 0.0;
    let y0 = if south_up {
        y + step_y * (f64::from(height) - 1.0)
    } else {
        y
    };
    let placement = Placement {
        x0: x,
        y0,
        dx: step_x,
        dy: step_y.abs(),
    };
    Layout {
        placement,
        south_up,
    }
}

fn check(layout: Layout, path: &Path) -> Result<Layout, DemError> {
    let Placement { x0, y0, dx, dy } = layout.placement;
    if dx < 0.0 {
        return Err(needs_warp(path, "a raster stored from east to west"));
    }
    let sound = [x0, y0, dx, dy].iter().all(|v| v.is_finite()) && dx > 0.0 && dy > 0.0;
    if sound {
        return Ok(layout);
    }
    let found = format!("origin {x0}, {y0}, steps {dx}, {dy}");
    Err(DemError::damaged(
        path,
        "the georeference tags",
        found,
        "finite numbers, steps above 0",
    ))
}

fn needs_warp(path: &Path, what: &str) -> DemError {
    let hint = format!("straighten it: gdalwarp -r bilinear {}", in_and_out(path));
    DemError::unsupported(path, what, hint)
}

#[cfg(test)]
mod tests {
    use super::*;
    use Registration::{Cell, Grid};

    fn layout(tags: &ModelTags, registration: Registration) -> Result<Option<Layout>, DemError> {
        tags.layout(5, registration, Path::new("f.tif"))
    }

    fn scaled(tiepoints: &[f64]) -> ModelTags {
        let pixel_scale = vec![2.0, 4.0, 0.0];
        ModelTags {
            pixel_scale,
            tiepoints: tiepoints.into(),
            ..ModelTags::default()
        }
    }

    fn matrix(a: f64, b: f64, d: f64, e: f64, f: f64, h: f64) -> ModelTags {
        let transformation = vec![
            a, b, 0.0, d, e, f, 0.0, h, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0,
        ];
        ModelTags {
            transformation,
            ..ModelTags::default()
        }
    }

    #[test]
    fn a_tiepoint_names_a_sample_in_one_registration_and_a_corner_in_the_other() {
        let tags = scaled(&[0.0, 0.0, 0.0, 100.0, 200.0, 0.0]);
        let place = |r| layout(&tags, r).unwrap().unwrap().placement;
        assert_eq!(
            place(Grid),
            Placement {
                x0: 100.0,
                y0: 200.0,
                dx: 2.0,
                dy: 4.0
            }
        );
        assert_eq!(
            place(Cell),
            Placement {
                x0: 101.0,
                y0: 198.0,
                dx: 2.0,
                dy: 4.0
            }
        );
    }

    #[test]
    fn a_tiepoint_elsewhere_in_the_raster_counts_back_to_its_corner() {
        let tags = scaled(&[3.0, 2.0, 0.0, 106.0, 192.0, 0.0]);
        let placement = layout(&tags, Cell).unwrap().unwrap().placement;
        assert_eq!(
            placement,
            Placement {
                x0: 101.0,
                y0: 198.0,
                dx: 2.0,
                dy: 4.0
            }
        );
    }

    #[test]
    fn a_south_up_matrix_is_flipped_to_the_same_place() {
        let north = layout(&matrix(2.0, 0.0, 100.0, 0.0, -4.0, 200.0), Cell)
            .unwrap()
            .unwrap();
        let south = layout(&matrix(2.0, 0.0, 100.0, 0.0, 4.0, 180.0), Cell)
            .unwrap()
            .unwrap();
        assert_eq!((north.south_up, south.south_up), (false, true));
        assert_eq!(north.placement, south.placement);
    }

    #[test]
    fn rotation_shear_mirroring_and_control_points_name_gdalwarp() {
        let gcps = ModelTags {
            tiepoints: vec![0.0; 12],
            ..ModelTags::default()
        };
        let rotated = matrix(2.0, 0.1, 0.0, 0.1, -4.0, 0.0);
        let mirrored = matrix(-2.0, 0.0, 0.0, 0.0, -4.0, 0.0);
        for tags in [gcps, rotated, mirrored] {
            let error = layout(&tags, Cell).unwrap_err().to_string();
            assert!(error.contains("gdalwarp"), "{error}");
        }
    }

    #[test]
    fn steps_that_are_no_numbers_are_damage() {
        let tags = matrix(f64::NAN, 0.0, 0.0, 0.0, -1.0, 0.0);
        assert!(matches!(layout(&tags, Grid), Err(DemError::Damaged { .. })));
    }

    #[test]
    fn no_tags_mean_no_georeference() {
        assert_eq!(layout(&ModelTags::default(), Grid).unwrap(), None);
    }
}
