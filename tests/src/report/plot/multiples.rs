//! Many small charts with the same axes, in rows and columns.

use super::axis::Axis;
use super::chart::{Frame, SIZE, Series, Style, legend, title};
use super::drawing::{Anchor, Drawing, Ink};
use super::font::Font;

const PANEL: [f64; 2] = [215.0, 150.0];
const GAP: f64 = 14.0;
const LEFT: f64 = 96.0;
const RIGHT: f64 = 16.0;
const SMALL: f64 = 10.5;

/// One of the charts.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Panel {
    /// Its curves, the uppermost first.
    pub series: Vec<Series>,
    /// Upright lines, `(x, number of the colour)`.
    pub marks: Vec<(f64, usize)>,
}

/// Many small charts.
#[derive(Debug, Clone, PartialEq)]
pub struct Multiples {
    /// What they show.
    pub title: String,
    /// The axis of all to the right.
    pub x: Axis,
    /// The axis of all upwards.
    pub y: Axis,
    /// A level line in all, if any.
    pub level: Option<f64>,
    /// Above the columns.
    pub columns: Vec<String>,
    /// Before the rows, with the charts of each.
    pub rows: Vec<(String, Vec<Panel>)>,
    /// `(name, number)` of the curves.
    pub legend: Vec<(String, usize, Style)>,
}

impl Multiples {
    /// Draws them.
    pub fn draw(&self, font: &Font) -> Drawing {
        let width = LEFT + self.columns.len() as f64 * (PANEL[0] + GAP) - GAP + RIGHT;
        let mut drawing = Drawing::new([width, 0.0], &self.title);
        title(&mut drawing, &self.title);
        let mut top = legend(&mut drawing, font, &self.legend) + 26.0;
        for (i, column) in self.columns.iter().enumerate() {
            let middle = LEFT + i as f64 * (PANEL[0] + GAP) + PANEL[0] / 2.0;
            drawing.text([middle, top - 8.0], column, SIZE, Anchor::Middle, Ink::Text);
        }
        for (j, (name, panels)) in self.rows.iter().enumerate() {
            let last = j + 1 == self.rows.len();
            for (i, panel) in panels.iter().enumerate() {
                let left = LEFT + i as f64 * (PANEL[0] + GAP);
                let frame = Frame {
                    left,
                    top,
                    right: left + PANEL[0],
                    bottom: top + PANEL[1],
                };
                self.grid(&mut drawing, font, frame, [i == 0, last]);
                self.panel(&mut drawing, frame, panel);
            }
            self.name(&mut drawing, name, top + PANEL[1] / 2.0);
            top += PANEL[1] + GAP;
        }
        let middle = LEFT + (width - LEFT - RIGHT) / 2.0;
        let at = [middle, top + 28.0];
        drawing.text(at, &self.x.label, SIZE, Anchor::Middle, Ink::Text);
        drawing.size[1] = top + 40.0;
        drawing
    }

    /// A row's name, and what its charts have upwards.
    fn name(&self, drawing: &mut Drawing, name: &str, middle: f64) {
        for (x, text, ink) in [(16.0, name, Ink::Text), (34.0, &*self.y.label, Ink::Muted)] {
            drawing.text([x, middle], text, SIZE, Anchor::Middle, ink);
            if let Some(super::drawing::Shape::Text { upwards, .. }) = drawing.shapes.last_mut() {
                *upwards = true;
            }
        }
    }

    fn grid(&self, drawing: &mut Drawing, font: &Font, frame: Frame, [first, last]: [bool; 2]) {
        let mut free_from = f64::NEG_INFINITY;
        for tick in self
            .x
            .ticks()
            .into_iter()
            .filter(|tick| tick.label.is_some())
        {
            let x = frame.x(&self.x, tick.value);
            drawing.line(vec![[x, frame.top], [x, frame.bottom]], Ink::Grid, 0.8, &[]);
            let label = tick.label.unwrap_or_default();
            let half = font.room(&label, SMALL) / 2.0;
            if last && x - half > free_from {
                let at = [x, frame.bottom + 14.0];
                drawing.text(at, &label, SMALL, Anchor::Middle, Ink::Muted);
                free_from = x + half + 4.0;
            }
        }
        for tick in self
            .y
            .ticks()
            .into_iter()
            .filter(|tick| tick.label.is_some())
        {
            let y = frame.y(&self.y, tick.value);
            drawing.line(vec![[frame.left, y], [frame.right, y]], Ink::Grid, 0.8, &[]);
            let label = tick.label.unwrap_or_default();
            if first {
                let at = [frame.left - 6.0, y + 3.6];
                drawing.text(at, &label, SMALL, Anchor::End, Ink::Muted);
            }
        }
        if let Some(level) = self.level.filter(|&level| self.y.holds(level)) {
            let y = frame.y(&self.y, level);
            let points = vec![[frame.left, y], [frame.right, y]];
            drawing.line(points, Ink::Muted, 1.1, &[2.0, 3.0]);
        }
        let Frame {
            left,
            top,
            right,
            bottom,
        } = frame;
        let axes = vec![[left, top], [left, bottom], [right, bottom]];
        drawing.line(axes, Ink::Muted, 1.0, &[]);
    }

    fn panel(&self, drawing: &mut Drawing, frame: Frame, panel: &Panel) {
        for &(at, number) in panel.marks.iter().filter(|(at, _)| self.x.holds(*at)) {
            let x = frame.x(&self.x, at);
            let points = vec![[x, frame.top], [x, frame.bottom]];
            drawing.line(points, Ink::Series(number), 1.0, &[2.0, 3.0]);
        }
        for series in panel.series.iter().rev() {
            let held = series.points.iter().filter(|p| self.x.holds(p[0]));
            let held = held.filter(|p| p[1] > 0.0);
            let mut line: Vec<[f64; 2]> = Vec::new();
            for &[x, y] in held {
                let at = [frame.x(&self.x, x), frame.y(&self.y, y)];
                if let Some(&[_, before]) = line.last() {
                    line.push([at[0], before]);
                }
                line.push(at);
            }
            if line.len() > 1 {
                drawing.line(line, Ink::Series(series.number), 1.7, &[]);
            }
        }
    }
}
