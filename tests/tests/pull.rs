//! Regions pulled from a server: hosted again, verified, and compared with what they are of.

use escarp_client::pull::{Bounds, PullError, PullOptions, PullReport, pull};
use escarp_proto::err8::Err8;
use escarp_proto::geometry::PageId;
use escarp_proto::page::{ChildSlot, Codec, Page, Record, revision};
use escarp_proto::wire::{Chunk, ServerMessage};
use escarp_tests::drive::{settle, view_to};
use escarp_tests::host::Host;
use escarp_tests::liar::Liar;
use escarp_tests::programs::run;
use escarp_tests::terrain::TempDataset;
use escarp_tiles::dataset::{Dataset, PageReader};
use escarp_tiles::verify::{Share, verify};
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::Duration;
use tempfile::TempDir;

/// Rough land with a lake, and a hole in the north-east.
fn land(x: u32, y: u32) -> f64 {
    let (fx, fy) = (f64::from(x), f64::from(y));
    if x > 700 && y < 60 && (x + y) % 40 < 30 {
        return f64::NAN;
    }
    let hills = 400.0 * (fx / 97.0).sin() * (fy / 71.0).cos() + 60.0 * (fx / 7.3 + fy / 11.0).sin();
    let rough = f64::from((x.wrapping_mul(2_654_435_761) ^ y.wrapping_mul(40_503)) >> 5 & 15);
    (hills + rough).max(0.0).round()
}

fn options(output: PathBuf, error_m: f64, sides: Option<[f64; 4]>) -> PullOptions {
    PullOptions {
        bounds: sides.map(|sides| Bounds {
            sides,
            is_lonlat: false,
        }),
        error_m,
        output,
        dry_run: false,
        patience: Duration::from_secs(60),
        token: None,
    }
}

fn pulled(host: &Host, options: &PullOptions) -> Result<PullReport, PullError> {
    pull(&host.url("land"), options, &mut |_| {})
}

/// All finest samples, by grid column and row, with the shift of a pulled grid taken back.
fn samples(dataset: &Dataset, shift: [u32; 2]) -> HashMap<(u32, u32), i32> {
    let mut reader = PageReader::new(dataset);
    let [width, height] = dataset.manifest().samples;
    let mut found = HashMap::new();
    for row in 0..(height - 1).div_ceil(16) {
        let samples = reader.page_row(row).expect("sound pages");
        for (i, sample) in samples.iter().enumerate() {
            let (x, y) = (i as u32 % width, row * 16 + i as u32 / width);
            if let Some(sample) = sample {
                found.insert((x + shift[0], y + shift[1]), *sample);
            }
        }
    }
    found
}

/// The largest difference of the samples of a pulled dataset, which must be those of the region.
fn compare(whole: &Dataset, part: &Dataset, sides: Option<[f64; 4]>) -> u32 {
    let georef = &whole.manifest().georef;
    let [ox, oy] = part.manifest().georef.origin_m;
    let shift = georef.grid(ox, oy).map(|v| v.round() as u32);
    let (all, some) = (samples(whole, [0, 0]), samples(part, shift));
    let mut largest = 0;
    for (place, height) in &some {
        largest = largest.max(all[place].abs_diff(*height));
    }
    let inside = |&(x, y): &(u32, u32)| {
        sides.is_none_or(|[w, s, e, n]| {
            let (x, y) = (georef.world_x(x), georef.world_y(y));
            (w..=e).contains(&x) && (s..=n).contains(&y)
        })
    };
    let missing = all
        .keys()
        .filter(|place| inside(place) && !some.contains_key(place));
    assert_eq!(missing.count(), 0, "samples within the bounds are there");
    largest
}

fn verified(folder: &Path) -> Dataset {
    let dataset = Dataset::open(folder).expect("a dataset");
    let report = verify(&dataset, Share::Full, &|_, _| {}).expect("a sound dataset");
    assert!(report.broken.is_empty(), "{:?}", report.broken);
    assert!(report.largest_ratio <= 1.0);
    dataset
}

struct Desk {
    data: TempDataset,
    host: Host,
    folder: TempDir,
}

impl Desk {
    fn new() -> Desk {
        let data = TempDataset::of(900, 600, land);
        let host = Host::of("land", data.open());
        Desk {
            data,
            host,
            folder: tempfile::tempdir().unwrap(),
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
}

#[test]
fn a_pulled_region_is_a_sound_dataset_within_its_error() {
    let desk = Desk::new();
    let regions = [
        None,
        Some([3500.0, 3300.0, 6900.0, 5000.0]),
        Some([7800.0, 7000.0, 9500.0, 9000.0]),
    ];
    for (number, sides) in regions.into_iter().enumerate() {
        let mut before = u64::MAX;
        for error_m in [0.0, 30.0, 250.0] {
            let target = desk.path(&format!("{number}-{error_m}.escarp"));
            let mut options = options(target.clone(), error_m, sides);
            options.dry_run = true;
            let estimate = pulled(&desk.host, &options).unwrap();
            assert!(!target.exists());
            options.dry_run = false;
            let report = pulled(&desk.host, &options).unwrap();
            assert_eq!(estimate.pages, report.pages, "all tiles are looked at");
            let part = verified(&target);
            let largest = compare(&desk.data.dataset, &part, sides);
            assert!(f64::from(largest) <= error_m, "{largest} of {error_m}");
            assert!(f64::from(largest) <= part.manifest().storage_error_m);
            assert!(part.manifest().storage_error_m <= error_m + 1e-9);
            assert!(report.bytes <= before, "a wider error takes no more");
            before = report.bytes;
            let named = part.manifest().sources.last().unwrap();
            assert!(named.contains("/land, generation 1"), "{named}");
        }
        assert!(!desk.path(&format!("{number}-0.escarp.part")).exists());
    }
}

#[test]
fn the_whole_without_an_error_is_the_same_dataset() {
    let desk = Desk::new();
    let target = desk.path("whole.escarp");
    pulled(&desk.host, &options(target.clone(), 0.0, None)).unwrap();
    let part = verified(&target);
    let (ours, theirs) = (desk.data.dataset.manifest(), part.manifest());
    assert_eq!(ours.pages, theirs.pages);
    assert_eq!(ours.valid_samples, theirs.valid_samples);
    assert_eq!(ours.height_range, theirs.height_range);
    for entry in desk.data.dataset.families() {
        for record in desk.data.dataset.family(&entry).unwrap().records() {
            let record = record.unwrap();
            let same = part.record(record.page).unwrap().map(|found| found.bytes);
            assert_eq!(same, Some(record.bytes), "page {}", record.page);
        }
    }
}

#[test]
fn a_pulled_region_is_hosted_and_viewed() {
    let desk = Desk::new();
    let target = desk.path("part.escarp");
    let sides = Some([3500.0, 3300.0, 6900.0, 5000.0]);
    pulled(&desk.host, &options(target.clone(), 20.0, sides)).unwrap();
    let host = Host::of("part", Dataset::open(&target).unwrap());
    let mut driver = host.client("part");
    let manifest = driver.connect(Duration::from_secs(60)).unwrap();
    let [x, y, z] = manifest.extent_m();
    let middle = [(x[0] + x[1]) / 2.0, (y[0] + y[1]) / 2.0];
    let view = view_to(
        [middle[0], middle[1] - 500.0, z[1] + 300.0],
        [middle[0], middle[1], z[0]],
        1.0,
    );
    let stats = settle(&mut driver, &view);
    assert!(stats.converged && stats.triangles > 100, "{stats:?}");
}

#[test]
fn a_pull_that_is_killed_goes_on_where_it_was() {
    let desk = Desk::new();
    let target = desk.path("part.escarp");
    let options = options(target.clone(), 0.0, None);
    let mut batches = 0;
    let killed = catch_unwind(AssertUnwindSafe(|| {
        pull(&desk.host.url("land"), &options, &mut |_| {
            batches += 1;
            assert!(batches < 4, "as if killed");
        })
    }));
    assert!(killed.is_err() && !target.exists());
    assert!(Dataset::open(&desk.path("part.escarp.part/dataset")).is_err());
    // The tail of a journal may be cut short.
    let journal = desk.path("part.escarp.part/received-1");
    let length = journal.metadata().unwrap().len();
    let file = std::fs::File::options().write(true).open(&journal).unwrap();
    file.set_len(length - 7).unwrap();
    let report = pulled(&desk.host, &options).unwrap();
    assert!(
        report.pages < desk.data.dataset.manifest().pages,
        "{report:?}"
    );
    assert_eq!(compare(&desk.data.dataset, &verified(&target), None), 0);
    assert!(!desk.path("part.escarp.part").exists());
}

#[test]
fn what_is_in_the_way_is_named_and_left_alone() {
    let desk = Desk::new();
    let target = desk.path("there.escarp");
    std::fs::create_dir(&target).unwrap();
    let refusal = |options: &PullOptions| pulled(&desk.host, options).unwrap_err().to_string();
    assert!(refusal(&options(target, 0.0, None)).contains("exists already"));
    let target = desk.path("other.escarp");
    std::fs::create_dir(desk.path("other.escarp.part")).unwrap();
    std::fs::write(desk.path("other.escarp.part/notes"), "mine").unwrap();
    assert!(refusal(&options(target, 0.0, None)).contains("other files"));
    let target = desk.path("wrong.escarp");
    assert!(refusal(&options(target.clone(), -1.0, None)).contains("0 and more"));
    let beside = Some([1e6, 1e6, 2e6, 2e6]);
    assert!(refusal(&options(target.clone(), 1.0, beside)).contains("beside the data"));
    let mut degrees = options(target.clone(), 1.0, Some([1.0, 1.0, 2.0, 2.0]));
    degrees.bounds.as_mut().unwrap().is_lonlat = true;
    assert!(refusal(&degrees).contains("EPSG:32632"));
    assert!(!target.exists());
}

#[test]
fn wrong_usage_exits_with_2_and_what_is_refused_for_good_is_not_tried_again() {
    let desk = Desk::new();
    let (url, output) = (desk.host.url("land").to_string(), desk.path("part.escarp"));
    let output = output.to_str().unwrap();
    let pull = |arguments: &[&str]| {
        let all = [&["pull"], arguments, &["-o", output]].concat();
        run("escarp-client", &all)
    };
    let wrong: [(&[&str], &str); 5] = [
        (&[&url, "--error=-1"], "0 and more"),
        (&[&url, "--error=1", "--bounds=5,5,1,1"], "no rectangle"),
        (
            &[&url, "--error=1", "--bounds=1e6,1e6,2e6,2e6"],
            "beside the data",
        ),
        (
            &[&url, "--error=1", "--bounds=9,50,10,51", "--lonlat"],
            "gdaltransform -s_srs EPSG:4326 -t_srs 'EPSG:32632'",
        ),
        (&[&url], "--error"),
    ];
    for (arguments, words) in wrong {
        let ran = pull(arguments);
        assert!(ran.err.contains(words), "{arguments:?}: {ran:?}");
        assert_eq!(ran.code, Some(2), "{arguments:?}: {ran:?}");
        assert!(!ran.err.contains("again"), "{arguments:?}: {ran:?}");
    }
    // One that tried on would not end before it is killed.
    let ran = pull(&[
        &desk.host.url("sea").to_string(),
        "--error=1",
        "--wait=86400",
    ]);
    assert!(ran.err.contains("the server refuses"), "{ran:?}");
    assert!(ran.err.contains("land"), "it says what there is: {ran:?}");
    assert!(!ran.err.contains("again"), "{ran:?}");
    assert_eq!(ran.code, Some(1), "{ran:?}");
}

#[test]
fn a_lying_server_gets_an_error_and_leaves_no_dataset() {
    type Change = fn(&mut Chunk);
    let data = TempDataset::of(900, 600, land);
    let lies: [(Change, &str); 3] = [
        (|chunk| chunk.bytes[0] ^= 0x40, "revision"),
        (
            |chunk| chunk.bytes.truncate(chunk.bytes.len() - 1),
            "revision",
        ),
        (
            |chunk| {
                // A sound record of another place.
                if let Some(page) = PageId::from_key(chunk.page).filter(|page| page.level() > 0) {
                    let samples = [Some(7777); 289];
                    let slots =
                        (page.level() < 8).then(|| Box::new([ChildSlot::Full(Err8(0)); 256]));
                    let record =
                        Record::encode(&Page::new(page, &samples, slots).unwrap(), Codec::Dense);
                    chunk.bytes = record.bytes().to_vec();
                    chunk.revision = revision(page, &chunk.bytes);
                }
            },
            "corner",
        ),
    ];
    for (lie, what) in lies {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("part.escarp");
        let change = move |mut chunk: Chunk| {
            lie(&mut chunk);
            vec![ServerMessage::Pages(vec![chunk]).encode()]
        };
        let liar = Liar::start(data.open(), Box::new(change));
        let options = options(target.clone(), 10.0, None);
        let error = pull(&liar.url(), &options, &mut |_| {})
            .unwrap_err()
            .to_string();
        assert!(error.contains(what), "{error}");
        assert!(!target.exists());
    }
}
