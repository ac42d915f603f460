//! GeoTIFFs packed in ways that the decoder does not know (LERC, LZMA, JPEG, odd bits) go through
//! `gdal_translate`, if it is installed, to a temporary GeoTIFF.

use std::io::ErrorKind;
use std::path::Path;
use std::process::{Command, Stdio};

use super::geotiff::{COMPRESSION, GeoTiff, SAMPLE_FORMAT};
use super::unpack::Spool;
use super::{DemError, DemSource, OpenOptions};

/// The program that converts.
const PROGRAM: &str = "gdal_translate";

/// Options that lose nothing, and make a file that is read fast.
const OPTIONS: [&str; 11] = [
    "-q",
    "-of",
    "GTiff",
    "-co",
    "COMPRESS=DEFLATE",
    "-co",
    "ZLEVEL=1",
    "-co",
    "TILED=YES",
    "-co",
    "BIGTIFF=IF_SAFER",
];

/// Whether GDAL may read what was refused.
pub(super) fn helps(error: &DemError) -> bool {
    match error {
        DemError::Unsupported { what, .. } => {
            what.starts_with(COMPRESSION) || wider_type(what).is_some()
        }
        _ => false,
    }
}

/// GDAL's type that holds samples of odd bits: whole numbers (formats 1 and 2), floats (3).
fn wider_type(refusal: &str) -> Option<&'static str> {
    match refusal.strip_prefix(SAMPLE_FORMAT)?.trim_start().get(..2)? {
        "1 " | "2 " => Some("Int32"),
        "3 " => Some("Float32"),
        _ => None,
    }
}

/// Converts and opens; the refusal comes back where GDAL is not installed.
///
/// # Errors
/// `refusal`; [`DemError::Unsupported`] with GDAL's own words where it fails, too.
pub(super) fn open(
    path: &Path,
    options: &OpenOptions,
    refusal: DemError,
) -> Result<Box<dyn DemSource>, DemError> {
    open_with(PROGRAM, path, options, refusal)
}

fn open_with(
    program: &str,
    path: &Path,
    options: &OpenOptions,
    refusal: DemError,
) -> Result<Box<dyn DemSource>, DemError> {
    let spool = Spool::converted(path, "converted.tif")?;
    // A whole path never looks like an option.
    let whole = path
        .canonicalize()
        .map_err(|e| DemError::io(path, "find", e))?;
    let DemError::Unsupported { what, hint, .. } = &refusal else {
        return Err(refusal);
    };
    let wider = wider_type(what).map(|name| ["-ot", name]);
    let ran = Command::new(program)
        .args(OPTIONS)
        .args(wider.into_iter().flatten())
        .arg(whole)
        .arg(spool.file())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .output();
    let output = match ran {
        Err(error) if error.kind() == ErrorKind::NotFound => return Err(refusal),
        Err(error) => return Err(DemError::io(path, "run gdal_translate on it", error)),
        Ok(output) => output,
    };
    if !output.status.success() {
        let words = String::from_utf8_lossy(&output.stderr);
        let words: String = words.trim().chars().take(300).collect();
        let what = format!("{what}, which {program} failed to convert ({words}),");
        return Err(DemError::unsupported(path, what, hint.as_str()));
    }
    super::note(
        path,
        &format!("{what}: converted by {program} to a temporary file"),
    );
    spool.open(|file| Ok(Box::new(GeoTiff::open(file, options)?)))
}

#[cfg(test)]
mod tests {
    use super::super::SampleType;
    use super::super::testing::{Folder, Tiff, read_all};
    use super::*;

    fn lerc(folder: &Folder) -> std::path::PathBuf {
        let tiff = Tiff {
            compression: 34887,
            ..Tiff::plain(4, 3, SampleType::I16)
        };
        folder.write("a.tif", &tiff.bytes(|_, _| 0.0))
    }

    fn refused(program: &str) -> DemError {
        let folder = Folder::new();
        let path = lerc(&folder);
        let options = OpenOptions::default();
        let refusal = GeoTiff::open(&path, &options).err().unwrap();
        assert!(helps(&refusal), "{refusal}");
        open_with(program, &path, &options, refusal).err().unwrap()
    }

    #[test]
    fn without_the_program_the_error_names_its_command() {
        let error = refused("escarp-there-is-no-such-program").to_string();
        assert!(error.contains("34887 (LERC)"), "{error}");
        assert!(
            error.contains("gdal_translate -co COMPRESS=DEFLATE"),
            "{error}"
        );
    }

    #[test]
    fn a_program_that_fails_is_quoted_and_its_command_named() {
        // The data are no LERC: with or without GDAL installed there is an error.
        let folder = Folder::new();
        let error = read_all(&lerc(&folder), &OpenOptions::default()).unwrap_err();
        assert!(error.to_string().contains("gdal_translate"), "{error}");
    }

    #[test]
    fn other_refusals_stay() {
        let other = DemError::unsupported(Path::new("f"), "an image with 3 bands", "take one");
        assert!(!helps(&other));
    }
}
