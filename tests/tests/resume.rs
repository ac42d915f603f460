//! Builds that are stopped on their way and resumed: whatever stopped them, wherever, and with
//! how many threads they go on, the dataset is the same to the byte.

use escarp_tests::files::{contents, files, flip};
use escarp_tests::programs::{Desk, program, run};
use escarp_tests::terrain::{FunctionSource, Heights, TempDataset, hash, hills, holed_hills};
use escarp_tiles::build::{BuildError, BuildOptions, Coarsened, Tolerances, Wish, build};
use escarp_tiles::dataset::{Dataset, unfinished};
use escarp_tiles::dem::{DemError, DemInfo, DemSource};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// A terrain that can be read so many times, and then has a bad block.
struct BadBlock {
    sound: FunctionSource<Heights>,
    reads_left: u32,
}

impl DemSource for BadBlock {
    fn info(&self) -> &DemInfo {
        self.sound.info()
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        let Some(left) = self.reads_left.checked_sub(1) else {
            return Err(DemError::Io {
                path: PathBuf::from("disk.tif"),
                doing: "read",
                source: std::io::Error::other("a bad block"),
            });
        };
        self.reads_left = left;
        self.sound.read_rows(first_row, rows, out)
    }
}

/// Six bands of the finest pages, and one each of the two levels above.
const SIZE: [u32; 2] = [610, 1400];

fn sound(heights: Heights) -> FunctionSource<Heights> {
    FunctionSource::new(SIZE[0], SIZE[1], heights)
}

fn options(checkpoint_samples: u64, resume: bool) -> BuildOptions {
    BuildOptions {
        resume,
        checkpoint_samples,
        ..BuildOptions::default()
    }
}

fn build_at(
    path: &Path,
    source: &mut dyn DemSource,
    options: BuildOptions,
    threads: usize,
) -> Result<(), BuildError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
    let pool = pool.build().expect("threads");
    pool.install(|| build(source, path, vec!["test".into()], options, &|_, _| {}))
        .map(|_| ())
}

fn undisturbed(heights: Heights) -> Vec<(String, Vec<u8>)> {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("whole.escarp");
    build_at(&path, &mut sound(heights), options(u64::MAX, false), 1).unwrap();
    contents(&path)
}

/// Builds up to a bad block after so many reads.
fn stopped(path: &Path, heights: Heights, reads: u32, checkpoint: u64, resume: bool) {
    let mut source = BadBlock {
        sound: sound(heights),
        reads_left: reads,
    };
    let error = build_at(path, &mut source, options(checkpoint, resume), 2).unwrap_err();
    assert!(error.to_string().contains("disk.tif"), "{error}");
    assert!(Dataset::open(path).is_err());
}

#[test]
fn a_build_stopped_by_a_bad_block_anywhere_goes_on_to_the_same_bytes() {
    for heights in [hills as Heights, holed_hills] {
        let whole = undisturbed(heights);
        for reads in 0..6 {
            for (checkpoint, threads) in [(1, 1), (400_000, 2), (u64::MAX, 4)] {
                let folder = TempDir::new().unwrap();
                let path = folder.path().join("test.escarp");
                stopped(&path, heights, reads, checkpoint, false);
                let kept = unfinished(&path).unwrap();
                let bands_kept = reads as u64 * 256 * u64::from(SIZE[0]) / checkpoint > 0;
                assert_eq!(
                    kept.is_some_and(|kept| kept.resumable),
                    bands_kept,
                    "{reads}"
                );
                build_at(
                    &path,
                    &mut sound(heights),
                    options(checkpoint, true),
                    threads,
                )
                .unwrap();
                assert!(
                    contents(&path) == whole,
                    "{reads} reads, {:?}",
                    files(&path)
                );
            }
        }
    }
}

#[test]
fn a_resumed_build_with_a_tolerance_states_what_all_of_it_lost() {
    // Steep in the north, flat in the south: the largest error is in what is not read again.
    let heights: Heights = |x, y| f64::from(hash(x, y) % 9) * f64::from(y < 300) * 1.0;
    let coarse = |reads_left| {
        let sound = sound(heights);
        let wish = Wish {
            tolerance_m: 12.0,
            region: None,
        };
        let tolerances = Tolerances::open(&[wish], sound.info()).unwrap();
        let source = BadBlock { sound, reads_left };
        Coarsened::new(Box::new(source), 1.0, tolerances).unwrap()
    };
    let folder = TempDir::new().unwrap();
    let whole = folder.path().join("whole.escarp");
    build_at(&whole, &mut coarse(u32::MAX), options(u64::MAX, false), 1).unwrap();
    let stated = Dataset::open(&whole).unwrap().manifest().storage_error_m;
    assert!(stated > 0.0);
    let mut stopped = 0;
    for reads in 1..200 {
        let path = folder.path().join(format!("{reads}.escarp"));
        if build_at(&path, &mut coarse(reads), options(1, false), 2).is_ok() {
            break;
        }
        stopped += 1;
        build_at(&path, &mut coarse(u32::MAX), options(1, true), 2).unwrap();
        assert_eq!(contents(&path), contents(&whole), "after {reads} reads");
    }
    assert!(stopped > 5);
}

#[test]
fn work_before_a_checkpoint_is_not_done_again() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("test.escarp");
    stopped(&path, hills, 4, 1, false);
    // Two bands are left, and the row that the first of them shares with the one before.
    let mut rest = BadBlock {
        sound: sound(hills),
        reads_left: 3,
    };
    build_at(&path, &mut rest, options(1, true), 2).unwrap();
    assert!(contents(&path) == undisturbed(hills));
}

#[test]
fn a_build_stopped_again_and_again_comes_to_its_end() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("test.escarp");
    stopped(&path, holed_hills, 1, 1, false);
    for _ in 0..4 {
        stopped(&path, holed_hills, 2, 1, true);
    }
    build_at(&path, &mut sound(holed_hills), options(1, true), 3).unwrap();
    assert!(contents(&path) == undisturbed(holed_hills));
}

/// What a crash can leave: the journal torn anywhere, the segment longer than noted.
#[test]
fn a_torn_journal_and_a_longer_segment_give_the_same_bytes() {
    let whole = undisturbed(holed_hills);
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("test.escarp");
    stopped(&path, holed_hills, 5, 1, false);
    let left = contents(&path);
    let journal = left.iter().find(|(name, _)| name == "resume-1");
    let journal = journal.expect("a journal").1.len();
    for round in 0..30 {
        for (name, bytes) in &left {
            let mut bytes = bytes.clone();
            match name.as_str() {
                "resume-1" => bytes.truncate(hash(round, 1) as usize % (journal + 1)),
                _ => bytes.extend(vec![0xa5; hash(round, 2) as usize % 5000]),
            }
            std::fs::write(path.join(name), bytes).unwrap();
        }
        std::fs::write(path.join("seg-1-1"), "a next one").unwrap();
        build_at(&path, &mut sound(holed_hills), options(1, true), 2).unwrap();
        assert!(
            contents(&path) == whole,
            "round {round}: {:?}",
            files(&path)
        );
        std::fs::remove_dir_all(&path).unwrap();
        std::fs::create_dir(&path).unwrap();
    }
}

#[test]
fn a_flipped_byte_in_what_was_left_is_found_or_made_again() {
    let whole = undisturbed(hills);
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("test.escarp");
    stopped(&path, hills, 5, 1, false);
    let left = contents(&path);
    let mut refused = 0;
    for round in 0..60 {
        for (name, bytes) in &left {
            std::fs::write(path.join(name), bytes).unwrap();
        }
        let (name, bytes) = &left[round % left.len()];
        let mut damaged = bytes.clone();
        let at = flip(&mut damaged, round as u32);
        std::fs::write(path.join(name), damaged).unwrap();
        match build_at(&path, &mut sound(hills), options(1, true), 2) {
            Ok(()) => assert!(contents(&path) == whole, "{name}, byte {at}"),
            Err(error) => {
                assert!(
                    error.to_string().contains(name),
                    "{name}, byte {at}: {error}"
                );
                refused += 1;
            }
        }
        for name in files(&path) {
            std::fs::remove_file(path.join(name)).unwrap();
        }
    }
    assert!(
        refused > 10,
        "damage in a segment was found {refused} times"
    );
}

#[test]
fn a_segment_that_is_shorter_than_noted_or_gone_is_refused_by_name() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("test.escarp");
    stopped(&path, hills, 3, 1, false);
    let segment = path.join("seg-1-0");
    let length = std::fs::metadata(&segment).unwrap().len();
    let file = std::fs::File::options().write(true).open(&segment).unwrap();
    file.set_len(length / 2).unwrap();
    for _ in 0..2 {
        let error = build_at(&path, &mut sound(hills), options(1, true), 2).unwrap_err();
        assert!(error.to_string().contains("seg-1-0"), "{error}");
        let _ = std::fs::remove_file(&segment);
    }
    // Anew, it needs none of it.
    build_at(&path, &mut sound(hills), options(1, false), 2).unwrap();
    assert!(contents(&path) == undisturbed(hills));
}

#[test]
fn a_build_of_something_else_is_not_gone_on_with() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("test.escarp");
    stopped(&path, hills, 3, 1, false);
    let before = contents(&path);
    let mut other = FunctionSource::new(SIZE[0], SIZE[1] + 1, hills);
    let error = build_at(&path, &mut other, options(1, true), 1).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("resume-1") && text.contains("1401"), "{text}");
    let named = BuildOptions {
        identity: vec!["input a.tif, 7 bytes".into()],
        ..options(1, true)
    };
    let error = build_at(&path, &mut sound(hills), named.clone(), 1).unwrap_err();
    assert!(error.to_string().contains("a.tif"), "{error}");
    assert!(contents(&path) == before, "what was left is touched");
    // Unless the user vouches for the inputs.
    let vouched = BuildOptions {
        accept_changed: true,
        ..named
    };
    build_at(&path, &mut sound(hills), vouched, 1).unwrap();
    assert!(contents(&path) == undisturbed(hills));
}

#[test]
fn an_unfinished_replacement_leaves_the_published_dataset_and_can_be_resumed() {
    let data = TempDataset::of(100, 80, hills);
    let overwrite = |resume| BuildOptions {
        overwrite: true,
        ..options(1, resume)
    };
    let mut source = BadBlock {
        sound: sound(hills),
        reads_left: 3,
    };
    build_at(&data.path(), &mut source, overwrite(false), 1).unwrap_err();
    assert_eq!(data.open().manifest().generation, 1);
    let error = build_at(&data.path(), &mut sound(hills), options(1, true), 1).unwrap_err();
    assert!(error.to_string().contains("--overwrite"), "{error}");
    source.reads_left = 4;
    build_at(&data.path(), &mut source, overwrite(true), 1).unwrap();
    assert_eq!(
        files(&data.path()),
        ["CURRENT", "index-2", "manifest-2.json", "seg-2-0"]
    );
}

#[test]
fn a_terrain_that_can_never_fit_leaves_nothing_behind() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("test.escarp");
    let mut source = FunctionSource::new(300, 1400, |x, y| match (x, y) {
        (3, 1200) => 1e9,
        _ => hills(x, y),
    });
    let small = BuildOptions {
        quantum: escarp_tiles::build::Quantum::Metres(0.1),
        ..options(1, false)
    };
    let error = build_at(&path, &mut source, small, 1).unwrap_err();
    assert!(matches!(error, BuildError::Unfit { .. }), "{error}");
    assert_eq!(files(&path), Vec::<String>::new());
}

/// Arguments of a build of a DEM into a dataset, with many checkpoints.
fn arguments(tif: &str, out: &str) -> Vec<String> {
    let fixed = ["build", tif, "-o", out, "--checkpoint", "1"];
    fixed.map(str::to_owned).to_vec()
}

#[test]
fn a_program_killed_at_random_moments_and_resumed_makes_the_same_bytes() {
    let desk = Desk::new();
    let (tif, whole) = (desk.name("demo.tif"), desk.name("whole.escarp"));
    let sample = ["sample", "-o", &tif, "--size", "1500", "--seed", "5"];
    run("escarp-tiles", &sample).ok();
    let began = Instant::now();
    let built = arguments(&tif, &whole);
    run(
        "escarp-tiles",
        &built.iter().map(String::as_str).collect::<Vec<_>>(),
    )
    .ok();
    // As long as an undisturbed run takes here, a kill may come at any moment of it.
    let longest_ms = began.elapsed().as_millis().max(2) as u32;
    let whole = contents(Path::new(&whole));
    for series in 0..2 {
        let out = desk.name(&format!("killed-{series}.escarp"));
        for round in 0..25 {
            let jobs = (hash(series, round) % 3 + 1).to_string();
            let mut command = program("escarp-tiles");
            command
                .args(arguments(&tif, &out))
                .args(["--resume", "--jobs", &jobs]);
            let mut child = command
                .stderr(Stdio::null())
                .stdout(Stdio::null())
                .spawn()
                .unwrap();
            let delay = u64::from(hash(round, series + 9) % longest_ms);
            std::thread::sleep(Duration::from_millis(delay));
            child.kill().expect("it is killed, or has ended");
            child.wait().unwrap();
            if Path::new(&out).join("CURRENT").exists() {
                break;
            }
        }
        if !Path::new(&out).join("CURRENT").exists() {
            let mut last = arguments(&tif, &out);
            last.push("--resume".into());
            run(
                "escarp-tiles",
                &last.iter().map(String::as_str).collect::<Vec<_>>(),
            )
            .ok();
        }
        // A kill between publishing and tidying leaves the journal, which is of no use any more.
        let made = contents(Path::new(&out));
        let made: Vec<_> = made
            .into_iter()
            .filter(|(name, _)| name != "resume-1" && !name.starts_with("build-"))
            .collect();
        assert!(
            made == expected(&whole),
            "series {series}: {:?}",
            files(Path::new(&out))
        );
    }
}

/// Without what a build says of its own speed.
fn expected(whole: &[(String, Vec<u8>)]) -> Vec<(String, Vec<u8>)> {
    let mut whole = whole.to_vec();
    whole.retain(|(name, _)| !name.starts_with("build-"));
    whole
}

#[test]
fn a_full_disk_stops_the_program_with_a_clear_error_and_it_goes_on_with_room() {
    let desk = Desk::new();
    let (tif, whole) = (desk.name("demo.tif"), desk.name("whole.escarp"));
    let sample = ["sample", "-o", &tif, "--size", "1500", "--seed", "6"];
    run("escarp-tiles", &sample).ok();
    let built = arguments(&tif, &whole);
    run(
        "escarp-tiles",
        &built.iter().map(String::as_str).collect::<Vec<_>>(),
    )
    .ok();
    let segment = std::fs::metadata(Path::new(&whole).join("seg-1-0"))
        .unwrap()
        .len();
    let out = desk.name("full.escarp");
    // The system refuses to write more than so many blocks of 512 bytes to a file.
    for share in [4, 2] {
        let call = format!(
            "ulimit -f {}; trap '' XFSZ; exec \"$0\" build {tif} -o {out} --checkpoint 1 --resume",
            segment * share / 5 / 512
        );
        let tiles = program("escarp-tiles");
        let shell = std::process::Command::new("sh")
            .args(["-c", &call])
            .arg(tiles.get_program())
            .output()
            .expect("a shell");
        let error = String::from_utf8_lossy(&shell.stderr);
        assert_eq!(shell.status.code(), Some(1), "{error}");
        assert!(
            error.contains("cannot write") && error.contains("full.escarp"),
            "{error}"
        );
        assert!(
            error.contains("MB of the unfinished build are kept"),
            "{error}"
        );
    }
    let mut last = arguments(&tif, &out);
    last.push("--resume".into());
    run(
        "escarp-tiles",
        &last.iter().map(String::as_str).collect::<Vec<_>>(),
    )
    .ok();
    let (made, whole) = (contents(Path::new(&out)), contents(Path::new(&whole)));
    assert!(
        expected(&made) == expected(&whole),
        "{:?}",
        files(Path::new(&out))
    );
}

#[test]
fn a_damaged_block_of_a_file_is_named_and_the_build_goes_on_once_it_is_repaired() {
    let desk = Desk::new();
    let (tif, out) = (desk.name("demo.tif"), desk.name("demo.escarp"));
    let sample = ["sample", "-o", &tif, "--size", "1200", "--seed", "7"];
    run("escarp-tiles", &sample).ok();
    let sound = std::fs::read(&tif).unwrap();
    let mut damaged = sound.clone();
    let middle = damaged.len() / 2;
    damaged[middle..middle + 20_000].fill(0xff);
    std::fs::write(&tif, damaged).unwrap();
    let built = arguments(&tif, &out);
    let built: Vec<&str> = built.iter().map(String::as_str).collect();
    let failed = run("escarp-tiles", &built);
    assert_eq!(failed.code, Some(1), "{failed:?}");
    assert!(
        failed.err.contains("demo.tif: damaged at"),
        "{}",
        failed.err
    );
    assert!(failed.err.contains("--resume"), "{}", failed.err);
    std::fs::write(&tif, sound).unwrap();
    let refused = run("escarp-tiles", &[&built[..], &["--resume"]].concat());
    assert!(refused.err.contains("--accept-changed"), "{}", refused.err);
    run(
        "escarp-tiles",
        &[&built[..], &["--resume", "--accept-changed"]].concat(),
    )
    .ok();
    let verify = ["verify", &out, "--against", &tif];
    run("escarp-tiles", &verify).ok();
}
