//! Heights in the colours of PNG tiles: Mapbox terrain-RGB and Terrarium.
//!
//! After Mapbox, "Mapbox Terrain-RGB v1": height = -10000 + (65536 R + 256 G + B) / 10; and
//! Mapzen, "Terrain Tiles, formats": height = 256 R + G + B / 256 - 32768. A tile is a square of
//! Web Mercator: at zoom z the world has 2^z by 2^z of them, row 0 in the north.

use std::path::Path;

use image::{ColorType, ImageDecoder};

use super::bitmap;
use super::error::in_and_out;
use super::heights::{self, HeightRule};
use super::open::local_placement;
use super::{Crs, DemError, DemInfo, DemSource, OpenOptions, Placement, Registration, SampleType};

/// How three colours code a height.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RgbCoding {
    /// Steps of 0.1 m from -10000 m.
    Mapbox,
    /// Steps of 1/256 m from -32768 m.
    Terrarium,
}

impl RgbCoding {
    /// What a colour, read as a number of 24 bits, means. Black is the lowest height there is,
    /// below any ground: it stands for no height.
    pub(super) fn rule(self) -> HeightRule {
        let (step_m, offset_m) = match self {
            Self::Mapbox => (0.1, -10_000.0),
            Self::Terrarium => (1.0 / 256.0, -32_768.0),
        };
        HeightRule {
            step_m,
            offset_m,
            nodata: Some(0.0),
        }
    }
}

/// Half the circumference of Web Mercator's sphere, metres.
const HALF_WORLD_M: f64 = 20_037_508.342_789_244;

/// The deepest zoom: beyond it a tile's columns are not told apart.
pub(super) const MAX_ZOOM: u32 = 24;

/// Stands for a transparent pixel among numbers of 24 bits.
pub(super) const TRANSPARENT: u32 = u32::MAX;

/// Where tiles lie whose north-west one is (x, y).
pub(super) fn placement([zoom, x, y]: [u32; 3], tile_px: u32) -> Placement {
    let cells = f64::from(tile_px) * 2f64.powi(zoom as i32);
    let step = 2.0 * HALF_WORLD_M / cells;
    // Of the half world, from its middle: exact, as all but the last product is by powers of 2.
    let middle = |tile: u32| (f64::from(tile) * f64::from(tile_px) + 0.5) * 2.0 / cells - 1.0;
    Placement {
        x0: middle(x) * HALF_WORLD_M,
        y0: -middle(y) * HALF_WORLD_M,
        dx: step,
        dy: step,
    }
}

/// The system of all tiles.
pub(super) fn web_mercator() -> Crs {
    Crs::Projected {
        name: "EPSG:3857".into(),
        metres_per_unit: 1.0,
    }
}

/// Samples on a side of a tile, from its header.
///
/// # Errors
/// [`DemError::Unsupported`] for a picture that is not square or not in colour.
pub(super) fn side_px(path: &Path) -> Result<[u32; 2], DemError> {
    let (decoder, _) = bitmap::decoder(path)?;
    if !matches!(decoder.color_type(), ColorType::Rgb8 | ColorType::Rgba8) {
        let what = "a tile that is no PNG in colours of 8 bits";
        let hint = format!(
            "convert it: gdal_translate -of PNG -expand rgb {}",
            in_and_out(path)
        );
        return Err(DemError::unsupported(path, what, hint));
    }
    let (width, height) = decoder.dimensions();
    Ok([width, height])
}

/// The numbers of a tile's colours, row by row; [`TRANSPARENT`] where a pixel is.
///
/// # Errors
/// Those of decoding.
pub(super) fn numbers(path: &Path) -> Result<Vec<u32>, DemError> {
    let (pixels, colour) = bitmap::pixels(path)?;
    let number = |rgb: &[u8]| u32::from_be_bytes([0, rgb[0], rgb[1], rgb[2]]);
    let seen = |rgba: &[u8]| match rgba[3] {
        0 => TRANSPARENT,
        _ => number(rgba),
    };
    match colour {
        ColorType::Rgb8 => Ok(pixels.chunks_exact(3).map(number).collect()),
        ColorType::Rgba8 => Ok(pixels.chunks_exact(4).map(seen).collect()),
        other => {
            let found = format!("{other:?}");
            Err(DemError::damaged(
                path,
                "the tile's colours",
                found,
                "RGB of 8 bits",
            ))
        }
    }
}

/// Height of a number.
pub(super) fn height_m(number: u32, rule: &HeightRule) -> f64 {
    match number {
        TRANSPARENT => f64::NAN,
        number => rule.height_m(f64::from(number)),
    }
}

/// One tile on its own.
pub(super) struct RgbTile {
    info: DemInfo,
    rule: HeightRule,
    numbers: Option<Vec<u32>>,
}

impl RgbTile {
    /// Reads the header. The tile's place is that of its name `{z}/{x}/{y}.png`, or given; with
    /// neither, the user gives the spacing.
    ///
    /// # Errors
    /// [`DemError::Usage`] without place and spacing; those of the picture.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, DemError> {
        let [width, height] = side_px(path)?;
        let file_rule = options.rgb.unwrap_or(RgbCoding::Mapbox).rule();
        let rule = HeightRule::resolve(file_rule, options, SampleType::U32, path)?;
        let tile = options.tile.or_else(|| tile_of(path));
        let (placement, crs) = match tile {
            Some(tile) if options.spacing_m.is_none() => {
                check_tile(tile, [width, height], path)?;
                (placement(tile, width), web_mercator())
            }
            _ => (unplaced(path, options)?, Crs::Local),
        };
        let info = DemInfo {
            path: path.into(),
            format: "RGB tile",
            width,
            height,
            placement,
            crs,
            registration: Registration::Cell,
            sample_type: SampleType::U32,
            height_step_m: rule.step_m,
            nodata: rule.nodata,
            vertical: None,
        };
        info.check_size()?;
        Ok(Self {
            info,
            rule,
            numbers: None,
        })
    }
}

fn unplaced(path: &Path, options: &OpenOptions) -> Result<Placement, DemError> {
    local_placement(options, path).map_err(|error| match error {
        DemError::Usage { what, .. } if options.spacing_m.is_none() => {
            let hint = "say which tile it is, --tile ZOOM/COLUMN/ROW, or its --spacing in metres";
            DemError::usage(path, what, hint)
        }
        other => other,
    })
}

fn check_tile([zoom, x, y]: [u32; 3], size: [u32; 2], path: &Path) -> Result<(), DemError> {
    let sound = zoom <= MAX_ZOOM && x < 1 << zoom && y < 1 << zoom;
    if !sound {
        let what = format!("tile {zoom}/{x}/{y}");
        let hint = format!("zoom is at most {MAX_ZOOM}, column and row below 2 to its power");
        return Err(DemError::usage(path, what, hint));
    }
    if size[0] != size[1] {
        let what = format!("a tile of {} x {} samples", size[0], size[1]);
        return Err(DemError::usage(
            path,
            what,
            "tiles are square: give --spacing instead",
        ));
    }
    Ok(())
}

/// Zoom, column and row of a path that ends with `{z}/{x}/{y}.png`.
fn tile_of(path: &Path) -> Option<[u32; 3]> {
    let y = path.file_stem()?.to_str()?.parse().ok()?;
    let mut folders = path.parent()?.components().rev();
    let mut number = || folders.next()?.as_os_str().to_str()?.parse::<u32>().ok();
    let (x, zoom) = (number()?, number()?);
    (zoom <= MAX_ZOOM).then_some([zoom, x, y])
}

impl DemSource for RgbTile {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        if self.numbers.is_none() {
            self.numbers = Some(numbers(&self.info.path)?);
        }
        let numbers = self.numbers.as_deref().unwrap_or_default();
        let from = first_row as usize * self.info.width as usize;
        for (height, number) in out.iter_mut().zip(&numbers[from..]) {
            *height = height_m(*number, &self.rule);
        }
        heights::check(&self.info, first_row, out)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Folder, read_all, rgba_bytes};
    use super::*;

    fn coded(rgb: RgbCoding) -> OpenOptions {
        OpenOptions {
            rgb: Some(rgb),
            spacing_m: Some(10.0),
            ..OpenOptions::default()
        }
    }

    #[test]
    fn colours_become_heights_by_either_coding_and_clear_pixels_holes() {
        let folder = Folder::new();
        // The example of Mapbox's page, sea level, and two holes.
        let pixels = [
            [1, 134, 160, 255],
            [2, 0, 3, 255],
            [9, 9, 9, 0],
            [0, 0, 0, 255],
        ];
        let path = folder.write("a.png", &rgba_bytes(4, 1, |_, c| pixels[c as usize]));
        let (_, mapbox) = read_all(&path, &coded(RgbCoding::Mapbox)).unwrap();
        assert_eq!(mapbox[0], 0.0);
        assert!((mapbox[1] - 3107.5).abs() < 1e-9, "{mapbox:?}");
        assert!(mapbox[2].is_nan() && mapbox[3].is_nan());
        let pixels = [
            [128, 0, 0, 255],
            [128, 1, 128, 255],
            [127, 255, 0, 255],
            [0, 0, 0, 255],
        ];
        let path = folder.write("b.png", &rgba_bytes(4, 1, |_, c| pixels[c as usize]));
        let (_, terrarium) = read_all(&path, &coded(RgbCoding::Terrarium)).unwrap();
        assert_eq!(terrarium[..3], [0.0, 1.5, -1.0]);
        assert!(terrarium[3].is_nan());
    }

    #[test]
    fn a_tile_is_placed_by_folders_or_as_said() {
        let folder = Folder::new();
        std::fs::create_dir_all(folder.path().join("1/1")).unwrap();
        let bytes = rgba_bytes(2, 2, |_, _| [1, 134, 160, 255]);
        let named = folder.write("1/1/0.png", &bytes);
        let other = folder.write("a.png", &bytes);
        let mut options = OpenOptions {
            rgb: Some(RgbCoding::Mapbox),
            ..OpenOptions::default()
        };
        let (info, _) = read_all(&named, &options).unwrap();
        let quarter = HALF_WORLD_M / 4.0;
        let place = info.placement;
        assert_eq!((place.x0, place.y0), (quarter, 3.0 * quarter));
        assert_eq!((place.dx, info.crs), (2.0 * quarter, web_mercator()));
        let error = read_all(&other, &options).unwrap_err().to_string();
        assert!(error.contains("--tile"), "{error}");
        options.tile = Some([1, 1, 0]);
        assert_eq!(read_all(&other, &options).unwrap().0.placement, place);
        options.tile = Some([1, 2, 0]);
        assert!(matches!(
            read_all(&other, &options),
            Err(DemError::Usage { .. })
        ));
    }

    #[test]
    fn every_short_prefix_is_an_error() {
        let folder = Folder::new();
        let bytes = rgba_bytes(5, 4, |r, c| [1, r as u8 * 40, c as u8 * 50, 255]);
        for length in 0..bytes.len() - 12 {
            let path = folder.write("a.png", &bytes[..length]);
            assert!(
                read_all(&path, &coded(RgbCoding::Mapbox)).is_err(),
                "{length}"
            );
        }
    }
}
