//! Widths and outlines of text, in the font that the viewer's text has.

use skrifa::instance::{LocationRef, Size};
use skrifa::outline::{DrawSettings, OutlinePen};
use skrifa::{FontRef, GlyphId, MetadataProvider};
use vello_cpu::kurbo::BezPath;

/// A font of which nothing is missing for numbers and Latin text.
pub struct Font(FontRef<'static>);

/// Collects an outline, `y` downwards.
struct Pen {
    path: BezPath,
    x: f64,
    y: f64,
}

impl Pen {
    fn at(&self, x: f32, y: f32) -> (f64, f64) {
        (self.x + f64::from(x), self.y - f64::from(y))
    }
}

impl OutlinePen for Pen {
    fn move_to(&mut self, x: f32, y: f32) {
        self.path.move_to(self.at(x, y));
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.path.line_to(self.at(x, y));
    }

    fn quad_to(&mut self, cx: f32, cy: f32, x: f32, y: f32) {
        self.path.quad_to(self.at(cx, cy), self.at(x, y));
    }

    fn curve_to(&mut self, cx0: f32, cy0: f32, cx1: f32, cy1: f32, x: f32, y: f32) {
        self.path
            .curve_to(self.at(cx0, cy0), self.at(cx1, cy1), self.at(x, y));
    }

    fn close(&mut self) {
        self.path.close_path();
    }
}

impl Font {
    /// The font that comes with the program; `None` if it is damaged.
    pub fn load() -> Option<Font> {
        FontRef::new(epaint_default_fonts::UBUNTU_LIGHT)
            .ok()
            .map(Font)
    }

    fn glyphs(&self, text: &str) -> Vec<GlyphId> {
        let map = self.0.charmap();
        let glyph = |c: char| map.map(c).unwrap_or_default();
        text.chars().map(glyph).collect()
    }

    /// Room for a text in whatever font it is shown in, in the unit of its size.
    pub fn room(&self, text: &str, size: f64) -> f64 {
        // Of the fonts that browsers fall back to, DejaVu Sans is the widest.
        1.16 * self.width(text, size)
    }

    /// Width of a text, in the unit of its size.
    pub fn width(&self, text: &str, size: f64) -> f64 {
        let metrics = self
            .0
            .glyph_metrics(Size::new(size as f32), LocationRef::default());
        let advance = |glyph| f64::from(metrics.advance_width(glyph).unwrap_or(0.0));
        self.glyphs(text).into_iter().map(advance).sum()
    }

    /// Outline of a text whose baseline begins at the origin, `y` downwards.
    pub fn outline(&self, text: &str, size: f64) -> BezPath {
        let size = Size::new(size as f32);
        let metrics = self.0.glyph_metrics(size, LocationRef::default());
        let outlines = self.0.outline_glyphs();
        let mut pen = Pen {
            path: BezPath::new(),
            x: 0.0,
            y: 0.0,
        };
        for glyph in self.glyphs(text) {
            if let Some(outline) = outlines.get(glyph) {
                let settings = DrawSettings::unhinted(size, LocationRef::default());
                // A glyph that does not draw leaves its place empty.
                let _ = outline.draw(settings, &mut pen);
            }
            pen.x += f64::from(metrics.advance_width(glyph).unwrap_or(0.0));
        }
        pen.path
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_font_has_every_sign_that_plots_use() {
        let font = Font::load().unwrap();
        for sign in "0123456789.,%µ×≤≥±–²/()-_:abcXYZ".chars() {
            assert_ne!(font.0.charmap().map(sign), None, "{sign}");
        }
        assert!(font.width("error", 12.0) > 20.0);
        assert!(!font.outline("error", 12.0).is_empty());
    }
}
