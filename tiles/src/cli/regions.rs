//! What the user says of how exactly places are to be stored.

use crate::build::{BuildError, Coarsened, Quantum, Tolerances, Wish, choose_quantum};
use crate::dem::DemSource;
use clap::Args;
use std::path::PathBuf;

/// Where the dataset may be coarser than its inputs.
#[derive(Debug, Clone, Args)]
pub(super) struct RegionArgs {
    /// Metres that stored heights may differ from the inputs; with a file, inside its polygons
    /// (GeoJSON, in the CRS of the inputs) or where it is not 0 (a raster on the inputs' lattice).
    /// Can be given several times: the first file that holds a place counts, and elsewhere the
    /// number without a file, or 0
    #[arg(long = "tolerance", value_name = "M[:FILE]", value_parser = wish)]
    tolerances: Vec<Wish>,
    /// Metres that stored heights may differ from inputs coarser than the finest where only they
    /// count; default: their samples are exact where they lie 16 cells apart or more, else all
    /// heights are
    #[arg(long, value_name = "M", value_parser = length)]
    base_tolerance: Option<f64>,
}

fn length(text: &str) -> Result<f64, String> {
    let metres = text.parse().ok();
    metres
        .filter(|m: &f64| m.is_finite() && *m >= 0.0)
        .ok_or_else(|| format!("{text:?} is no length in metres, 0 or more"))
}

fn wish(text: &str) -> Result<Wish, String> {
    let (metres, file) = match text.split_once(':') {
        Some((metres, file)) => (metres, Some(PathBuf::from(file))),
        None => (text, None),
    };
    let tolerance_m: f64 = metres
        .parse()
        .map_err(|_| format!("{metres:?} is no number of metres"))?;
    if !tolerance_m.is_finite() || tolerance_m < 0.0 {
        return Err(format!("{tolerance_m} m, allowed are 0 and more"));
    }
    if file
        .as_ref()
        .is_some_and(|file| file.as_os_str().is_empty())
    {
        return Err("no file is named after the colon".into());
    }
    Ok(Wish {
        tolerance_m,
        region: file,
    })
}

impl RegionArgs {
    /// The source as coarse as it may be, and the quantum that it is in.
    pub(super) fn coarsen(
        &self,
        mut source: Box<dyn DemSource>,
        quantum: Quantum,
    ) -> Result<(Box<dyn DemSource>, Quantum), BuildError> {
        let is_nested = source.is_nested();
        if self.tolerances.is_empty() && !is_nested {
            return Ok((source, quantum));
        }
        let quantum_m = choose_quantum(&mut *source, quantum)?;
        let mut tolerances = Tolerances::open(&self.tolerances, source.info())?;
        if is_nested {
            tolerances = tolerances.with_base(self.base_tolerance, quantum_m, source.info())?;
        }
        let coarsened = Coarsened::new(source, quantum_m, tolerances)?;
        Ok((Box::new(coarsened), Quantum::Metres(quantum_m)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tolerance_is_a_length_with_or_without_a_file() {
        let plain = wish("2.5").unwrap();
        assert_eq!((plain.tolerance_m, plain.region), (2.5, None));
        let road = wish("0:a:b.geojson").unwrap();
        assert_eq!(road.region, Some(PathBuf::from("a:b.geojson")));
        for wrong in ["", "x", "-1", "nan", "inf", "3:", ":a.tif"] {
            assert!(wish(wrong).is_err(), "{wrong}");
        }
    }
}
