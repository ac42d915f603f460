//! A drawing as PNG, on white.

use super::drawing::{Anchor, Drawing, Ink, Shape};
use super::font::Font;
use anyhow::{Context, Result};
use image::{ImageFormat, RgbImage};
use std::io::Cursor;
use vello_cpu::color::{AlphaColor, Srgb};
use vello_cpu::kurbo::{Affine, BezPath, Cap, Join, Stroke, Vec2};
use vello_cpu::{Pixmap, RenderContext, Resources};

/// Pixels of the picture a pixel of the drawing.
const SCALE: f64 = 2.0;

/// The PNG file of a drawing.
///
/// # Errors
/// If the drawing is too large for a picture, or there is no font.
pub fn png(drawing: &Drawing) -> Result<Vec<u8>> {
    let font = Font::load().context("the program's font is damaged")?;
    let [width, height] = drawing.size.map(|side| (side * SCALE).ceil());
    let fits = (1.0..=16_384.0).contains(&width) && (1.0..=16_384.0).contains(&height);
    anyhow::ensure!(
        fits,
        "a picture of {width} x {height} pixels, allowed are 16384 a side"
    );
    let (width, height) = (width as u16, height as u16);
    let mut context = RenderContext::new(width, height);
    context.set_transform(Affine::scale(SCALE));
    paint(&mut context, Ink::Paper, 1.0);
    context.fill_path(&polygon(&[
        [0.0, 0.0],
        [drawing.size[0], 0.0],
        drawing.size,
        [0.0, drawing.size[1]],
    ]));
    for shape in &drawing.shapes {
        one(&mut context, &font, shape);
    }
    let mut pixmap = Pixmap::new(width, height);
    context.flush();
    context.render(&mut pixmap, &mut Resources::new());
    let pixels = pixmap.data().iter().flat_map(|p| [p.r, p.g, p.b]).collect();
    let image = RgbImage::from_raw(width.into(), height.into(), pixels);
    let mut file = Cursor::new(Vec::new());
    image
        .context("a picture of another size than drawn")?
        .write_to(&mut file, ImageFormat::Png)?;
    Ok(file.into_inner())
}

fn paint(context: &mut RenderContext, ink: Ink, opacity: f64) {
    let [r, g, b] = ink.light();
    let alpha = (opacity * 255.0).round() as u8;
    context.set_paint(AlphaColor::<Srgb>::from_rgba8(r, g, b, alpha));
}

fn open(points: &[[f64; 2]]) -> BezPath {
    let mut path = BezPath::new();
    for (i, &[x, y]) in points.iter().enumerate() {
        match i {
            0 => path.move_to((x, y)),
            _ => path.line_to((x, y)),
        }
    }
    path
}

fn polygon(points: &[[f64; 2]]) -> BezPath {
    let mut path = open(points);
    if !points.is_empty() {
        path.close_path();
    }
    path
}

fn one(context: &mut RenderContext, font: &Font, shape: &Shape) {
    match shape {
        Shape::Line {
            points,
            ink,
            width,
            dash,
        } => {
            paint(context, *ink, 1.0);
            let mut stroke = Stroke::new(*width)
                .with_join(Join::Round)
                .with_caps(Cap::Butt);
            if !dash.is_empty() {
                stroke = stroke.with_dashes(0.0, dash.iter().copied());
            }
            context.set_stroke(stroke);
            context.stroke_path(&open(points));
        }
        Shape::Fill {
            points,
            ink,
            opacity,
        } => {
            paint(context, *ink, *opacity);
            context.fill_path(&polygon(points));
        }
        Shape::Text {
            at,
            text,
            size,
            anchor,
            ink,
            bold,
            upwards,
        } => {
            paint(context, *ink, 1.0);
            let width = font.width(text, *size);
            let shift = match anchor {
                Anchor::Start => 0.0,
                Anchor::Middle => -width / 2.0,
                Anchor::End => -width,
            };
            let turn = if *upwards {
                -std::f64::consts::FRAC_PI_2
            } else {
                0.0
            };
            let place = Affine::translate(Vec2::new(at[0], at[1]))
                * Affine::rotate(turn)
                * Affine::translate(Vec2::new(shift, 0.0));
            let outline = place * font.outline(text, *size);
            context.fill_path(&outline);
            // The font is a light one.
            context.set_stroke(Stroke::new(if *bold { 0.7 } else { 0.25 }));
            context.stroke_path(&outline);
        }
    }
}
