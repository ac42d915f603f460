//! Every sample in view.

use super::crossings::{crossings, follows_the_grid};
use super::judge::Judge;
use super::scan::{Area, Point, scan};
use super::surface::{Heights, Samples, surface_height};
use super::tally::{Promise, Tally};
use super::{Triangle, size_m};
use escarp_proto::view::View;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// A bit a sample.
struct Bits(Vec<AtomicU64>);

impl Bits {
    fn new(samples: usize) -> Bits {
        Bits(
            (0..samples.div_ceil(64))
                .map(|_| AtomicU64::new(0))
                .collect(),
        )
    }

    /// Sets a bit; whether it was not set before.
    fn set(&self, at: usize) -> bool {
        let bit = 1 << (at % 64);
        self.0[at / 64].fetch_or(bit, Ordering::Relaxed) & bit == 0
    }

    /// Bits that are set here and not there.
    fn without(&self, other: &Bits) -> u64 {
        let words = self.0.iter().zip(&other.0);
        words
            .map(|(here, there)| here.load(Ordering::Relaxed) & !there.load(Ordering::Relaxed))
            .map(|word| u64::from(word.count_ones()))
            .sum()
    }
}

/// What is being measured.
struct Scene<'a> {
    samples: &'a Samples,
    judge: &'a Judge,
    promise: Promise,
    /// Tolerance at a distance of one metre, metres.
    tolerance: f64,
    /// Samples that a triangle was compared at.
    counted: Bits,
    /// Samples in triangles that are not drawn though they are too large to be left out.
    suspect: Bits,
    /// Samples that some triangle is drawn over, or may leave out.
    excused: Bits,
}

/// Measures all samples in view, each once.
pub fn measure(
    samples: &Samples,
    triangles: &[Triangle],
    judge: &Judge,
    view: &View,
    promise: Promise,
) -> Tally {
    let [width, height] = samples.size();
    let count = width as usize * height as usize;
    let scene = Scene {
        samples,
        judge,
        promise,
        tolerance: 1.0 / view.threshold(),
        counted: Bits::new(count),
        suspect: Bits::new(count),
        excused: Bits::new(count),
    };
    let mut tally = triangles
        .par_chunks(1024)
        .map(|some| {
            let mut tally = Tally::default();
            some.iter()
                .for_each(|triangle| scene.triangle(triangle, &mut tally));
            tally
        })
        .reduce(Tally::default, |a, b| a.merge(&b));
    tally.left_out = scene.suspect.without(&scene.excused);
    tally
}

impl Scene<'_> {
    fn triangle(&self, triangle: &Triangle, tally: &mut Tally) {
        let [width, height] = self.samples.size();
        let all = Area {
            x: [0, width - 1],
            y: [0, height - 1],
        };
        let georef = self.judge.georef();
        let size_m = size_m(&triangle.corners, georef);
        scan(&triangle.corners, all, 1, |point| {
            self.point(triangle.drawn, size_m, point, tally)
        });
        if triangle.drawn && !triangle.exact {
            self.between(triangle, tally);
        }
    }

    fn point(&self, drawn: bool, size_m: f64, point: Point, tally: &mut Tally) {
        let Point {
            x,
            y,
            height,
            shared,
        } = point;
        let sample = self.samples.height(x, y);
        // In a hole it is the triangle that is there.
        let there = sample.unwrap_or(height.round() as i32);
        let Some(at_m) = self.judge.sees(x, y, there) else {
            return;
        };
        let coarse = || size_m > self.judge.distance_m(at_m) * self.tolerance;
        let place = y as usize * self.samples.size()[0] as usize + x as usize;
        match (sample, drawn) {
            (Some(sample), true) => {
                self.excused.set(place);
                if !shared || self.counted.set(place) {
                    let up_m = (height - f64::from(sample)) * self.judge.georef().quantum_m;
                    self.compare(at_m, up_m, tally);
                }
            }
            (Some(_), false) if !coarse() => {
                self.excused.set(place);
            }
            (Some(_), false) if self.samples.is_on_surface(x, y) => {
                self.suspect.set(place);
            }
            (None, true) if coarse() => tally.covered += 1,
            _ => {}
        }
    }

    fn compare(&self, at_m: [f64; 3], up_m: f64, tally: &mut Tally) {
        if up_m == 0.0 {
            tally.add_exact(1, 1.0);
        } else {
            tally.add(self.judge.deviation(at_m, up_m), self.promise, 1.0);
        }
    }

    /// Crossings of its edges that are no samples.
    fn between(&self, triangle: &Triangle, tally: &mut Tally) {
        let [a, b, c] = triangle.corners;
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let (start, end) = ((from.0, from.1), (to.0, to.1));
            if follows_the_grid(start, end) {
                continue;
            }
            crossings(start, end, |share| {
                let along = |a: f64, b: f64| a + share * (b - a);
                let x = along(f64::from(from.0), f64::from(to.0));
                let y = along(f64::from(from.1), f64::from(to.1));
                let mesh = along(from.2, to.2);
                if let Some(surface) = surface_height(self.samples, x, y) {
                    self.crossing(x, y, surface, mesh, tally);
                }
            });
        }
    }

    fn crossing(&self, x: f64, y: f64, surface: f64, mesh: f64, tally: &mut Tally) {
        let georef = self.judge.georef();
        let at_m = [
            georef.origin_m[0] + x * georef.sample_spacing_m[0],
            georef.origin_m[1] + y * georef.sample_spacing_m[1],
            surface * georef.quantum_m,
        ];
        let point = escarp_proto::georef::WorldBox {
            min: at_m,
            max: at_m,
        };
        if self.judge.may_see(&point) {
            let px = self.judge.px(at_m, (mesh - surface) * georef.quantum_m);
            tally.add_between(px, self.promise);
        }
    }
}
