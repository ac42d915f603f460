//! What the user says of the grid that inputs are brought to.

use crate::crs;
use crate::dem::{Crs, DemSource};
use crate::place::{Interpolation, Stated, Wish, place};
use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use std::path::Path;

/// The grid of the dataset, where it is not that of the inputs.
#[derive(Debug, Clone, Args)]
pub(super) struct GridArgs {
    /// Bring inputs to this CRS: EPSG:code, a PROJ string, WKT, or a file with WKT (.prj)
    #[arg(long, value_name = "CRS")]
    crs: Option<String>,
    /// Keep only what lies inside, in the units of the dataset's CRS: degrees if that is geographic
    /// (then WEST may be larger than EAST, across the date line), metres from the south-west sample
    /// without georeference
    #[arg(long, value_name = "W,S,E,N", allow_hyphen_values = true, value_parser = bounds)]
    bounds: Option<[f64; 4]>,
    /// How heights between samples are found, with --crs and --spacing
    #[arg(long, value_name = "HOW", default_value = "linear")]
    interpolation: How,
    /// State what heights are above, such as "EGM96 height"; they are not changed
    #[arg(long, value_name = "TEXT")]
    vertical: Option<String>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum How {
    /// From the four samples around
    Linear,
    /// From sixteen samples around
    Cubic,
}

impl GridArgs {
    /// The source on that grid. `spacing` is in the units of its CRS.
    pub(super) fn place(
        &self,
        source: Box<dyn DemSource>,
        spacing: Option<f64>,
    ) -> Result<Box<dyn DemSource>> {
        let wish = Wish {
            crs: self.crs.as_deref().map(read_crs).transpose()?,
            spacing,
            bounds: self.bounds,
            interpolation: match self.interpolation {
                How::Linear => Interpolation::Linear,
                How::Cubic => Interpolation::Cubic,
            },
        };
        let source = place(source, &wish)?;
        let Some(text) = &self.vertical else {
            return Ok(source);
        };
        match crs::vertical::from_text(text) {
            Some(vertical) => Ok(Box::new(Stated::new(source, vertical))),
            None => bail!("--vertical is empty; say what heights are above"),
        }
    }
}

/// Four numbers: west, south, east, north.
pub(super) fn bounds(text: &str) -> Result<[f64; 4], String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|number| {
            let number = number.trim();
            let parsed = number.parse().ok().filter(|v: &f64| v.is_finite());
            parsed.ok_or_else(|| format!("{number:?} is no number"))
        })
        .collect::<Result<_, _>>()?;
    let [west, south, east, north] = numbers[..] else {
        let found = numbers.len();
        return Err(format!("{found} numbers; give west,south,east,north"));
    };
    if south > north {
        return Err(format!(
            "the south, {south}, is north of the north, {north}"
        ));
    }
    Ok([west, south, east, north])
}

/// A CRS as it is written on the command line, or in a file.
pub(super) fn read_crs(text: &str) -> Result<Crs> {
    let path = Path::new(text);
    let written = if path.is_file() {
        let limit = crs::wkt::MAX_BYTES as u64;
        let length = path
            .metadata()
            .with_context(|| format!("cannot read {text}"))?
            .len();
        if length > limit {
            bail!("{text}: {length} bytes, at most {limit} are allowed in a file with WKT");
        }
        std::fs::read_to_string(path).with_context(|| format!("cannot read {text}"))?
    } else {
        text.to_owned()
    };
    crs::from_user(&written).map_err(|why| anyhow::anyhow!("--crs {text}: {why}"))
}
