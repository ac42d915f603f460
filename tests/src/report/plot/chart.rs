//! Charts of curves over two axes.

use super::axis::{Axis, Tick};
use super::drawing::{Anchor, Drawing, Ink};
use super::font::Font;

/// How the points of a series are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// Joined, with a mark at each.
    Marked,
    /// A mark at each.
    Marks,
    /// Joined.
    Plain,
    /// Joined by dashes.
    Dashed,
    /// Level until the next.
    Steps,
}

/// A curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// What the legend says.
    pub name: String,
    /// Number of its colour and mark.
    pub number: usize,
    /// How it is drawn.
    pub style: Style,
    /// `[x, y]`, in order. Those that an axis does not have are left out.
    pub points: Vec<[f64; 2]>,
    /// `[y, from x, to x]`: bars that show how far the values reach.
    pub reaches: Vec<[f64; 3]>,
}

impl Series {
    /// A curve without bars.
    pub fn new(name: &str, number: usize, style: Style, points: Vec<[f64; 2]>) -> Series {
        Series {
            name: name.into(),
            number,
            style,
            points,
            reaches: Vec::new(),
        }
    }
}

/// A line right across, with what it says.
#[derive(Debug, Clone, PartialEq)]
pub struct Mark {
    /// At this `x`, or this `y`.
    pub at: At,
    /// What it says.
    pub label: String,
}

/// Where a [`Mark`] is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum At {
    /// Upright.
    X(f64),
    /// Level.
    Y(f64),
    /// Where both values are the same.
    Diagonal,
}

/// A chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Chart {
    /// What it shows.
    pub title: String,
    /// To the right.
    pub x: Axis,
    /// Upwards.
    pub y: Axis,
    /// The curves, the uppermost first.
    pub series: Vec<Series>,
    /// Lines to hold them against.
    pub marks: Vec<Mark>,
}

pub(super) const WIDTH: f64 = 760.0;
const PLOT_HEIGHT: f64 = 330.0;
pub(super) const SIZE: f64 = 12.5;
pub(super) const TITLE: f64 = 15.0;
const RIGHT: f64 = 22.0;

/// The rectangle of a plot.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    pub(super) left: f64,
    pub(super) top: f64,
    pub(super) right: f64,
    pub(super) bottom: f64,
}

impl Frame {
    pub(super) fn x(&self, axis: &Axis, value: f64) -> f64 {
        self.left + axis.share(value).clamp(0.0, 1.0) * (self.right - self.left)
    }

    pub(super) fn y(&self, axis: &Axis, value: f64) -> f64 {
        self.bottom - axis.share(value).clamp(0.0, 1.0) * (self.bottom - self.top)
    }
}

/// A title, bold, at the top.
pub(super) fn title(drawing: &mut Drawing, text: &str) {
    drawing.text([12.0, 22.0], text, TITLE, Anchor::Start, Ink::Text);
    if let Some(super::drawing::Shape::Text { bold, .. }) = drawing.shapes.last_mut() {
        *bold = true;
    }
}

/// `(name, number, style)`, in rows below the title. Where it ends.
pub(super) fn legend(
    drawing: &mut Drawing,
    font: &Font,
    entries: &[(String, usize, Style)],
) -> f64 {
    const KEY: f64 = 26.0;
    const GAP: f64 = 18.0;
    let (mut x, mut y) = (14.0, 44.0);
    for (name, number, style) in entries {
        let width = KEY + 6.0 + font.room(name, SIZE) + GAP;
        if x + width - GAP > WIDTH - RIGHT && x > 14.0 {
            (x, y) = (14.0, y + 19.0);
        }
        let middle = y - 4.0;
        let dash: &[f64] = if *style == Style::Dashed {
            &[5.0, 3.5]
        } else {
            &[]
        };
        let points = vec![[x, middle], [x + KEY, middle]];
        if *style != Style::Marks {
            drawing.line(points, Ink::Series(*number), 2.2, dash);
        }
        if matches!(style, Style::Marked | Style::Marks) {
            drawing.mark([x + KEY / 2.0, middle], *number, 4.0);
        }
        drawing.text([x + KEY + 6.0, y], name, SIZE, Anchor::Start, Ink::Text);
        x += width;
    }
    if entries.is_empty() { 30.0 } else { y + 8.0 }
}

impl Chart {
    /// Draws it.
    pub fn draw(&self, font: &Font) -> Drawing {
        let mut drawing = Drawing::new([WIDTH, 0.0], &self.title);
        title(&mut drawing, &self.title);
        let entries: Vec<(String, usize, Style)> = self
            .series
            .iter()
            .filter(|series| !series.name.is_empty())
            .map(|series| (series.name.clone(), series.number, series.style))
            .collect();
        let top = legend(&mut drawing, font, &entries) + 10.0;
        let (xs, ys) = (self.x.ticks(), self.y.ticks());
        let labels = ys.iter().filter_map(|tick| tick.label.as_deref());
        let widest = labels
            .map(|label| font.room(label, SIZE))
            .fold(0.0, f64::max);
        let frame = Frame {
            left: 40.0 + widest,
            top,
            right: WIDTH - RIGHT,
            bottom: top + PLOT_HEIGHT,
        };
        drawing.size[1] = frame.bottom + 52.0;
        self.grid(&mut drawing, font, frame, (&xs, &ys));
        for mark in &self.marks {
            self.mark(&mut drawing, font, frame, mark);
        }
        for series in self.series.iter().rev() {
            self.curve(&mut drawing, frame, series);
        }
        drawing
    }

    fn grid(&self, drawing: &mut Drawing, font: &Font, frame: Frame, (xs, ys): (&[Tick], &[Tick])) {
        let Frame {
            left,
            top,
            right,
            bottom,
        } = frame;
        let line = |drawing: &mut Drawing, points: Vec<[f64; 2]>, major: bool| {
            drawing.line(points, Ink::Grid, if major { 1.0 } else { 0.5 }, &[]);
        };
        let mut free_from = f64::NEG_INFINITY;
        for tick in xs {
            let x = frame.x(&self.x, tick.value);
            line(drawing, vec![[x, top], [x, bottom]], tick.label.is_some());
            if let Some(label) = &tick.label {
                let half = font.room(label, SIZE) / 2.0;
                if x - half > free_from {
                    drawing.text([x, bottom + 18.0], label, SIZE, Anchor::Middle, Ink::Muted);
                    free_from = x + half + 6.0;
                }
            }
        }
        for tick in ys {
            let y = frame.y(&self.y, tick.value);
            line(drawing, vec![[left, y], [right, y]], tick.label.is_some());
            if let Some(label) = &tick.label {
                drawing.text([left - 8.0, y + 4.2], label, SIZE, Anchor::End, Ink::Muted);
            }
        }
        let axes = vec![[left, top], [left, bottom], [right, bottom]];
        drawing.line(axes, Ink::Muted, 1.2, &[]);
        let middle = (left + right) / 2.0;
        drawing.text(
            [middle, bottom + 41.0],
            &self.x.label,
            SIZE,
            Anchor::Middle,
            Ink::Text,
        );
        let at = [20.0, (top + bottom) / 2.0];
        drawing.text(at, &self.y.label, SIZE, Anchor::Middle, Ink::Text);
        if let Some(super::drawing::Shape::Text { upwards, .. }) = drawing.shapes.last_mut() {
            *upwards = true;
        }
    }

    fn mark(&self, drawing: &mut Drawing, font: &Font, frame: Frame, mark: &Mark) {
        const DASH: &[f64] = &[2.0, 3.0];
        match mark.at {
            At::X(value) if self.x.holds(value) => {
                let x = frame.x(&self.x, value);
                let points = vec![[x, frame.top], [x, frame.bottom]];
                drawing.line(points, Ink::Muted, 1.3, DASH);
                let fits = x + 8.0 + font.room(&mark.label, SIZE) < frame.right;
                let (x, anchor) = if fits {
                    (x + 6.0, Anchor::Start)
                } else {
                    (x - 6.0, Anchor::End)
                };
                let at = [x, frame.bottom - 10.0];
                drawing.text(at, &mark.label, SIZE, anchor, Ink::Muted);
            }
            At::Y(value) if self.y.holds(value) => {
                let y = frame.y(&self.y, value);
                let points = vec![[frame.left, y], [frame.right, y]];
                drawing.line(points, Ink::Muted, 1.3, DASH);
                let at = [frame.right - 6.0, y - 6.0];
                drawing.text(at, &mark.label, SIZE, Anchor::End, Ink::Muted);
            }
            At::Diagonal => {
                let from = self.x.range[0].max(self.y.range[0]);
                let to = self.x.range[1].min(self.y.range[1]);
                if from < to {
                    let at = |v: f64| [frame.x(&self.x, v), frame.y(&self.y, v)];
                    drawing.line(vec![at(from), at(to)], Ink::Muted, 1.3, DASH);
                    let [x, y] = at(to);
                    let anchor = Anchor::End;
                    drawing.text([x - 14.0, y + 14.0], &mark.label, SIZE, anchor, Ink::Muted);
                }
            }
            At::X(_) | At::Y(_) => {}
        }
    }

    fn curve(&self, drawing: &mut Drawing, frame: Frame, series: &Series) {
        let ink = Ink::Series(series.number);
        for &[y, from, to] in &series.reaches {
            if self.y.holds(y) && self.x.holds(from) && to.is_finite() {
                let y = frame.y(&self.y, y);
                let (from, to) = (frame.x(&self.x, from), frame.x(&self.x, to));
                drawing.line(vec![[from, y], [to, y]], ink, 1.1, &[]);
                drawing.line(vec![[to, y - 3.5], [to, y + 3.5]], ink, 1.1, &[]);
            }
        }
        let held = series
            .points
            .iter()
            .filter(|[x, y]| self.x.holds(*x) && self.y.holds(*y));
        let places: Vec<[f64; 2]> = held
            .map(|&[x, y]| [frame.x(&self.x, x), frame.y(&self.y, y)])
            .collect();
        let dash: &[f64] = if series.style == Style::Dashed {
            &[5.0, 3.5]
        } else {
            &[]
        };
        let line = match series.style {
            Style::Steps => steps(&places),
            _ => places.clone(),
        };
        if line.len() > 1 && series.style != Style::Marks {
            drawing.line(line, ink, 2.0, dash);
        }
        if matches!(series.style, Style::Marked | Style::Marks) || places.len() == 1 {
            places
                .iter()
                .for_each(|&at| drawing.mark(at, series.number, 4.0));
        }
    }
}

fn steps(places: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut line = Vec::with_capacity(2 * places.len());
    for (i, &[x, y]) in places.iter().enumerate() {
        if let Some(&[_, before]) = i.checked_sub(1).and_then(|i| places.get(i)) {
            line.push([x, before]);
        }
        line.push([x, y]);
    }
    line
}
