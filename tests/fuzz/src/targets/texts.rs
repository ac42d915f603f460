//! What files and users say in words: coordinate systems, shapes, synthetic terrain.

use escarp_tiles::crs::{self, Projection, vertical, wkt};
use escarp_tiles::dem::{Crs, RawShape};
use escarp_tiles::synth::SynthSource;
use std::path::Path;

/// A definition of a coordinate system, in all spellings; a raw shape; a synthetic terrain.
pub fn text(data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    let known = [
        wkt::from_wkt(&text),
        crs::from_proj(&text),
        crs::from_user(&text),
    ];
    known.iter().flatten().for_each(system);
    vertical::from_wkt(&text);
    vertical::from_text(&text);
    if let Some(metres) = vertical::metres_of_wkt(&text) {
        assert!(metres.is_finite() && metres > 0.0);
    }
    let _ = text.parse::<RawShape>();
    let _ = SynthSource::parse(Path::new(&*text));
}

/// A system that was taken: it has a name, which is understood again, and transforms what it may.
fn system(crs: &Crs) {
    if let Ok(definition) = crs::definition(crs) {
        crs::from_user(&definition).expect("own definition");
    }
    let Ok(projection) = Projection::of(crs) else {
        return;
    };
    projection.axes_m();
    for latitude in [-90.0, -45.5, 0.0, 10.0, 89.0, 90.0] {
        projection.metres_a_degree(latitude);
        for longitude in [-180.0, -77.0, 0.0, 9.0, 179.9, 1e9] {
            let Some([x, y]) = projection.from_degrees(longitude, latitude) else {
                continue;
            };
            assert!(x.is_finite() && y.is_finite());
            if let Some(back) = projection.to_degrees(x, y) {
                assert!(back.iter().all(|v| v.is_finite()));
            }
        }
    }
    projection.to_degrees(1e300, -1e300);
}
