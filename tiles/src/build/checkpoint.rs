//! How far a build has come, noted from time to time, so that another can go on with it.
//!
//! Between two bands the state of a build is: the families written so far, what each level left
//! for the one above, and the sums of what was stored. All of it only grows, so each checkpoint
//! appends to a journal what is new since the last one. The segments are made durable before; what
//! was written to them after the last checkpoint is dropped on resuming, and made again. When
//! checkpoints are made decides how much that is, and nothing else.

mod bands;
mod replay;

use super::above::Above;
use super::level::Level;
use super::rows::Stored;
use super::{BuildError, BuildOptions};
use crate::dataset::{DatasetError, DatasetWriter, Journal, MAX_ENTRY_BYTES};
use bands::{put_band, put_stored};
use escarp_proto::manifest::Manifest;
use replay::Replay;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A level as far as it is done.
#[derive(Debug)]
pub(super) struct Done {
    /// What it left for the level above.
    pub(super) above: Above,
    /// Bands that are still to be made: those below this number.
    pub(super) bands_left: usize,
}

/// Notes how far a build has come.
#[derive(Debug)]
pub(super) struct Checkpoints {
    path: PathBuf,
    head: String,
    journal: Option<Journal>,
    /// Samples of work between two checkpoints.
    every: u64,
    since: u64,
    /// Families that the journal has.
    noted: usize,
    /// Bands since the last checkpoint, encoded, and their number.
    pending: Vec<u8>,
    bands: u32,
    stored: Stored,
    /// What was done before, by level.
    done: BTreeMap<u8, Done>,
}

impl Checkpoints {
    /// For a build whose first level is `finest`. With [`BuildOptions::resume`], goes on with what
    /// an unfinished build left behind.
    pub(super) fn open(
        writer: &mut DatasetWriter,
        manifest: &Manifest,
        options: &BuildOptions,
        finest: Level,
    ) -> Result<Checkpoints, BuildError> {
        let mut own = Checkpoints {
            path: writer.journal_path(),
            head: head(manifest, options),
            journal: None,
            every: options.checkpoint_samples,
            since: 0,
            noted: 0,
            pending: Vec::new(),
            bands: 0,
            stored: Stored::NOTHING,
            done: BTreeMap::new(),
        };
        if options.resume {
            own.resume(writer, finest, options.accept_changed)?;
        }
        Ok(own)
    }

    fn resume(
        &mut self,
        writer: &mut DatasetWriter,
        finest: Level,
        accept_changed: bool,
    ) -> Result<(), BuildError> {
        let mut replay = Replay {
            path: self.path.clone(),
            samples: finest.samples(),
            level: finest,
            index: Vec::new(),
            pages: 0,
            stored: Stored::NOTHING,
            done: BTreeMap::new(),
        };
        let journal = Journal::open(&self.path, |number, content| match number {
            0 => check_head(&self.path, content, &self.head, accept_changed),
            _ => replay.take(number, content),
        })?;
        match journal.filter(Journal::has_entries) {
            None => writer.start_anew()?,
            Some(journal) => {
                self.noted = replay.index.len();
                writer.go_on(replay.index, replay.pages)?;
                (self.stored, self.done) = (replay.stored, replay.done);
                self.journal = Some(journal);
            }
        }
        Ok(())
    }

    /// What was done of a level before; each level is asked for once.
    pub(super) fn take(&mut self, level: u8) -> Option<Done> {
        self.done.remove(&level)
    }

    /// What was stored before, or up to the last band.
    pub(super) const fn stored(&self) -> Stored {
        self.stored
    }

    /// Notes that a band is done: its families are written, and what it left is in `above`.
    pub(super) fn band(
        &mut self,
        level: &Level,
        number: usize,
        above: &Above,
        stored: Option<Stored>,
        writer: &mut DatasetWriter,
    ) -> Result<(), DatasetError> {
        self.stored = stored.unwrap_or(self.stored);
        self.since += level.band_samples();
        self.bands += 1;
        self.pending.push(level.level());
        self.pending.extend((number as u32).to_le_bytes());
        put_band(level, number, above, &mut self.pending);
        let enough = self.since >= self.every || self.pending.len() > MAX_ENTRY_BYTES / 4;
        if enough { self.write(writer) } else { Ok(()) }
    }

    fn write(&mut self, writer: &mut DatasetWriter) -> Result<(), DatasetError> {
        writer.sync()?;
        let journal = match &mut self.journal {
            Some(journal) => journal,
            none => {
                let mut journal = Journal::create(&self.path)?;
                journal.append(self.head.as_bytes())?;
                none.insert(journal)
            }
        };
        let families = &writer.written()[self.noted..];
        let mut entry = Vec::with_capacity(self.pending.len() + families.len() * 28 + 64);
        entry.extend(writer.pages().to_le_bytes());
        put_stored(self.stored, &mut entry);
        entry.extend((families.len() as u32).to_le_bytes());
        families.iter().for_each(|family| family.put(&mut entry));
        entry.extend(self.bands.to_le_bytes());
        entry.append(&mut self.pending);
        journal.append(&entry)?;
        writer.keep_unfinished(true);
        self.noted = writer.written().len();
        (self.since, self.bands) = (0, 0);
        Ok(())
    }
}

/// What must be the same for a build to go on with another's work, line by line.
fn head(manifest: &Manifest, options: &BuildOptions) -> String {
    let program = concat!("program escarp-tiles ", env!("CARGO_PKG_VERSION"));
    let result = serde_json::to_string(manifest).unwrap_or_default();
    let lines = [program.to_owned(), format!("result {result}")];
    let lines: Vec<String> = lines
        .into_iter()
        .chain(options.identity.iter().cloned())
        .collect();
    lines.join("\n")
}

/// Compares what an unfinished build said of itself with what this one says.
fn check_head(
    path: &Path,
    found: &[u8],
    own: &str,
    accept_changed: bool,
) -> Result<(), DatasetError> {
    let found = String::from_utf8_lossy(found);
    let counts = |line: &&str| !(accept_changed && line.starts_with("input "));
    let then: Vec<&str> = found.lines().filter(counts).collect();
    let now: Vec<&str> = own.lines().filter(counts).collect();
    let Some(at) = (0..then.len().max(now.len())).find(|&i| then.get(i) != now.get(i)) else {
        return Ok(());
    };
    let line = |lines: &[&str]| lines.get(at).map_or("nothing", |line| line).to_owned();
    let (then, now) = (line(&then), line(&now));
    Err(DatasetError::Usage {
        path: path.to_path_buf(),
        why: format!(
            "the unfinished build is another one: it has {then:?}, this one {now:?}; give the \
             same inputs and options (--accept-changed if an input was only repaired), or start \
             anew without --resume"
        ),
    })
}
