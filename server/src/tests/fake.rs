//! A dataset made up on the spot, with every kind of page in it.

use crate::source::{GenerationId, Pack, PageSource, Revised, SourceError};
use bytes::Bytes;
use escarp_proto::err8::Err8;
use escarp_proto::geometry::{GridLevels, PAGE_SLOTS, PageId};
use escarp_proto::georef::{Georef, Plane};
use escarp_proto::manifest::{FORMAT, FileCheck, Manifest, Segment, VERSION};
use escarp_proto::page::{ChildSlot, Codec, PAGE_AREA, Page, Record, revision};
use std::collections::HashMap;
use std::sync::{Arc, Mutex};

/// Levels of the fake grid: pages at 0, 4, 8.
const LEVELS: u8 = 12;

/// What a fake page is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Stored,
    NotStored,
    Damaged,
    /// Given out as verified, but no record can be read from it.
    Rubbish,
}

/// A fake dataset.
pub(crate) struct FakeSource {
    manifest: Manifest,
    json: Vec<u8>,
    records: Mutex<HashMap<PageId, Vec<u8>>>,
}

impl FakeSource {
    pub(crate) fn new() -> FakeSource {
        FakeSource::of_generation(3)
    }

    pub(crate) fn of_generation(generation: u64) -> FakeSource {
        let manifest = Manifest {
            generation,
            ..manifest()
        };
        FakeSource {
            json: manifest.to_json(),
            manifest,
            records: Mutex::default(),
        }
    }

    pub(crate) fn shared() -> Arc<dyn PageSource> {
        Arc::new(FakeSource::new())
    }

    /// Every 16th page of a level is not stored, the next damaged, the next rubbish.
    pub(crate) fn kind(page: PageId) -> Kind {
        match page.square().x % 16 {
            13 => Kind::NotStored,
            14 => Kind::Damaged,
            15 => Kind::Rubbish,
            _ => Kind::Stored,
        }
    }

    /// The record of a stored page.
    pub(crate) fn stored(&self, page: PageId) -> Vec<u8> {
        let mut records = self.records.lock().unwrap();
        records
            .entry(page)
            .or_insert_with(|| noise(page, &self.manifest))
            .clone()
    }
}

impl PageSource for FakeSource {
    fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    fn manifest_json(&self) -> &[u8] {
        &self.json
    }

    fn generation_id(&self) -> GenerationId {
        GenerationId::of(&self.manifest, &self.json)
    }

    fn record(&self, page: PageId) -> Result<Option<Revised>, SourceError> {
        let given = |revision, bytes| Ok(Some(Revised { revision, bytes }));
        match FakeSource::kind(page) {
            Kind::NotStored => Ok(None),
            Kind::Damaged => Err(SourceError::Damaged {
                file: "seg-3-0".into(),
                why: "a fake flaw".into(),
            }),
            Kind::Rubbish => given(7, Bytes::from_static(&[0xff; 40])),
            Kind::Stored => {
                let record = self.stored(page);
                given(revision(page, &record), record.into())
            }
        }
    }

    /// Not as on disk, but as long as a family may be.
    fn pack(&self, parent: PageId) -> Result<Option<Pack>, SourceError> {
        let bytes = Bytes::from(parent.key().to_le_bytes().repeat(2500));
        let checksum = parent.square().x;
        Ok((parent.level() < LEVELS - 4).then_some(Pack { checksum, bytes }))
    }
}

/// Noise that is stronger in pages further north: their records are longer.
fn noise(id: PageId, manifest: &Manifest) -> Vec<u8> {
    let mut state = id.key() | 1;
    let bits = 1 + id.square().y % 16;
    let mut samples = [None; PAGE_AREA];
    for sample in &mut samples {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        *sample = Some((state >> 40) as i32 & ((1 << bits) - 1));
    }
    let finest = manifest.grid_levels.is_finest(id);
    let slots = (!finest).then(|| Box::new([ChildSlot::Full(Err8(9)); PAGE_SLOTS]));
    let page = Page::new(id, &samples, slots).unwrap();
    Record::encode(&page, Codec::Plain).bytes().to_vec()
}

fn manifest() -> Manifest {
    let grid_levels = GridLevels::new(LEVELS).unwrap();
    Manifest {
        format: FORMAT.into(),
        version: VERSION,
        generation: 3,
        grid_levels,
        samples: [grid_levels.cells_per_side() + 1, 4001],
        valid_samples: 4097 * 4001,
        height_range: Some([0, 1000]),
        georef: Georef {
            origin_m: [0.0; 2],
            sample_spacing_m: [30.0; 2],
            quantum_m: 0.5,
            plane: Plane::Local,
        },
        storage_error_m: 0.25,
        codec: 0,
        pages: 1,
        segments: vec![Segment {
            file: "seg-3-0".into(),
            bytes: 1000,
        }],
        index: FileCheck {
            bytes: 24,
            crc32c: 0,
        },
        sources: vec!["fake.tif".into()],
        vertical: None,
        scale_error_percent: None,
        resampling: None,
        filled: None,
        tolerances: Vec::new(),
    }
}
