//! Datasets whose files are hostile under checksums that match: what an attacker would make.

use super::crc32c;
use escarp_proto::geometry::{PageId, Slot};
use escarp_proto::manifest::VERSION;
use escarp_proto::page::{Codec, revision};
use escarp_tiles::dataset::{Dataset, FamilyId, FamilyTable, PageReader};
use escarp_tiles::dem::DemSource;
use escarp_tiles::export::DatasetSource;
use escarp_tiles::update::{Edit, compact, update};
use escarp_tiles::verify::{Share, diff, survey, verify};
use std::fs;
use std::path::Path;

const GENERATION: u64 = 1;
const HEAD: usize = 24;
const ENTRY: usize = 28;

/// What the input's first bytes say.
struct Shape {
    /// Entries of the index.
    entries: usize,
    /// Bytes of `filled-1`; none, and there is no such file.
    filled: usize,
    samples: [u32; 2],
    codec: Codec,
    /// Bits: what is left as it is, although it does not match.
    unsealed: u8,
}

/// An index, a segment and perhaps fills. Checksums, magics and counts are made to match, but
/// those that a flag leaves out.
pub fn dataset(data: &[u8]) {
    let Some((&[entries, filled, width, height, codec, unsealed], data)) = data.split_first_chunk()
    else {
        return;
    };
    let shape = Shape {
        entries: usize::from(entries & 15),
        filled: usize::from(filled),
        samples: [width, height].map(|n| u32::from(n) + 1),
        codec: [Codec::Plain, Codec::Dense][usize::from(codec & 1)],
        unsealed,
    };
    let (index, data) = data.split_at(data.len().min(shape.entries * ENTRY));
    let (fills, segment) = data.split_at(data.len().min(shape.filled));
    let mut segment = segment.to_vec();
    let index = sealed_index(index, &mut segment, &shape);
    let folder = tempfile::tempdir().expect("a folder");
    write_dataset(
        folder.path(),
        &shape,
        &index,
        &segment,
        &sealed_fills(fills, &shape),
    );
    let Ok(dataset) = Dataset::open(folder.path()) else {
        return;
    };
    read_records(&dataset);
    if let Ok(fills) = dataset.filled() {
        fills.contains(width.into(), height.into());
    }
    let _ = survey(&dataset);
    let _ = verify(&dataset, Share::PagesALevel(1, 0), &|_, _| {});
    let same = diff(&dataset, &dataset, &|_, _| {});
    assert!(same.is_err() || same.is_ok_and(|found| found.samples == 0));
    change(&dataset);
    read_rows(dataset);
}

/// Every record that is found by its family is found by its page.
fn read_records(dataset: &Dataset) {
    let mut pages = PageReader::new(dataset);
    let _ = pages.page(PageId::ROOT);
    for entry in dataset.families() {
        let Ok(table) = dataset.family(&entry) else {
            continue;
        };
        for record in FamilyTable::records(&table).flatten() {
            assert_eq!(FamilyId::of(record.page), entry.family);
            if !dataset.grid().holds(record.page) {
                continue;
            }
            let found = dataset.record(record.page).expect("as sound as before");
            assert_eq!(found.expect("stored").bytes, record.bytes);
            let _ = pages.page(record.page);
        }
    }
}

/// A part is removed, and what is left compacted.
fn change(dataset: &Dataset) {
    let edit = Edit {
        patches: Vec::new(),
        remove: vec![[2.0, 1.0, 18.0, 5.0]],
        sources: Vec::new(),
    };
    if update(dataset, edit, &|_, _| {}).is_err() {
        return;
    }
    let changed = Dataset::open(dataset.folder()).expect("it was published");
    if compact(&changed, 0.0, &|_, _| {}).is_ok() {
        Dataset::open(dataset.folder()).expect("it was published");
    }
}

/// The dataset as a source: its rows are heights or holes.
fn read_rows(dataset: Dataset) {
    let [width, height] = dataset.manifest().samples;
    let mut source = DatasetSource::new(dataset);
    let rows = height.min(20);
    let mut band = vec![0.0; (width * rows) as usize];
    for first in [0, height - rows] {
        let _ = source.read_rows(first, rows, &mut band);
    }
}

fn sealed_index(entries: &[u8], segment: &mut [u8], shape: &Shape) -> Vec<u8> {
    let mut index = b"ESCARPIX".to_vec();
    index.extend(GENERATION.to_le_bytes());
    let count = match shape.unsealed & 1 {
        0 => entries.len() / ENTRY,
        _ => 1 << 60 | entries.len(),
    };
    index.extend((count as u64).to_le_bytes());
    index.extend(entries);
    if shape.unsealed & 1 == 0 {
        index.truncate(HEAD + count * ENTRY);
    }
    if shape.unsealed & 2 == 0 {
        for entry in index[HEAD..].chunks_exact_mut(ENTRY) {
            seal_entry(entry, segment, shape.unsealed);
        }
    }
    index
}

/// Makes an entry point into the segment, and what lies there match.
fn seal_entry(entry: &mut [u8], segment: &mut [u8], unsealed: u8) {
    let field =
        |at: usize| u32::from_le_bytes([entry[at], entry[at + 1], entry[at + 2], entry[at + 3]]);
    let offset = field(8) as usize % (segment.len() + 1);
    let bytes = field(16) as usize % (segment.len() - offset + 1);
    let id: [u8; 8] = std::array::from_fn(|i| entry[i]);
    entry[8..16].copy_from_slice(&(offset as u64).to_le_bytes());
    entry[16..20].copy_from_slice(&(bytes as u32).to_le_bytes());
    entry[20..24].fill(0);
    let family = &mut segment[offset..offset + bytes];
    if family.len() < 9 {
        return;
    }
    family[..8].copy_from_slice(&id);
    let table = match unsealed & 4 {
        0 => seal_family(u64::from_le_bytes(id), family),
        _ => None,
    };
    let sum = crc32c(&family[..table.unwrap_or(bytes)]);
    entry[24..28].copy_from_slice(&sum.to_le_bytes());
}

/// Makes the revisions in a family's table match its records, and the length of a lone one the
/// space that there is. The table's length; `None` if there is none that fits.
fn seal_family(family: u64, bytes: &mut [u8]) -> Option<usize> {
    let count = usize::from(bytes[8]) + 1;
    let slots_at = 9;
    let lengths_at = slots_at
        + match count {
            256 => 0,
            32.. => 32,
            _ => count,
        };
    let width = usize::from(*bytes.get(lengths_at + 2)?).min(16);
    let revisions_at = lengths_at + 3 + (count * width).div_ceil(8);
    let records_at = revisions_at + 4 * count;
    let space = bytes.len().checked_sub(records_at)?;
    if count == 1 && width == 0 {
        bytes[lengths_at..lengths_at + 2].copy_from_slice(&(space as u16).to_le_bytes());
    }
    let shortest = usize::from(u16::from_le_bytes([
        bytes[lengths_at],
        bytes[lengths_at + 1],
    ]));
    let listed = bytes[slots_at..lengths_at].to_vec();
    let has = |slot: &usize| match count {
        256 => true,
        32.. => listed[slot / 8] >> (slot % 8) & 1 == 1,
        _ => listed.contains(&(*slot as u8)),
    };
    let mut at = records_at;
    for (number, slot) in (0..256).filter(has).take(count).enumerate() {
        let bit = |k: usize| {
            let k = number * width + k;
            usize::from(bytes[lengths_at + 3 + k / 8] >> (k % 8) & 1)
        };
        let length = shortest + (0..width).map(|k| bit(k) << k).sum::<usize>();
        let record = at..(at + length).min(bytes.len());
        let slot = Slot::from_index(slot as u8);
        let page = FamilyId::from_u64(family).and_then(|family| family.page(slot));
        let sum = revision(page.unwrap_or(PageId::ROOT), &bytes[record.clone()]);
        bytes[revisions_at + 4 * number..][..4].copy_from_slice(&sum.to_le_bytes());
        at = record.end;
    }
    Some(records_at)
}

fn sealed_fills(runs: &[u8], shape: &Shape) -> Vec<u8> {
    let mut fills = b"ESCARPFL".to_vec();
    fills.extend(GENERATION.to_le_bytes());
    let ends = runs.iter().filter(|byte| **byte < 0x80).count() as u64;
    let count = if shape.unsealed & 8 == 0 {
        ends / 3
    } else {
        ends << 40
    };
    fills.extend(count.to_le_bytes());
    fills.extend(runs);
    fills
}

/// Filled samples of runs whose numbers have a byte each.
fn samples_of(runs: &[u8]) -> u64 {
    let lengths = runs.chunks_exact(3).map(|run| u64::from(run[2]));
    lengths.sum::<u64>().min(1000)
}

fn write_dataset(folder: &Path, shape: &Shape, index: &[u8], segment: &[u8], fills: &[u8]) {
    let filled = match shape.filled {
        0 => String::new(),
        _ => format!(
            r#""filled":{{"samples":{},"file":{{"bytes":{},"crc32c":{}}}}},"#,
            samples_of(&fills[HEAD.min(fills.len())..]),
            fills.len(),
            crc32c(fills),
        ),
    };
    let [width, height] = shape.samples;
    let valid = width * height;
    let manifest = format!(
        r#"{{"format":"escarp","version":{VERSION},"generation":{GENERATION},"grid_levels":8,
        "samples":[{width},{height}],"valid_samples":{valid},"height_range":[0,1],{filled}
        "georef":{{"origin_m":[0,0],"sample_spacing_m":[1,1],"quantum_m":1,"plane":{{"kind":"local"}}}},
        "storage_error_m":0,"codec":{},"pages":1,"segments":[{{"file":"seg-1-0","bytes":{}}}],
        "index":{{"bytes":{},"crc32c":{}}},"sources":[]}}"#,
        shape.codec as u8,
        segment.len(),
        index.len(),
        crc32c(index),
    );
    let (bytes, crc) = (manifest.len(), crc32c(manifest.as_bytes()));
    let current = format!("escarp 1\ngeneration {GENERATION}\nmanifest {bytes} {crc:08x}\n");
    let files: [(&str, &[u8]); 5] = [
        ("seg-1-0", segment),
        ("index-1", index),
        ("filled-1", fills),
        ("manifest-1.json", manifest.as_bytes()),
        ("CURRENT", current.as_bytes()),
    ];
    for (name, bytes) in files {
        fs::write(folder.join(name), bytes).expect("a file");
    }
}
