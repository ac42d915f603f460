//! From coordinates of the target's CRS to columns and rows of the source, and back.

use crate::crs::Projection;
use crate::crs::longitude::from_west;
use crate::dem::{Crs, DemError, DemInfo, Placement};

/// Two CRSs, and the source's lattice.
pub(super) struct Mapping {
    source: Placement,
    /// Source and target; `None` where they are one CRS.
    projections: Option<[Projection; 2]>,
    source_is_geographic: bool,
    target_is_geographic: bool,
    /// Columns in a whole turn, where the source goes around its body.
    pub turn: Option<u32>,
}

impl Mapping {
    /// Within one CRS.
    pub fn same(info: &DemInfo) -> Mapping {
        let geographic = matches!(info.crs, Crs::Geographic { .. });
        Mapping {
            source: info.placement,
            projections: None,
            source_is_geographic: geographic,
            target_is_geographic: geographic,
            turn: turn(info),
        }
    }

    /// Into another CRS.
    ///
    /// # Errors
    /// [`DemError::Usage`] where one of them cannot be transformed, or is of another body.
    pub fn between(info: &DemInfo, target: &Crs) -> Result<Mapping, DemError> {
        let unusable = |whose: &str, why: String, hint: &str| {
            let what = format!("its CRS cannot be brought to {target}: {whose}: {why}");
            DemError::usage(&info.path, what, hint)
        };
        let state = "state its CRS with a .prj file, or by gdal_translate -a_srs";
        let source =
            Projection::of(&info.crs).map_err(|why| unusable("the source's", why, state))?;
        let other = Projection::of(target)
            .map_err(|why| unusable("the wanted one", why, "give another --crs"))?;
        if !source.is_on_the_body_of(&other) {
            let (a, b) = (source.axes_m()[0], other.axes_m()[0]);
            let why = format!("it is of a body with a radius of {b} m, the source's has {a} m");
            return Err(unusable(
                "the wanted one",
                why,
                "give a CRS of the same body",
            ));
        }
        Ok(Mapping {
            source: info.placement,
            source_is_geographic: source.is_geographic(),
            target_is_geographic: other.is_geographic(),
            turn: turn(info),
            projections: Some([source, other]),
        })
    }

    /// Column and row of the source, with fractions, of a place in the target's CRS.
    pub fn to_source(&self, point: [f64; 2]) -> Option<[f64; 2]> {
        let [x, y] = match &self.projections {
            Some([source, target]) => target.transform(source, point)?,
            None => point,
        };
        let Placement { x0, y0, dx, dy } = self.source;
        let row = snapped((y0 - y) / dy);
        if let Some(turn) = self.turn {
            // A turn is counted in columns: a step that is a rounded part of 360 degrees still
            // brings each sample back to itself.
            let (column, turn) = (snapped((x - x0) / dx), f64::from(turn));
            return Some([column - turn * ((column + 0.5) / turn).floor(), row]);
        }
        let x = match self.source_is_geographic {
            true => from_west(x, x0 - dx / 2.0),
            false => x,
        };
        Some([snapped((x - x0) / dx), row])
    }

    /// A place in the target's CRS of a column and row of the source. Longitudes are those of the
    /// turn that starts at `west`.
    pub fn to_target(&self, [column, row]: [f64; 2], west: f64) -> Option<[f64; 2]> {
        let Placement { x0, y0, dx, dy } = self.source;
        let point = [x0 + column * dx, y0 - row * dy];
        let [x, y] = match &self.projections {
            Some([source, target]) => source.transform(target, point)?,
            None => point,
        };
        match self.target_is_geographic {
            true => Some([from_west(x, west), y]),
            false => Some([x, y]),
        }
    }

    /// How far a place comes back from itself when it goes to the target and back, in cells.
    pub fn round_trip_cells(&self, place: [f64; 2]) -> Option<f64> {
        let there = self.to_target(place, -180.0)?;
        let back = self.to_source(there)?;
        let turn = self.turn.map_or(f64::INFINITY, f64::from);
        let east = (back[0] - place[0]).abs();
        let east = east.min((east - turn).abs());
        Some(east.max((back[1] - place[1]).abs()))
    }

    /// Whether both are one CRS.
    pub fn is_same(&self) -> bool {
        self.projections.is_none()
    }

    /// Metres of one unit of the source's coordinates, east and north, at a row.
    pub fn source_units_m(&self, crs: &Crs, row: f64) -> [f64; 2] {
        match (crs, &self.projections) {
            (
                Crs::Projected {
                    metres_per_unit, ..
                },
                _,
            ) => [*metres_per_unit; 2],
            (Crs::Geographic { .. }, Some([source, _])) => {
                source.metres_a_degree(self.source.y0 - row * self.source.dy)
            }
            (Crs::Geographic { radius_m, .. }, None) => [radius_m.to_radians(); 2],
            (Crs::Local, _) => [1.0; 2],
        }
    }
}

/// A place within a millionth of a cell of a sample is that sample.
fn snapped(cells: f64) -> f64 {
    let whole = cells.round();
    if (cells - whole).abs() < 1e-6 {
        whole
    } else {
        cells
    }
}

/// Columns in 360 degrees, if the source has them all.
fn turn(info: &DemInfo) -> Option<u32> {
    if !matches!(info.crs, Crs::Geographic { .. }) {
        return None;
    }
    let columns = 360.0 / info.placement.dx;
    let whole = columns.round();
    let fits = (columns - whole).abs() < 1e-3 && whole >= 2.0 && whole <= f64::from(info.width);
    fits.then_some(whole as u32)
}

/// Corners of a rectangle, north-west, north-east, south-west, south-east.
type Corners = [Option<[f64; 2]>; 4];

/// Values of a map at the whole places of a rectangle, row by row: exact at some, and between
/// them by two straight lines wherever that is right to `tolerance`, which is tested halfway.
/// `None` is left as NaN.
pub(super) fn fill_lattice(
    map: &(dyn Fn(f64, f64) -> Option<[f64; 2]> + Sync),
    [left, top]: [u32; 2],
    [columns, rows]: [usize; 2],
    tolerance: f64,
    out: &mut [[f64; 2]],
) {
    /// Cells on a side of the first rectangles.
    const STEP: usize = 32;
    let lattice = Lattice {
        map,
        origin: [f64::from(left), f64::from(top)],
        columns,
        tolerance,
    };
    for r in (0..rows).step_by(STEP) {
        for c in (0..columns).step_by(STEP) {
            // Neighbours share a side, so that each place is in some rectangle.
            let (right, bottom) = ((c + STEP).min(columns - 1), (r + STEP).min(rows - 1));
            let corners = [(c, r), (right, r), (c, bottom), (right, bottom)]
                .map(|(c, r)| lattice.at(c as f64, r as f64));
            lattice.fill([c, right], [r, bottom], corners, out);
        }
    }
}

struct Lattice<'a> {
    map: &'a (dyn Fn(f64, f64) -> Option<[f64; 2]> + Sync),
    origin: [f64; 2],
    columns: usize,
    tolerance: f64,
}

impl Lattice<'_> {
    fn at(&self, c: f64, r: f64) -> Option<[f64; 2]> {
        (self.map)(self.origin[0] + c, self.origin[1] + r)
    }

    /// Fills columns `c` and rows `r`, both ends included.
    fn fill(&self, c: [usize; 2], r: [usize; 2], corners: Corners, out: &mut [[f64; 2]]) {
        let (wide, high) = (c[1] - c[0], r[1] - r[0]);
        if wide <= 1 && high <= 1 {
            let places = [(c[0], r[0]), (c[1], r[0]), (c[0], r[1]), (c[1], r[1])];
            for ((c, r), value) in places.into_iter().zip(corners) {
                out[r * self.columns + c] = value.unwrap_or([f64::NAN; 2]);
            }
            return;
        }
        if let [Some(nw), Some(ne), Some(sw), Some(se)] = corners
            && self.is_straight(c, r, [nw, ne, sw, se])
        {
            for row in r[0]..=r[1] {
                let fy = part(row - r[0], high);
                let (west, east) = (mix(nw, sw, fy), mix(ne, se, fy));
                for column in c[0]..=c[1] {
                    out[row * self.columns + column] = mix(west, east, part(column - c[0], wide));
                }
            }
            return;
        }
        self.split(c, r, corners, out);
    }

    /// Halves the longer side.
    fn split(&self, c: [usize; 2], r: [usize; 2], corners: Corners, out: &mut [[f64; 2]]) {
        let [nw, ne, sw, se] = corners;
        if c[1] - c[0] >= r[1] - r[0] {
            let middle = usize::midpoint(c[0], c[1]);
            let [north, south] = r.map(|r| self.at(middle as f64, r as f64));
            self.fill([c[0], middle], r, [nw, north, sw, south], out);
            self.fill([middle, c[1]], r, [north, ne, south, se], out);
        } else {
            let middle = usize::midpoint(r[0], r[1]);
            let [west, east] = c.map(|c| self.at(c as f64, middle as f64));
            self.fill(c, [r[0], middle], [nw, ne, west, east], out);
            self.fill(c, [middle, r[1]], [west, east, sw, se], out);
        }
    }

    /// Whether straight lines are right halfway along each side and in the middle.
    fn is_straight(&self, c: [usize; 2], r: [usize; 2], [nw, ne, sw, se]: [[f64; 2]; 4]) -> bool {
        let tests = [(0.5, 0.0), (0.5, 1.0), (0.0, 0.5), (1.0, 0.5), (0.5, 0.5)];
        tests.into_iter().all(|(fx, fy)| {
            let expected = mix(mix(nw, sw, fy), mix(ne, se, fy), fx);
            let place = |ends: [usize; 2], f: f64| ends[0] as f64 + f * (ends[1] - ends[0]) as f64;
            let found = self.at(place(c, fx), place(r, fy));
            found.is_some_and(|found| {
                (0..2).all(|i| (found[i] - expected[i]).abs() <= self.tolerance)
            })
        })
    }
}

fn part(n: usize, of: usize) -> f64 {
    n as f64 / of.max(1) as f64
}

fn mix(a: [f64; 2], b: [f64; 2], f: f64) -> [f64; 2] {
    [a[0] + (b[0] - a[0]) * f, a[1] + (b[1] - a[1]) * f]
}
