//! Points, batches and profiles.

use super::*;
use crate::source::{GenerationId, Pack, Revised, SourceError};
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;

const SIZE: [u32; 2] = [333, 271];

fn random_place(made: &Made, number: u32) -> [f64; 2] {
    let [width, height] = made.raster.size.map(|n| (n - 1) as f64);
    [part(1, number) * width, part(2, number) * height]
}

fn at(made: &Made, grid: [f64; 2], detail: Detail) -> Option<Height> {
    let place = made.frame().within(grid).unwrap();
    height_at(&mut made.pages(), place, detail).unwrap()
}

fn datasets() -> Vec<Made> {
    let mut all = vec![Made::hills(SIZE, false), Made::hills(SIZE, true)];
    all.extend(Made::real("mt_everest_90m.tif"));
    all.extend(Made::real("merewether_topography1_asc.zip"));
    all
}

#[test]
fn at_samples_the_height_is_the_sample_and_between_them_that_of_the_triangle() {
    for made in datasets() {
        let quantum_m = made.dataset.manifest().georef.quantum_m;
        let mut nulls = 0;
        for number in 0..3000 {
            let place = random_place(&made, number);
            let places = [place, place.map(f64::round), [place[0].round(), place[1]]];
            for place in places {
                let expected = made.raster.height(place).map(|height| height * quantum_m);
                let found = at(&made, place, Detail::Finest);
                match (found, expected) {
                    (Some(found), Some(expected)) => {
                        let error = (found.height_m - expected).abs();
                        assert!(error < 1e-6, "{place:?}: {found:?}, {expected}");
                        assert_eq!(found.error_m, made.dataset.manifest().storage_error_m);
                    }
                    (None, None) => nulls += 1,
                    _ => panic!("{place:?}: {found:?}, {expected:?}"),
                }
            }
            let node = places[1];
            let sample = made.raster.sample(node[0] as i64, node[1] as i64);
            if let (Some(found), Some(sample)) = (at(&made, node, Detail::Finest), sample) {
                assert_eq!(found.height_m, sample * quantum_m, "exact at {node:?}");
            }
        }
        let manifest = made.dataset.manifest();
        let samples = u64::from(manifest.samples[0]) * u64::from(manifest.samples[1]);
        let holes = samples - manifest.valid_samples;
        assert!(nulls == 0 || holes > 0, "{nulls}");
        // Few holes may be missed by chance.
        assert!(nulls > 0 || holes * 100 < samples, "{holes}");
    }
}

#[test]
fn a_coarser_height_is_within_its_bound_and_its_bound_within_what_was_asked() {
    for made in datasets() {
        let manifest = made.dataset.manifest();
        let quantum_m = manifest.georef.quantum_m;
        let mut coarse = 0;
        for number in 0..2000 {
            let place = random_place(&made, number);
            let expected = made.raster.height(place).map(|height| height * quantum_m);
            let asked_m = [0.5, 30.0, 200.0, 1e4][number as usize % 4];
            for detail in [Detail::ErrorM(asked_m), Detail::ResolutionM(10.0 * asked_m)] {
                let found = at(&made, place, detail);
                assert_eq!(found.is_some(), expected.is_some(), "{place:?} {detail:?}");
                let (Some(found), Some(expected)) = (found, expected) else {
                    continue;
                };
                let off = (found.height_m - expected).abs();
                assert!(
                    off <= found.error_m + 1e-9,
                    "{place:?} {detail:?} {found:?} {off}"
                );
                coarse += u32::from(found.stride > 1);
                match detail {
                    Detail::ErrorM(_) => assert!(
                        found.error_m <= asked_m.max(Accuracy::of(manifest).finest_m()),
                        "{found:?}"
                    ),
                    _ => assert!(
                        found.stride == 1
                            || f64::from(found.stride) * manifest.georef.sample_spacing_m[0]
                                <= 10.0 * asked_m
                    ),
                }
            }
        }
        assert!(coarse > 0);
    }
}

#[test]
fn a_batch_is_its_points_in_their_order_and_null_outside() {
    let made = Made::hills(SIZE, true);
    let frame = made.frame();
    let places: Vec<_> = (0..500)
        .map(|number| random_place(&made, number).map(|v| v * 1.1 - 10.0))
        .map(|grid| frame.within(grid))
        .collect();
    let found = heights_at(&mut made.pages(), &places, Detail::Finest).unwrap();
    assert!(places.iter().any(Option::is_none));
    for (place, found) in places.iter().zip(found) {
        let alone =
            place.and_then(|place| height_at(&mut made.pages(), place, Detail::Finest).unwrap());
        assert_eq!(found, alone);
    }
}

#[test]
fn coordinates_lead_to_the_grid_and_back_in_both_systems() {
    let made = Made::hills([33, 33], false);
    let manifest = made.dataset.manifest();
    for kind in [CoordinateKind::Native, CoordinateKind::LonLat] {
        let frame = Frame::of(manifest, kind).unwrap();
        for grid in [[0.0, 0.0], [32.0, 32.0], [7.0, 21.0], [3.25, 30.5]] {
            let given = frame.coordinates(grid).unwrap();
            let back = frame.grid(given).unwrap();
            assert!((back[0] - grid[0]).abs() < 1e-6 && (back[1] - grid[1]).abs() < 1e-6);
            let place = frame.within(back).unwrap().grid();
            if grid.iter().all(|v| v.fract() == 0.0) {
                assert_eq!(place, grid, "the sample itself");
            }
        }
    }
    // UTM zone 32 has its middle, 500 km, at 9 degrees.
    let lonlat = Frame::of(manifest, CoordinateKind::LonLat).unwrap();
    let [longitude, latitude] = lonlat.coordinates([0.0, 32.0]).unwrap();
    assert!((longitude - 9.0).abs() < 1e-9 && (45.0..45.3).contains(&latitude));
    let native = Frame::of(manifest, CoordinateKind::Native).unwrap();
    assert_eq!(native.grid([500_010.0, 5_000_000.0]), Some([1.0, 32.0]));
    assert_eq!(
        native.within([32.0 + 1e-8, -1e-8]),
        native.within([32.0, 0.0])
    );
    assert_eq!(native.within([32.001, 5.0]), None);
    assert_eq!(native.within([f64::NAN, 5.0]), None);
}

#[test]
fn longitudes_of_any_turn_are_the_same_place() {
    let mut source = function([21, 21], |x, _| f64::from(x));
    source.info.crs = escarp_tiles::crs::from_epsg(4326).unwrap();
    source.info.placement = Placement {
        x0: 179.9,
        y0: 10.2,
        dx: 0.01,
        dy: 0.01,
    };
    let made = Made::of(&mut source);
    let frame = Frame::of(made.dataset.manifest(), CoordinateKind::LonLat).unwrap();
    for longitude in [180.05, -179.95, 540.05] {
        let grid = frame.grid([longitude, 10.1]).unwrap();
        assert!((grid[0] - 15.0).abs() < 1e-6, "{grid:?}");
    }
}

#[test]
fn samples_of_a_profile_are_where_they_are_said_to_be() {
    let made = Made::hills([101, 101], false);
    let frame = made.frame();
    // 10 m a column, 20 m a row: a leg of 300 m, and one of 400 m.
    let vertices = [[0.0, 0.0], [30.0, 0.0], [30.0, 20.0]];
    let profile = along(&frame, &vertices, Spread::Samples(8), 100).unwrap();
    assert_eq!(profile.length_m, 700.0);
    assert_eq!(profile.distances_m[3], 300.0);
    let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-9;
    assert!(near(profile.grid[3], [30.0, 0.0]) && near(profile.grid[5], [30.0, 10.0]));
    assert_eq!(profile.grid[7], [30.0, 20.0]);
    let spaced = along(&frame, &vertices, Spread::SpacingM(250.0), 100).unwrap();
    assert_eq!(spaced.distances_m, [0.0, 250.0, 500.0, 700.0]);
    let standing = along(&frame, &[[1.0, 1.0]; 2], Spread::SpacingM(5.0), 100).unwrap();
    assert_eq!(standing.distances_m, [0.0]);
    for (vertices, spread) in [
        (&vertices[..1], Spread::Samples(8)),
        (&vertices[..], Spread::Samples(1)),
        (&vertices[..], Spread::Samples(101)),
        (&vertices[..], Spread::SpacingM(1.0)),
        (&vertices[..], Spread::SpacingM(0.0)),
        (&vertices[..], Spread::SpacingM(f64::NAN)),
        (&vertices[..], Spread::SpacingM(1e-300)),
    ] {
        let refused = along(&frame, vertices, spread, 100);
        assert!(
            matches!(refused, Err(HeightError::Usage { .. })),
            "{refused:?}"
        );
    }
}

/// A dataset that counts the records that are read of it.
struct Counted<'a>(&'a Dataset, std::sync::atomic::AtomicU64);

impl PageSource for Counted<'_> {
    fn manifest(&self) -> &Manifest {
        self.0.manifest()
    }

    fn manifest_json(&self) -> &[u8] {
        self.0.manifest_json()
    }

    fn generation_id(&self) -> GenerationId {
        PageSource::generation_id(self.0)
    }

    fn record(&self, page: PageId) -> Result<Option<Revised>, SourceError> {
        self.1.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        PageSource::record(self.0, page)
    }

    fn pack(&self, parent: PageId) -> Result<Option<Pack>, SourceError> {
        PageSource::pack(self.0, parent)
    }
}

#[test]
fn a_coarser_height_reads_fewer_pages_and_a_point_no_more_than_there_are_levels() {
    let made = Made::hills([600, 600], false);
    let read = |detail| {
        let counted = Counted(&made.dataset, Default::default());
        let mut pages = Pages::new(&counted, Work::new(1000, 0, &GOES_ON));
        let place = made.frame().within([301.5, 77.25]).unwrap();
        height_at(&mut pages, place, detail).unwrap().unwrap();
        counted.1.into_inner()
    };
    assert_eq!(read(Detail::Finest), 3);
    assert_eq!(read(Detail::ErrorM(1e5)), 1);
}

#[test]
fn what_costs_more_than_is_allowed_or_is_cancelled_ends_early() {
    let made = Made::hills([600, 600], false);
    let places: Vec<_> = (0..100)
        .map(|number| made.frame().within(random_place(&made, number)))
        .collect();
    let mut pages = Pages::new(&made.dataset, Work::new(20, 0, &GOES_ON));
    let refused = heights_at(&mut pages, &places, Detail::Finest);
    assert!(matches!(
        refused,
        Err(HeightError::TooMuch { most: 20, .. })
    ));
    let cancelled = AtomicBool::new(true);
    let mut pages = Pages::new(&made.dataset, Work::new(20, 0, &cancelled));
    let ended = heights_at(&mut pages, &places, Detail::Finest);
    assert_eq!(ended, Err(HeightError::Cancelled));
}
