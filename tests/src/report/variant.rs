//! What is compared: a mesher, and the metric that it goes by.

use escarp_client::mesh::{MeshOptions, MesherKind, Metric};
use serde::{Serialize, Serializer};
use std::fmt;
use std::str::FromStr;

/// A mesher with its metric.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Variant {
    /// The mesher.
    pub mesher: MesherKind,
    /// What it takes for a triangle's error.
    pub metric: Metric,
}

impl Variant {
    /// Every mesher, and the quadtree with the article's metric.
    pub fn all() -> Vec<Variant> {
        let bounding = MesherKind::ALL.iter().map(|&mesher| Variant {
            mesher,
            metric: Metric::Bounding,
        });
        let article = Variant {
            mesher: MesherKind::Quadtree,
            metric: Metric::Local,
        };
        bounding.chain([article]).collect()
    }

    /// Whether it promises to keep the tolerance.
    pub fn keeps_tolerance(self) -> bool {
        self.mesher.keeps_tolerance() && self.metric == Metric::Bounding
    }

    /// The mesh tree's options.
    pub fn options(self) -> MeshOptions {
        MeshOptions {
            mesher: self.mesher,
            metric: self.metric,
            ..MeshOptions::default()
        }
    }
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.metric {
            Metric::Bounding => write!(f, "{}", self.mesher),
            metric => write!(f, "{}:{metric}", self.mesher),
        }
    }
}

impl FromStr for Variant {
    type Err = String;

    /// `MESHER` or `MESHER:METRIC`.
    fn from_str(text: &str) -> Result<Variant, String> {
        let (mesher, metric) = match text.split_once(':') {
            Some((mesher, metric)) => (mesher, metric.parse()?),
            None => (text, Metric::default()),
        };
        Ok(Variant {
            mesher: mesher.parse()?,
            metric,
        })
    }
}

impl Serialize for Variant {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_variant_is_found_by_its_name_and_others_are_refused() {
        for variant in Variant::all() {
            assert_eq!(variant.to_string().parse(), Ok(variant));
        }
        let error = "rome".parse::<Variant>().unwrap_err();
        assert!(
            error.contains("\"rome\"") && error.contains("quadtree"),
            "{error}"
        );
        assert!("quadtree:best".parse::<Variant>().is_err());
    }
}
