//! The land: everything wide enough to be told by every eighth sample.
//!
//! Octaves of gradient noise shape it (K. Perlin, "Improving Noise", 2002), the largest folded into
//! ridges; gullies are carved into it. A gully octave blends waves whose crests run down the slope
//! of all octaves before it, so that small gullies join large ones (after F. Westin and C. John,
//! "Terrain Erosion", 2022, and R. Skovbo Johansen, "Phacelle noise", 2025).
//!
//! Lengths are samples, heights centimetres where samples are 10 m apart; other numbers have 16
//! fractional bits.

/// One, with 16 fractional bits.
pub(super) const ONE: i64 = 1 << 16;

/// Centimetres in a metre.
const M: i64 = 100;

/// Centimetres between samples.
const SPACING_CM: i64 = 1000;

/// The full turn of a circle, divided by its radius.
const TAU: i64 = 411_775;

/// How far the land is bent sideways per slope of [`BEND`], in samples.
const BEND_SAMPLES: i64 = 105;

const CONTINENT: Wave = Wave::new(19_000, 4, 2);
const PROVINCE: Wave = Wave::new(7_000, 2, 3);
const BEND: Wave = Wave::new(900, 2, 11);
const LAND: Wave = Wave::new(2300, 1, 1);
const FAULT: Wave = Wave::new(1300, 5, 70);
const FAULT_REACH: Wave = Wave::new(1500, 3, 71);
const RIDGES: Wave = Wave::new(1050, 0, 20);
const RIDGES_CM: i64 = 720 * M;
const CLIFF_CM: i64 = 150 * M;

/// Waves with their heights in centimetres.
const HILLS: [(Wave, i64); 2] = [
    (Wave::new(560, 1, 21), 600 * M),
    (Wave::new(270, 2, 22), 200 * M),
];
const GULLIES: [(Wave, i64); 3] = [
    (Wave::new(184, 3, 40), 122 * M),
    (Wave::new(82, 4, 41), 60 * M),
    (Wave::new(36, 5, 42), 27 * M),
];

/// The land at a place.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Land {
    /// Centimetres.
    pub(super) cm: i64,
    /// How much of the detail there is: 0 to [`ONE`].
    pub(super) rough: i64,
    /// How far across a fault line; the step is where this is zero.
    pub(super) fault: i64,
    /// How high the step is, in centimetres.
    pub(super) step_cm: i64,
}

/// The land at sample (`x` east, `y` south).
pub(super) fn land(seed: u64, x: i64, y: i64) -> Land {
    let here = Place { x, y, bend: (0, 0) };
    let bend = gradient_noise(seed, &BEND, here);
    let bent = Place {
        bend: (bend.dx * BEND_SAMPLES, bend.dy * BEND_SAMPLES),
        ..here
    };
    let continent = gradient_noise(seed, &CONTINENT, here).value;
    let province = gradient_noise(seed, &PROVINCE, here).value;
    let lie = gradient_noise(seed, &LAND, bent).value + (continent + province) / 3;
    let high = smooth_step(lie, -ONE / 4, ONE / 5);
    // Lowland keeps an eighth of every relief, so that plains roll too.
    let relief = ONE / 8 + mul(high, ONE * 7 / 8);
    let mut ground = Ground {
        cm: 620 * M + mul(high, 850 * M) + mul(continent, 250 * M) + mul(province, 150 * M),
        slope: (0, 0),
    };
    ground.add(
        ridge(gradient_noise(seed, &RIDGES, bent)),
        mul(RIDGES_CM, relief),
        &RIDGES,
    );
    for (wave, cm) in &HILLS {
        ground.add(gradient_noise(seed, wave, bent), mul(*cm, relief), wave);
    }
    for (wave, cm) in &GULLIES {
        ground.add(
            gullies(seed, wave, here, ground.contour()),
            mul(*cm, relief),
            wave,
        );
    }
    let steep = (ground.slope.0.abs() + ground.slope.1.abs()).min(ONE);
    let (fault, step_cm) = cliff(seed, here, bent, high, ground.slope);
    Land {
        cm: ground.cm,
        rough: mul(relief, ONE / 4 + steep * 3 / 4),
        fault,
        step_cm,
    }
}

/// What the octaves so far have made of a place.
struct Ground {
    cm: i64,
    /// Rise over run, east and south.
    slope: (i64, i64),
}

impl Ground {
    fn add(&mut self, field: Field, cm: i64, wave: &Wave) {
        let steepness = mul(cm, wave.per_cm);
        self.cm += mul(field.value, cm);
        self.slope.0 += mul(field.dx, steepness);
        self.slope.1 += mul(field.dy, steepness);
    }

    /// The direction along the slope's contour: of length one on slopes, fading out on flats.
    fn contour(&self) -> (i64, i64) {
        const FLAT: i64 = ONE * 9 / 100;
        let (sx, sy) = self.slope;
        let length = ((sx * sx + sy * sy + FLAT * FLAT) as u64).isqrt() as i64;
        let scale = (ONE << 16) / length;
        (mul(-sy, scale), mul(sx, scale))
    }
}

/// A step along a fault line in the lowland; in mountains it would look like a scratch. Gives how
/// far a place is across the line (the step is where this is zero), and how high the step is.
fn cliff(seed: u64, here: Place, bent: Place, high: i64, slope: (i64, i64)) -> (i64, i64) {
    if high == ONE {
        return (0, 0);
    }
    let reach = gradient_noise(seed, &FAULT_REACH, here).value;
    let reach = smooth_step(reach, -ONE / 8, ONE / 5);
    if reach == 0 {
        return (0, 0);
    }
    // Slopes notch the line where gullies cross it.
    let line = gradient_noise(seed, &FAULT, bent).value + (slope.0 + slope.1) / 20;
    (line, mul(mul(reach, ONE - high), CLIFF_CM))
}

/// A sample, and how far from it the land is looked up.
#[derive(Clone, Copy)]
struct Place {
    x: i64,
    y: i64,
    /// In samples.
    bend: (i64, i64),
}

/// A lattice of cells of `length` samples, turned so that no two lattices line up.
struct Wave {
    /// Rise over run of one centimetre a cell, 32 fractional bits.
    per_cm: i64,
    cos: i64,
    sin: i64,
    /// Cells a sample, 32 fractional bits.
    step: (i64, i64),
    salt: u64,
}

/// Where a place lies in a lattice: its cell, and how far into it.
struct Spot {
    cell: (i64, i64),
    inside: (i64, i64),
}

impl Wave {
    const fn new(length: i64, turn: usize, salt: u64) -> Self {
        // Angles with whole-number cosine, sine and hypotenuse.
        const TURNS: [(i64, i64, i64); 6] = [
            (4, 3, 5),
            (5, 12, 13),
            (15, 8, 17),
            (7, 24, 25),
            (20, 21, 29),
            (12, 35, 37),
        ];
        let (cos, sin, one) = TURNS[turn];
        Self {
            per_cm: (1 << 32) / (length * SPACING_CM),
            cos: (cos << 16) / one,
            sin: (sin << 16) / one,
            step: ((cos << 32) / (one * length), (sin << 32) / (one * length)),
            salt: salt.wrapping_mul(0x9E37_79B9_7F4A_7C15),
        }
    }

    fn spot(&self, place: Place) -> Spot {
        let ((a, b), (bx, by)) = (self.step, place.bend);
        let u = place
            .x
            .wrapping_mul(a)
            .wrapping_add(place.y.wrapping_mul(b));
        let v = place
            .y
            .wrapping_mul(a)
            .wrapping_sub(place.x.wrapping_mul(b));
        let (u, v) = (
            u.wrapping_add(mul(bx, a) + mul(by, b)),
            v.wrapping_add(mul(by, a) - mul(bx, b)),
        );
        let inside = |w: i64| i64::from(w as u32 >> 16);
        Spot {
            cell: (u >> 32, v >> 32),
            inside: (inside(u), inside(v)),
        }
    }

    fn to_lattice(&self, (x, y): (i64, i64)) -> (i64, i64) {
        (
            mul(x, self.cos) + mul(y, self.sin),
            mul(y, self.cos) - mul(x, self.sin),
        )
    }

    fn to_world(&self, (u, v): (i64, i64)) -> (i64, i64) {
        (
            mul(u, self.cos) - mul(v, self.sin),
            mul(u, self.sin) + mul(v, self.cos),
        )
    }
}

/// A value in -1..=1 and its slope a cell, east and south.
#[derive(Clone, Copy)]
struct Field {
    value: i64,
    dx: i64,
    dy: i64,
}

/// Gradient noise with its slope.
fn gradient_noise(seed: u64, wave: &Wave, place: Place) -> Field {
    let Spot {
        cell,
        inside: (u, v),
    } = wave.spot(place);
    let corner = |i: i64, j: i64| {
        let (gu, gv) = signed_pair(hash(seed ^ wave.salt, cell.0 + i, cell.1 + j));
        [
            gu * 2,
            gv * 2,
            mul(gu * 2, u - i * ONE) + mul(gv * 2, v - j * ONE),
        ]
    };
    let (nw, ne, sw, se) = (corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1));
    let (fu, fv) = (fade(u), fade(v));
    let blend = |k: usize| {
        let north = nw[k] + mul(fu, ne[k] - nw[k]);
        let south = sw[k] + mul(fu, se[k] - sw[k]);
        north + mul(fv, south - north)
    };
    let twist = nw[2] - ne[2] - sw[2] + se[2];
    let du = blend(0) + mul(fade_slope(u), ne[2] - nw[2] + mul(fv, twist));
    let dv = blend(1) + mul(fade_slope(v), sw[2] - nw[2] + mul(fu, twist));
    let (dx, dy) = wave.to_world((du, dv));
    Field {
        value: blend(2),
        dx,
        dy,
    }
}

/// Folds noise at its zero line into a rounded crest.
fn ridge(noise: Field) -> Field {
    const ROUND: i64 = ONE / 18;
    let fold = ((noise.value * noise.value + ROUND * ROUND) as u64).isqrt() as i64;
    let side = -2 * (noise.value << 16) / fold;
    Field {
        value: ONE - 2 * fold,
        dx: mul(side, noise.dx),
        dy: mul(side, noise.dy),
    }
}

/// Waves along `contour` (so that their crests run down the slope), blended from a point a cell.
fn gullies(seed: u64, wave: &Wave, place: Place, contour: (i64, i64)) -> Field {
    /// Square of the reach of a point, 1.2 cells: beyond it no cell but the nearest nine matters.
    const REACH_2: i64 = ONE * 144 / 100;
    let Spot {
        cell,
        inside: (u, v),
    } = wave.spot(place);
    let (cu, cv) = wave.to_lattice(contour);
    let (mut weights, mut cosines, mut sines) = (1, 0, 0);
    for j in -1..=1 {
        for i in -1..=1 {
            let (ju, jv) = signed_pair(hash(seed ^ wave.salt, cell.0 + i, cell.1 + j));
            let pu = u - i * ONE - ONE / 2 - ju / 2;
            let pv = v - j * ONE - ONE / 2 - jv / 2;
            let near = REACH_2 - mul(pu, pu) - mul(pv, pv);
            if near <= 0 {
                continue;
            }
            let weight = mul(mul(near, near), near);
            let phase = mul(pu, cu) + mul(pv, cv);
            weights += weight;
            cosines += mul(weight, sine(phase + ONE / 4));
            sines += mul(weight, sine(phase));
        }
    }
    // One division for both; the sums are no larger than the weights, so nothing overflows.
    let share = (1 << 44) / weights;
    let fall = -mul((sines * share) >> 28, TAU);
    let value = (cosines * share) >> 28;
    Field {
        value,
        dx: mul(fall, contour.0),
        dy: mul(fall, contour.1),
    }
}

/// Sine of `turn` full turns, within 0.1 %: a parabola, and a part of its square.
fn sine(turn: i64) -> i64 {
    let half = turn & 0x7fff;
    let arch = (16 * half * (0x8000 - half)) >> 16;
    let arch = arch + mul(mul(arch, arch) - arch, 14_745);
    if turn & 0x8000 == 0 { arch } else { -arch }
}

/// 6t^5 - 15t^4 + 10t^3.
fn fade(t: i64) -> i64 {
    mul(mul(mul(t, t), t), mul(t, 6 * t - 15 * ONE) + 10 * ONE)
}

/// Slope of [`fade`].
fn fade_slope(t: i64) -> i64 {
    let w = mul(t, t - ONE);
    30 * mul(w, w)
}

/// 0 up to `from`, 1 beyond `to`, smooth between.
pub(super) fn smooth_step(x: i64, from: i64, to: i64) -> i64 {
    let t = ((x - from) * ONE / (to - from)).clamp(0, ONE);
    mul(mul(t, t), 3 * ONE - 2 * t)
}

pub(super) fn mul(a: i64, b: i64) -> i64 {
    (a * b) >> 16
}

/// Two numbers in -1/2..1/2 from the high half of a hash.
fn signed_pair(hash: u64) -> (i64, i64) {
    (
        i64::from((hash >> 48) as i16),
        i64::from((hash >> 32) as i16),
    )
}

/// Mixes as splitmix64 does (G. Steele and others, 2014).
pub(super) fn hash(seed: u64, x: i64, y: i64) -> u64 {
    let x = (x as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let y = (y as u64).wrapping_mul(0xD1B5_4A32_D192_ED03);
    let h = seed ^ x ^ y;
    let h = (h ^ (h >> 32)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (h ^ (h >> 29)).wrapping_mul(0x94D0_49BB_1331_11EB)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sine_is_within_a_thousandth() {
        for turn in -70_000..70_000 {
            let exact = (turn as f64 / 65_536.0 * std::f64::consts::TAU).sin();
            assert!(
                (sine(turn) as f64 / 65_536.0 - exact).abs() < 1.2e-3,
                "{turn}"
            );
        }
    }

    #[test]
    fn slopes_agree_with_differences_of_values() {
        let wave = Wave::new(1000, 1, 5);
        for k in 0..200 {
            let at = |x| {
                gradient_noise(
                    9,
                    &wave,
                    Place {
                        x,
                        y: k * 37,
                        bend: (0, 0),
                    },
                )
            };
            let (west, here, east) = (at(k * 53 - 4), at(k * 53), at(k * 53 + 4));
            let difference = (east.value - west.value) * 1000 / 8;
            assert!(
                (difference - here.dx).abs() < ONE / 50,
                "{difference} {}",
                here.dx
            );
        }
    }
}
