//! From paths to sources: formats are told by content, not by name.

use std::path::{Path, PathBuf};

use super::ascii_grid::AsciiGrid;
use super::bitmap::Bitmap;
use super::detect::{self, Head, Kind};
use super::dted::Dted;
use super::geotiff::GeoTiff;
use super::hgt::Hgt;
use super::matrix::Matrix;
use super::mosaic::Mosaic;
use super::pyramid::Pyramid;
use super::raw::RawGrid;
use super::rgb::RgbTile;
use super::usgs::UsgsDem;
use super::{
    DemError, DemSource, JoinOptions, OpenOptions, Placement, envi, esri_header, folder, handover,
    unpack,
};
use crate::synth::SynthSource;

/// Opens one DEM: a file, a folder of tiles `{z}/{x}/{y}.png`, or `synth:size=...` (see
/// [`SynthSource::parse`]). Only its header is read, and
/// what is packed is unpacked; samples are decoded when rows are asked for.
///
/// # Errors
/// [`DemError`], sorted by who must act.
pub fn open(path: &Path, options: &OpenOptions) -> Result<Box<dyn DemSource>, DemError> {
    match SynthSource::parse(path) {
        Some(synth) => Ok(Box::new(synth?)),
        None => open_nested(path, options, 0),
    }
}

/// [`open`], for a file that came out of `depth` packed ones.
pub(super) fn open_nested(
    path: &Path,
    options: &OpenOptions,
    depth: u32,
) -> Result<Box<dyn DemSource>, DemError> {
    if path.is_dir() {
        return open_folder(path, options);
    }
    if std::fs::metadata(path).is_ok_and(|found| !found.is_file()) {
        let hint = "copy what it gives into a file";
        return Err(DemError::usage(path, "it is a pipe or a device", hint));
    }
    let head = Head::read(path)?;
    let kind = detect::kind_of(path, &head);
    match (kind, &options.raw) {
        (Some(Kind::Gzip), _) => unpack::open_gzip(path, options, depth),
        (Some(Kind::Zip), _) => unpack::open_zip(path, options, depth),
        (_, Some(shape)) => Ok(Box::new(RawGrid::open(path, shape, options)?)),
        (Some(kind), None) => open_kind(kind, path, options),
        (None, None) => match esri_header::header_of(path) {
            Some((header, kind)) => open_header(kind, &header, path, options),
            None => Err(detect::unknown(path, &head)),
        },
    }
}

fn open_kind(
    kind: Kind,
    path: &Path,
    options: &OpenOptions,
) -> Result<Box<dyn DemSource>, DemError> {
    Ok(match kind {
        Kind::GeoTiff => match GeoTiff::open(path, options) {
            Err(error) if handover::helps(&error) => handover::open(path, options, error)?,
            opened => Box::new(opened?),
        },
        Kind::Bitmap if options.rgb.is_some() => Box::new(RgbTile::open(path, options)?),
        Kind::Bitmap => Box::new(Bitmap::open(path, options)?),
        Kind::Dted => Box::new(Dted::open(path, options)?),
        Kind::AsciiGrid => Box::new(AsciiGrid::open(path, options)?),
        Kind::Usgs => Box::new(UsgsDem::open(path, options)?),
        Kind::Matrix => Box::new(Matrix::open(path, options)?),
        Kind::Hgt => Box::new(Hgt::open(path, options)?),
        Kind::EsriHeader | Kind::EnviHeader => {
            let data = esri_header::data_of(path, kind)?;
            return open_header(kind, path, &data, options);
        }
        Kind::Gzip | Kind::Zip => return Err(DemError::not_a_dem(path, "it is packed")),
    })
}

fn open_header(
    kind: Kind,
    header: &Path,
    data: &Path,
    options: &OpenOptions,
) -> Result<Box<dyn DemSource>, DemError> {
    Ok(Box::new(match kind {
        Kind::EnviHeader => envi::open(header, data, options)?,
        _ => esri_header::open(header, data, options)?,
    }))
}

fn open_folder(path: &Path, options: &OpenOptions) -> Result<Box<dyn DemSource>, DemError> {
    if folder::is_pyramid(path)? {
        return Ok(Box::new(Pyramid::open(path, options)?));
    }
    let files = folder::dems_in(path)?;
    match &files[..] {
        [one] => open(one, options),
        _ => Ok(Box::new(Mosaic::open(
            &files,
            options,
            JoinOptions::default(),
        )?)),
    }
}

/// Opens one source, or a [`Mosaic`] of several; a folder stands for the DEMs in it.
///
/// # Errors
/// Those of [`open`], and [`DemError::Usage`] for inputs that do not fit together.
pub fn open_all(paths: &[PathBuf], options: &OpenOptions) -> Result<Box<dyn DemSource>, DemError> {
    join_all(paths, options, JoinOptions::default())
}

/// As [`open_all`], with a say in how inputs are joined.
///
/// # Errors
/// As [`open_all`].
pub fn join_all(
    paths: &[PathBuf],
    options: &OpenOptions,
    join: JoinOptions,
) -> Result<Box<dyn DemSource>, DemError> {
    match &folder::expand(paths)?[..] {
        [one] => open(one, options),
        several => Ok(Box::new(Mosaic::open(several, options, join)?)),
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
        let error = error("picture.tif", b"GIX89a..");
        assert!(matches!(error, DemError::NotADem { .. }));
        assert!(error.to_string().contains("GIX89a"), "{error}");
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
