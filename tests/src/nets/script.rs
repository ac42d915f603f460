//! What a client says on a flight, found out once and said by many: views, and what a mesh tree
//! that has got all before lacks for each.

use super::places::{Ground, Way};
use crate::report::supply::Supply;
use crate::report::variant::Variant;
use anyhow::Result;
use escarp_client::mesh::Wish;
use escarp_proto::view::View;
use escarp_proto::wire::Want;
use escarp_tiles::dataset::Dataset;

/// A moment of a flight.
#[derive(Debug, Clone)]
pub struct Line {
    /// Where the eye is.
    pub view: View,
    /// What is wanted, most urgent first.
    pub wants: Vec<Want>,
}

/// A flight's lines, so many a second.
#[derive(Debug, Clone)]
pub struct Script {
    /// The lines.
    pub lines: Vec<Line>,
}

impl Script {
    /// Of a flight.
    ///
    /// # Errors
    /// If the dataset is damaged, or has no ground there.
    pub fn write(
        dataset: &Dataset,
        way: Way,
        lines_a_second: f64,
        size: [u32; 2],
    ) -> Result<Script> {
        let flight = Ground::new(dataset).flight(way, lines_a_second)?;
        let mut supply = Supply::new(dataset, Variant::usual());
        let mut lines = Vec::new();
        for frame in 0..flight.frames() {
            let mut view = flight.view(flight.frame_time_s(frame));
            view.viewport_px = size;
            let mut wants = Vec::new();
            supply.converge_noting(&view, &mut |wishes| {
                wants.extend(wishes.iter().map(Wish::to_want));
            })?;
            lines.push(Line { view, wants });
        }
        Ok(Script { lines })
    }

    /// The line at a number of lines since the beginning: there and back, without end.
    pub fn line(&self, number: usize) -> &Line {
        let last = self.lines.len() - 1;
        let at = number % (2 * last).max(1);
        &self.lines[if at > last { 2 * last - at } else { at }]
    }
}
