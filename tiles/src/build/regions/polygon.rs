//! Regions given as polygons: GeoJSON (RFC 7946), with coordinates in the CRS of the source.

use super::tolerance::Marks;
use crate::dem::{DemError, DemInfo};
use serde::Deserialize;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// The longest file of polygons; read, it may take 36 times as much memory.
const MAX_BYTES: u64 = 16 << 20;
/// The most sides that the polygons of a file may have together.
const MAX_EDGES: usize = 1 << 18;
/// Sides are found by row, in this many strips of the source.
const STRIPS: u32 = 64;
/// No position may be further from the first sample, in samples.
const FARTHEST: f64 = 1e12;
/// Geometries in geometries.
const MAX_DEPTH: usize = 16;

/// What Escarp reads of GeoJSON.
#[derive(Deserialize)]
#[serde(tag = "type")]
enum Json {
    FeatureCollection {
        features: Vec<Json>,
    },
    Feature {
        geometry: Option<Box<Json>>,
    },
    GeometryCollection {
        geometries: Vec<Json>,
    },
    Polygon {
        coordinates: Polygon,
    },
    MultiPolygon {
        coordinates: Vec<Polygon>,
    },
    #[serde(other)]
    Other,
}

/// Rings of positions; a position may have more than two numbers.
type Polygon = Vec<Vec<Vec<f64>>>;

/// A side, in columns and rows of the source; its first end is not below its second.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Edge {
    polygon: u32,
    from: [f64; 2],
    to: [f64; 2],
}

pub(super) struct Polygons {
    edges: Vec<Edge>,
    /// Sides by strip of rows, by polygon.
    strips: Vec<Vec<u32>>,
    rows_a_strip: u32,
}

impl Polygons {
    /// Whether a file starts as JSON does.
    pub(super) fn is_json(path: &Path) -> Result<bool, DemError> {
        let mut start = Vec::new();
        let file = File::open(path).map_err(|error| DemError::io(path, "open", error))?;
        let read = file.take(64).read_to_end(&mut start);
        read.map_err(|error| DemError::io(path, "read", error))?;
        Ok(start.trim_ascii_start().first() == Some(&b'{'))
    }

    pub(super) fn open(path: &Path, info: &DemInfo) -> Result<Polygons, DemError> {
        let mut text = Vec::new();
        let file = File::open(path).map_err(|error| DemError::io(path, "open", error))?;
        let read = file.take(MAX_BYTES + 1).read_to_end(&mut text);
        read.map_err(|error| DemError::io(path, "read", error))?;
        if text.len() as u64 > MAX_BYTES {
            let what = format!("it is longer than {MAX_BYTES} bytes");
            return Err(DemError::usage(
                path,
                what,
                "simplify it: ogr2ogr -simplify",
            ));
        }
        Polygons::parse(&text, path, info)
    }

    pub(super) fn parse(text: &[u8], path: &Path, info: &DemInfo) -> Result<Polygons, DemError> {
        let json: Json = serde_json::from_slice(text).map_err(|error| {
            let hint = "give polygons as GeoJSON: ogr2ogr -f GeoJSON region.geojson INPUT";
            DemError::usage(path, format!("it is not GeoJSON: {error}"), hint)
        })?;
        let mut polygons = Vec::new();
        collect(json, 0, &mut polygons).map_err(|what| {
            let hint = "give polygons; around a line they are made by: ogr2ogr -dialect sqlite \
                        -sql \"SELECT ST_Buffer(geometry, 50) FROM layer\"";
            DemError::usage(path, what, hint)
        })?;
        let edges = edges(&polygons, info).map_err(|what| {
            DemError::usage(path, what, "give closed rings of at least 4 positions each")
        })?;
        let most = [f64::from(info.width - 1), f64::from(info.height - 1)];
        let beyond = |axis: usize| {
            let ends = || edges.iter().flat_map(|e| [e.from[axis], e.to[axis]]);
            ends().all(|at| at < 0.0) || ends().all(|at| at > most[axis])
        };
        if beyond(0) || beyond(1) {
            let what = format!("its polygons do not meet the data, which has {}", info.crs);
            let hint = "give coordinates in that system: ogr2ogr -t_srs EPSG:CODE -lco RFC7946=NO";
            return Err(DemError::usage(path, what, hint));
        }
        Ok(Polygons::of(edges, info.height))
    }

    fn of(edges: Vec<Edge>, height: u32) -> Polygons {
        let rows_a_strip = height.div_ceil(STRIPS).max(1);
        let mut strips = vec![Vec::new(); height.div_ceil(rows_a_strip) as usize];
        let last = f64::from(height);
        for (number, edge) in edges.iter().enumerate() {
            // A side counts for the rows beside it, too.
            if edge.to[1] < -1.0 || edge.from[1] > last {
                continue;
            }
            let strip = |row: f64| (row.clamp(0.0, last - 1.0) as u32 / rows_a_strip) as usize;
            let (first, end) = (strip(edge.from[1] - 1.0), strip(edge.to[1] + 1.0));
            for strip in &mut strips[first..=end] {
                strip.push(number as u32);
            }
        }
        Polygons {
            edges,
            strips,
            rows_a_strip,
        }
    }

    /// Marks the samples of cells that the polygons touch, and those that only cells wholly inside
    /// touch.
    pub(super) fn mark(&self, first_row: u32, width: u32, marks: Marks<'_>) {
        let rows = marks.touched.chunks_exact_mut(width as usize);
        let rows = rows.zip(marks.core.chunks_exact_mut(width as usize));
        let mut border = vec![false; width as usize];
        for (row, (touched, core)) in (first_row..).zip(rows) {
            let strip = &self.strips[(row / self.rows_a_strip) as usize];
            let row = f64::from(row);
            let near = strip.iter().map(|&edge| &self.edges[edge as usize]);
            let near: Vec<&Edge> = near
                .filter(|edge| edge.to[1] >= row - 1.0 && edge.from[1] <= row + 1.0)
                .collect();
            for polygon in near.chunk_by(|a, b| a.polygon == b.polygon) {
                border.fill(false);
                for edge in polygon {
                    mark_border(edge, row, &mut border);
                }
                mark_inside(polygon, row, touched, core, &border);
            }
        }
    }
}

/// Marks the corners, in a row, of the cells above and below it that a side passes through.
fn mark_border(edge: &Edge, row: f64, border: &mut [bool]) {
    for [top, bottom] in [[row - 1.0, row], [row, row + 1.0]] {
        let (from, to) = (edge.from[1].max(top), edge.to[1].min(bottom));
        if from > to {
            continue;
        }
        let ends = [column_at(edge, from), column_at(edge, to)];
        // A level side has all its columns in one row.
        let ends = match edge.from[1] == edge.to[1] {
            true => [edge.from[0], edge.to[0]],
            false => ends,
        };
        let (low, high) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
        fill(
            border,
            (low - EDGE_SLACK).floor(),
            (high + EDGE_SLACK).ceil(),
        );
    }
}

/// Columns by which a computed place on a side may be off.
const EDGE_SLACK: f64 = 1e-6;

/// Marks the samples of a row inside a polygon, by the even-odd rule, and on its border.
fn mark_inside(
    polygon: &[&Edge],
    row: f64,
    touched: &mut [bool],
    core: &mut [bool],
    border: &[bool],
) {
    let crossed = polygon.iter().filter(|e| e.from[1] <= row && row < e.to[1]);
    let mut columns: Vec<f64> = crossed.map(|edge| column_at(edge, row)).collect();
    columns.sort_unstable_by(f64::total_cmp);
    let mut inside = vec![false; touched.len()];
    for pair in columns.chunks_exact(2) {
        fill(&mut inside, pair[0].ceil(), pair[1].floor());
    }
    for (at, inside) in inside.into_iter().enumerate() {
        touched[at] |= inside || border[at];
        core[at] |= inside && !border[at];
    }
}

fn fill(marks: &mut [bool], low: f64, high: f64) {
    let last = marks.len() as f64 - 1.0;
    if low <= last && high >= 0.0 && low <= high {
        marks[low.max(0.0) as usize..=high.min(last) as usize].fill(true);
    }
}

fn column_at(edge: &Edge, row: f64) -> f64 {
    let [x, y] = edge.from;
    let (dx, dy) = (edge.to[0] - x, edge.to[1] - y);
    if dy == 0.0 {
        x
    } else {
        x + dx * ((row - y) / dy)
    }
}

fn collect(json: Json, depth: usize, out: &mut Vec<Polygon>) -> Result<(), String> {
    if depth > MAX_DEPTH {
        return Err(format!("geometries in geometries, {depth} deep"));
    }
    match json {
        Json::FeatureCollection { features: parts }
        | Json::GeometryCollection { geometries: parts } => parts
            .into_iter()
            .try_for_each(|part| collect(part, depth + 1, out)),
        Json::Feature { geometry } => match geometry {
            Some(geometry) => collect(*geometry, depth + 1, out),
            None => Ok(()),
        },
        Json::Polygon { coordinates } => {
            out.push(coordinates);
            Ok(())
        }
        Json::MultiPolygon { coordinates } => {
            out.extend(coordinates);
            Ok(())
        }
        Json::Other => Err("a geometry that is no polygon".into()),
    }
}

/// The sides of all polygons, in columns and rows of the source.
fn edges(polygons: &[Polygon], info: &DemInfo) -> Result<Vec<Edge>, String> {
    let place = &info.placement;
    let mut edges = Vec::new();
    for (number, polygon) in polygons.iter().enumerate() {
        for ring in polygon {
            let corners: Vec<[f64; 2]> = ring
                .iter()
                .map(|position| {
                    let corner = match position[..] {
                        [x, y, ..] => [(x - place.x0) / place.dx, (place.y0 - y) / place.dy],
                        _ => [f64::NAN; 2],
                    };
                    let is_near = corner.iter().all(|at| at.abs() <= FARTHEST);
                    is_near.then_some(corner).ok_or_else(|| {
                        let start = &position[..position.len().min(4)];
                        format!("polygon {number}: a position {start:?}")
                    })
                })
                .collect::<Result<_, _>>()?;
            if corners.len() < 4 || corners.first() != corners.last() {
                return Err(format!("polygon {number}: a ring that is not closed"));
            }
            if edges.len() + corners.len() > MAX_EDGES {
                return Err(format!("more than {MAX_EDGES} sides"));
            }
            edges.extend(corners.windows(2).map(|pair| {
                let (a, b) = (pair[0], pair[1]);
                let (from, to) = if a[1] <= b[1] { (a, b) } else { (b, a) };
                Edge {
                    polygon: number as u32,
                    from,
                    to,
                }
            }));
        }
    }
    match edges.is_empty() {
        true => Err("it has no polygon".into()),
        false => Ok(edges),
    }
}
