//! What is fuzzed: functions that must return, whatever the bytes, and whose results must be
//! consistent. Shared by the fuzz targets and by the test that replays the corpus.
#![allow(dead_code, reason = "each target uses one of them")]

mod records;

mod messages;

mod sessions;

mod texts;

mod inputs;

mod slope;

mod regions;

mod datasets;

mod journals;

/// A target's name and what it does with bytes.
pub type Target = (&'static str, fn(&[u8]));

/// All targets.
pub const TARGETS: [Target; 11] = [
    ("page", records::page),
    ("codec", records::codec),
    ("wire", messages::wire),
    ("session", sessions::session),
    ("text", texts::text),
    ("dem", inputs::dem),
    ("side", inputs::side),
    ("packed", inputs::packed),
    ("region", regions::region),
    ("dataset", datasets::dataset),
    ("journal", journals::journal),
];

/// Runs a target.
///
/// # Panics
/// If there is none of this name, or if it finds something.
pub fn run(name: &str, data: &[u8]) {
    let found = TARGETS.iter().find(|(target, _)| *target == name);
    found.expect("a target").1(data);
}

/// CRC-32C.
fn crc32c(bytes: &[u8]) -> u32 {
    crc_fast::checksum(crc_fast::CrcAlgorithm::Crc32Iscsi, bytes) as u32
}
