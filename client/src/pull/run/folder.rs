//! What is written before a pulled dataset is published: a folder beside the target.
//!
//! ```text
//! NAME.part/
//!   LOCK          held by the program that pulls
//!   pull.json     what is being pulled: another job starts anew
//!   received-<n>  journals of what has come
//!   dataset/      the dataset, renamed to NAME at the end
//! ```

use super::super::{PullError, Region};
use crate::net::Url;
use escarp_proto::manifest::Manifest;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

/// The folder of an unfinished pull, locked.
pub(super) struct Part {
    target: PathBuf,
    folder: PathBuf,
    _lock: File,
}

fn io(path: &Path, action: &'static str) -> impl FnOnce(std::io::Error) -> PullError {
    let path = path.to_path_buf();
    move |source| PullError::Io {
        path,
        action,
        source,
    }
}

/// Says what is wrong with a target before anything is done for it.
pub(super) fn check_target(target: &Path) -> Result<(), PullError> {
    let usage = |why: &str| Err(PullError::Usage(format!("{}: {why}", target.display())));
    if target.symlink_metadata().is_ok() {
        return usage("exists already; choose another name, or remove it");
    }
    if target.file_name().is_none() {
        return usage("is no name for a folder; give one such as local.escarp");
    }
    let beside = target
        .parent()
        .filter(|beside| !beside.as_os_str().is_empty());
    match beside {
        Some(beside) if !beside.is_dir() => usage("there is no folder to put it in"),
        _ => Ok(()),
    }
}

impl Part {
    /// Opens what an unfinished pull of the same job left behind, or starts anew.
    pub(super) fn open(
        target: &Path,
        url: &Url,
        manifest: &Manifest,
        region: &Region,
        most: u32,
    ) -> Result<Part, PullError> {
        let mut name = target.file_name().unwrap_or_default().to_os_string();
        name.push(".part");
        let folder = target.with_file_name(name);
        let usage = |why: &str| PullError::Usage(format!("{}: {why}", folder.display()));
        if folder.symlink_metadata().is_ok() && !is_ours(&folder)? {
            return Err(usage(
                "holds other files; remove it, or choose another name",
            ));
        }
        fs::create_dir_all(&folder).map_err(io(&folder, "create the folder"))?;
        let path = folder.join("LOCK");
        let lock = File::create(&path).map_err(io(&path, "create"))?;
        lock.try_lock()
            .map_err(|_| usage("another program pulls to it; wait for it to end"))?;
        let part = Part {
            target: target.to_path_buf(),
            folder,
            _lock: lock,
        };
        part.start(&job(url, manifest, region, most))?;
        Ok(part)
    }

    /// Drops what was left of another job.
    fn start(&self, job: &[u8]) -> Result<(), PullError> {
        let path = self.folder.join("pull.json");
        if fs::read(&path).is_ok_and(|found| found == job) {
            return Ok(());
        }
        self.clear()?;
        let new = self.folder.join("pull.json.new");
        let mut file = File::create(&new).map_err(io(&new, "create"))?;
        file.write_all(job)
            .and_then(|()| file.sync_all())
            .map_err(io(&new, "write"))?;
        fs::rename(&new, &path).map_err(io(&path, "rename into place"))
    }

    fn clear(&self) -> Result<(), PullError> {
        for name in names(&self.folder)? {
            let path = self.folder.join(&name);
            if name == "dataset" {
                fs::remove_dir_all(&path).map_err(io(&path, "remove"))?;
            } else if name != "LOCK" {
                fs::remove_file(&path).map_err(io(&path, "remove"))?;
            }
        }
        Ok(())
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Where the dataset is written.
    pub(super) fn dataset(&self) -> PathBuf {
        self.folder.join("dataset")
    }

    /// Gives the finished dataset its name, at once, and removes the rest.
    pub(super) fn publish(self) -> Result<(), PullError> {
        check_target(&self.target)?;
        let dataset = self.dataset();
        fs::rename(&dataset, &self.target).map_err(io(&self.target, "rename into place"))?;
        let beside = match self.target.parent() {
            Some(beside) if !beside.as_os_str().is_empty() => beside,
            _ => Path::new("."),
        };
        File::open(beside)
            .and_then(|folder| folder.sync_all())
            .map_err(io(beside, "sync the folder"))?;
        fs::remove_dir_all(&self.folder).map_err(io(&self.folder, "remove"))
    }
}

/// What tells one job from another.
fn job(url: &Url, manifest: &Manifest, region: &Region, most: u32) -> Vec<u8> {
    let json = serde_json::json!({
        "url": url.to_string(),
        "x": region.x,
        "y": region.y,
        "error_quanta": most,
        "manifest": String::from_utf8_lossy(&manifest.to_json()),
    });
    json.to_string().into_bytes()
}

fn names(folder: &Path) -> Result<Vec<String>, PullError> {
    let entries = fs::read_dir(folder).map_err(io(folder, "list"))?;
    let names = entries.map(|entry| entry.map(|e| e.file_name().to_string_lossy().into_owned()));
    names.collect::<Result<_, _>>().map_err(io(folder, "list"))
}

/// Whether a folder is what an unfinished pull left behind, and nothing else.
fn is_ours(folder: &Path) -> Result<bool, PullError> {
    if !folder.symlink_metadata().is_ok_and(|found| found.is_dir()) {
        return Ok(false);
    }
    let ours = |name: &String| {
        let number = name.strip_prefix("received-");
        let is_file = ["LOCK", "pull.json", "pull.json.new"].contains(&name.as_str())
            || number.is_some_and(|n| n.bytes().all(|b| b.is_ascii_digit()));
        let found = folder.join(name).symlink_metadata();
        found.is_ok_and(|found| match name == "dataset" {
            true => found.is_dir(),
            false => is_file && found.is_file(),
        })
    };
    Ok(names(folder)?.iter().all(ours))
}
