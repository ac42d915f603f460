//! A folder of tiles `{z}/{x}/{y}.png` as one source: one zoom of it, with holes where tiles are
//! missing. A row of tiles is decoded at a time.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::heights::{self, HeightRule};
use super::rgb::{self, MAX_ZOOM};
use super::{
    DemError, DemInfo, DemSource, MAX_SIDE_SAMPLES, OpenOptions, Registration, SampleType, folder,
};

/// The most tiles of one zoom: what is known of each is in memory.
const MAX_TILES: u64 = 1 << 22;

/// Decoded tiles of a row are kept for the next band up to this many bytes.
const KEPT_BYTES: u64 = 512 << 20;

/// Tiles decoded at once.
const BATCH: usize = 32;

type Numbers = Vec<u32>;

/// One open folder, at one zoom.
pub(super) struct Pyramid {
    info: DemInfo,
    rule: HeightRule,
    tile_px: u32,
    /// Of the north-west tile.
    first: [u32; 2],
    /// By row, then column, of tiles.
    tiles: BTreeMap<[u32; 2], PathBuf>,
    kept: BTreeMap<[u32; 2], Numbers>,
}

/// The tiles of a zoom, by row and column.
type Tiles = BTreeMap<[u32; 2], PathBuf>;

impl Pyramid {
    /// Lists the tiles of a zoom: the one asked for, or the deepest whose tiles leave no gap in
    /// the box around them, or else the deepest.
    ///
    /// # Errors
    /// [`DemError::Usage`] where it is not said how colours code heights, or for a zoom that is
    /// not there; [`DemError::Limits`]; [`DemError::Io`].
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, DemError> {
        let Some(coding) = options.rgb else {
            let hint = "say how their colours code heights: --rgb mapbox or --rgb terrarium";
            return Err(DemError::usage(path, "it is a folder of tiles", hint));
        };
        let (zoom, tiles) = choose(path, options.zoom)?;
        let rule = HeightRule::resolve(coding.rule(), options, SampleType::U32, path)?;
        let (first, size) = around(&tiles);
        let Some(any) = tiles.values().next() else {
            return Err(DemError::usage(
                path,
                "it has no tiles",
                "name another folder",
            ));
        };
        let [tile_px, height_px] = rgb::side_px(any)?;
        if tile_px != height_px || tile_px == 0 {
            let found = format!("{tile_px} x {height_px} samples");
            return Err(DemError::damaged(any, "the tile's size", found, "a square"));
        }
        let side = |what, tiles: u32| {
            let (found, allowed) = (
                u64::from(tiles) * u64::from(tile_px),
                u64::from(MAX_SIDE_SAMPLES),
            );
            let fits = u32::try_from(found).ok().filter(|_| found <= allowed);
            fits.ok_or_else(|| DemError::limits(path, what, found, allowed, "samples"))
        };
        let info = DemInfo {
            path: path.into(),
            format: "RGB tiles",
            width: side("width", size[1])?,
            height: side("height", size[0])?,
            placement: rgb::placement([zoom, first[1], first[0]], tile_px),
            crs: rgb::web_mercator(),
            registration: Registration::Cell,
            sample_type: SampleType::U32,
            height_step_m: rule.step_m,
            nodata: rule.nodata,
            vertical: None,
        };
        Ok(Self {
            info,
            rule,
            tile_px,
            first,
            tiles,
            kept: BTreeMap::new(),
        })
    }

    /// Copies the rows of a tile that lie in a band.
    fn place(&self, [row, column]: [u32; 2], numbers: &[u32], band: (u32, u32), out: &mut [f64]) {
        let side = self.tile_px;
        let (top, left) = (
            (row - self.first[0]) * side,
            (column - self.first[1]) * side,
        );
        let width = self.info.width as usize;
        for y in top.max(band.0)..(top + side).min(band.1) {
            let from = (y - top) as usize * side as usize;
            let to = (y - band.0) as usize * width + left as usize;
            let stored = &numbers[from..from + side as usize];
            for (height, number) in out[to..to + side as usize].iter_mut().zip(stored) {
                *height = rgb::height_m(*number, &self.rule);
            }
        }
    }

    /// First row of tiles that a band meets, and the one after the last.
    fn tile_rows(&self, first_row: u32, rows: u32) -> [u32; 2] {
        let end = (first_row + rows).div_ceil(self.tile_px);
        [
            self.first[0] + first_row / self.tile_px,
            self.first[0] + end,
        ]
    }

    fn decode(&self, at: &[u32; 2]) -> Result<Numbers, DemError> {
        let path = &self.tiles[at];
        let found = rgb::side_px(path)?;
        if found != [self.tile_px; 2] {
            let found = format!("{} x {} samples", found[0], found[1]);
            let expected = format!("{0} x {0}, as in the others", self.tile_px);
            return Err(DemError::damaged(path, "the tile's size", found, expected));
        }
        rgb::numbers(path)
    }
}

impl DemSource for Pyramid {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        out.fill(f64::NAN);
        let band = (first_row, first_row + rows);
        let [top, bottom] = self.tile_rows(first_row, rows);
        let wanted: Vec<[u32; 2]> = self
            .tiles
            .range([top, 0]..[bottom, 0])
            .map(|t| *t.0)
            .collect();
        self.kept.retain(|at, _| (top..bottom).contains(&at[0]));
        let (have, missing): (Vec<_>, Vec<_>) = wanted
            .into_iter()
            .partition(|at| self.kept.contains_key(at));
        for at in have {
            self.place(at, &self.kept[&at], band, out);
        }
        let tile_bytes = 4 * u64::from(self.tile_px).pow(2);
        for batch in missing.chunks(BATCH) {
            let decoded: Result<Vec<Numbers>, _> =
                batch.par_iter().map(|at| self.decode(at)).collect();
            for (at, numbers) in batch.iter().zip(decoded?) {
                self.place(*at, &numbers, band, out);
                if (self.kept.len() as u64 + 1) * tile_bytes <= KEPT_BYTES {
                    self.kept.insert(*at, numbers);
                }
            }
        }
        heights::check(&self.info, first_row, out)
    }

    fn data_columns(&self, first_row: u32, rows: u32) -> Vec<Range<u32>> {
        let [top, bottom] = self.tile_rows(first_row, rows);
        let tiles = self.tiles.range([top, 0]..[bottom, 0]);
        let columns: BTreeSet<u32> = tiles.map(|(at, _)| at[1] - self.first[1]).collect();
        let mut spans: Vec<Range<u32>> = Vec::new();
        for column in columns {
            let span = column * self.tile_px..(column + 1) * self.tile_px;
            match spans.last_mut() {
                Some(last) if last.end == span.start => last.end = span.end,
                _ => spans.push(span),
            }
        }
        spans
    }
}

/// First row and column, and counts of rows and columns, of the box around tiles.
fn around(tiles: &Tiles) -> ([u32; 2], [u32; 2]) {
    let mut least = [u32::MAX; 2];
    let mut most = [0; 2];
    for at in tiles.keys() {
        for axis in 0..2 {
            least[axis] = least[axis].min(at[axis]);
            most[axis] = most[axis].max(at[axis]);
        }
    }
    let count = |axis: usize| (most[axis] + 1).saturating_sub(least[axis]);
    (least, [count(0), count(1)])
}

fn choose(path: &Path, asked: Option<u8>) -> Result<(u32, Tiles), DemError> {
    let zooms = folder::numbered(path)?;
    if let Some(asked) = asked.map(u32::from) {
        let Some(folder) = zooms.get(&asked) else {
            let has: Vec<String> = zooms.keys().map(u32::to_string).collect();
            let what = format!("it has no zoom {asked}");
            let hint = format!("it has {}", has.join(", "));
            return Err(DemError::usage(path, what, hint));
        };
        return Ok((asked, tiles_in(folder, asked)?));
    }
    let mut deepest: Option<(u32, Tiles)> = None;
    for (zoom, folder) in zooms.iter().rev() {
        let tiles = tiles_in(folder, *zoom)?;
        let (_, [rows, columns]) = around(&tiles);
        if !tiles.is_empty() && tiles.len() as u64 == u64::from(rows) * u64::from(columns) {
            if let Some((deepest, _)) = &deepest {
                let text = format!(
                    "zoom {zoom} is read, as tiles of {deepest} are missing; --zoom {deepest} \
                     reads those that are there"
                );
                super::note(path, &text);
            }
            return Ok((*zoom, tiles));
        }
        if !tiles.is_empty() && deepest.is_none() {
            deepest = Some((*zoom, tiles));
        }
    }
    deepest.ok_or_else(|| DemError::usage(path, "it has no tiles", "name another folder"))
}

fn tiles_in(folder: &Path, zoom: u32) -> Result<Tiles, DemError> {
    let mut tiles = Tiles::new();
    if zoom > MAX_ZOOM {
        let what = format!("zoom {zoom}");
        return Err(DemError::usage(
            folder,
            what,
            format!("at most {MAX_ZOOM} is read"),
        ));
    }
    for (x, column) in folder::numbered(folder)? {
        for (y, tile) in folder::numbered_files(&column, "png")? {
            if x >= 1 << zoom || y >= 1 << zoom {
                let found = format!("column {x}, row {y}");
                let expected = format!("below {} at zoom {zoom}", 1u32 << zoom);
                return Err(DemError::damaged(&tile, "the tile's name", found, expected));
            }
            tiles.insert([y, x], tile);
        }
        let found = tiles.len() as u64;
        if found > MAX_TILES {
            return Err(DemError::limits(
                folder,
                "its count",
                found,
                MAX_TILES,
                "tiles",
            ));
        }
    }
    Ok(tiles)
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Folder, read_all, rgba_bytes};
    use super::super::{RgbCoding, open};
    use super::*;

    const SIDE: u32 = 4;

    /// Tiles of a ramp over the world's pixels at their zoom, in tenths of a metre above zero.
    fn write_tile(folder: &Folder, [zoom, x, y]: [u32; 3]) {
        std::fs::create_dir_all(folder.path().join(format!("{zoom}/{x}"))).unwrap();
        let bytes = rgba_bytes(SIDE, SIDE, |r, c| {
            let [_, a, b, c] = (100_000 + ramp(x * SIDE + c, y * SIDE + r)).to_be_bytes();
            [a, b, c, 255]
        });
        folder.write(&format!("{zoom}/{x}/{y}.png"), &bytes);
    }

    fn ramp(column: u32, row: u32) -> u32 {
        column * 30 + row * 700
    }

    fn mapbox() -> OpenOptions {
        OpenOptions {
            rgb: Some(RgbCoding::Mapbox),
            ..OpenOptions::default()
        }
    }

    #[test]
    fn tiles_form_one_ramp_with_a_hole_where_one_is_missing() {
        let folder = Folder::new();
        for tile in [[3, 2, 5], [3, 3, 5], [3, 2, 6]] {
            write_tile(&folder, tile);
        }
        let (info, heights) = read_all(folder.path(), &mapbox()).unwrap();
        assert_eq!((info.width, info.height), (2 * SIDE, 2 * SIDE));
        assert_eq!(info.placement, rgb::placement([3, 2, 5], SIDE));
        for (at, height) in heights.iter().enumerate() {
            let (row, column) = (at as u32 / info.width, at as u32 % info.width);
            let expected = f64::from(ramp(2 * SIDE + column, 5 * SIDE + row)) * 0.1;
            let missing = row >= SIDE && column >= SIDE;
            assert_eq!(height.is_nan(), missing, "{row} {column}");
            assert!(
                missing || (height - expected).abs() < 1e-9,
                "{height} {expected}"
            );
        }
    }

    #[test]
    fn the_deepest_zoom_without_a_gap_is_read_or_the_one_asked_for() {
        let folder = Folder::new();
        for tile in [[0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 0, 0], [2, 1, 1]] {
            write_tile(&folder, tile);
        }
        let width =
            |options: &OpenOptions| open(folder.path(), options).unwrap().info().placement.dx;
        let at = |zoom| rgb::placement([zoom, 0, 0], SIDE).dx;
        assert_eq!(width(&mapbox()), at(1));
        for zoom in [0, 1, 2] {
            let options = OpenOptions {
                zoom: Some(zoom),
                ..mapbox()
            };
            assert_eq!(width(&options), at(u32::from(zoom)));
        }
        let none = OpenOptions {
            zoom: Some(7),
            ..mapbox()
        };
        let error = open(folder.path(), &none).err().unwrap().to_string();
        assert!(error.contains("0, 1, 2"), "{error}");
    }

    #[test]
    fn without_a_coding_with_odd_names_or_sizes_it_is_refused() {
        let folder = Folder::new();
        write_tile(&folder, [1, 0, 0]);
        let error = open(folder.path(), &OpenOptions::default()).err().unwrap();
        assert!(error.to_string().contains("--rgb"), "{error}");
        write_tile(&folder, [1, 1, 0]);
        folder.write("1/1/0.png", &rgba_bytes(3, 3, |_, _| [1, 2, 3, 255]));
        let error = read_all(folder.path(), &mapbox()).unwrap_err();
        assert!(error.to_string().contains("1/1/0.png"), "{error}");
        write_tile(&folder, [1, 2, 0]);
        let error = open(folder.path(), &mapbox()).err().unwrap();
        assert!(error.to_string().contains("column 2"), "{error}");
    }
}
