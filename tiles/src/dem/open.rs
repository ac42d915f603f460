//! From paths to sources: formats are told by content, not by name.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::geotiff::GeoTiff;
use super::hgt::{self, Hgt};
use super::mosaic::Mosaic;
use super::png::Png;
use super::{DemError, DemSource, OpenOptions, Placement};
use crate::synth::SynthSource;

/// Opens one DEM: a file, or `synth:size=...` (see [`SynthSource::parse`]). Only its header is read; samples are decoded when rows are asked for.
///
/// # Errors
/// [`DemError`], sorted by who must act.
pub fn open(path: &Path, options: &OpenOptions) -> Result<Box<dyn DemSource>, DemError> {
    if let Some(synth) = SynthSource::parse(path) {
        return Ok(Box::new(synth?));
    }
    let (magic, length) = first_bytes(path)?;
    Ok(match &magic[..] {
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => {
            Box::new(GeoTiff::open(path, options)?)
        }
        [0x89, b'P', b'N', b'G', ..] => Box::new(Png::open(path, options)?),
        [b'P', b'K', 3, 4, ..] | [b'P', b'K', 5, 6, ..] => Box::new(Hgt::open_zip(path, options)?),
        _ if hgt::looks_like(path, length) => Box::new(Hgt::open(path, options)?),
        [] => return Err(DemError::not_a_dem(path, "the file is empty")),
        _ => {
            return Err(DemError::not_a_dem(
                path,
                format!("it starts with {}", shown(&magic)),
            ));
        }
    })
}

/// Opens one source, or a [`Mosaic`] of several.
///
/// # Errors
/// Those of [`open`], and [`DemError::Usage`] for inputs that do not fit together.
pub fn open_all(paths: &[PathBuf], options: &OpenOptions) -> Result<Box<dyn DemSource>, DemError> {
    match paths {
        [one] => open(one, options),
        _ => Ok(Box::new(Mosaic::open(paths, options)?)),
    }
}

/// The placement of a file without georeference, from the user's spacing.
///
/// # Errors
/// [`DemError::Usage`] if the spacing is not given, or is no length.
pub(super) fn local_placement(options: &OpenOptions, path: &Path) -> Result<Placement, DemError> {
    let Some(spacing_m) = options.spacing_m else {
        let hint = "give the distance between samples in metres: --spacing 30";
        return Err(DemError::usage(path, "it has no georeference", hint));
    };
    if !spacing_m.is_finite() || spacing_m <= 0.0 {
        let what = format!("a spacing of {spacing_m} m");
        return Err(DemError::usage(path, what, "give a length above 0 m"));
    }
    Ok(Placement {
        x0: 0.0,
        y0: 0.0,
        dx: spacing_m,
        dy: spacing_m,
    })
}

fn first_bytes(path: &Path) -> Result<(Vec<u8>, u64), DemError> {
    let failed = |doing| move |error| DemError::io(path, doing, error);
    let file = File::open(path).map_err(failed("open"))?;
    let metadata = file.metadata().map_err(failed("ask the size"))?;
    if metadata.is_dir() {
        return Err(DemError::usage(
            path,
            "it is a folder",
            "name the files in it",
        ));
    }
    let mut magic = Vec::new();
    file.take(8)
        .read_to_end(&mut magic)
        .map_err(failed("read"))?;
    Ok((magic, metadata.len()))
}

fn shown(magic: &[u8]) -> String {
    format!("\"{}\"", magic.escape_ascii())
}

#[cfg(test)]
mod tests {
    use super::super::testing::Folder;
    use super::*;

    fn error(name: &str, bytes: &[u8]) -> DemError {
        let folder = Folder::new();
        let path = folder.write(name, bytes);
        open(&path, &OpenOptions::default())
            .err()
            .expect("an error")
    }

    #[test]
    fn a_file_of_another_kind_is_named_with_its_first_bytes() {
        let error = error("picture.tif", b"GIF89a..");
        assert!(matches!(error, DemError::NotADem { .. }));
        assert!(error.to_string().contains("GIF89a"), "{error}");
    }

    #[test]
    fn an_empty_file_says_so() {
        assert!(error("a.tif", b"").to_string().contains("empty"));
    }

    #[test]
    fn a_folder_and_a_missing_file_are_told_apart() {
        let folder = Folder::new();
        let options = OpenOptions::default();
        assert!(matches!(
            open(folder.path(), &options),
            Err(DemError::Usage { .. })
        ));
        let missing = folder.path().join("none.tif");
        assert!(matches!(open(&missing, &options), Err(DemError::Io { .. })));
    }

    #[test]
    fn no_inputs_are_a_usage_error() {
        let none = open_all(&[], &OpenOptions::default());
        assert!(matches!(none, Err(DemError::Usage { .. })));
    }
}
