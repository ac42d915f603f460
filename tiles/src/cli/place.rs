//! Where a dataset lies, and what bringing it there cost: lines of `build` and `info`.

use super::build::rounded_up;
use crate::crs::{extent, title};
use escarp_proto::georef::Plane;
use escarp_proto::manifest::Manifest;

/// Horizontal errors of scale above this, in per cent, are warned of.
const WARN_PERCENT: f64 = 2.0;

/// Lines about a dataset's place.
pub(super) fn print(manifest: &Manifest) {
    if let Some(extent) = extent::of(manifest) {
        let [west, south] = extent.south_west;
        let [east, north] = extent.north_east;
        let [longitude, latitude] = extent.centre;
        let longitudes = match goes_around(manifest) {
            true => "all longitudes".to_owned(),
            false => format!("longitude {west:.6} .. {east:.6}"),
        };
        println!(
            "place       {longitudes}, latitude {south:.6} .. {north:.6} (south-west \
             to north-east corner); middle {longitude:.6}, {latitude:.6}"
        );
    }
    if let Some(percent) = manifest.scale_error_percent {
        println!(
            "scale       horizontal distances are wrong by at most {} %",
            shown_percent(percent)
        );
    }
    if let Some(vertical) = &manifest.vertical {
        println!("vertical    {vertical}");
    }
    if let Some(resampling) = &manifest.resampling {
        println!(
            "resampled   from {} ({}); {} source samples differ from the surface by at most {} m, {:.3} m \
             root mean square; {} lie beside its holes and borders; places right to {} m",
            title(&resampling.from_crs),
            resampling.interpolation,
            resampling.compared,
            rounded_up(resampling.largest_difference_m),
            resampling.rms_difference_m,
            resampling.uncovered,
            rounded_up(resampling.horizontal_error_m),
        );
    }
}

/// Whether geographic data comes back to its first column, or nearly.
fn goes_around(manifest: &Manifest) -> bool {
    let degrees = extent::placement_of(manifest).dx * f64::from(manifest.samples[0]);
    matches!(manifest.georef.plane, Plane::Geographic { .. }) && degrees > 359.99
}

/// What a user should know who did not ask, with what to do.
pub(super) fn warn(manifest: &Manifest) {
    let Some(percent) = manifest.scale_error_percent.filter(|p| *p > WARN_PERCENT) else {
        return;
    };
    let how = match &manifest.georef.plane {
        Plane::Geographic { .. } => "east to west at its northern or southern border",
        _ => "in its projection",
    };
    let advice = match extent::suggestion(manifest) {
        Some(crs) => format!("where distances matter, build with --crs '{crs}', or in parts"),
        None => "where distances matter, build it in parts, with --crs and --bounds".into(),
    };
    eprintln!(
        "warning: horizontal distances are up to {} % wrong {how}; {advice}",
        shown_percent(percent)
    );
}

/// Three digits, rounded up.
fn shown_percent(percent: f64) -> String {
    let digits = if percent >= 100.0 { 0 } else { 2 };
    let scale = 10f64.powi(digits);
    format!("{:.*}", digits as usize, (percent * scale).ceil() / scale)
}
