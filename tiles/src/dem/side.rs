//! Files beside a DEM: the world file that places a raster, and the `.prj` that names its
//! coordinate system.
//!
//! A world file has six lines, A D B E C F: x = A * column + B * row + C, y = D * column +
//! E * row + F, where (C, F) is the *centre* of the first stored sample.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::affine::{self, Layout};
use super::open::local_placement;
use super::{Crs, DemError, OpenOptions, prj};

/// The most bytes of a header, world file or `.prj`.
pub(super) const MAX_SIDE_BYTES: u64 = 1 << 20;

/// Extensions of files that only say something of others.
pub(super) const SIDE_EXTENSIONS: [&str; 16] = [
    "prj", "hdr", "wld", "tfw", "tifw", "pgw", "pngw", "jgw", "jpgw", "bpw", "bmpw", "blw", "bilw",
    "pnw", "pgmw", "flw",
];

/// The file of the same stem with one of these extensions, in lower or upper case.
pub(super) fn beside(path: &Path, extensions: &[&str]) -> Option<PathBuf> {
    let spelled = |e: &&str| [e.to_string(), e.to_ascii_uppercase()];
    extensions
        .iter()
        .flat_map(spelled)
        .map(|extension| path.with_extension(extension))
        .find(|candidate| candidate != path && candidate.is_file())
}

/// Whether a file only says something of others, by its extension.
pub(super) fn is_side_file(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default();
    let also = ["txt", "xml", "aux", "md", "html", "pdf"];
    SIDE_EXTENSIONS
        .iter()
        .chain(&also)
        .any(|e| extension.eq_ignore_ascii_case(e))
}

/// A small text file; bytes that are no UTF-8 are replaced.
///
/// # Errors
/// [`DemError::Limits`] beyond [`MAX_SIDE_BYTES`], [`DemError::Io`].
pub(super) fn read_text(path: &Path) -> Result<String, DemError> {
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(|e| DemError::io(path, "open", e))?;
    file.take(MAX_SIDE_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(|e| DemError::io(path, "read", e))?;
    let found = bytes.len() as u64;
    if found > MAX_SIDE_BYTES {
        let what = "this side file";
        return Err(DemError::limits(path, what, found, MAX_SIDE_BYTES, "bytes"));
    }
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// What the `.prj` beside a file says, or else what the user said.
///
/// # Errors
/// [`DemError::Unsupported`] naming the `.prj`.
pub(super) fn projection(
    path: &Path,
    options: &OpenOptions,
) -> Result<Option<prj::Projection>, DemError> {
    let given = || options.crs.clone().map(prj::Projection::of);
    let Some(beside) = beside(path, &["prj"]) else {
        return Ok(given());
    };
    let text = read_text(&beside)?;
    match prj::parse(&text) {
        Ok(projection) => Ok(Some(projection)),
        Err(_) if options.crs.is_some() => Ok(given()),
        Err(why) => {
            let hint = "name the coordinate system: --input-crs EPSG:CODE";
            Err(DemError::unsupported(&beside, why, hint))
        }
    }
}

/// The layout that a world file beside `path` gives a raster of `height` rows.
///
/// # Errors
/// [`DemError::Damaged`] naming the world file; [`DemError::Unsupported`] for a rotated raster.
pub(super) fn world_file(path: &Path, height: u32) -> Result<Option<Layout>, DemError> {
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    let extension = extension.to_ascii_lowercase();
    let (first, last) = (extension.chars().next(), extension.chars().last());
    let short: String = first.into_iter().chain(last).chain(['w']).collect();
    let Some(file) = beside(path, &[&short, &format!("{extension}w"), "wld"]) else {
        return Ok(None);
    };
    let text = read_text(&file)?;
    let numbers: Option<Vec<f64>> = text.split_whitespace().map(|t| t.parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[a, d, b, e, c, f]) => affine::of_first_sample([a, b, c, d, e, f], height, &file),
        _ => {
            let words = text
                .split_whitespace()
                .take(7)
                .collect::<Vec<_>>()
                .join(" ");
            let expected =
                "6 numbers: step x, rotation, rotation, step y, x and y of the first sample";
            let found = format!("{words:?}");
            Err(DemError::damaged(&file, "the world file", found, expected))
        }
    }
    .map(Some)
}

/// Where samples lie, of what a file says and what the user says: both a layout and a CRS, or a
/// spacing in metres.
///
/// # Errors
/// [`DemError::Usage`] saying what is missing.
pub(super) fn settle(
    layout: Option<Layout>,
    crs: Option<Crs>,
    path: &Path,
    options: &OpenOptions,
) -> Result<(Layout, Crs), DemError> {
    match (layout, crs.or_else(|| options.crs.clone())) {
        (Some(layout), Some(crs)) => Ok((layout, crs)),
        (Some(_), None) if options.spacing_m.is_none() => {
            let hint = "name it: --input-crs EPSG:CODE, or a .prj beside the file; or give \
                        --spacing in metres, which leaves the place out";
            let what = "it is placed, but in no named coordinate system";
            Err(DemError::usage(path, what, hint))
        }
        (layout, _) => {
            let placement = local_placement(options, path)?;
            let south_up = layout.is_some_and(|layout| layout.south_up);
            let layout = Layout {
                placement,
                south_up,
            };
            Ok((layout, Crs::Local))
        }
    }
}
