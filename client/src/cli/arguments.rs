//! Arguments that the commands share, and how they are read.

use crate::camera::overview;
use crate::net::Url;
use crate::remote::RemoteTerrain;
use clap::Args;
use escarp_proto::manifest::Manifest;
use escarp_proto::view::SCREEN_ERRORS_PX;
use std::str::FromStr;

/// Vertical field of view, radians.
pub(super) const FOV_Y: f64 = std::f64::consts::FRAC_PI_3;

/// A position in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Position(pub(super) [f64; 3]);

impl FromStr for Position {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong =
            || format!("{text:?} is no position; write X,Y,Z in metres, such as 500,-1200,800");
        let numbers: Vec<f64> = text
            .split(',')
            .map(|part| part.trim().parse().map_err(|_| wrong()))
            .collect::<Result<_, _>>()?;
        let position: [f64; 3] = numbers.try_into().map_err(|_| wrong())?;
        if position.iter().all(|v| v.is_finite()) {
            Ok(Position(position))
        } else {
            Err(wrong())
        }
    }
}

/// Width and height of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Size(pub(super) [u32; 2]);

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!("{text:?} is no size; write WxH in pixels, 1x1 to 8192x8192, such as 1280x720")
        };
        let (width, height) = text.split_once('x').ok_or_else(wrong)?;
        let side = |text: &str| text.parse().ok().filter(|side| (1..=8192).contains(side));
        Ok(Size([
            side(width).ok_or_else(wrong)?,
            side(height).ok_or_else(wrong)?,
        ]))
    }
}

pub(super) fn error_px(text: &str) -> Result<f32, String> {
    let [least, most] = SCREEN_ERRORS_PX;
    let value: f32 = text.parse().map_err(|_| format!("{text:?} is no number"))?;
    if (least..=most).contains(&value) {
        Ok(value)
    } else {
        Err(format!("{value} px, allowed are {least} to {most}"))
    }
}

/// Where to connect to.
#[derive(Debug, Clone, Args)]
pub(super) struct ServerArgs {
    /// Address of the dataset, http://HOST:PORT/NAME
    #[arg(value_name = "URL")]
    url: Url,
    /// Most memory for resident pages, MB; the GPU's copy of what is drawn comes on top
    #[arg(long, default_value_t = 1024, value_name = "MB", value_parser = clap::value_parser!(u32).range(16..))]
    memory_mb: u32,
}

impl ServerArgs {
    pub(super) fn open(&self) -> RemoteTerrain {
        RemoteTerrain::open(self.url.clone(), (self.memory_mb as usize) << 20)
    }
}

/// From where to look, and how exactly.
#[derive(Debug, Clone, Args)]
pub(super) struct LookArgs {
    /// Position of the eye; default: a view of the whole
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    eye: Option<Position>,
    /// Position that is looked at; default: the middle of the data
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    look: Option<Position>,
    /// Tolerance: how far the mesh may be from the data on the screen, pixels
    #[arg(long, default_value_t = 2.0, value_parser = error_px, value_name = "P")]
    pub(super) error_px: f32,
    /// Size of the picture, pixels
    #[arg(long, default_value = "1280x720", value_name = "WxH")]
    pub(super) size: Size,
    /// Draw the triangles' edges
    #[arg(long)]
    pub(super) wireframe: bool,
}

impl LookArgs {
    /// What was said of eye and look, if anything.
    pub(super) fn given(&self) -> Option<([f64; 3], [f64; 3])> {
        Some((self.eye?.0, self.look?.0))
    }

    /// Eye and look; what was not said follows from the data.
    pub(super) fn resolve(&self, manifest: &Manifest) -> ([f64; 3], [f64; 3]) {
        let [width, height] = self.size.0;
        let (eye, look) = overview(manifest, FOV_Y, f64::from(width) / f64::from(height));
        (
            self.eye.map_or(eye, |p| p.0),
            self.look.map_or(look, |p| p.0),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_and_sizes_are_read_or_refused_with_the_right_form() {
        assert_eq!("1,-2.5, 3e3".parse(), Ok(Position([1.0, -2.5, 3000.0])));
        assert!("1,2".parse::<Position>().unwrap_err().contains("X,Y,Z"));
        assert!("1,2,NaN".parse::<Position>().is_err());
        assert_eq!("640x480".parse(), Ok(Size([640, 480])));
        assert!("640".parse::<Size>().unwrap_err().contains("WxH"));
        assert!("0x480".parse::<Size>().is_err());
        assert!(error_px("0").unwrap_err().contains("allowed"));
        assert_eq!(error_px("1.5"), Ok(1.5));
    }
}
