//! Charts of bars that lie, each of several parts.

use super::axis::{Axis, Scale, number};
use super::chart::{Frame, SIZE, Style, WIDTH, legend, title};
use super::drawing::{Anchor, Drawing, Ink};
use super::font::Font;

/// A bar.
#[derive(Debug, Clone, PartialEq)]
pub struct Bar {
    /// What it is.
    pub name: String,
    /// Its parts, from the left, one for each of the chart's.
    pub parts: Vec<f64>,
}

/// A chart of bars.
#[derive(Debug, Clone, PartialEq)]
pub struct Bars {
    /// What it shows.
    pub title: String,
    /// What their length is, with its unit.
    pub label: String,
    /// Names of the parts; a single part needs none.
    pub parts: Vec<String>,
    /// The bars, the uppermost first.
    pub bars: Vec<Bar>,
}

const ROW: f64 = 26.0;

impl Bars {
    /// Draws it.
    pub fn draw(&self, font: &Font) -> Drawing {
        let mut drawing = Drawing::new([WIDTH, 0.0], &self.title);
        title(&mut drawing, &self.title);
        let named = self.parts.iter().filter(|part| !part.is_empty());
        let entries: Vec<(String, usize, Style)> = named
            .enumerate()
            .map(|(i, part)| (part.clone(), i, Style::Plain))
            .collect();
        let top = legend(&mut drawing, font, &entries) + 8.0;
        let names = self.bars.iter().map(|bar| font.room(&bar.name, SIZE));
        let frame = Frame {
            left: 24.0 + names.fold(0.0, f64::max),
            top,
            right: WIDTH - 74.0,
            bottom: top + ROW * self.bars.len().max(1) as f64 + 6.0,
        };
        drawing.size[1] = frame.bottom + 50.0;
        let totals = self.bars.iter().map(|bar| bar.parts.iter().sum::<f64>());
        let axis = Axis::around(&self.label, Scale::Linear, totals);
        for tick in axis.ticks() {
            let x = frame.x(&axis, tick.value);
            let points = vec![[x, frame.top], [x, frame.bottom]];
            drawing.line(
                points,
                Ink::Grid,
                if tick.label.is_some() { 1.0 } else { 0.5 },
                &[],
            );
            if let Some(label) = tick.label {
                let at = [x, frame.bottom + 17.0];
                drawing.text(at, &label, SIZE, Anchor::Middle, Ink::Muted);
            }
        }
        for (i, bar) in self.bars.iter().enumerate() {
            let middle = frame.top + ROW * (i as f64 + 0.5) + 3.0;
            self.bar(&mut drawing, frame, &axis, bar, middle);
        }
        let axes = vec![[frame.left, frame.top], [frame.left, frame.bottom]];
        drawing.line(axes, Ink::Muted, 1.2, &[]);
        let at = [(frame.left + frame.right) / 2.0, frame.bottom + 40.0];
        drawing.text(at, &self.label, SIZE, Anchor::Middle, Ink::Text);
        drawing
    }

    fn bar(&self, drawing: &mut Drawing, frame: Frame, axis: &Axis, bar: &Bar, middle: f64) {
        let at = [frame.left - 8.0, middle + 4.2];
        drawing.text(at, &bar.name, SIZE, Anchor::End, Ink::Text);
        let mut sum = 0.0;
        let mut from = frame.left;
        for (number, part) in bar.parts.iter().enumerate() {
            sum += part;
            let to = frame.x(axis, sum);
            if *part > 0.0 {
                let (upper, lower) = (middle - 8.0, middle + 8.0);
                drawing.rectangle([from, upper], [to, lower], Ink::Series(number), 1.0);
                from = to;
            }
        }
        let at = [from + 7.0, middle + 4.2];
        drawing.text(at, &number(sum), SIZE, Anchor::Start, Ink::Muted);
    }
}
