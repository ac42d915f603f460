//! The triangles of a square, from which of its vertices are enabled.

use super::place::PageSquare;
use super::squares::{At, PAGE_SQUARES, PLACES_OF};
use escarp_proto::geometry::Edge;

/// Which of a square's edge vertices are enabled, a bit each by [`Edge`], and above them of its
/// quadrants' centres, by [`Quadrant`](escarp_proto::geometry::Quadrant).
pub(super) type Mask = u8;

/// Corners of all triangles of a square, three each, counter-clockwise seen from above: at
/// `(x, y)` halves of its side from the south-west, `x + 3 y`.
struct Fan {
    corners: [u8; 24],
    used: u8,
}

const CENTRE: u8 = 4;

/// `x + 3 y` of an edge's middle, and of its two ends, counter-clockwise around the centre.
const fn along(edge: Edge) -> [u8; 3] {
    match edge {
        Edge::East => [5, 2, 8],
        Edge::North => [7, 8, 6],
        Edge::West => [3, 6, 0],
        Edge::South => [1, 0, 2],
    }
}

const fn fan(mask: Mask) -> Fan {
    let mut fan = Fan {
        corners: [0; 24],
        used: 0,
    };
    let mut i = 0;
    while i < 4 {
        let edge = Edge::ALL[i];
        let [middle, from, to] = along(edge);
        if mask & 1 << i == 0 {
            fan = with(fan, [CENTRE, from, to]);
        } else {
            let [first, last] = PageSquare::end_quadrants(edge);
            if mask & 16 << first as u8 == 0 {
                fan = with(fan, [CENTRE, from, middle]);
            }
            if mask & 16 << last as u8 == 0 {
                fan = with(fan, [CENTRE, middle, to]);
            }
        }
        i += 1;
    }
    fan
}

const fn with(mut fan: Fan, triangle: [u8; 3]) -> Fan {
    let mut i = 0;
    while i < 3 {
        fan.corners[fan.used as usize] = triangle[i];
        fan.used += 1;
        i += 1;
    }
    fan
}

static FANS: [Fan; 256] = {
    let mut fans = [const { fan(0) }; 256];
    let mut mask = 0;
    while mask < 256 {
        fans[mask] = fan(mask as Mask);
        mask += 1;
    }
    fans
};

/// Samples of a square's corners, edge vertices and centre, by `x + 3 y`.
static SAMPLES: [[u16; 16]; PAGE_SQUARES] = {
    let mut samples = [[0; 16]; PAGE_SQUARES];
    let mut at = 0;
    while at < PAGE_SQUARES {
        let mut i = 0;
        while i < 9 {
            samples[at][i] = PLACES_OF[at].square.sample(i % 3, i / 3) as u16;
            i += 1;
        }
        at += 1;
    }
    samples
};

/// Adds the triangles of a square.
pub(super) fn emit(indices: &mut Vec<u16>, at: At, mask: Mask) {
    let fan = &FANS[mask as usize];
    let samples = &SAMPLES[at];
    let corners = &fan.corners[..fan.used as usize];
    indices.extend(corners.iter().map(|&corner| samples[corner as usize % 16]));
}
