//! The formulas of one line: world coordinates, thresholds, errors, distances, normals.

use super::exact::Exact;
use super::placing::figure;
use super::setup::{Random, Worst};
use crate::stability::{Case, Outcome, Verdict};
use escarp_client::mesh::Vertex;
use escarp_proto::georef::{Georef, Plane, WorldBox};
use escarp_proto::page::Kind;
use escarp_proto::view::{FIELDS_OF_VIEW, View, error_m};

const TRIES: usize = 100_000;
/// Half a unit in the last place of 1: what one rounding may cost, relative.
const ROUNDING: f64 = f64::EPSILON / 2.0;

/// All cases.
pub fn cases() -> Vec<Case> {
    vec![
        world(),
        back(),
        order(),
        threshold(),
        metres(),
        half_diagonals(),
        distance(),
        nested(),
        normals(),
    ]
}

fn georef(random: &mut Random, origin_m: f64) -> Georef {
    Georef {
        origin_m: [0; 2].map(|_| random.within(-origin_m, origin_m)),
        sample_spacing_m: [0; 2].map(|_| random.decades(1e-9, 1e3)),
        quantum_m: random.decades(1e-9, 1e2),
        plane: Plane::Local,
    }
}

fn cell(random: &mut Random) -> u32 {
    random.decades(1.0, (1u64 << 28) as f64) as u32
}

/// One unit in the last place of the larger of two numbers.
fn unit_of(a: f64, b: f64) -> f64 {
    let largest = a.abs().max(b.abs()).max(f64::MIN_POSITIVE);
    largest.next_up() - largest
}

fn world() -> Case {
    Case::new(
        "world_x, world_y of a grid sample, against exact products",
        "off by at most 1.5 units in the last place of the larger of origin and offset: two roundings",
        || {
            let mut random = Random::new(31);
            let mut worst = Worst::default();
            let mut metres: f64 = 0.0;
            for _ in 0..TRIES {
                let origin = random.decades(1.0, 1e12);
                let georef = georef(&mut random, origin);
                let x = cell(&mut random);
                let exact = Exact::product(f64::from(x), georef.sample_spacing_m[0])
                    .plus(georef.origin_m[0]);
                let off = exact.plus(-georef.world_x(x)).near().abs();
                let offset = f64::from(x) * georef.sample_spacing_m[0];
                metres = metres.max(off);
                worst.add(off / unit_of(georef.origin_m[0], offset), ());
            }
            let measured = format!(
                "{:.3} units, {} m at coordinates up to 1e12 m; {} tries",
                worst.value,
                figure(metres),
                worst.count
            );
            Outcome::of(worst.value <= 1.5, measured)
        },
    )
}

fn back() -> Case {
    Case::new(
        "from a grid sample to the world and back",
        "the same sample, to what the last place of the coordinate is worth",
        || {
            let mut random = Random::new(37);
            let mut worst = Worst::default();
            for _ in 0..TRIES {
                let origin = random.decades(1.0, 1e12);
                let georef = georef(&mut random, origin);
                let (x, y) = (cell(&mut random), cell(&mut random));
                let [found, _] = georef.grid(georef.world_x(x), georef.world_y(y));
                let offset = f64::from(x) * georef.sample_spacing_m[0];
                let unit = unit_of(georef.origin_m[0], offset) / georef.sample_spacing_m[0];
                worst.add(
                    (found - f64::from(x)).abs() / unit.max(f64::from(x) * f64::EPSILON),
                    (),
                );
            }
            let measured = format!("off by at most {:.3} such units", worst.value);
            Outcome::of(worst.value <= 2.0, measured)
        },
    )
}

fn order() -> Case {
    Case::new(
        "order of columns, samples 1e-9 to 1000 m apart, at coordinates to 1e12 m",
        "world_x grows with the column",
        || {
            let mut random = Random::new(41);
            let (mut falls, mut stands, mut stands_m): (u32, u32, f64) = (0, 0, 0.0);
            for _ in 0..TRIES {
                let origin = random.decades(1.0, 1e12);
                let georef = georef(&mut random, origin);
                let x = cell(&mut random);
                let step = georef.world_x(x + 1) - georef.world_x(x);
                falls += u32::from(step < 0.0);
                if step == 0.0 {
                    stands += 1;
                    stands_m = stands_m.max(georef.sample_spacing_m[0]);
                }
            }
            let measured = format!("never falls ({falls}); stands still in {stands} of {TRIES}");
            let verdict = match falls {
                0 => Verdict::Bounded(format!(
                    "the last place of the coordinate: samples up to {} m apart coincide",
                    figure(stands_m)
                )),
                _ => Verdict::Fails("it falls".into()),
            };
            Outcome { measured, verdict }
        },
    )
}

/// `2^60 sin(a) / a` and `2^60 cos(a)` of an angle of at most 1.5 that is a single-precision
/// number, by their series, in integers.
fn series(angle: f64) -> (i128, i128) {
    const ONE: i128 = 1 << 60;
    let square = (angle * angle * ONE as f64) as i128;
    let (mut sin, mut cos) = (ONE, ONE);
    let (mut sin_term, mut cos_term) = (ONE, ONE);
    for k in 1..24i128 {
        cos_term = -((cos_term * square) >> 60) / ((2 * k - 1) * (2 * k));
        sin_term = -((sin_term * square) >> 60) / ((2 * k) * (2 * k + 1));
        cos += cos_term;
        sin += sin_term;
    }
    (sin, cos)
}

fn threshold() -> Case {
    Case::new(
        "px_per_slope and threshold, against the series of sine and cosine in integers of 60 bits",
        "off by at most 1e-14 of their value at every field of view",
        || {
            let [least, most] = FIELDS_OF_VIEW;
            let mut worst = Worst::default();
            let mut random = Random::new(43);
            for i in 0..20_000 {
                let fov_y = match i {
                    0 => least,
                    1 => most,
                    _ => random.decades(f64::from(least), f64::from(most)) as f32,
                }
                .clamp(least, most);
                let view = View {
                    eye_m: [0.0; 3],
                    direction: [0.0, 1.0, 0.0],
                    velocity_m_s: [0.0; 3],
                    fov_y,
                    viewport_px: [1280, 1024],
                    max_screen_error_px: 0.5,
                };
                let half = f64::from(fov_y) / 2.0;
                let (sin, cos) = series(half);
                let right = 512.0 * (cos as f64 / sin as f64) / half;
                let off = (view.px_per_slope() / right - 1.0).abs();
                let off = off.max((view.threshold() / (right * 2.0) - 1.0).abs());
                worst.add(off, fov_y);
            }
            let measured = format!(
                "{} of their value, at {:.3} radians",
                figure(worst.value),
                worst.at.unwrap_or(0.0)
            );
            Outcome::of(worst.value <= 1e-14, measured)
        },
    )
}

fn metres() -> Case {
    Case::new(
        "error_m: a bound in quanta as metres",
        "not below the exact product",
        || {
            let mut random = Random::new(47);
            let mut worst = Worst::default();
            for _ in 0..TRIES {
                let error = random.decades(1.0, f64::from(u32::MAX)) as u32;
                let quantum = random.decades(1e-9, 1e9);
                let found = error_m(error, Kind::Full, quantum, 0.0);
                let short = Exact::product(f64::from(error), quantum)
                    .plus(-found)
                    .near();
                worst.add(short.max(0.0) / found, ());
            }
            let measured = format!("short of it by at most {} of itself", figure(worst.value));
            match worst.value {
                0.0 => Outcome::of(true, measured),
                short if short <= ROUNDING => Outcome {
                    measured,
                    verdict: Verdict::Bounded(
                        "one rounding in double precision, 1.1e-16 of the bound".into(),
                    ),
                },
                _ => Outcome::of(false, measured),
            }
        },
    )
}

fn half_diagonals() -> Case {
    Case::new(
        "half_diagonal_m of a square, against exact squares",
        "not below half the diagonal, and at most 1e-15 of it above",
        || {
            let mut random = Random::new(53);
            let mut below = 0;
            let mut worst = Worst::default();
            for _ in 0..TRIES / 4 {
                let mut georef = georef(&mut random, 1.0);
                georef.sample_spacing_m = [0; 2].map(|_| random.decades(1e-9, 1e9));
                let cells = 1u32 << (random.share() * 29.0) as u32;
                let found = georef.half_diagonal_m(cells);
                let [dx, dy] = georef.sample_spacing_m;
                let sum = Exact::of(dx).squared().and(&Exact::of(dy).squared());
                let half = f64::from(cells) / 2.0;
                let right = sum.times(half).times(half);
                let above = Exact::of(found).squared().less(&right);
                below += u32::from(above.is_negative());
                worst.add(above.near() / right.near() / 2.0, ());
            }
            let measured = format!(
                "below in {below} cases; above by at most {} of itself",
                figure(worst.value)
            );
            Outcome::of(below == 0 && worst.value <= 2e-15, measured)
        },
    )
}

fn random_box(random: &mut Random) -> (WorldBox, [f64; 3]) {
    let scale = random.decades(1e-6, 1e12);
    let mut coordinate = || random.within(-scale, scale);
    let ends = [0; 3].map(|_| {
        let (a, b) = (coordinate(), coordinate());
        [a.min(b), a.max(b)]
    });
    let region = WorldBox {
        min: ends.map(|[from, _]| from),
        max: ends.map(|[_, to]| to),
    };
    (region, [coordinate(), coordinate(), coordinate()])
}

fn distance() -> Case {
    Case::new(
        "WorldBox::distance_m, against exact differences",
        "the exact difference, rounded once",
        || {
            let mut random = Random::new(59);
            let mut worst = Worst::default();
            for _ in 0..TRIES {
                let (region, point) = random_box(&mut random);
                let along = |axis: usize| {
                    let low = Exact::of(region.min[axis]).plus(-point[axis]).near();
                    let high = Exact::of(point[axis]).plus(-region.max[axis]).near();
                    low.max(high)
                };
                let right = along(0).max(along(1)).max(along(2)).max(0.0);
                let found = region.distance_m(point);
                worst.add((found - right).abs() / right.max(f64::MIN_POSITIVE), ());
            }
            let measured = format!("off by at most {} of itself", figure(worst.value));
            Outcome::of(worst.value <= ROUNDING * 2.0, measured)
        },
    )
}

fn nested() -> Case {
    Case::new(
        "distances of a box and of a smaller one inside",
        "the smaller one is never nearer: tests are nested to the last bit",
        || {
            let mut random = Random::new(61);
            let mut nearer = 0;
            for _ in 0..TRIES {
                let (outer, point) = random_box(&mut random);
                let shrink = |axis: usize, share: f64| {
                    let (min, max) = (outer.min[axis], outer.max[axis]);
                    (min + (max - min) * share).clamp(min, max)
                };
                let shares = [random.within(0.0, 0.5), random.within(0.5, 1.0)];
                let inner = WorldBox {
                    min: std::array::from_fn(|axis| shrink(axis, shares[0])),
                    max: std::array::from_fn(|axis| shrink(axis, shares[1])),
                };
                nearer += u32::from(inner.distance_m(point) < outer.distance_m(point));
            }
            Outcome::of(nearer == 0, format!("nearer in {nearer} of {TRIES}"))
        },
    )
}

/// The angle between a slope's normal and what the GPU unpacks from 16 bits a coordinate.
fn normal_error(east: f64, north: f64) -> f64 {
    let packed = Vertex::on_slope(0, east, north).normal;
    // Normalised as the graphics interface does, in single precision, and completed as the shader.
    let [x, y] = packed.map(|v| (f32::from(v) / f32::from(i16::MAX)).max(-1.0));
    let z = (1.0 - (x * x + y * y)).max(0.0).sqrt();
    let length = (east * east + north * north + 1.0).sqrt();
    let right = [-east / length, -north / length, 1.0 / length];
    let found = [x, y, z].map(f64::from);
    let cross = [
        right[1] * found[2] - right[2] * found[1],
        right[2] * found[0] - right[0] * found[2],
        right[0] * found[1] - right[1] * found[0],
    ];
    let sine = cross.iter().map(|v| v * v).sum::<f64>().sqrt();
    let cosine: f64 = (0..3).map(|i| right[i] * found[i]).sum();
    sine.atan2(cosine).to_degrees()
}

fn normals() -> Case {
    Case::new(
        "normals in 16 bits a coordinate, at slopes from 1e-12 to 1e12",
        "within 0.01 degrees up to a slope of 3, within half a degree at any; never a lost number",
        || {
            let mut random = Random::new(67);
            let (mut gentle, mut any): (Worst<f64>, Worst<f64>) = Default::default();
            for _ in 0..TRIES {
                let slope = random.decades(1e-12, 1e12);
                let turn = random.within(0.0, std::f64::consts::TAU);
                let off = normal_error(slope * turn.cos(), slope * turn.sin());
                any.add(off, slope);
                if slope <= 3.0 {
                    gentle.add(off, slope);
                }
            }
            let measured = format!(
                "{:.4} degrees up to a slope of 3; {:.3} at a slope of {:.0}",
                gentle.value,
                any.value,
                any.at.unwrap_or(0.0)
            );
            Outcome::of(gentle.value <= 0.01 && any.value <= 0.5, measured)
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_are_those_of_sine_and_cosine() {
        for angle in [0.0005, 0.5, 1.0, 1.5] {
            let (sin, cos) = series(angle);
            let one = (1u64 << 60) as f64;
            assert!((sin as f64 / one - angle.sin() / angle).abs() < 1e-15);
            assert!((cos as f64 / one - angle.cos()).abs() < 1e-15);
        }
    }
}
