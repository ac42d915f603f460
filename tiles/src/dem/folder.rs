//! Folders as inputs: all DEMs directly in one, or a pyramid of tiles `{z}/{x}/{y}.png`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::detect::{Head, kind_of};
use super::{DemError, esri_header, side};

/// The most entries of a folder.
const MAX_ENTRIES: u64 = 1 << 22;

/// Replaces each folder among inputs by the DEMs directly in it, sorted by name; a folder of
/// tiles stays one input.
///
/// # Errors
/// [`DemError::Usage`] for a folder without a DEM; [`DemError::Io`].
pub fn expand(paths: &[PathBuf]) -> Result<Vec<PathBuf>, DemError> {
    let mut all = Vec::new();
    for path in paths {
        match path.is_dir() && !is_pyramid(path)? {
            true => all.extend(dems_in(path)?),
            false => all.push(path.clone()),
        }
    }
    Ok(all)
}

/// Whether a folder has tiles `{z}/{x}/{y}.png`.
///
/// # Errors
/// [`DemError::Io`].
pub(super) fn is_pyramid(path: &Path) -> Result<bool, DemError> {
    for zoom in numbered(path)?.values() {
        for column in numbered(zoom)?.values() {
            if !numbered_files(column, "png")?.is_empty() {
                return Ok(true);
            }
        }
    }
    Ok(false)
}

/// The DEMs directly in a folder, sorted. Pictures and bare numbers only count where nothing
/// else does, as they may be previews and notes.
///
/// # Errors
/// [`DemError::Usage`] where there is none; [`DemError::Io`].
pub(super) fn dems_in(path: &Path) -> Result<Vec<PathBuf>, DemError> {
    let (mut sure, mut vague) = (Vec::new(), Vec::new());
    for file in entries(path)? {
        if !file.is_file() || is_hidden(&file) {
            continue;
        }
        match kind_of(&file, &Head::read(&file)?) {
            Some(kind) if kind.is_header() => sure.extend(esri_header::data_of(&file, kind).ok()),
            Some(kind) if kind.is_vague() && side::is_side_file(&file) => {}
            Some(kind) if kind.is_vague() => vague.push(file),
            Some(_) if is_overview(&file) => {}
            Some(_) => sure.push(file),
            None => {} // samples are found by their header
        }
    }
    let mut found = if sure.is_empty() { vague } else { sure };
    found.sort();
    found.dedup();
    match found.is_empty() {
        true => Err(DemError::usage(
            path,
            "it is a folder without a DEM",
            "name the files",
        )),
        false => Ok(found),
    }
}

/// GDAL's overviews and masks are TIFFs, too.
fn is_overview(file: &Path) -> bool {
    let extension = file.extension().unwrap_or_default();
    ["ovr", "msk"]
        .iter()
        .any(|e| extension.eq_ignore_ascii_case(e))
}

fn is_hidden(file: &Path) -> bool {
    file.file_name()
        .is_none_or(|name| name.to_string_lossy().starts_with('.'))
}

/// Folders in a folder whose names are numbers.
///
/// # Errors
/// [`DemError::Io`].
pub(super) fn numbered(path: &Path) -> Result<BTreeMap<u32, PathBuf>, DemError> {
    let number = |entry: &PathBuf| plain_number(entry.file_name()?.to_str()?);
    let found = entries(path)?
        .into_iter()
        .filter_map(|e| Some((number(&e)?, e)));
    Ok(found.filter(|(_, entry)| entry.is_dir()).collect())
}

/// Files in a folder that are called by a number and an extension.
///
/// # Errors
/// [`DemError::Io`].
pub(super) fn numbered_files(
    path: &Path,
    extension: &str,
) -> Result<BTreeMap<u32, PathBuf>, DemError> {
    let number = |entry: &PathBuf| {
        let fits = entry.extension()?.eq_ignore_ascii_case(extension);
        fits.then(|| plain_number(entry.file_stem()?.to_str()?))?
    };
    Ok(entries(path)?
        .into_iter()
        .filter_map(|e| Some((number(&e)?, e)))
        .collect())
}

/// Digits alone.
fn plain_number(text: &str) -> Option<u32> {
    let digits = text.bytes().all(|b| b.is_ascii_digit());
    digits.then(|| text.parse().ok())?
}

fn entries(path: &Path) -> Result<Vec<PathBuf>, DemError> {
    let failed = |error| DemError::io(path, "list", error);
    let mut found = Vec::new();
    for entry in std::fs::read_dir(path).map_err(failed)? {
        found.push(entry.map_err(failed)?.path());
        let count = found.len() as u64;
        if count > MAX_ENTRIES {
            return Err(DemError::limits(
                path,
                "its count",
                count,
                MAX_ENTRIES,
                "entries",
            ));
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Folder, hgt_bytes, png_bytes};
    use super::super::{OpenOptions, open, open_all};
    use super::*;

    #[test]
    fn a_folder_stands_for_the_dems_in_it_without_previews_and_notes() {
        let folder = Folder::new();
        let tile = hgt_bytes(1201, |row, column| row as i16 - column as i16);
        for name in ["N01E002.hgt", "N01E001.hgt", ".hidden.hgt"] {
            folder.write(name, &tile);
        }
        folder.write("preview.png", &png_bytes(2, 2, false, |_, _| 0));
        folder.write("readme.txt", b"what it is");
        folder.write("numbers.txt", b"1 2 3\n");
        let files = expand(&[folder.path().into()]).unwrap();
        let names: Vec<_> = files
            .iter()
            .map(|f| f.file_name().unwrap().to_str().unwrap())
            .collect();
        assert_eq!(names, ["N01E001.hgt", "N01E002.hgt"]);
        let options = OpenOptions::default();
        for opened in [
            open(folder.path(), &options),
            open_all(&[folder.path().into()], &options),
        ] {
            assert_eq!(opened.unwrap().info().width, 2401);
        }
    }

    #[test]
    fn samples_and_header_are_one_input() {
        let folder = Folder::new();
        folder.write(
            "a.hdr",
            b"NROWS 1\nNCOLS 2\nULXMAP 0\nULYMAP 0\nXDIM 1\nYDIM 1\n",
        );
        folder.write("a.bil", &[1, 2]);
        folder.write("a.prj", b"Projection UTM\nZone 32\nDatum WGS84\n");
        let files = expand(&[folder.path().into()]).unwrap();
        assert_eq!(files, [folder.path().join("a.bil")]);
    }

    #[test]
    fn a_folder_without_a_dem_says_so() {
        let folder = Folder::new();
        folder.write("readme.txt", b"what it is");
        let error = expand(&[folder.path().into()]).unwrap_err();
        assert!(error.to_string().contains("without a DEM"), "{error}");
    }
}
