//! Which turn of the circle longitudes are on: 0..360 or -180..180, and tiles on both sides of
//! the date line.

/// A longitude in -180..180, degrees.
pub fn wrapped(longitude: f64) -> f64 {
    let turned = (longitude + 180.0).rem_euclid(360.0) - 180.0;
    // Adding and taking away may cost a digit; what is inside already stays as it is.
    if (-180.0..180.0).contains(&longitude) {
        longitude
    } else {
        turned
    }
}

/// A longitude moved by whole turns to lie at `west` or up to 360 degrees east of it.
pub fn from_west(longitude: f64, west: f64) -> f64 {
    let turns = ((west - longitude) / 360.0).ceil();
    longitude + turns * 360.0
}

/// Whole turns, in degrees, by which intervals of longitude must be moved to lie in one window as
/// narrow as can be, whose middle is above -180 and at most 180. The window is cut at the widest gap.
pub fn window(intervals: &[[f64; 2]]) -> Vec<f64> {
    let mut wests: Vec<f64> = intervals.iter().map(|[west, _]| wrapped(*west)).collect();
    wests.sort_by(f64::total_cmp);
    wests.dedup();
    let span = |start: f64| {
        let ends = intervals
            .iter()
            .map(|[west, east]| from_west(wrapped(*west), start) + (east - west));
        ends.fold(start, f64::max) - start
    };
    let best = wests
        .iter()
        .copied()
        .min_by(|a, b| span(*a).total_cmp(&span(*b)));
    let Some(start) = best else {
        return Vec::new();
    };
    let middle = start + span(start) / 2.0;
    let start = start - wrapped(-middle) - middle;
    intervals
        .iter()
        .map(|[west, _]| {
            let turns = ((start - west) / 360.0 - 1e-9).ceil();
            turns * 360.0
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn longitudes_are_told_in_one_turn() {
        assert_eq!(wrapped(190.0), -170.0);
        assert_eq!(wrapped(-180.0), -180.0);
        assert_eq!(wrapped(180.0), -180.0);
        assert_eq!(wrapped(86.925_001), 86.925_001);
        assert_eq!(from_west(-170.0, 20.0), 190.0);
        assert_eq!(from_west(380.0, 20.0), 20.0);
    }

    #[test]
    fn tiles_on_both_sides_of_the_date_line_are_neighbours() {
        assert_eq!(window(&[[179.0, 180.0], [-180.0, -179.0]]), [0.0, 360.0]);
        assert_eq!(window(&[[-180.0, -179.0], [179.0, 180.0]]), [360.0, 0.0]);
        assert_eq!(window(&[[170.0, 190.0], [-170.0, -160.0]]), [-360.0, 0.0]);
    }

    #[test]
    fn tiles_elsewhere_and_whole_worlds_stay() {
        assert_eq!(window(&[[-115.0, -114.0], [-125.0, -124.0]]), [0.0, 0.0]);
        assert_eq!(window(&[[-180.0, 180.0]]), [0.0]);
        assert_eq!(window(&[[0.0, 360.0]]), [0.0]);
        assert_eq!(window(&[[0.0, 64.0], [-64.0, 0.0]]), [0.0, 0.0]);
        assert_eq!(window(&[]), Vec::<f64>::new());
    }

    #[test]
    fn longitudes_from_0_to_360_are_brought_to_the_usual_turn() {
        assert_eq!(window(&[[200.0, 210.0]]), [-360.0]);
        assert_eq!(window(&[[20.0, 380.0]]), [-360.0]);
    }
}
