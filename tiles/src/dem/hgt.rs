//! SRTM tiles: big-endian i16, -32768 is a void, grid-registered, placed by their name
//! (`N36W115` is the south-west corner), plain or in a zip.
//!
//! After USGS, "SRTM Topography", section 2.1 (2005). A tile has 1201 or 3601 samples a side, and
//! shares its outer rows and columns with its neighbours.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::heights::HeightRule;
use super::unpack::{archive, zip_error};
use super::{Crs, DemError, DemInfo, DemSource, OpenOptions, Placement, Registration, SampleType};

/// Samples a side of 3 and 1 arc second tiles.
const SIDES: [u32; 2] = [1201, 3601];

const VOID: f64 = -32768.0;
const WGS84_RADIUS_M: f64 = 6_378_137.0;

enum Store {
    /// Rows are read where they lie.
    Plain(File),
    /// The zip is decompressed whole (at most 26 MB) when rows are first asked for.
    Zipped {
        entry: usize,
        samples: Option<Vec<u8>>,
    },
}

/// One open tile.
pub(super) struct Hgt {
    info: DemInfo,
    rule: HeightRule,
    store: Store,
}

/// Whether a file without magic is a tile: by its size, or by its extension.
pub(super) fn looks_like(path: &Path, length: u64) -> bool {
    let extension = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("hgt"));
    extension || (side_of(length).is_some() && corner(&stem(path)).is_some())
}

impl Hgt {
    /// Opens a plain tile.
    ///
    /// # Errors
    /// [`DemError::Damaged`] for another size, [`DemError::Usage`] for a name without a place.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, DemError> {
        let file = File::open(path).map_err(|e| DemError::io(path, "open", e))?;
        let length = file
            .metadata()
            .map_err(|e| DemError::io(path, "ask the size", e))?
            .len();
        Self::new(path, &stem(path), length, Store::Plain(file), options)
    }

    /// Opens a tile that is a member of a zip; the member's name says the place.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_zip(
        path: &Path,
        entry: usize,
        name: &str,
        options: &OpenOptions,
    ) -> Result<Self, DemError> {
        let mut archive = archive(path)?;
        let file = archive.by_index(entry).map_err(|e| zip_error(e, path))?;
        let length = file.size();
        drop(file);
        let store = Store::Zipped {
            entry,
            samples: None,
        };
        Self::new(path, &stem(Path::new(&name)), length, store, options)
    }

    fn new(
        path: &Path,
        name: &str,
        length: u64,
        store: Store,
        options: &OpenOptions,
    ) -> Result<Self, DemError> {
        let side = side_of(length).ok_or_else(|| {
            let expected = "2884802 (1201 x 1201) or 25934402 (3601 x 3601) bytes";
            DemError::damaged(path, "the tile's size", format!("{length} bytes"), expected)
        })?;
        let (latitude, longitude) = corner(name).ok_or_else(|| {
            let hint = "name it after its south-west corner, such as N36W115.hgt";
            DemError::usage(path, format!("the name {name:?} says no place"), hint)
        })?;
        let file_rule = HeightRule {
            nodata: Some(VOID),
            ..HeightRule::METRES
        };
        let rule = HeightRule::resolve(file_rule, options, SampleType::I16, path)?;
        let step = 1.0 / f64::from(side - 1);
        let info = DemInfo {
            path: path.into(),
            format: "SRTM hgt",
            width: side,
            height: side,
            placement: Placement {
                x0: longitude,
                y0: latitude + 1.0,
                dx: step,
                dy: step,
            },
            crs: Crs::Geographic {
                name: "EPSG:4326".into(),
                radius_m: WGS84_RADIUS_M,
            },
            registration: Registration::Grid,
            sample_type: SampleType::I16,
            height_step_m: rule.step_m,
            nodata: rule.nodata,
            vertical: None,
        };
        Ok(Self { info, rule, store })
    }

    /// The stored bytes of a band.
    fn band(&mut self, first_row: u32, rows: u32) -> Result<Vec<u8>, DemError> {
        let path = &self.info.path;
        let row_bytes = self.info.width as usize * 2;
        let (from, len) = (first_row as usize * row_bytes, rows as usize * row_bytes);
        match &mut self.store {
            Store::Plain(file) => {
                let mut bytes = vec![0; len];
                file.seek(SeekFrom::Start(from as u64))
                    .and_then(|_| file.read_exact(&mut bytes))
                    .map_err(|e| DemError::io(path, "read", e))?;
                Ok(bytes)
            }
            Store::Zipped { entry, samples } => {
                if samples.is_none() {
                    *samples = Some(unpack(path, *entry, self.info.height as usize * row_bytes)?);
                }
                Ok(samples.as_deref().unwrap_or_default()[from..from + len].to_vec())
            }
        }
    }
}

impl DemSource for Hgt {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        let bytes = self.band(first_row, rows)?;
        for (height, stored) in out.iter_mut().zip(bytes.as_chunks().0) {
            *height = self.rule.height_m(f64::from(i16::from_be_bytes(*stored)));
        }
        super::heights::check(&self.info, first_row, out)
    }
}

fn side_of(length: u64) -> Option<u32> {
    SIDES
        .into_iter()
        .find(|side| u64::from(*side).pow(2) * 2 == length)
}

/// The file name up to its first dot: `N36W115` of `N36W115.SRTMGL1.hgt`.
fn stem(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.split('.').next().unwrap_or_default().to_string()
}

/// South-west corner in degrees (latitude, longitude) from a name that starts with one.
fn corner(name: &str) -> Option<(f64, f64)> {
    let (latitude, rest) = signed(name, ['N', 'S'], 2, 90)?;
    let (longitude, _) = signed(rest, ['E', 'W'], 3, 180)?;
    Some((latitude, longitude))
}

/// A letter (the first one is plus) and a fixed count of digits; the number and what follows it.
fn signed(text: &str, letters: [char; 2], digits: usize, most: u16) -> Option<(f64, &str)> {
    let letter = text.chars().next()?.to_ascii_uppercase();
    let sign = [1.0, -1.0][letters.iter().position(|l| *l == letter)?];
    let (number, rest) = text.get(1..)?.split_at_checked(digits)?;
    let whole: u16 = number
        .bytes()
        .all(|b| b.is_ascii_digit())
        .then(|| number.parse().ok())??;
    (whole <= most).then(|| (sign * f64::from(whole), rest))
}

fn unpack(path: &Path, entry: usize, len: usize) -> Result<Vec<u8>, DemError> {
    let mut archive = archive(path)?;
    let mut file = archive.by_index(entry).map_err(|e| zip_error(e, path))?;
    let mut bytes = vec![0; len];
    file.read_exact(&mut bytes).map_err(|e| {
        let expected = format!("{len} sound bytes (is the file cut short?)");
        DemError::damaged(path, format!("zip entry {entry}"), e.to_string(), expected)
    })?;
    // The checksum is compared when the end is met.
    match file.read(&mut [0]) {
        Ok(0) => Ok(bytes),
        Ok(_) => Err(DemError::damaged(
            path,
            "the zip entry",
            "more bytes",
            format!("{len}"),
        )),
        Err(e) => Err(DemError::damaged(
            path,
            "the zip entry",
            e.to_string(),
            "its checksum",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Folder, hgt_bytes, zip_bytes};
    use super::*;

    fn tile() -> Vec<u8> {
        hgt_bytes(1201, |row, column| {
            if row == 3 && column == 4 {
                -32768
            } else {
                row as i16 - column as i16
            }
        })
    }

    #[test]
    fn names_give_the_south_west_corner() {
        assert_eq!(corner("N36W115"), Some((36.0, -115.0)));
        assert_eq!(corner("s01e009"), Some((-1.0, 9.0)));
        assert_eq!(corner("N00E000"), Some((0.0, 0.0)));
        for bad in [
            "",
            "N3",
            "N36",
            "X36W115",
            "N36W11x",
            "N99W115",
            "N36W999",
            "Nä36W115",
        ] {
            assert_eq!(corner(bad), None, "{bad}");
        }
    }

    #[test]
    fn a_tile_is_placed_by_its_name_and_its_voids_are_holes() {
        let folder = Folder::new();
        let plain = folder.write("N36W115.hgt", &tile());
        let zipped = folder.write("any.zip", &zip_bytes("dir/N36W115.hgt", &tile()));
        for path in [plain, zipped] {
            let mut dem = super::super::open(&path, &OpenOptions::default()).unwrap();
            let Placement { x0, y0, dx, .. } = dem.info().placement;
            assert_eq!((x0, y0, dx), (-115.0, 37.0, 1.0 / 1200.0));
            let mut rows = vec![0.0; 2 * 1201];
            dem.read_rows(3, 2, &mut rows).unwrap();
            assert_eq!((rows[0], rows[1201 + 7]), (3.0, -3.0));
            assert!(rows[4].is_nan());
        }
    }

    #[test]
    fn a_tile_cut_short_names_the_sizes_allowed() {
        let folder = Folder::new();
        let path = folder.write("N36W115.hgt", &tile()[..1000]);
        let error = Hgt::open(&path, &OpenOptions::default())
            .err()
            .unwrap()
            .to_string();
        assert!(
            error.contains("1000 bytes") && error.contains("2884802"),
            "{error}"
        );
    }

    #[test]
    fn a_tile_without_a_place_in_its_name_says_what_to_do() {
        let folder = Folder::new();
        let path = folder.write("mountain.hgt", &tile());
        let error = Hgt::open(&path, &OpenOptions::default()).err().unwrap();
        assert!(matches!(error, DemError::Usage { .. }), "{error}");
    }

    #[test]
    fn a_zip_without_a_tile_is_not_a_dem() {
        let folder = Folder::new();
        let path = folder.write("a.zip", &zip_bytes("readme.txt", b"hello"));
        let error = super::super::open(&path, &OpenOptions::default())
            .err()
            .unwrap();
        assert!(matches!(error, DemError::NotADem { .. }), "{error}");
    }

    #[test]
    fn every_short_prefix_of_a_zip_is_an_error() {
        let folder = Folder::new();
        let bytes = zip_bytes("N36W115.hgt", &tile());
        let step = bytes.len().div_ceil(200);
        for length in (0..300).chain((300..bytes.len()).step_by(step)) {
            let path = folder.write("a.zip", &bytes[..length]);
            let opened = super::super::open(&path, &OpenOptions::default());
            assert!(opened.is_err(), "{length} of {} bytes", bytes.len());
        }
    }

    #[test]
    fn a_zip_with_a_flipped_bit_fails_its_checksum() {
        let folder = Folder::new();
        let mut bytes = zip_bytes("N36W115.hgt", &tile());
        let middle = bytes.len() / 2;
        bytes[middle] ^= 0x10;
        let path = folder.write("a.zip", &bytes);
        let mut dem = super::super::open(&path, &OpenOptions::default()).unwrap();
        let read = dem.read_rows(0, 1, &mut vec![0.0; 1201]);
        assert!(matches!(read, Err(DemError::Damaged { .. })));
    }
}
