//! Plots: charts become drawings, and drawings SVG and PNG.

pub mod axis;
pub mod bars;
pub mod chart;
pub mod drawing;
pub mod font;
pub mod multiples;
pub mod png;
pub mod svg;

pub use axis::{Axis, Scale, number};
pub use bars::{Bar, Bars};
pub use chart::{At, Chart, Mark, Series, Style};
pub use drawing::Drawing;
