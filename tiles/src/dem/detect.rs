//! Formats are told by content: the first bytes, and for the formats without any sign, the size
//! or what lies beside the file.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::{DemError, ascii_grid, esri_header, hgt, usgs};

/// First bytes that are looked at.
pub(super) const HEAD_BYTES: u64 = 4096;

/// The first bytes of a file, and its length.
pub(super) struct Head {
    /// At most [`HEAD_BYTES`].
    pub bytes: Vec<u8>,
    /// Of the whole file, in bytes; `u64::MAX` where it is not known.
    pub length: u64,
}

impl Head {
    /// Reads them.
    ///
    /// # Errors
    /// [`DemError::Io`].
    pub fn read(path: &Path) -> Result<Self, DemError> {
        let failed = |doing| move |error| DemError::io(path, doing, error);
        let file = File::open(path).map_err(failed("open"))?;
        let length = file.metadata().map_err(failed("ask the size"))?.len();
        let mut bytes = Vec::new();
        file.take(HEAD_BYTES)
            .read_to_end(&mut bytes)
            .map_err(failed("read"))?;
        Ok(Self { bytes, length })
    }

    /// The first bytes, if they are plain text.
    pub fn text(&self) -> Option<&str> {
        let plain = |b: &u8| matches!(b, b' '..=b'~' | b'\t' | b'\r' | b'\n');
        let text = self
            .bytes
            .strip_prefix(b"\xef\xbb\xbf")
            .unwrap_or(&self.bytes);
        (!text.is_empty() && text.iter().all(plain)).then_some(())?;
        std::str::from_utf8(text).ok()
    }

    /// Whether [`Self::bytes`] is the whole file.
    fn is_whole(&self) -> bool {
        self.bytes.len() as u64 == self.length
    }
}

/// What a file is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    GeoTiff,
    Bitmap,
    Zip,
    Gzip,
    Dted,
    AsciiGrid,
    Usgs,
    /// `.hdr` of a `.bil`, `.bip`, `.bsq` or `.flt`.
    EsriHeader,
    /// `.hdr` of ENVI.
    EnviHeader,
    /// Numbers and nothing else.
    Matrix,
    Hgt,
}

impl Kind {
    /// Whether it is only said of a header beside which the samples lie.
    pub fn is_header(self) -> bool {
        matches!(self, Self::EsriHeader | Self::EnviHeader)
    }

    /// Whether the file may well be something else than a DEM.
    pub fn is_vague(self) -> bool {
        matches!(self, Self::Bitmap | Self::Matrix)
    }
}

/// What a file is by its first bytes; by its name only where the format has no other sign.
pub(super) fn kind_of(name: &Path, head: &Head) -> Option<Kind> {
    Some(match &head.bytes[..] {
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => Kind::GeoTiff,
        [0x89, b'P', b'N', b'G', ..] | [0xff, 0xd8, 0xff, ..] => Kind::Bitmap,
        [b'B', b'M', _, _, _, _, 0, 0, 0, 0, ..] => Kind::Bitmap,
        [b'P', b'2' | b'5', b' ' | b'\t' | b'\r' | b'\n', ..] => Kind::Bitmap,
        [b'P', b'K', 3, 4, ..] | [b'P', b'K', 5, 6, ..] => Kind::Zip,
        [0x1f, 0x8b, 8, ..] => Kind::Gzip,
        // A DTED may start with the labels of the tape that it was on.
        [b'U', b'H', b'L', b'1', ..] | [b'V' | b'H', b'O' | b'D', b'L' | b'R', ..]
            if super::dted::looks_like(&head.bytes) =>
        {
            Kind::Dted
        }
        _ if hgt::looks_like(name, head.length) => Kind::Hgt,
        _ => return head.text().and_then(|text| kind_of_text(text, head)),
    })
}

fn kind_of_text(text: &str, head: &Head) -> Option<Kind> {
    let first = text.split_whitespace().next()?;
    if first == "ENVI" {
        return Some(Kind::EnviHeader);
    }
    if usgs::looks_like(text) {
        return Some(Kind::Usgs);
    }
    if ascii_grid::looks_like(text) {
        return Some(Kind::AsciiGrid);
    }
    if esri_header::looks_like(text) {
        return Some(Kind::EsriHeader);
    }
    let mut tokens: Vec<&str> = text.split_whitespace().collect();
    if !head.is_whole() {
        tokens.pop(); // it may be cut
    }
    let number = |token: &&str| token.parse::<f64>().is_ok();
    (tokens.len() >= 2 && tokens.iter().all(number)).then_some(Kind::Matrix)
}

/// What is known of formats that are not read here: first bytes, name, and what to do.
const OTHERS: [(&[u8], &str, &str); 17] = [
    (
        b"\x89HDF",
        "HDF5 or NetCDF 4",
        "gdalinfo lists its layers; gdal_translate NETCDF:INPUT:LAYER OUTPUT.tif takes one",
    ),
    (
        b"CDF",
        "NetCDF",
        "gdalinfo lists its layers; gdal_translate NETCDF:INPUT:LAYER OUTPUT.tif takes one",
    ),
    (
        b"GRIB",
        "GRIB",
        "gdal_translate -b 1 INPUT OUTPUT.tif takes one of its bands",
    ),
    (
        b"EHFA_HEADER_TAG",
        "ERDAS Imagine",
        "gdal_translate INPUT OUTPUT.tif converts it",
    ),
    (
        b"SQLite format 3",
        "GeoPackage or MBTiles",
        "gdal_translate INPUT OUTPUT.tif converts its raster",
    ),
    (
        b"LASF",
        "a LAS or LAZ point cloud",
        "pdal makes a raster of it: pdal pipeline, with writers.gdal",
    ),
    (
        b"Lerc2 ",
        "a bare LERC blob",
        "gdal_translate INPUT OUTPUT.tif converts it",
    ),
    (
        b"CntZImage",
        "a bare LERC blob",
        "gdal_translate INPUT OUTPUT.tif converts it",
    ),
    (
        b"binterr",
        "VTP binary terrain",
        "gdal_translate INPUT OUTPUT.tif converts it",
    ),
    (
        b"DSAA",
        "a Surfer ASCII grid",
        "gdal_translate INPUT OUTPUT.tif converts it",
    ),
    (
        b"DSBB",
        "a Surfer grid",
        "gdal_translate INPUT OUTPUT.tif converts it",
    ),
    (
        b"GIF8",
        "a GIF picture",
        "a picture is no DEM; 16-bit PNG and GeoTIFF are read",
    ),
    (b"BZh", "bzip2", "unpack it first: bunzip2 --keep INPUT"),
    (
        b"\xfd7zXZ",
        "xz",
        "unpack it first: xz --decompress --keep INPUT",
    ),
    (
        b"\x28\xb5\x2f\xfd",
        "zstd",
        "unpack it first: zstd --decompress INPUT",
    ),
    (
        b"7z\xbc\xaf\x27\x1c",
        "7-Zip",
        "unpack it first: 7z x INPUT",
    ),
    (
        b"\x1f\x9d",
        "compress (.Z)",
        "unpack it first: gunzip INPUT",
    ),
];

/// The error for a file that is none of [`Kind`].
pub(super) fn unknown(path: &Path, head: &Head) -> DemError {
    if head.length == 0 {
        return DemError::not_a_dem(path, "the file is empty");
    }
    let known = OTHERS
        .iter()
        .find(|(magic, ..)| head.bytes.starts_with(magic));
    if let Some((_, name, hint)) = known {
        let file = format!("'{}'", path.display());
        return DemError::unsupported(path, *name, hint.replace("INPUT", &file));
    }
    let shown = &head.bytes[..head.bytes.len().min(16)];
    let text = head.bytes.iter().filter(|b| b.is_ascii_graphic()).count() * 2 > head.bytes.len();
    let what = if text { "text" } else { "binary" };
    let size = match head.length {
        u64::MAX => String::new(),
        length => format!(" of {length} bytes"),
    };
    let found = format!("{what}{size} that starts with \"{}\"", shown.escape_ascii());
    DemError::not_a_dem(path, found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind(name: &str, bytes: &[u8]) -> Option<Kind> {
        let head = Head {
            bytes: bytes.into(),
            length: bytes.len() as u64,
        };
        kind_of(Path::new(name), &head)
    }

    #[test]
    fn formats_are_told_by_content_whatever_the_name_says() {
        let grid = "NCOLS 2\nnrows 1\nxllcorner 0\nYLLCENTER 0\ncellsize 1\n1 2\n";
        let header = &grid[..grid.len() - 4];
        let cases: [(&[u8], Option<Kind>); 14] = [
            (b"II\x2a\0", Some(Kind::GeoTiff)),
            (b"MM\0\x2b", Some(Kind::GeoTiff)),
            (b"\x89PNG", Some(Kind::Bitmap)),
            (b"BM\x10\0\0\0\0\0\0\0", Some(Kind::Bitmap)),
            (b"P5\n2 2 255\n", Some(Kind::Bitmap)),
            (b"PK\x03\x04", Some(Kind::Zip)),
            (b"\x1f\x8b\x08", Some(Kind::Gzip)),
            (grid.as_bytes(), Some(Kind::AsciiGrid)),
            (header.as_bytes(), Some(Kind::EsriHeader)),
            (b"ENVI\nsamples = 3\n", Some(Kind::EnviHeader)),
            (b"BYTEORDER I\nNROWS 3\nNCOLS 4\n", Some(Kind::EsriHeader)),
            (b"1.5 2e3 -7\n", Some(Kind::Matrix)),
            (b"# not numbers", None),
            (b"BMW is a car", None),
        ];
        for (bytes, expected) in cases {
            assert_eq!(
                kind("wrong.tif", bytes),
                expected,
                "{}",
                bytes.escape_ascii()
            );
        }
    }

    #[test]
    fn formats_of_others_are_named_with_what_to_do() {
        let head = |bytes: &[u8]| Head {
            bytes: bytes.into(),
            length: bytes.len() as u64,
        };
        let error = unknown(Path::new("a.nc"), &head(b"CDF\x01")).to_string();
        assert!(error.contains("gdal_translate NETCDF:'a.nc':"), "{error}");
        let error = unknown(Path::new("a.xyz"), &head(b"hello there")).to_string();
        assert!(
            error.contains("text of 11 bytes") && error.contains("hello"),
            "{error}"
        );
    }
}
