//! What `build` says of unfinished builds, and by what it knows its own.

use crate::dataset::unfinished;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// What decides the result, in words: the inputs as they are now with the files beside them, and
/// how they are read. `more` are files that options name.
pub(super) fn identity(
    inputs: &[PathBuf],
    more: &[PathBuf],
    options: &dyn std::fmt::Debug,
) -> Vec<String> {
    let mut all = Vec::new();
    for input in inputs {
        all.push(input.clone());
        all.extend(files_of(input));
    }
    all.extend_from_slice(more);
    let files = all.iter().map(|input| match fs::metadata(input) {
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

/// What is read with an input: side files of its name (headers, world files, `.prj`), or all that
/// is in a folder, sorted.
fn files_of(input: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    match input.is_dir() {
        true => collect(input, 0, &mut found),
        false => {
            let folder = input
                .parent()
                .filter(|folder| !folder.as_os_str().is_empty());
            let entries = fs::read_dir(folder.unwrap_or(Path::new("."))).into_iter();
            let paths = entries.flatten().flatten().map(|entry| entry.path());
            let beside = paths.filter(|path| {
                path.file_stem() == input.file_stem() && path.file_name() != input.file_name()
            });
            found.extend(beside.filter(|path| path.is_file()));
        }
    }
    found.sort();
    found
}

/// All files below a folder, as deep as tiles lie.
fn collect(folder: &Path, depth: u32, found: &mut Vec<PathBuf>) {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    for path in entries.map(|entry| entry.path()) {
        match path.is_dir() {
            true if depth < 3 => collect(&path, depth + 1, found),
            true => {}
            false => found.push(path),
        }
    }
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
        let before = identity(inputs, &[], &1);
        assert_eq!(identity(inputs, &[], &1), before);
        assert_ne!(identity(inputs, &[], &2), before);
        fs::write(&path, "other").unwrap();
        let changed = identity(inputs, &[], &1);
        assert_ne!(changed, before);
        fs::write(folder.path().join("a.prj"), "beside it").unwrap();
        let with_side_file = identity(inputs, &[], &1);
        assert_ne!(with_side_file, changed);
        fs::write(folder.path().join("b.prj"), "of another").unwrap();
        assert_eq!(identity(inputs, &[], &1), with_side_file);
        let region = folder.path().join("r.geojson");
        fs::write(&region, "{}").unwrap();
        let with_region = identity(inputs, std::slice::from_ref(&region), &1);
        fs::write(&region, "{ }").unwrap();
        assert_ne!(
            identity(inputs, std::slice::from_ref(&region), &1),
            with_region
        );
        let tiles = folder.path().join("tiles");
        fs::create_dir_all(tiles.join("3/1")).unwrap();
        fs::write(tiles.join("3/1/2.png"), "one").unwrap();
        let of_tiles = identity(std::slice::from_ref(&tiles), &[], &1);
        fs::write(tiles.join("3/1/2.png"), "other").unwrap();
        assert_ne!(identity(std::slice::from_ref(&tiles), &[], &1), of_tiles);
    }
}
