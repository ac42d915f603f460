//! The whole way, from a DEM to a picture: built, served over loopback, streamed, and drawn on a
//! graphics adapter (a software one counts), then compared with a stored picture.
//!
//! `ESCARP_BLESS=1` stores what is drawn now. Look at it before it is committed.

use escarp_client::app::headless::{Driver, Painter};
use escarp_client::camera::look_at;
use escarp_proto::view::View;
use escarp_tests::host::{Host, PATIENCE};
use escarp_tests::programs::workspace;
use escarp_tests::terrain::TempDataset;
use escarp_tiles::synth::SynthSource;
use image::RgbaImage;
use std::path::PathBuf;

const SIZE_PX: [u32; 2] = [320, 180];
const SAMPLES: u32 = 513;
const SEED: u64 = 42;
const SPACING_CM: u32 = 4000;

/// Adapters differ in rounding and in how they sample edges: a few pixels along silhouettes, and
/// the last digits of shades. Allowed are a mean difference of so many steps of 255 ...
const MEAN_STEPS: f64 = 1.5;
/// ... and this share of pixels that are off ...
const SHARE_OFF: f64 = 0.02;
/// ... by more than so many steps in a channel.
const OFF_STEPS: u8 = 24;

/// How two pictures differ.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Difference {
    /// Mean of the absolute differences of all channels, steps of 255.
    mean_steps: f64,
    /// Share of pixels of which a channel is off by more than [`OFF_STEPS`].
    share_off: f64,
}

impl Difference {
    fn of(a: &RgbaImage, b: &RgbaImage) -> Difference {
        assert_eq!(a.dimensions(), b.dimensions());
        let (mut sum, mut off) = (0, 0);
        for (a, b) in a.pixels().zip(b.pixels()) {
            let steps = [0, 1, 2].map(|channel| a[channel].abs_diff(b[channel]));
            sum += steps.iter().map(|step| u64::from(*step)).sum::<u64>();
            off += u64::from(steps.iter().any(|step| *step > OFF_STEPS));
        }
        let pixels = f64::from(a.width()) * f64::from(a.height());
        Difference {
            mean_steps: sum as f64 / (3.0 * pixels),
            share_off: off as f64 / pixels,
        }
    }

    fn is_tolerable(&self) -> bool {
        self.mean_steps <= MEAN_STEPS && self.share_off <= SHARE_OFF
    }
}

/// Over the southern edge of the terrain, looking north across ridges to a plain; moved aside
/// and turned a little by so many metres.
fn view(by_m: f64) -> View {
    let eye = [508_000.0 + by_m, 5_177_500.0, 10_500.0];
    let look = [511_500.0 - by_m, 5_191_000.0, 5_000.0];
    look_at(eye, look, std::f64::consts::FRAC_PI_3, SIZE_PX, 1.0)
}

fn terrain() -> TempDataset {
    TempDataset::build(&mut SynthSource::with_spacing_cm(SAMPLES, SEED, SPACING_CM))
}

/// Streams what a view needs, and draws it.
fn draw(driver: &mut Driver, view: View) -> RgbaImage {
    let manifest = driver.connect(PATIENCE).expect("a session");
    let stats = driver.settle(&view, PATIENCE).expect("the session goes on");
    assert!(stats.converged && stats.bound_px <= 1.0, "{stats:?}");
    let mut painter = Painter::new(&manifest, SIZE_PX)
        .unwrap_or_else(|error| panic!("this test needs a graphics adapter: {error}"));
    painter
        .paint(&driver.client, view, false)
        .expect("a picture")
        .image
}

fn stored() -> PathBuf {
    workspace().join("tests/pictures/terrain.png")
}

#[test]
fn a_dataset_streamed_over_loopback_looks_as_stored() {
    let data = terrain();
    let host = Host::of("terrain", data.open());
    let drawn = draw(&mut host.client("terrain"), view(0.0));
    let path = stored();
    if std::env::var_os("ESCARP_BLESS").is_some() {
        drawn.save(&path).expect("the picture is stored");
    }
    let expected = image::open(&path)
        .unwrap_or_else(|error| panic!("{}: {error}; ESCARP_BLESS=1 makes it", path.display()));
    let difference = Difference::of(&drawn, &expected.to_rgba8());
    if !difference.is_tolerable() {
        let beside = std::env::temp_dir().join("escarp-picture-differs.png");
        drawn.save(&beside).expect("the picture is stored");
        panic!(
            "{difference:?}: compare {} with {}",
            beside.display(),
            path.display()
        );
    }
    println!("{difference:?}");
}

#[test]
fn the_stored_picture_shows_terrain_and_sky() {
    let picture = image::open(stored())
        .expect("the stored picture")
        .to_rgba8();
    assert_eq!([picture.width(), picture.height()], SIZE_PX);
    // Many colours below, light and shadow among them, and a horizon with sky above it.
    let mut colours: Vec<[u8; 3]> = picture.pixels().map(|p| [p[0], p[1], p[2]]).collect();
    colours.sort_unstable();
    colours.dedup();
    assert!(colours.len() > 5000, "{} colours", colours.len());
    let lightness = |row: u32| -> Vec<u32> {
        let pixel = |column| {
            picture.get_pixel(column, row).0[..3]
                .iter()
                .map(|c| *c as u32)
        };
        (0..SIZE_PX[0]).map(|column| pixel(column).sum()).collect()
    };
    let spread = |row| {
        let row = lightness(row);
        row.iter().max().unwrap_or(&0) - row.iter().min().unwrap_or(&0)
    };
    assert!(spread(SIZE_PX[1] * 3 / 4) > 150, "the ground is even");
    assert!(spread(0) < 60, "the sky is not");
}

#[test]
fn another_view_or_another_terrain_is_told_apart() {
    let expected = image::open(stored())
        .expect("the stored picture")
        .to_rgba8();
    let data = terrain();
    let host = Host::of("terrain", data.open());
    let moved = draw(&mut host.client("terrain"), view(250.0));
    let difference = Difference::of(&moved, &expected);
    assert!(
        !difference.is_tolerable(),
        "250 m beside it is taken for the same: {difference:?}"
    );
    let other = TempDataset::build(&mut SynthSource::with_spacing_cm(
        SAMPLES,
        SEED + 1,
        SPACING_CM,
    ));
    let host = Host::of("terrain", other.open());
    let drawn = draw(&mut host.client("terrain"), view(0.0));
    let difference = Difference::of(&drawn, &expected);
    assert!(
        !difference.is_tolerable(),
        "another terrain is the same: {difference:?}"
    );
}
