//! Outlines of regions of interest: GeoJSON, or a raster.

use super::slope::Slope;
use escarp_tiles::build::{Coarsened, Tolerances, Wish};
use escarp_tiles::dem::DemSource;
use std::fs;

const SIDE: u32 = 40;

/// An outline: each height of the region is within its tolerance of the source, all others are
/// the source's. The first byte is the tolerance.
pub fn region(data: &[u8]) {
    let Some((&tolerance, outline)) = data.split_first() else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("region");
    fs::write(&path, outline).expect("a file");
    let tolerance_m = f64::from(tolerance);
    let wish = Wish {
        tolerance_m,
        region: Some(path),
    };
    let slope = || Slope::new(SIDE, SIDE, u32::MAX);
    let Ok(tolerances) = Tolerances::open(&[wish], slope().info()) else {
        return;
    };
    let coarse = Coarsened::new(Box::new(slope()), 1.0, tolerances);
    let rows = |source: &mut dyn DemSource| {
        let mut rows = vec![0.0; (SIDE * SIDE) as usize];
        source.read_rows(0, SIDE, &mut rows).map(|()| rows)
    };
    let Ok(found) = rows(&mut coarse.expect("a small source")) else {
        return;
    };
    let given = rows(&mut slope()).expect("no bad block");
    for (found, given) in found.into_iter().zip(given) {
        assert_eq!(found.is_nan(), given.is_nan());
        assert!(found.is_nan() || (found - given).abs() <= tolerance_m);
    }
}
