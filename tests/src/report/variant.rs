//! What is compared: a mesher, the metric that it goes by, and whether its vertices morph.

use escarp_client::mesh::{DEFAULT_MORPH, MeshOptions, MesherKind, Metric};
use serde::{Serialize, Serializer};
use std::fmt;
use std::str::FromStr;

/// What the name of a variant with morph ends in.
const MORPH: &str = "+morph";

/// A mesher with its metric, and with or without morph.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Variant {
    /// The mesher.
    pub mesher: MesherKind,
    /// What it takes for a triangle's error.
    pub metric: Metric,
    /// Vertices come and go gradually.
    pub morph: bool,
}

impl Variant {
    /// Every mesher, and the quadtree with morph and with the article's metric.
    pub fn all() -> Vec<Variant> {
        let bounding = MesherKind::ALL.iter().map(|&mesher| Variant {
            mesher,
            metric: Metric::Bounding,
            morph: false,
        });
        let quadtree = |metric, morph| Variant {
            mesher: MesherKind::Quadtree,
            metric,
            morph,
        };
        let others = [
            quadtree(Metric::Bounding, true),
            quadtree(Metric::Local, false),
        ];
        bounding.chain(others).collect()
    }

    /// What clients do if nobody says otherwise.
    pub fn usual() -> Variant {
        let MeshOptions { mesher, metric, .. } = MeshOptions::default();
        Variant {
            mesher,
            metric,
            morph: false,
        }
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
            morph: if self.morph { DEFAULT_MORPH } else { 0.0 },
            ..MeshOptions::default()
        }
    }
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.mesher)?;
        if self.metric != Metric::default() {
            write!(f, ":{}", self.metric)?;
        }
        f.write_str(if self.morph { MORPH } else { "" })
    }
}

impl FromStr for Variant {
    type Err = String;

    /// `MESHER`, `MESHER:METRIC`, either with `+morph`.
    fn from_str(text: &str) -> Result<Variant, String> {
        let (text, morph) = match text.strip_suffix(MORPH) {
            Some(text) => (text, true),
            None => (text, false),
        };
        let (mesher, metric) = match text.split_once(':') {
            Some((mesher, metric)) => (mesher, metric.parse()?),
            None => (text, Metric::default()),
        };
        Ok(Variant {
            mesher: mesher.parse()?,
            metric,
            morph,
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
