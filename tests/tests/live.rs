//! Datasets that come, go, change and break while they are hosted.

use escarp_proto::geometry::{PAGE_LEVELS, PageId};
use escarp_server::source::SourceError;
use escarp_server::watch::Watcher;
use escarp_server::{Catalog, PageSource};
use escarp_tests::files::{Copy, files};
use escarp_tests::terrain::{FunctionSource, TempDataset, build_at, cliff, hills, holed_hills};
use escarp_tiles::dataset::{Dataset, Io, Wait};
use escarp_tiles::update::compact;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const BOTH: [Io; 2] = [Io::Pread, Io::Mmap];

/// The pages of a grid that may have data, and as many around them.
fn pages(dataset: &Dataset) -> Vec<PageId> {
    let levels = (0..=dataset.grid().finest_page_level()).step_by(PAGE_LEVELS.into());
    let places = levels.flat_map(|level| {
        let cells = dataset.manifest().samples[0] >> (dataset.grid().get() - level);
        let side = (2 * cells + 2).min(1 << level);
        (0..side).flat_map(move |y| (0..side).filter_map(move |x| PageId::new(level, x, y)))
    });
    places.collect()
}

/// What a source says of a page.
fn ask(source: &dyn PageSource, page: PageId) -> Result<Option<(u32, Vec<u8>)>, SourceError> {
    let record = source.record(page)?;
    Ok(record.map(|record| (record.revision, record.bytes.to_vec())))
}

fn copied(dataset: &Path, folder: &Path, name: &str) -> PathBuf {
    let to = folder.join(name);
    fs::create_dir(&to).unwrap();
    for file in files(dataset) {
        fs::copy(dataset.join(&file), to.join(&file)).unwrap();
    }
    to
}

#[test]
fn all_ways_to_read_a_record_give_the_same() {
    for heights in [hills, holed_hills] {
        let data = TempDataset::of(300, 260, heights);
        let mut found = 0;
        for io in BOTH {
            let served = data.open().with_io(io);
            for page in pages(&data.dataset) {
                let right = data.dataset.record(page).unwrap();
                let right = right.map(|record| (record.revision, record.bytes.to_vec()));
                assert_eq!(ask(&served, page), Ok(right.clone()), "{page}");
                let revision = right.as_ref().map(|right| right.0);
                assert_eq!(served.revision(page), Ok(revision));
                // Whether the system has it in memory is the system's business.
                if let Some(at_once) = served.record_at_once(page) {
                    let at_once = at_once.unwrap().map(|r| (r.revision, r.bytes.to_vec()));
                    assert_eq!(at_once, right);
                }
                found += usize::from(right.is_some());
            }
        }
        assert!(found > 100);
    }
}

#[test]
fn a_pack_has_the_records_of_all_children_behind_their_table() {
    let data = TempDataset::of(300, 260, holed_hills);
    let mut records = 0;
    for io in BOTH {
        let served = data.open().with_io(io);
        for parent in pages(&data.dataset) {
            let children = |child: &PageId| child.parent().is_some_and(|(page, _)| page == parent);
            let below = pages(&data.dataset).into_iter().filter(children);
            let mut right: Vec<(usize, Vec<u8>)> = below
                .filter_map(|child| {
                    let record = data.dataset.record(child).unwrap()?;
                    Some((child.parent()?.1.index(), record.bytes.to_vec()))
                })
                .collect();
            right.sort();
            let right: Vec<u8> = right.into_iter().flat_map(|(_, bytes)| bytes).collect();
            match served.pack(parent).unwrap() {
                Some(pack) => assert!(pack.bytes.ends_with(&right) && !right.is_empty()),
                None => assert!(right.is_empty()),
            }
            records += right.len();
        }
    }
    assert!(records > 10_000);
}

#[test]
fn a_segment_that_is_cut_short_under_a_reader_is_damaged_and_nothing_worse() {
    let data = TempDataset::of(300, 260, hills);
    let copy = Copy::of(&data.path());
    for io in BOTH {
        let served = Dataset::open(&copy.path()).unwrap().with_io(io);
        let path = copy.path().join("seg-1-0");
        let whole = fs::read(&path).unwrap();
        for kept in [whole.len() / 2, 1, 0] {
            let file = OpenOptions::new().write(true).open(&path).unwrap();
            file.set_len(kept as u64).unwrap();
            let (mut sound, mut damaged) = (0, 0);
            for page in pages(&data.dataset) {
                match ask(&served, page) {
                    Ok(record) => {
                        let right = data.dataset.record(page).unwrap();
                        assert_eq!(record.map(|r| r.0), right.map(|r| r.revision));
                        sound += 1;
                    }
                    Err(SourceError::Damaged { file, why }) => {
                        assert_eq!(file, path);
                        assert!(
                            why.contains("cut short") || why.contains("checksum"),
                            "{why}"
                        );
                        damaged += 1;
                    }
                    Err(other) => panic!("{other}"),
                }
                assert!(
                    served.read_family(page, Wait::Yes).is_err()
                        || kept > 1
                        || page != PageId::ROOT
                );
            }
            // The root page's family lies last.
            assert!(damaged > 0 && (sound > 0 || kept < 2), "{sound} {damaged}");
        }
        fs::write(&path, &whole).unwrap();
        assert!(ask(&served, PageId::ROOT).is_ok());
    }
}

#[test]
fn a_segment_that_is_written_over_under_a_reader_is_damaged_also_where_it_was_right_before() {
    let data = TempDataset::of(300, 260, hills);
    let copy = Copy::of(&data.path());
    let path = copy.path().join("seg-1-0");
    let whole = fs::read(&path).unwrap();
    for (io, before) in BOTH.into_iter().flat_map(|io| [(io, false), (io, true)]) {
        let served = Dataset::open(&copy.path()).unwrap().with_io(io);
        let all = pages(&data.dataset);
        let mut right = Vec::new();
        for &page in all.iter().filter(|_| before) {
            right.push((ask(&served, page), served.pack(page)));
        }
        let zeros = vec![0; whole.len()];
        let file = OpenOptions::new().write(true).open(&path);
        file.unwrap().write_all(&zeros).unwrap();
        for &page in &all {
            let stored = data.dataset.record(page).unwrap().is_some();
            assert!(ask(&served, page).is_err() || !stored);
            let below = data.dataset.pack(page).unwrap().is_some();
            assert_eq!(served.pack(page).is_err(), below);
        }
        fs::write(&path, &whole).unwrap();
        for (&page, (record, pack)) in all.iter().zip(right) {
            // A mapping shows what is in the file now; a copy is what was read.
            assert!(ask(&served, page) == record && served.pack(page) == pack);
        }
    }
}

#[test]
fn the_files_of_an_old_generation_can_be_removed_under_its_reader() {
    for io in BOTH {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("moon.escarp");
        build_at(&path, &mut FunctionSource::new(200, 200, hills));
        let old = Dataset::open(&path).unwrap().with_io(io);
        let all = pages(&old);
        let before: Vec<_> = all.iter().map(|&page| ask(&old, page)).collect();
        build_at(&path, &mut FunctionSource::new(200, 200, cliff));
        compact(&Dataset::open(&path).unwrap(), 0.0, &|_, _| {}).unwrap();
        assert!(!path.join("seg-1-0").exists());
        let after: Vec<_> = all.iter().map(|&page| ask(&old, page)).collect();
        assert!(before == after && before.iter().all(Result::is_ok));
    }
}

/// A watched folder, and what is hosted of it.
struct Hosting {
    folder: tempfile::TempDir,
    catalog: Arc<Catalog>,
    watcher: Watcher,
}

impl Hosting {
    fn new() -> Hosting {
        let folder = tempfile::tempdir().unwrap();
        let catalog = Arc::new(Catalog::default());
        let folders = [folder.path().to_path_buf()];
        let watcher = Watcher::start(catalog.clone(), &[], &folders, Io::Pread).unwrap();
        Hosting {
            folder,
            catalog,
            watcher,
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The hosted datasets and their generations, after a look.
    fn look(&mut self) -> Vec<(String, u64)> {
        self.watcher.look();
        let all = self.catalog.all();
        let named = all.iter().map(|hosted| {
            let id = hosted.source().generation_id();
            (hosted.name().to_owned(), id.generation)
        });
        named.collect()
    }
}

#[test]
fn a_watched_folder_is_hosted_as_it_comes_and_goes() {
    let mut hosting = Hosting::new();
    assert_eq!(hosting.look(), []);
    let moon = hosting.path("moon.escarp");
    build_at(&moon, &mut FunctionSource::new(100, 100, hills));
    fs::create_dir(hosting.path("unfinished.escarp")).unwrap();
    fs::create_dir(hosting.path("other")).unwrap();
    assert_eq!(hosting.look(), [("moon".into(), 1)]);
    let hosted = hosting.catalog.get("moon").unwrap();
    let mut watched = hosted.subscribe();
    let first = hosted.source();
    // Nothing happens, and nobody is told.
    assert_eq!(hosting.look(), [("moon".into(), 1)]);
    assert!(!watched.has_changed().unwrap());
    build_at(&moon, &mut FunctionSource::new(100, 100, cliff));
    build_at(
        &hosting.path("mars.escarp"),
        &mut FunctionSource::new(50, 50, hills),
    );
    assert_eq!(hosting.look(), [("mars".into(), 1), ("moon".into(), 2)]);
    assert!(watched.has_changed().unwrap());
    assert_eq!(
        watched
            .borrow_and_update()
            .published
            .source()
            .generation_id()
            .generation,
        2
    );
    assert!(first.record(PageId::ROOT).unwrap().is_some());
    fs::remove_dir_all(&moon).unwrap();
    assert_eq!(hosting.look(), [("mars".into(), 1)]);
    assert!(!watched.borrow_and_update().hosted);
    // Whoever flies over it can do so to the end.
    assert!(hosted.source().record(PageId::ROOT).unwrap().is_some());
    build_at(&moon, &mut FunctionSource::new(100, 100, hills));
    assert_eq!(hosting.look(), [("mars".into(), 1), ("moon".into(), 1)]);
}

#[test]
fn a_dataset_built_again_under_the_same_number_has_another_id() {
    let mut hosting = Hosting::new();
    let moon = hosting.path("moon.escarp");
    build_at(&moon, &mut FunctionSource::new(100, 100, hills));
    hosting.look();
    let source = |hosting: &Hosting| hosting.catalog.get("moon").unwrap().source();
    let before = source(&hosting).generation_id();
    fs::remove_dir_all(&moon).unwrap();
    build_at(&moon, &mut FunctionSource::new(100, 100, cliff));
    hosting.look();
    let after = source(&hosting).generation_id();
    assert_eq!(before.generation, after.generation);
    assert_ne!(before, after);
}

#[test]
fn a_damaged_generation_is_not_taken_and_the_old_one_stays() {
    let mut hosting = Hosting::new();
    let moon = hosting.path("moon.escarp");
    build_at(&moon, &mut FunctionSource::new(100, 100, hills));
    hosting.look();
    let hosted = hosting.catalog.get("moon").unwrap();
    let watched = hosted.subscribe();
    let sound = fs::read(moon.join("CURRENT")).unwrap();
    fs::write(
        moon.join("CURRENT"),
        "escarp 1\ngeneration 2\nmanifest 5 00000000\n",
    )
    .unwrap();
    for _ in 0..25 {
        assert_eq!(hosting.look(), [("moon".into(), 1)]);
    }
    assert!(!watched.has_changed().unwrap());
    assert!(hosted.source().record(PageId::ROOT).unwrap().is_some());
    fs::write(moon.join("CURRENT"), sound).unwrap();
    assert_eq!(hosting.look(), [("moon".into(), 1)]);
}

#[test]
fn a_segment_that_is_restored_is_read_again() {
    let mut hosting = Hosting::new();
    let moon = hosting.path("moon.escarp");
    build_at(&moon, &mut FunctionSource::new(100, 100, hills));
    hosting.look();
    let hosted = hosting.catalog.get("moon").unwrap();
    let root = || hosted.source().record(PageId::ROOT);
    let segment = moon.join("seg-1-0");
    let whole = fs::read(&segment).unwrap();
    File::create(&segment).unwrap();
    assert!(matches!(root(), Err(SourceError::Damaged { .. })));
    hosting.look();
    assert!(root().is_err());
    // Another file of the same name, as from a backup.
    fs::remove_file(&segment).unwrap();
    fs::write(&segment, whole).unwrap();
    hosting.look();
    assert!(root().unwrap().is_some());
}

#[test]
fn a_folder_of_datasets_stands_for_them_and_a_damaged_one_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let data = TempDataset::of(100, 100, hills);
    copied(&data.path(), folder.path(), "mars.escarp");
    let broken = copied(&data.path(), folder.path(), "moon.escarp");
    fs::write(broken.join("index-1"), "no index").unwrap();
    let catalog = Arc::new(Catalog::default());
    let paths = [folder.path().to_path_buf()];
    Watcher::start(catalog.clone(), &paths, &[], Io::Pread).unwrap();
    assert_eq!(catalog.names(), ["mars"]);
    // By its own name it is no accident.
    let refused = Watcher::start(Arc::default(), &[broken], &[], Io::Pread);
    assert!(refused.err().unwrap().to_string().contains("index-1"));
}
