use super::segment::{Head, encode, record_len, scan, segment_head};
use super::{CacheOptions, DiskCache, Loaded, Store, folder};
use escarp_proto::wire::{Chunk, Class, Have, Want};
use proptest::prelude::*;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const ADDRESS: &str = "http://127.0.0.1:8787/moon";

/// Bytes that follow from page and part.
fn bytes_of(page: u64, first: u8, last: u8) -> Vec<u8> {
    (first..=last)
        .flat_map(|part| vec![(page as u8).wrapping_mul(31) ^ part; 20 + page as usize % 50])
        .collect()
}

fn chunk(page: u64, first_part: u8, last_part: u8) -> Chunk {
    Chunk {
        page,
        revision: 7 * page as u32 + 1,
        first_part,
        last_part,
        bytes: bytes_of(page, first_part, last_part),
    }
}

fn options(folder: &Path, cap_bytes: u64) -> CacheOptions {
    CacheOptions {
        folder: folder.to_path_buf(),
        cap_bytes,
    }
}

fn store(folder: &Path) -> Store {
    let mut store = Store::new(options(folder, 16 << 20), ADDRESS);
    store.scan();
    store
}

fn files(folder: &Path) -> Vec<PathBuf> {
    folder::segments(&folder::of_address(folder, ADDRESS))
}

/// Pages that are found, each held against what was written. Panics if one differs.
fn check(store: &mut Store, pages: impl Iterator<Item = u64>) -> usize {
    let mut found = 0;
    for page in pages {
        if let Some(kept) = store.get(page) {
            assert_eq!(kept, chunk(page, 0, kept.last_part), "page {page}");
            found += 1;
        }
    }
    found
}

#[test]
fn pages_come_back_in_the_next_run_with_all_their_parts() {
    let folder = tempfile::tempdir().unwrap();
    let mut first = store(folder.path());
    first.start(b"{}");
    for page in 0..300 {
        first.put(&chunk(page, 0, 1));
        first.put(&chunk(page, 2, 4));
        // Parts that do not continue what is there are not kept.
        first.put(&chunk(page, 6, 6));
    }
    drop(first);
    let mut second = store(folder.path());
    assert_eq!(second.pages(), 300);
    assert_eq!(check(&mut second, 0..300), 300);
    assert!(
        second
            .newest(10)
            .iter()
            .all(|have| have.parts == 4 && have.page >= 290)
    );
    assert_eq!(files(folder.path()).len(), 1, "small runs share a segment");
    // Nothing is written twice.
    let length = || files(folder.path())[0].metadata().unwrap().len();
    let before = length();
    second.put(&chunk(5, 0, 3));
    assert_eq!(length(), before);
}

#[test]
fn a_page_of_another_revision_takes_the_place_of_the_old_one() {
    let folder = tempfile::tempdir().unwrap();
    let mut first = store(folder.path());
    first.put(&chunk(1, 0, 4));
    let newer = Chunk {
        revision: 99,
        ..chunk(1, 0, 2)
    };
    first.put(&newer);
    assert_eq!(first.get(1), Some(newer.clone()));
    drop(first);
    assert_eq!(store(folder.path()).get(1), Some(newer));
}

#[test]
fn a_page_that_is_confirmed_is_of_the_new_manifest_in_later_runs_too_and_others_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let have = |page, revision| Have {
        page,
        revision,
        parts: 0,
    };
    let current = |store: &Store| {
        let pages = (0..10).filter(|&page| store.index.lock().unwrap().current(page).is_some());
        pages.collect::<Vec<u64>>()
    };
    let mut first = store(folder.path());
    first.start(b"one");
    (0..10).for_each(|page| first.put(&chunk(page, 0, (page % 3) as u8)));
    first.start(b"two");
    assert_eq!(current(&first), [0; 0]);
    first.put(&chunk(9, 0, 0));
    // Of a revision that is not kept, and of a page that is not.
    first.confirm(&[have(4, 1), have(77, 1)]);
    let same: Vec<Have> = [0, 1, 2, 5]
        .map(|page| have(page, chunk(page, 0, 0).revision))
        .into();
    first.confirm(&same);
    let length = || files(folder.path())[0].metadata().unwrap().len();
    let before = length();
    first.confirm(&same);
    assert_eq!(length(), before, "nothing is said twice");
    assert_eq!(current(&first), [0, 1, 2, 5, 9]);
    drop(first);
    let mut second = store(folder.path());
    assert_eq!(current(&second), [0, 1, 2, 5, 9]);
    assert_eq!(check(&mut second, 0..10), 10, "all parts are there");
}

#[test]
fn what_comes_faster_than_the_disk_takes_it_is_kept_when_the_program_ends() {
    const PAGES: u64 = 30_000;
    let folder = tempfile::tempdir().unwrap();
    let mut cache = DiskCache::open(options(folder.path(), 64 << 20), ADDRESS, Box::new(|| {}));
    cache.start(b"one");
    for page in 0..PAGES {
        cache.put(&chunk(page, 0, 1));
        cache.put(&chunk(page, 2, 4));
    }
    drop(cache);
    let mut again = store(folder.path());
    assert_eq!(check(&mut again, 0..PAGES), PAGES as usize);
    assert_eq!(again.get(7).unwrap().last_part, 4);
}

#[test]
fn pages_of_another_address_are_never_found_not_even_in_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let mut ours = store(folder.path());
    ours.put(&chunk(1, 0, 4));
    drop(ours);
    let other = "http://127.0.0.1:8787/mars";
    let mut theirs = Store::new(options(folder.path(), 16 << 20), other);
    theirs.scan();
    assert_eq!(theirs.pages(), 0);
    // As if both addresses had one folder.
    let theirs_folder = folder::of_address(folder.path(), other);
    std::fs::create_dir_all(&theirs_folder).unwrap();
    let copy = theirs_folder.join("seg-0000000000000001-1-1");
    std::fs::copy(&files(folder.path())[0], copy).unwrap();
    theirs.scan();
    assert_eq!(theirs.pages(), 0);
}

#[test]
fn no_damage_of_a_segment_gives_a_wrong_page_or_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let mut first = store(folder.path());
    (0..40).for_each(|page| first.put(&chunk(page, 0, 4)));
    drop(first);
    let path = files(folder.path())[0].clone();
    let sound = std::fs::read(&path).unwrap();
    for cut in (0..sound.len()).step_by(37) {
        std::fs::write(&path, &sound[..cut]).unwrap();
        check(&mut store(folder.path()), 0..40);
        std::fs::remove_file(&path).unwrap();
    }
    let mut lost = 0;
    for at in (0..sound.len()).step_by(29) {
        let mut damaged = sound.clone();
        damaged[at] ^= 1 << (at % 8);
        std::fs::write(&path, &damaged).unwrap();
        lost += 40 - check(&mut store(folder.path()), 0..40);
    }
    assert!(lost > 0, "damage is found");
    // What follows a damaged tail is written where it is found again.
    std::fs::write(&path, &sound[..sound.len() - 3]).unwrap();
    let mut again = store(folder.path());
    again.put(&chunk(39, 0, 4));
    drop(again);
    assert_eq!(check(&mut store(folder.path()), 0..40), 40);
}

#[test]
fn the_cap_is_kept_by_all_together_and_the_oldest_goes_first() {
    let folder = tempfile::tempdir().unwrap();
    let cap = 2 << 20;
    let mut stores: Vec<Store> = (0..3)
        .map(|i| Store::new(options(folder.path(), cap), &format!("{ADDRESS}{i}")))
        .collect();
    stores.iter_mut().for_each(Store::scan);
    for page in 0..9000 {
        stores
            .iter_mut()
            .for_each(|store| store.put(&chunk(page, 0, 4)));
    }
    let mut total = 0;
    for i in 0..3 {
        let bucket = folder::of_address(folder.path(), &format!("{ADDRESS}{i}"));
        let lengths = folder::segments(&bucket)
            .into_iter()
            .map(|path| path.metadata().unwrap().len());
        total += lengths.sum::<u64>();
    }
    assert!(total <= cap, "{total} bytes of {cap}");
    for store in &mut stores {
        assert_eq!(check(store, 8900..9000), 100, "the newest are there");
        assert_eq!(check(store, 0..100), 0, "the oldest are gone");
    }
}

#[test]
fn a_page_that_is_used_outlives_those_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let put = |pages: std::ops::Range<u64>| {
        let mut store = Store::new(options(folder.path(), 2 << 20), ADDRESS);
        store.scan();
        let _ = check(&mut store, 0..10);
        pages.for_each(|page| store.put(&chunk(page, 0, 4)));
    };
    for round in 0..12 {
        put(1000 * round..1000 * (round + 1));
    }
    let mut last = store(folder.path());
    assert_eq!(check(&mut last, 0..10), 10, "used in every run");
    assert_eq!(check(&mut last, 10..100), 0);
}

#[test]
fn without_room_or_right_to_write_it_goes_on_and_says_so_once() {
    let folder = tempfile::tempdir().unwrap();
    let no_folder = folder.path().join("file");
    std::fs::write(&no_folder, "in the way").unwrap();
    let mut store = store(&no_folder);
    store.start(b"{}");
    (0..10).for_each(|page| store.put(&chunk(page, 0, 4)));
    let trouble = store.take_trouble().unwrap();
    assert!(trouble.contains("nothing more is kept"), "{trouble}");
    assert_eq!(store.take_trouble(), None);
    assert_eq!(store.get(1), None);
}

#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_fills_up_costs_no_page_that_was_kept() {
    let mount = tempfile::tempdir().unwrap();
    let path = mount.path().to_str().unwrap();
    let mounted = Command::new("mount")
        .args(["-t", "tmpfs", "-o", "size=256k", "escarp", path])
        .stderr(Stdio::null())
        .status();
    if !mounted.is_ok_and(|status| status.success()) {
        eprintln!("skipped: a tmpfs cannot be mounted here");
        return;
    }
    let mut full = store(mount.path());
    (0..5000).for_each(|page| full.put(&chunk(page, 0, 4)));
    let trouble = full.take_trouble();
    let kept = check(&mut full, 0..5000);
    drop(full);
    let again = check(&mut store(mount.path()), 0..5000);
    let ended = Command::new("umount").arg(path).status();
    assert!(ended.is_ok_and(|status| status.success()));
    assert!(trouble.unwrap().contains("cannot be written"));
    assert!(kept > 100 && again == kept, "{kept}, then {again}");
}

/// Not a test by itself: what the next ones start, and kill.
#[test]
fn a_program_that_writes_until_it_is_killed() {
    let Some(folder) = std::env::var_os("ESCARP_CACHE_WRITER") else {
        return;
    };
    let mut store = Store::new(options(Path::new(&folder), 4 << 20), ADDRESS);
    store.scan();
    store.start(b"{}");
    for page in (0..u64::MAX).map(|n| n * 7919 % 20_000) {
        store.put(&chunk(page, 0, 2));
        store.put(&chunk(page, 3, 4));
    }
}

fn writer(folder: &Path) -> std::process::Child {
    let test = "cache::tests::a_program_that_writes_until_it_is_killed";
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", test])
        .env("ESCARP_CACHE_WRITER", folder)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

fn wait_for_files(folder: &Path, count: usize) {
    let began = Instant::now();
    while files(folder).len() < count {
        assert!(
            began.elapsed() < Duration::from_secs(60),
            "nothing is written"
        );
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn what_killed_programs_wrote_is_right_or_not_there() {
    let folder = tempfile::tempdir().unwrap();
    let mut found = 0;
    for round in 0..24u64 {
        // Every third time two at once, on the same folder.
        let mut children: Vec<_> = (0..1 + usize::from(round % 3 == 0))
            .map(|_| writer(folder.path()))
            .collect();
        wait_for_files(folder.path(), 1);
        std::thread::sleep(Duration::from_micros(round * round * 137 % 9000));
        for child in &mut children {
            child.kill().unwrap();
            child.wait().unwrap();
        }
        let mut store = Store::new(options(folder.path(), 4 << 20), ADDRESS);
        store.scan();
        found += check(&mut store, 0..20_000);
    }
    assert!(found > 1000, "{found} pages");
    let total: u64 = files(folder.path())
        .iter()
        .map(|f| f.metadata().unwrap().len())
        .sum();
    assert!(total <= 4 << 20, "{total} bytes");
}

#[test]
fn the_thread_gives_what_is_kept_and_leaves_the_rest_to_the_server() {
    let folder = tempfile::tempdir().unwrap();
    let open = || DiskCache::open(options(folder.path(), 16 << 20), ADDRESS, Box::new(|| {}));
    let want = |page| Want {
        page,
        first_part: 0,
        last_part: 4,
        class: Class::Blocker,
        priority: 1.0,
    };
    let ready = |cache: &DiskCache| {
        while !cache.is_ready() {
            std::thread::sleep(Duration::from_millis(1));
        }
    };
    let mut cache = open();
    ready(&cache);
    assert_eq!(cache.manifest(), None);
    cache.start(b"one");
    (0..10).for_each(|page| cache.put(&chunk(page, 0, 4)));
    cache.flush();
    let mut cache = open();
    ready(&cache);
    assert_eq!(cache.manifest().as_deref(), Some(&b"one"[..]));
    let wants: Vec<Want> = (5..15).map(want).collect();
    let left = cache.take_over(&wants);
    assert_eq!(
        left.iter().map(|w| w.page).collect::<Vec<_>>(),
        [10, 11, 12, 13, 14]
    );
    let mut come = Vec::new();
    while cache.is_reading() {
        match cache.poll() {
            Some(Loaded::Page(kept)) => come.push(kept.page),
            Some(Loaded::Gone(page)) => panic!("{page} is gone"),
            None => std::thread::sleep(Duration::from_millis(1)),
        }
    }
    assert_eq!(come, [5, 6, 7, 8, 9]);
    // In another generation they may be other pages.
    cache.start(b"two");
    assert_eq!(cache.take_over(&wants).len(), 10);
}

proptest! {
    #[test]
    fn hostile_segments_are_looked_through_without_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let framed = [segment_head(ADDRESS), bytes].concat();
        let found = scan(&framed, ADDRESS).unwrap();
        prop_assert!(found.end <= framed.len());
    }

    #[test]
    fn records_are_found_where_they_were_put(lengths in prop::collection::vec(0u16..300, 0..20)) {
        let mut bytes = segment_head(ADDRESS);
        let mut places = Vec::new();
        for (page, length) in lengths.iter().enumerate() {
            let head = Head {
                page: page as u64,
                revision: 3,
                first_part: 0,
                last_part: 1,
                length: *length,
                tag: 9,
            };
            places.push((bytes.len() as u32, head));
            bytes.extend(encode(&head, &vec![5; usize::from(*length)]));
            prop_assert_eq!(bytes.len() - places[page].0 as usize, record_len(*length));
        }
        let found = scan(&bytes, ADDRESS).unwrap();
        prop_assert_eq!(found.records, places);
        prop_assert!(found.is_clean);
    }
}
