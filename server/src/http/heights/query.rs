//! What stands in an address after `?`: every word is known, or refused.

use crate::heights::{CoordinateKind, Curvature, Detail, Frame, GridPlace, HeightError, Spread};
use escarp_proto::view::FARTHEST_EYE_M;
use std::collections::BTreeMap;
use std::str::FromStr;

/// Observers and targets are no higher or lower, metres: beyond, everything is in sight or nothing.
const MOST_ABOVE_GROUND_M: f64 = 1e7;
/// Height of an observer's eye above the ground unless told otherwise, metres.
const EYE_M: f64 = 2.0;

/// Bent light, unless told otherwise.
const REFRACTION: f64 = 0.13;

/// Names and values.
#[derive(Debug)]
pub(crate) struct Query(BTreeMap<String, String>);

impl Query {
    /// Reads an address's query; each name at most once, and of those that are known.
    pub(crate) fn parse(query: Option<String>, known: &[&str]) -> Result<Query, HeightError> {
        let mut values = BTreeMap::new();
        let query = query.unwrap_or_default();
        for (name, value) in form_urlencoded::parse(query.as_bytes()) {
            if !known.contains(&name.as_ref()) {
                let found = format!("unknown parameter `{}`", shortened(&name));
                return Err(HeightError::usage(found, known.join(", ")));
            }
            if values
                .insert(name.to_string(), value.into_owned())
                .is_some()
            {
                let found = format!("parameter `{name}` twice");
                return Err(HeightError::usage(found, "once"));
            }
        }
        Ok(Query(values))
    }

    fn parsed<T: FromStr>(&self, name: &str, allowed: &str) -> Result<Option<T>, HeightError> {
        let Some(value) = self.0.get(name) else {
            return Ok(None);
        };
        value.trim().parse().map(Some).map_err(|_| {
            let found = format!("{name}={}", shortened(value));
            HeightError::usage(found, allowed)
        })
    }

    /// How far observer and target are above the ground, metres, and how light goes between them.
    pub(super) fn sighting(&self) -> Result<([f64; 2], Curvature), HeightError> {
        let above_ground_m = [
            self.above_ground("observer_height", EYE_M)?,
            self.above_ground("target_height", 0.0)?,
        ];
        Ok((above_ground_m, self.curvature()?))
    }

    /// A height above the ground, metres.
    fn above_ground(&self, name: &str, usual: f64) -> Result<f64, HeightError> {
        let height_m = self.number(name)?.unwrap_or(usual);
        match height_m.abs() <= MOST_ABOVE_GROUND_M {
            true => Ok(height_m),
            false => Err(HeightError::usage(
                format!("{name}={height_m}"),
                format!("at most {MOST_ABOVE_GROUND_M} metres above or below the ground"),
            )),
        }
    }

    /// A finite number.
    pub(super) fn number(&self, name: &str) -> Result<Option<f64>, HeightError> {
        let number = self.parsed(name, "a number")?;
        match number.filter(|number: &f64| !number.is_finite()) {
            None => Ok(number),
            Some(number) => Err(HeightError::usage(format!("{name}={number}"), "a number")),
        }
    }

    pub(super) fn needed(&self, name: &str) -> Result<f64, HeightError> {
        let number = self.number(name)?;
        number.ok_or_else(|| HeightError::usage(format!("no `{name}`"), format!("{name}=NUMBER")))
    }

    pub(crate) fn whole(&self, name: &str) -> Result<Option<u32>, HeightError> {
        self.parsed(name, "a whole number")
    }

    /// `x,y`.
    pub(super) fn pair(&self, name: &str) -> Result<[f64; 2], HeightError> {
        let value = self.0.get(name).map(String::as_str);
        value.and_then(pair).ok_or_else(|| {
            let found = match value {
                Some(value) => format!("{name}={}", shortened(value)),
                None => format!("no `{name}`"),
            };
            HeightError::usage(found, format!("{name}=X,Y"))
        })
    }

    /// `x,y;x,y;...`
    pub(super) fn polyline(&self) -> Result<Vec<[f64; 2]>, HeightError> {
        let wrong = |found: String| HeightError::usage(found, "points=X,Y;X,Y;...");
        let value = self
            .0
            .get("points")
            .ok_or_else(|| wrong("no `points`".into()))?;
        let one = |text: &str| {
            pair(text).ok_or_else(|| wrong(format!("`{}` in points=", shortened(text))))
        };
        value.split(';').map(one).collect()
    }

    /// `x=` and `y=`, or `lon=` and `lat=`.
    pub(super) fn point(&self) -> Result<(CoordinateKind, [f64; 2]), HeightError> {
        let native = [self.number("x")?, self.number("y")?];
        let degrees = [self.number("lon")?, self.number("lat")?];
        match (native, degrees) {
            ([Some(x), Some(y)], [None, None]) => Ok((CoordinateKind::Native, [x, y])),
            ([None, None], [Some(lon), Some(lat)]) => Ok((CoordinateKind::LonLat, [lon, lat])),
            _ => {
                let names: Vec<&str> = ["x", "y", "lon", "lat"]
                    .into_iter()
                    .filter(|name| self.0.contains_key(*name))
                    .collect();
                let found = format!("a point by {names:?}");
                Err(HeightError::usage(found, "x= and y=, or lon= and lat="))
            }
        }
    }

    pub(super) fn kind(&self) -> Result<CoordinateKind, HeightError> {
        match self.0.get("crs").map(String::as_str) {
            None | Some("native") => Ok(CoordinateKind::Native),
            Some("lonlat") => Ok(CoordinateKind::LonLat),
            Some(other) => {
                let found = format!("crs={}", shortened(other));
                Err(HeightError::usage(found, "crs=native or crs=lonlat"))
            }
        }
    }

    pub(super) fn detail(&self) -> Result<Detail, HeightError> {
        Detail::from(self.number("error")?, self.number("resolution")?)
    }

    pub(super) fn spread(&self, samples: usize) -> Result<Spread, HeightError> {
        let given: Option<usize> = self.parsed("samples", "a whole number")?;
        match (given, self.number("spacing")?) {
            (given, None) => Ok(Spread::Samples(given.unwrap_or(samples))),
            (None, Some(metres)) => Ok(Spread::SpacingM(metres)),
            (Some(_), Some(_)) => Err(HeightError::usage(
                "both samples= and spacing=",
                "one of the two",
            )),
        }
    }

    fn curvature(&self) -> Result<Curvature, HeightError> {
        let refraction = self.number("refraction")?;
        match (self.0.get("curvature").map(String::as_str), refraction) {
            (None | Some("off"), None) => Ok(Curvature::Flat),
            (Some("on"), refraction) => Ok(Curvature::Round {
                refraction: refraction.unwrap_or(REFRACTION),
            }),
            (None | Some("off"), Some(_)) => Err(HeightError::usage(
                "refraction= without curvature",
                "curvature=on",
            )),
            (Some(other), _) => Err(HeightError::usage(
                format!("curvature={}", shortened(other)),
                "curvature=on or curvature=off",
            )),
        }
    }
}

/// Quoted in an error, and so cut.
fn shortened(text: &str) -> String {
    text.chars().take(60).collect()
}

fn pair(text: &str) -> Option<[f64; 2]> {
    let (x, y) = text.split_once(',')?;
    let pair: [f64; 2] = [x.trim().parse().ok()?, y.trim().parse().ok()?];
    pair.iter()
        .all(|v| v.abs() <= FARTHEST_EYE_M)
        .then_some(pair)
}

/// A place that must be within the data.
pub(super) fn inside(frame: &Frame, point: [f64; 2]) -> Result<GridPlace, HeightError> {
    let place = frame.grid(point).and_then(|grid| frame.within(grid));
    place.ok_or_else(|| {
        let found = format!("{point:?} lies outside of the data");
        HeightError::usage(found, "a point within the dataset's extent")
    })
}

/// Polylines may leave the data, but not the plane.
pub(super) fn all_on_the_plane(
    frame: &Frame,
    points: &[[f64; 2]],
) -> Result<Vec<[f64; 2]>, HeightError> {
    let on_plane = |point: &[f64; 2]| {
        frame.grid(*point).ok_or_else(|| {
            let found = format!("{point:?} has no place in the dataset's projection");
            HeightError::usage(found, "points near the dataset")
        })
    };
    points.iter().map(on_plane).collect()
}

pub(super) fn no_ground(who: &str, points: &[[f64; 2]]) -> HeightError {
    let found = format!("there is no data at the {who}: {points:?}");
    HeightError::usage(found, "points with data")
}
