//! A dataset in a few lines of JSON.

use crate::access::Caller;
use crate::catalog::{Hosted, percent_encoded};
use crate::native::{NativeCorners, native_corners};
use escarp_proto::manifest::Manifest;
use serde::Serialize;

/// The answer of `/datasets`.
#[derive(Debug, Serialize)]
pub(super) struct Datasets {
    pub datasets: Vec<Dataset>,
}

/// What a user wants to know before connecting.
#[derive(Debug, Serialize)]
pub(super) struct Dataset {
    name: String,
    /// Where to connect; the dataset's name goes into Hello.
    session_url: String,
    manifest_url: String,
    /// `[[min, max]; 3]` in world coordinates.
    extent_m: [[f64; 2]; 3],
    native: NativeCorners,
    /// Columns and rows.
    samples: [u32; 2],
    sample_spacing_m: [f64; 2],
    /// Levels of squares in the grid.
    levels: u8,
    pages: u64,
    /// On disk.
    bytes: u64,
    generation: u64,
    sources: Vec<String>,
}

impl Dataset {
    pub(super) fn of(hosted: &Hosted, caller: &Caller, host: &str) -> Dataset {
        let [http, ws] = ["http", "ws"].map(|plain| caller.scheme(plain));
        let (name, source) = (hosted.name(), hosted.source());
        let manifest = source.manifest();
        Dataset {
            name: name.into(),
            session_url: format!("{ws}://{host}/session"),
            manifest_url: format!("{http}://{host}/{}/manifest", percent_encoded(name)),
            extent_m: manifest.extent_m(),
            native: native_corners(manifest),
            samples: manifest.samples,
            sample_spacing_m: manifest.georef.sample_spacing_m,
            levels: manifest.grid_levels.get(),
            pages: manifest.pages,
            bytes: bytes_on_disk(manifest),
            generation: manifest.generation,
            sources: manifest.sources.clone(),
        }
    }
}

/// Segments and index.
fn bytes_on_disk(manifest: &Manifest) -> u64 {
    let segments = manifest.segments.iter().map(|segment| segment.bytes);
    segments.fold(manifest.index.bytes, u64::saturating_add)
}
