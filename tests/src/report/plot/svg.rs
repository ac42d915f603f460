//! A drawing as SVG.

use super::drawing::{Anchor, Drawing, Ink, Shape};
use std::fmt::Write;

/// Where the colours come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colours {
    /// Those on white, in the file itself.
    Light,
    /// The CSS variables of the page that it stands in.
    OfPage,
}

/// Writes text so that it means itself in SVG and HTML.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c if c.is_control() && c != '\n' => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

impl Colours {
    fn of(self, ink: Ink) -> String {
        let [r, g, b] = ink.light();
        match self {
            Colours::Light => format!("#{r:02x}{g:02x}{b:02x}"),
            Colours::OfPage => format!("var({},#{r:02x}{g:02x}{b:02x})", ink.variable()),
        }
    }
}

fn path(points: &[[f64; 2]]) -> String {
    let mut text = String::new();
    for (i, [x, y]) in points.iter().enumerate() {
        let step = if i == 0 { 'M' } else { 'L' };
        let _ = write!(text, "{step}{x:.1} {y:.1}");
    }
    text
}

/// The SVG of a drawing.
pub fn svg(drawing: &Drawing, colours: Colours) -> String {
    let [width, height] = drawing.size;
    let title = escape(&drawing.title);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\" \
         aria-label=\"{title}\" font-family=\"Ubuntu,'Segoe UI','Helvetica Neue',Arial,sans-serif\">\
         <title>{title}</title>\n"
    );
    if colours == Colours::Light {
        let paper = colours.of(Ink::Paper);
        let _ = writeln!(
            out,
            "<rect width=\"{width}\" height=\"{height}\" fill=\"{paper}\"/>"
        );
    }
    for shape in &drawing.shapes {
        one(&mut out, shape, colours);
    }
    out.push_str("</svg>\n");
    out
}

fn one(out: &mut String, shape: &Shape, colours: Colours) {
    // Writing to a string cannot fail.
    let _ = match shape {
        Shape::Line {
            points,
            ink,
            width,
            dash,
        } => {
            let lengths: Vec<String> = dash.iter().map(f64::to_string).collect();
            let dashes = match lengths.is_empty() {
                true => String::new(),
                false => format!(";stroke-dasharray:{}", lengths.join(" ")),
            };
            writeln!(
                out,
                "<path d=\"{}\" style=\"fill:none;stroke:{};stroke-width:{width};\
                 stroke-linejoin:round{dashes}\"/>",
                path(points),
                colours.of(*ink)
            )
        }
        Shape::Fill {
            points,
            ink,
            opacity,
        } => writeln!(
            out,
            "<path d=\"{}Z\" style=\"fill:{};fill-opacity:{opacity}\"/>",
            path(points),
            colours.of(*ink)
        ),
        Shape::Text {
            at: [x, y],
            text,
            size,
            anchor,
            ink,
            bold,
            upwards,
        } => {
            let anchor = match anchor {
                Anchor::Start => "start",
                Anchor::Middle => "middle",
                Anchor::End => "end",
            };
            let weight = if *bold { ";font-weight:600" } else { "" };
            let turn = match upwards {
                true => format!(" transform=\"rotate(-90 {x:.1} {y:.1})\""),
                false => String::new(),
            };
            writeln!(
                out,
                "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{size}\" text-anchor=\"{anchor}\" \
                 style=\"fill:{}{weight}\"{turn}>{}</text>",
                colours.of(*ink),
                escape(text)
            )
        }
    };
}
