//! Where clients look from: places above the ground of a dataset.

use anyhow::{Context, Result};
use escarp_client::camera;
use escarp_client::flight::{Key, Path as Flight};
use escarp_proto::geometry::{PAGE_CELLS, PAGE_SAMPLES, PageId};
use escarp_proto::view::View;
use escarp_tiles::dataset::{Dataset, PageReader};
use std::cell::RefCell;

/// A full picture, pixels.
pub const PICTURE: [u32; 2] = [1920, 1080];
/// Field of view, degrees.
const FOV_DEG: f64 = 60.0;
/// Down from the horizon, radians.
const PITCH: f64 = 0.17;
/// The eye's usual height above the ground, metres.
const ABOVE_M: f64 = 500.0;
/// Seconds from key to key of a flight.
const KEY_S: f64 = 2.0;
/// A flight's height follows the highest ground this long before and after, seconds.
const SMOOTH_S: f64 = 10.0;

/// The ground of a dataset.
#[derive(Debug)]
pub struct Ground<'a> {
    dataset: &'a Dataset,
    pages: RefCell<PageReader<'a>>,
}

impl<'a> Ground<'a> {
    /// Of a dataset.
    pub fn new(dataset: &'a Dataset) -> Ground<'a> {
        let pages = RefCell::new(PageReader::new(dataset));
        Ground { dataset, pages }
    }

    /// Height of the nearest sample, metres; `None` in holes and beyond the data.
    ///
    /// # Errors
    /// If the dataset is damaged.
    pub fn height_m(&self, [x_m, y_m]: [f64; 2]) -> Result<Option<f64>> {
        let manifest = self.dataset.manifest();
        let grid = manifest.georef.grid(x_m, y_m).map(f64::round);
        let inside = (0..2).all(|i| grid[i] >= 0.0 && grid[i] < f64::from(manifest.samples[i]));
        if !inside {
            return Ok(None);
        }
        // The last sample of the grid belongs to the last page.
        let level = self.dataset.grid().finest_page_level();
        let last = (1u32 << level) - 1;
        let page = grid.map(|v| (v as u32 / PAGE_CELLS as u32).min(last));
        let within = [0, 1].map(|i| grid[i] as usize - page[i] as usize * PAGE_CELLS);
        let id = PageId::new(level, page[0], page[1]).context("a page of the grid")?;
        let page = self.pages.borrow_mut().page(id)?;
        let sample = within[1] * PAGE_SAMPLES + within[0];
        let height = page.is_valid(sample).then(|| page.height(sample));
        Ok(height.map(|height| manifest.georef.world_z(height)))
    }

    /// A place of the data by shares of its extent, or the nearest on the way to its middle that
    /// is on ground.
    ///
    /// # Errors
    /// If the dataset is damaged, or there is no ground on the way.
    pub fn place(&self, share: [f64; 2]) -> Result<[f64; 3]> {
        let extent = self.dataset.manifest().extent_m();
        for step in 0..=100 {
            let toward = f64::from(step) / 100.0;
            let at = [0, 1].map(|i| {
                let share = share[i] + (0.5 - share[i]) * toward;
                extent[i][0] + share * (extent[i][1] - extent[i][0])
            });
            if let Some(height) = self.height_m(at)? {
                return Ok([at[0], at[1], height]);
            }
        }
        anyhow::bail!("{} has no ground there", self.dataset.name())
    }

    /// A view 500 m above the ground, a little down.
    ///
    /// # Errors
    /// As [`place`](Self::place).
    pub fn view(&self, share: [f64; 2], course_deg: f64, error_px: f32) -> Result<View> {
        let [x, y, z] = self.place(share)?;
        let course = course_deg.to_radians();
        let eye = [x, y, z + ABOVE_M];
        let look = [x + course.sin(), y + course.cos(), eye[2] - PITCH.tan()];
        let fov = FOV_DEG.to_radians();
        Ok(camera::look_at(eye, look, fov, PICTURE, error_px))
    }

    /// Straight on at a speed, 500 m above the highest ground nearby, for so long, or to the edge
    /// of the data.
    ///
    /// # Errors
    /// If the dataset is damaged.
    pub fn flight(&self, way: Way, fps: f64) -> Result<Flight> {
        let [x, y, _] = self.place(way.from)?;
        let course = way.course_deg.to_radians();
        let along = [course.sin(), course.cos()];
        let at = |t: f64| [0, 1].map(|i| [x, y][i] + along[i] * way.speed_m_s * t);
        let mut keys = Vec::new();
        let mut floor = None;
        for key in 0..=(way.seconds / KEY_S).ceil() as u32 {
            let t = f64::from(key) * KEY_S;
            let Some(highest) = self.highest(&at, t)?.or(floor) else {
                break;
            };
            if self.is_beyond(at(t)) {
                break;
            }
            floor = Some(highest);
            let ([x, y], [ahead_x, ahead_y]) = (at(t), at(t + KEY_S));
            let distance = way.speed_m_s * KEY_S;
            let eye = [x, y, highest + ABOVE_M];
            let look = [ahead_x, ahead_y, eye[2] - distance * PITCH.tan()];
            keys.push(Key { t, eye, look });
        }
        let flight = Flight {
            fov_deg: FOV_DEG,
            error_px: way.error_px,
            size: PICTURE,
            fps,
            keys,
        };
        flight.check()?;
        Ok(flight)
    }

    fn is_beyond(&self, at: [f64; 2]) -> bool {
        let extent = self.dataset.manifest().extent_m();
        (0..2).any(|i| at[i] < extent[i][0] || at[i] > extent[i][1])
    }

    fn highest(&self, at: &impl Fn(f64) -> [f64; 2], t: f64) -> Result<Option<f64>> {
        const STEPS: i32 = 20;
        let mut highest: Option<f64> = None;
        for step in -STEPS..=STEPS {
            let near = t + SMOOTH_S * f64::from(step) / f64::from(STEPS);
            if let Some(height) = self.height_m(at(near))? {
                highest = Some(highest.map_or(height, |other| other.max(height)));
            }
        }
        Ok(highest)
    }
}

/// A straight flight.
#[derive(Debug, Clone, Copy)]
pub struct Way {
    /// Where it begins, by shares of the extent.
    pub from: [f64; 2],
    /// Compass course, degrees.
    pub course_deg: f64,
    /// Over ground, metres a second.
    pub speed_m_s: f64,
    /// How long, seconds.
    pub seconds: f64,
    /// The tolerance, pixels.
    pub error_px: f32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::{TempDataset, hills, holed_hills};

    #[test]
    fn the_ground_is_at_its_samples_and_not_in_holes() {
        let data = TempDataset::of(230, 190, holed_hills);
        let ground = Ground::new(&data.dataset);
        let georef = &data.dataset.manifest().georef;
        for (x, y) in [(0, 0), (229, 189), (228, 0), (90, 119), (100, 60), (16, 17)] {
            let at = [georef.world_x(x), georef.world_y(y)];
            let expected = data.sample(x, y).map(|height| georef.world_z(height));
            assert_eq!(ground.height_m(at).expect("sound"), expected, "{x}, {y}");
        }
        assert_eq!(ground.height_m([-1e9, 0.0]).expect("sound"), None);
        let [x, y, z] = ground.place([0.4, 0.63]).expect("ground");
        assert_eq!(ground.height_m([x, y]).expect("sound"), Some(z));
    }

    #[test]
    fn a_flight_keeps_its_height_above_all_ground_below_it_and_ends_at_the_edge() {
        let data = TempDataset::of(400, 300, hills);
        let ground = Ground::new(&data.dataset);
        let way = Way {
            from: [0.1, 0.5],
            course_deg: 90.0,
            speed_m_s: 100.0,
            seconds: 1e3,
            error_px: 2.0,
        };
        let flight = ground.flight(way, 30.0).expect("a flight");
        assert!(
            (30.0..36.1).contains(&flight.duration_s()),
            "3.6 km are left"
        );
        for frame in 0..flight.frames() {
            let view = flight.view(flight.frame_time_s(frame));
            let [x, y, z] = view.eye_m;
            let below = ground.height_m([x, y]).expect("sound").expect("ground");
            assert!(z >= below + 0.9 * ABOVE_M, "{z} above {below}");
        }
    }
}
