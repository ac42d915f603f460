//! What `build` says of unfinished builds, and by what it knows its own.

use crate::dataset::unfinished;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// What decides the result, in words: the inputs as they are now, and how they are read.
pub(super) fn identity(inputs: &[PathBuf], options: &dyn std::fmt::Debug) -> Vec<String> {
    let files = inputs.iter().map(|input| match fs::metadata(input) {
        Ok(found) => {
            let path = fs::canonicalize(input).unwrap_or_else(|_| input.clone());
            let changed = found.modified().ok();
            let changed = changed.and_then(|time| time.duration_since(UNIX_EPOCH).ok());
            let changed_ns = changed.map_or(0, |since| since.as_nanos());
            let (path, bytes) = (path.display(), found.len());
            format!("input {path}, {bytes} bytes, changed at {changed_ns} ns")
        }
        // What is no file says all by its name.
        Err(_) => format!("input {}", input.display()),
    });
    let options = format!("options {options:?}");
    // A line each, whatever stands in names.
    let lines = files.chain([options]);
    lines.map(|line| line.replace('\n', " ")).collect()
}

/// Says what becomes of an unfinished build that lies in the way.
pub(super) fn announce(folder: &Path, resume: bool) {
    let Ok(found) = unfinished(folder) else {
        return; // What is wrong is said when the folder is taken.
    };
    let name = folder.display();
    match (found, resume) {
        (Some(found), true) if found.resumable => {
            let megabytes = found.bytes as f64 / 1e6;
            eprintln!("{name}: going on with an unfinished build of {megabytes:.1} MB");
        }
        (_, true) => eprintln!("{name}: nothing to resume: starting from the beginning"),
        (Some(found), false) => {
            let megabytes = found.bytes as f64 / 1e6;
            eprintln!(
                "{name}: starting anew; {megabytes:.1} MB of an unfinished build are removed"
            );
        }
        (None, false) => {}
    }
}

/// What a failed build left, for its error; `None` if nothing.
pub(super) fn kept(folder: &Path) -> Option<String> {
    let found = unfinished(folder).ok()??;
    let (name, megabytes) = (folder.display(), found.bytes as f64 / 1e6);
    let go_on = match found.resumable {
        true => "the same command with --resume goes on with them, without it starts anew",
        false => "the next build removes them",
    };
    Some(format!(
        "{megabytes:.1} MB of the unfinished build are kept in {name}: {go_on}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_changed_input_or_option_changes_the_identity() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tif");
        fs::write(&path, "one").unwrap();
        let inputs = std::slice::from_ref(&path);
        let before = identity(inputs, &1);
        assert_eq!(identity(inputs, &1), before);
        assert_ne!(identity(inputs, &2), before);
        fs::write(&path, "other").unwrap();
        assert_ne!(identity(inputs, &1), before);
    }
}
