//! Places along a polyline.

use super::{Frame, HeightError};

/// Vertices of a polyline.
pub const MAX_VERTICES: usize = 1_000;

/// How samples are spread along a polyline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Spread {
    /// So many, at equal distances, the two ends included.
    Samples(usize),
    /// So many metres apart from the beginning on, and the end.
    SpacingM(f64),
}

/// Places along a polyline, of which legs are straight in the dataset's plane.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Length of the polyline in the plane, metres.
    pub length_m: f64,
    /// Distance of each sample from the beginning, metres.
    pub distances_m: Vec<f64>,
    /// Its place, in columns and rows of the grid.
    pub grid: Vec<[f64; 2]>,
}

/// Spreads at most `most` samples along a polyline of grid places.
///
/// # Errors
/// [`HeightError::Usage`] if there are too few or too many vertices or samples.
pub fn along(
    frame: &Frame,
    vertices: &[[f64; 2]],
    spread: Spread,
    most: usize,
) -> Result<Profile, HeightError> {
    if !(2..=MAX_VERTICES).contains(&vertices.len()) {
        let found = format!("a polyline of {} vertices", vertices.len());
        return Err(HeightError::usage(found, format!("2 to {MAX_VERTICES}")));
    }
    let legs: Vec<f64> = vertices
        .windows(2)
        .map(|leg| frame.distance_m(leg[0], leg[1]))
        .collect();
    let length_m: f64 = legs.iter().sum();
    let distances_m = distances(length_m, spread, most)?;
    let mut grid = Vec::with_capacity(distances_m.len());
    let (mut leg, mut before) = (0, 0.0);
    for &distance in &distances_m {
        while leg + 1 < legs.len() && distance > before + legs[leg] {
            before += legs[leg];
            leg += 1;
        }
        let part = match legs[leg] {
            0.0 => 0.0,
            length => ((distance - before) / length).clamp(0.0, 1.0),
        };
        let (a, b) = (vertices[leg], vertices[leg + 1]);
        // Exact at both ends.
        grid.push([0, 1].map(|axis: usize| a[axis] * (1.0 - part) + b[axis] * part));
    }
    if let (Some(place), Some(end)) = (grid.last_mut(), vertices.last()) {
        *place = *end;
    }
    Ok(Profile {
        length_m,
        distances_m,
        grid,
    })
}

fn distances(length_m: f64, spread: Spread, most: usize) -> Result<Vec<f64>, HeightError> {
    match spread {
        Spread::Samples(samples) if (2..=most).contains(&samples) => {
            let last = (samples - 1) as f64;
            Ok((0..samples).map(|i| length_m * (i as f64 / last)).collect())
        }
        Spread::Samples(samples) => Err(HeightError::usage(
            format!("{samples} samples"),
            format!("2 to {most}"),
        )),
        Spread::SpacingM(metres) if metres > 0.0 && metres.is_finite() => {
            let steps = (length_m / metres).ceil();
            if steps + 1.0 > most as f64 {
                let found = format!("{} samples, {metres} m apart", steps + 1.0);
                let least = length_m / (most - 1) as f64;
                let allowed = format!("{most} samples, at least {least} m apart");
                return Err(HeightError::usage(found, allowed));
            }
            let mut all: Vec<f64> = (0..steps as usize).map(|i| i as f64 * metres).collect();
            all.push(length_m);
            Ok(all)
        }
        Spread::SpacingM(metres) => Err(HeightError::usage(
            format!("spacing={metres}"),
            "more than 0 metres",
        )),
    }
}
