//! Which samples of a dataset are no data but fill: runs of them, row by row.

use super::DatasetError;
use super::index::write_synced;
use crate::checksum::crc32c;
use escarp_proto::bytes::{Reader, put_varint};
use escarp_proto::manifest::{FileCheck, Filled, Manifest};
use std::path::{Path, PathBuf};

const MAGIC: &[u8; 8] = b"ESCARPFL";
const HEAD: usize = 8 + 8 + 8;

/// Filled samples of one row, next to each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FilledRun {
    /// Grid row, from the south.
    pub y: u32,
    /// The first grid column.
    pub x: u32,
    /// Samples.
    pub length: u32,
}

/// All filled samples of a dataset, by row from the south, then column.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FilledRuns {
    runs: Vec<FilledRun>,
}

impl FilledRuns {
    /// Runs in any order, apart from each other.
    pub fn new(mut runs: Vec<FilledRun>) -> FilledRuns {
        runs.sort_unstable_by_key(|run| (run.y, run.x));
        FilledRuns { runs }
    }

    /// The runs, by row from the south, then column.
    pub fn runs(&self) -> &[FilledRun] {
        &self.runs
    }

    /// Filled samples.
    pub fn samples(&self) -> u64 {
        self.runs.iter().map(|run| u64::from(run.length)).sum()
    }

    /// Whether the sample at a grid column and row is fill.
    pub fn contains(&self, x: u32, y: u32) -> bool {
        let after = self.runs.partition_point(|run| (run.y, run.x) <= (y, x));
        let run = after.checked_sub(1).map(|at| self.runs[at]);
        run.is_some_and(|run| run.y == y && x - run.x < run.length)
    }

    fn encode(&self, generation: u64) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEAD + 4 * self.runs.len());
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&generation.to_le_bytes());
        bytes.extend_from_slice(&(self.runs.len() as u64).to_le_bytes());
        let (mut y, mut end) = (0, 0);
        for run in &self.runs {
            put_varint(u64::from(run.y - y), &mut bytes);
            let from = if run.y == y { end } else { 0 };
            put_varint(u64::from(run.x - from), &mut bytes);
            put_varint(u64::from(run.length), &mut bytes);
            (y, end) = (run.y, run.x + run.length);
        }
        bytes
    }

    /// Reads runs within `samples` columns and rows. Safe on untrusted bytes: memory is a small
    /// multiple of theirs.
    fn decode(bytes: &[u8], generation: u64, samples: [u32; 2]) -> Result<FilledRuns, String> {
        let mut reader = Reader::new(bytes);
        let magic = reader.take(8) == Some(MAGIC);
        if !magic || reader.u64() != Some(generation) {
            return Err(format!("it is not the fills of generation {generation}"));
        }
        let count = reader.u64().ok_or("it ends inside its head")?;
        let most = reader.left() as u64 / 3;
        if count > most {
            return Err(format!("{count} runs, but bytes for {most} at most"));
        }
        let mut runs = Vec::with_capacity(count as usize);
        let (mut y, mut end) = (0, 0);
        for number in 0..count {
            let mut next = || {
                reader
                    .varint()
                    .ok_or(format!("it ends inside run {number}"))
            };
            let (rows, from, length) = (next()?, next()?, next()?);
            let x = if rows == 0 { end + from } else { from };
            y += rows;
            end = x + length;
            let [width, height] = samples.map(u64::from);
            if y >= height || length == 0 || end > width {
                let found = format!("run {number} has {length} samples from {x} on in row {y}");
                return Err(format!("{found}, allowed are {width} x {height}"));
            }
            runs.push(FilledRun {
                y: y as u32,
                x: x as u32,
                length: length as u32,
            });
        }
        match reader.left() {
            0 => Ok(FilledRuns { runs }),
            left => Err(format!("{left} bytes left over after its last run")),
        }
    }

    /// Writes the file of a generation.
    ///
    /// # Errors
    /// [`DatasetError::Io`] if the system refuses.
    pub(super) fn write(&self, folder: &Path, generation: u64) -> Result<Filled, DatasetError> {
        let bytes = self.encode(generation);
        write_synced(&path(folder, generation), &bytes)?;
        Ok(Filled {
            samples: self.samples(),
            file: FileCheck {
                bytes: bytes.len() as u64,
                crc32c: crc32c(&bytes),
            },
        })
    }

    /// Reads the file that a manifest names; nothing is filled where it names none.
    ///
    /// # Errors
    /// [`DatasetError`] if the file is missing, or is not what the manifest says.
    pub(super) fn read(folder: &Path, manifest: &Manifest) -> Result<FilledRuns, DatasetError> {
        let Some(stated) = &manifest.filled else {
            return Ok(FilledRuns::default());
        };
        let path = path(folder, manifest.generation);
        let map = super::map::Mapped::open(&path, stated.file.bytes)?;
        let damaged = |why: String| DatasetError::damaged(&path, why);
        let (found, expected) = (crc32c(map.bytes()), stated.file.crc32c);
        if found != expected {
            let why = format!("checksum {found:08x}, the manifest says {expected:08x}");
            return Err(damaged(why));
        }
        let runs =
            Self::decode(map.bytes(), manifest.generation, manifest.samples).map_err(damaged)?;
        match runs.samples() {
            found if found == stated.samples => Ok(runs),
            found => Err(damaged(format!(
                "{found} filled samples, the manifest says {}",
                stated.samples
            ))),
        }
    }
}

fn path(folder: &Path, generation: u64) -> PathBuf {
    folder.join(format!("filled-{generation}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn runs() -> impl Strategy<Value = FilledRuns> {
        prop::collection::btree_set((0u32..40, 0u32..20), 0..60).prop_map(|places| {
            let run = |(y, x): (u32, u32)| FilledRun {
                y,
                x: 5 * x,
                length: 1 + (x + y) % 4,
            };
            FilledRuns::new(places.into_iter().map(run).collect())
        })
    }

    proptest! {
        #[test]
        fn runs_come_back_and_every_sample_in_them_is_known_as_filled(runs in runs()) {
            let back = FilledRuns::decode(&runs.encode(7), 7, [100, 40]).unwrap();
            prop_assert_eq!(&back, &runs);
            let all = (0..40).flat_map(|y| (0..100).map(move |x| (x, y)));
            let filled = all.filter(|&(x, y)| runs.contains(x, y));
            let naive = |&(x, y): &(u32, u32)| {
                runs.runs().iter().any(|r| r.y == y && (r.x..r.x + r.length).contains(&x))
            };
            let filled: Vec<_> = filled.collect();
            prop_assert!(filled.iter().all(naive));
            prop_assert_eq!(filled.len() as u64, runs.samples());
        }

        #[test]
        fn other_sizes_generations_and_lengths_are_refused(runs in runs(), cut: prop::sample::Index) {
            let bytes = runs.encode(7);
            prop_assert!(FilledRuns::decode(&bytes, 8, [100, 40]).is_err());
            let cut = cut.index(bytes.len());
            prop_assert!(FilledRuns::decode(&bytes[..cut], 7, [100, 40]).is_err());
            let longer = [&bytes[..], &[0]].concat();
            prop_assert!(FilledRuns::decode(&longer, 7, [100, 40]).is_err());
            if let Some(last) = runs.runs().last() {
                prop_assert!(FilledRuns::decode(&bytes, 7, [100, last.y]).is_err());
            }
        }

        #[test]
        fn hostile_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let mut framed = MAGIC.to_vec();
            framed.extend_from_slice(&7u64.to_le_bytes());
            framed.extend_from_slice(&((bytes.len() / 3) as u64).to_le_bytes());
            framed.extend(bytes);
            if let Ok(runs) = FilledRuns::decode(&framed, 7, [1000, 1000]) {
                prop_assert!(runs.samples() <= 1_000_000);
            }
        }
    }
}
