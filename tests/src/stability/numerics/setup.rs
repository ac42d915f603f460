//! An eye, a vertex, and where it comes out on the screen: as the GPU computes it, and exactly.

use super::exact::Exact;
use crate::terrain::hash;
use escarp_client::render::EyeFrame;
use escarp_proto::georef::{Georef, Plane};
use escarp_proto::view::View;

/// Where a vertex is from the eye, metres: `place()` of `common.wgsl` in single precision.
pub fn place(frame: &EyeFrame, [x, y]: [u32; 2], height: i32) -> [f32; 3] {
    let [dx, dy] = frame.relative([x, y]);
    let above = height - frame.height;
    let steps = [dx as f32, dy as f32, above as f32];
    let (spacing, remainder) = (frame.spacing_m.to_array(), frame.remainder_m.to_array());
    std::array::from_fn(|axis| steps[axis] * spacing[axis] - remainder[axis])
}

/// `clip_from_eye * vec4(from_eye, 1)` in single precision, column by column.
pub fn clip(frame: &EyeFrame, from_eye: [f32; 3]) -> [f32; 4] {
    let m = frame.clip_from_eye().to_cols_array_2d();
    let [x, y, z] = from_eye;
    std::array::from_fn(|row| m[0][row] * x + m[1][row] * y + m[2][row] * z + m[3][row])
}

/// An eye and a vertex.
#[derive(Debug, Clone)]
pub struct Setup {
    /// The view.
    pub view: View,
    /// The grid.
    pub georef: Georef,
    /// Grid column and row of the vertex.
    pub vertex: [u32; 2],
    /// Its height, quanta.
    pub height: i32,
}

impl Setup {
    /// The frame of its eye, heights as they are.
    pub fn frame(&self) -> EyeFrame {
        EyeFrame::of(&self.view, &self.georef, 1.0)
    }

    /// The vertex from the eye, metres, rounded once from exact numbers.
    pub fn from_eye(&self) -> [f64; 3] {
        let georef = &self.georef;
        let world = |axis: usize| match axis {
            2 => Exact::product(f64::from(self.height), georef.quantum_m),
            _ => Exact::product(f64::from(self.vertex[axis]), georef.sample_spacing_m[axis])
                .plus(georef.origin_m[axis]),
        };
        std::array::from_fn(|axis| world(axis).plus(-self.view.eye_m[axis]).near())
    }

    /// Where it is on the screen, pixels from the middle, and its depth along the line of sight in
    /// metres: from exact numbers, then in double precision, in which nothing cancels any more.
    pub fn exactly(&self) -> [f64; 3] {
        self.on_screen(self.from_eye())
    }

    /// A place from the eye on the screen, in double precision.
    pub fn on_screen(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let frame = self.frame();
        let along = |axis: [f64; 3]| axis[0] * x + axis[1] * y + axis[2] * z;
        let ahead = along(frame.forward.to_array());
        let px = self.view.px_per_slope() / ahead;
        [
            along(frame.right.to_array()) * px,
            along(frame.up.to_array()) * px,
            ahead,
        ]
    }

    /// Where the GPU has it: single precision up to the division.
    pub fn as_drawn(&self) -> [f64; 3] {
        let frame = self.frame();
        let [x, y, _, w] = clip(&frame, place(&frame, self.vertex, self.height)).map(f64::from);
        let [width, height] = self.view.viewport_px.map(|px| f64::from(px) / 2.0);
        [x / w * width, y / w * height, w]
    }

    /// Whether the vertex is in the picture and not nearer than anything is drawn.
    pub fn is_seen(&self) -> bool {
        let [x, y, ahead] = self.exactly();
        let [width, height] = self.view.viewport_px.map(|px| f64::from(px) / 2.0);
        ahead >= self.near_m() && x.abs() <= width && y.abs() <= height
    }

    /// Nearest that anything is drawn, metres, as the projection says it.
    pub fn near_m(&self) -> f64 {
        f64::from(self.frame().clip_from_eye().to_cols_array()[14])
    }

    /// How far the drawn vertex is from where it should be, pixels.
    pub fn error_px(&self) -> f64 {
        let (found, right) = (self.as_drawn(), self.exactly());
        (found[0] - right[0]).hypot(found[1] - right[1])
    }

    /// For people.
    pub fn describe(&self) -> String {
        let [dx, dy] = self.georef.sample_spacing_m;
        let [x, y, z] = self.from_eye();
        let apart = x.abs().max(y.abs()).max(z.abs());
        format!("a vertex {apart:.2e} m away, samples {dx:.1e} x {dy:.1e} m apart")
    }
}

/// Numbers that look random, each from the ones before.
pub struct Random(u32, u32);

impl Random {
    /// A sequence of its own for each seed.
    pub const fn new(seed: u32) -> Random {
        Random(seed, 0)
    }

    /// 0 to 1, in steps of 2^-53 and with all of them.
    pub fn share(&mut self) -> f64 {
        self.1 = self.1.wrapping_add(2);
        let high = u64::from(hash(self.1, self.0));
        let low = u64::from(hash(self.1 + 1, self.0 ^ 0x5bd1_e995));
        ((high << 32 | low) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Between the two.
    pub fn within(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.share()
    }

    /// Between the two, every decade as often.
    pub fn decades(&mut self, from: f64, to: f64) -> f64 {
        from * (to / from).powf(self.share())
    }

    /// A unit vector, every direction as often.
    pub fn direction(&mut self) -> [f64; 3] {
        let z = self.within(-1.0, 1.0);
        let turn = self.within(0.0, std::f64::consts::TAU);
        let level = (1.0 - z * z).sqrt();
        [turn.cos() * level, turn.sin() * level, z]
    }
}

/// Ranges that setups are drawn from.
#[derive(Debug, Clone, Copy)]
pub struct Ranges {
    /// Field of view, radians.
    pub fov_y: f32,
    /// Pixels.
    pub viewport_px: [u32; 2],
    /// Metres between samples.
    pub spacing_m: [f64; 2],
    /// Metres from eye to vertex.
    pub distance_m: [f64; 2],
    /// The grid's origin is at most so far out, metres.
    pub origin_m: f64,
    /// Samples a side.
    pub cells: f64,
}

impl Ranges {
    /// A setup whose vertex is in the picture; `None` if chance put it outside.
    pub fn setup(&self, random: &mut Random) -> Option<Setup> {
        let spacing = random.decades(self.spacing_m[0], self.spacing_m[1]);
        let georef = Georef {
            origin_m: [0; 2].map(|_| random.within(-self.origin_m, self.origin_m)),
            sample_spacing_m: [spacing, spacing * random.decades(0.5, 2.0)],
            quantum_m: random.decades(1e-4, 1.0),
            plane: Plane::Local,
        };
        let vertex = [0; 2].map(|_| (random.share() * random.share() * self.cells) as u32);
        let height = (random.within(-1.0, 1.0) * 9000.0 / georef.quantum_m) as i32;
        let [least, most] = self.distance_m;
        let distance = random.decades(least, most);
        let way = random.direction();
        let world = georef.world(vertex[0], vertex[1], height);
        let eye_m = std::array::from_fn(|axis| world[axis] - way[axis] * distance);
        let spread = (f64::from(self.fov_y) / 2.0).tan().min(1.0);
        let aside = random.direction().map(|v| v * spread * 1.2);
        let view = View {
            eye_m,
            direction: std::array::from_fn(|axis| (way[axis] + aside[axis]) as f32),
            velocity_m_s: [0.0; 3],
            fov_y: self.fov_y,
            viewport_px: self.viewport_px,
            max_screen_error_px: 1.0,
        };
        let setup = Setup {
            view,
            georef,
            vertex,
            height,
        };
        (view.check().is_ok() && setup.is_seen()).then_some(setup)
    }

    /// So many setups with the vertex in the picture.
    pub fn setups(self, count: usize, seed: u32) -> impl Iterator<Item = Setup> {
        let mut random = Random::new(seed);
        std::iter::from_fn(move || Some(self.setup(&mut random)))
            .take(count * 60)
            .flatten()
            .take(count)
    }
}

/// The largest of some figures, and what it was found for.
#[derive(Debug, Clone)]
pub struct Worst<T> {
    /// The largest.
    pub value: f64,
    /// What it was found for.
    pub at: Option<T>,
    /// How many there were.
    pub count: usize,
}

impl<T> Default for Worst<T> {
    fn default() -> Self {
        Worst {
            value: 0.0,
            at: None,
            count: 0,
        }
    }
}

impl<T> Worst<T> {
    /// Takes one more figure. What is no number is the worst of all.
    pub fn add(&mut self, value: f64, at: T) {
        self.count += 1;
        let value = if value.is_nan() { f64::INFINITY } else { value };
        if value > self.value || self.at.is_none() {
            self.value = value;
            self.at = Some(at);
        }
    }
}
