//! Out and in again: places and heights must be those that went in.

use super::*;
use crate::build::{BuildOptions, Quantum, build};
use crate::crs;
use crate::dataset::Dataset;
use crate::dem::{
    Crs, DemError, OpenOptions, Placement, Registration, SampleType, open, write_geotiff_as,
};
use std::path::Path;

struct Grid {
    info: DemInfo,
    heights: Vec<f64>,
}

impl DemSource for Grid {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        let from = (first_row * self.info.width) as usize;
        out.copy_from_slice(&self.heights[from..from + out.len()]);
        Ok(())
    }
}

fn grid(crs: Crs, sample_type: SampleType, step_m: f64) -> Grid {
    let (width, height) = (300u32, 77u32);
    let heights = (0..width * height)
        .map(|i| match i % 97 {
            0 => f64::NAN,
            n => f64::from(n * 40 + i % 13) * step_m - 50.0 * step_m,
        })
        .collect();
    let (x0, y0, dx, dy) = match crs {
        Crs::Geographic { .. } => (86.0, 28.0, 1.0 / 1200.0, 1.0 / 3600.0),
        _ => (1_234_567.5, 3_210_000.25, 30.0, 27.5),
    };
    let info = DemInfo {
        path: "grid".into(),
        format: "grid",
        width,
        height,
        placement: Placement { x0, y0, dx, dy },
        crs,
        registration: Registration::Grid,
        sample_type,
        height_step_m: step_m,
        nodata: None,
        vertical: Some(crs::vertical::from_code(5773)),
    };
    Grid { info, heights }
}

fn rows(source: &mut dyn DemSource) -> Vec<f64> {
    let (width, height) = (source.info().width, source.info().height);
    let mut out = vec![0.0; (width * height) as usize];
    source.read_rows(0, height, &mut out).unwrap();
    out
}

fn same(a: &[f64], b: &[f64], within: f64) {
    assert_eq!(a.len(), b.len());
    for (i, (a, b)) in a.iter().zip(b).enumerate() {
        assert!(
            (a - b).abs() <= within || a.is_nan() && b.is_nan(),
            "{i}: {a} {b}"
        );
    }
}

fn near(a: &Placement, b: &Placement) {
    for (a, b) in [(a.x0, b.x0), (a.y0, b.y0), (a.dx, b.dx), (a.dy, b.dy)] {
        assert!((a - b).abs() <= 1e-13 * a.abs().max(b.abs()), "{a} {b}");
    }
}

fn built(folder: &Path, source: &mut dyn DemSource) -> DatasetSource {
    let options = BuildOptions {
        quantum: Quantum::Natural,
        overwrite: true,
        ..BuildOptions::default()
    };
    build(source, folder, vec!["grid".into()], options, &|_, _| {}).unwrap();
    DatasetSource::new(Dataset::open(folder).unwrap())
}

#[test]
fn build_and_export_and_build_again_gives_the_same_heights_and_places() {
    let custom = "+proj=aea +lat_0=23 +lon_0=-96 +lat_1=29.5 +lat_2=45.5 +x_0=0 +y_0=0 +R=1737400 \
                  +to_meter=0.3048 +no_defs +title=Moon_Albers";
    let moon = Crs::Geographic {
        name: "Moon 2000".into(),
        radius_m: 1_737_400.0,
    };
    let crs = [
        crs::from_epsg(4326).unwrap(),
        crs::from_epsg(32645).unwrap(),
        crs::from_epsg(2225).unwrap(),
        moon,
        crs::from_proj(custom).unwrap(),
    ];
    let kinds = [
        (SampleType::I16, 1.0),
        (SampleType::U16, 0.1),
        (SampleType::F32, 0.01),
    ];
    let temporary = tempfile::tempdir().unwrap();
    for crs in crs {
        for (sample_type, step_m) in kinds {
            let mut grid = grid(crs.clone(), sample_type, step_m);
            let mut first = built(&temporary.path().join("a.escarp"), &mut grid);
            let heights = rows(&mut first);
            near(&first.info().placement, &grid.info.placement);
            let encoding = encoding_for(first.info(), range_m(&first, &first));
            let path = temporary.path().join("a.tif");
            write_geotiff_as(&path, &mut first, encoding).unwrap();
            let mut again = open(&path, &OpenOptions::default()).unwrap();
            assert_eq!(again.info().vertical, grid.info.vertical);
            assert_eq!(again.info().crs.name(), crs.name());
            let second = &mut built(&temporary.path().join("b.escarp"), &mut *again);
            near(&second.info().placement, &grid.info.placement);
            // A float holds a decimal step to its last digit; whole metres exactly.
            same(&rows(second), &heights, 1e-9 * step_m.recip().min(1.0));
            assert_eq!(second.manifest().vertical, grid.info.vertical);
        }
    }
}

#[test]
fn a_window_is_the_same_part_of_the_whole() {
    let temporary = tempfile::tempdir().unwrap();
    let mut grid = grid(crs::from_epsg(32645).unwrap(), SampleType::I16, 1.0);
    let mut dataset = built(&temporary.path().join("a.escarp"), &mut grid);
    let whole = rows(&mut dataset);
    for (rows, columns) in [
        (0..77, 0..300),
        (15..18, 15..49),
        (76..77, 299..300),
        (30..65, 31..33),
    ] {
        let mut window = vec![0.0; rows.len() * columns.len()];
        dataset
            .read_window(rows.clone(), columns.clone(), &mut window)
            .unwrap();
        let expected: Vec<f64> = rows
            .flat_map(|r| columns.clone().map(move |c| (r * 300 + c) as usize))
            .map(|at| whole[at])
            .collect();
        same(&window, &expected, 0.0);
    }
}

#[test]
fn the_shortest_kind_that_loses_nothing_is_chosen() {
    let info = |sample_type, height_step_m| DemInfo {
        sample_type,
        height_step_m,
        ..grid(Crs::Local, SampleType::I16, 1.0).info
    };
    let metres = info(SampleType::I32, 1.0);
    assert_eq!(encoding_for(&metres, [-500.0, 9000.0]), Encoding::I16);
    assert_eq!(encoding_for(&metres, [-32_768.0, 0.0]), Encoding::I32);
    assert_eq!(encoding_for(&metres, [0.0, 32_768.0]), Encoding::I32);
    let centimetres = info(SampleType::I32, 0.01);
    assert_eq!(encoding_for(&centimetres, [-500.0, 9000.0]), Encoding::F32);
    assert_eq!(encoding_for(&centimetres, [0.0, 90_000.0]), Encoding::F64);
    assert_eq!(
        encoding_for(&info(SampleType::F64, 1.0), [0.0, 1.0]),
        Encoding::F64
    );
}
