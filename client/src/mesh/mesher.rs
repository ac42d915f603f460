//! What decides which vertices of a surface are enabled.

use super::quadtree::Quadtree;
use super::surface::{Index, Surface};
use escarp_proto::view::View;
use std::fmt::{self, Debug, Display};
use std::str::FromStr;

/// Decides which vertices are enabled.
///
/// A mesher enables and disables vertices of a [`Surface`] by asking for them
/// (`Surface::ask`), and wants what is missing. Whatever it asks for, the surface is without a
/// crack, and makes triangles of what has changed.
pub(super) trait Mesher: Debug + Send + Sync {
    /// Brings the enabled vertices up to date for a view that is in order, and wants what is
    /// missing. The root page is resident and its centre enabled. May be called several times in
    /// one update, as pages come that need no record.
    fn update(&mut self, surface: &mut Surface, view: &View) -> Found;

    /// A page is new, or has more parts than before.
    fn linked(&mut self, surface: &Surface, page: Index);

    /// A page has gone; none of its vertices was enabled, and another may take its index.
    fn unlinked(&mut self, page: Index);
}

/// What a mesher found.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Found {
    /// Largest bound of a triangle that stands and may be seen, over the tolerance. Where it is at
    /// most 1, it need be no more exact than that.
    pub(super) excess: f64,
    /// Squares whose triangles were tested.
    pub(super) squares: u64,
}

/// The meshers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum MesherKind {
    /// Ulrich's adaptive quadtree (2000), by bounds that hold.
    #[default]
    Quadtree,
}

impl MesherKind {
    /// All of them.
    pub const ALL: &[MesherKind] = &[MesherKind::Quadtree];

    /// Its name, as options and reports have it.
    pub const fn name(self) -> &'static str {
        match self {
            MesherKind::Quadtree => "quadtree",
        }
    }

    /// Whether its converged mesh is within the tolerance.
    pub const fn keeps_tolerance(self) -> bool {
        matches!(self, MesherKind::Quadtree)
    }
}

impl Display for MesherKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for MesherKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = MesherKind::ALL.iter().find(|kind| kind.name() == text);
        found.copied().ok_or_else(|| {
            let names: Vec<&str> = MesherKind::ALL.iter().map(|kind| kind.name()).collect();
            format!("{text:?} is no mesher; there are: {}", names.join(", "))
        })
    }
}

/// What a triangle's error is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Metric {
    /// A bound on the distance of the full-resolution surface from the triangle.
    #[default]
    Bounding,
    /// The article's: the distance of one vertex from the edge that it splits. It promises
    /// nothing, and is here for comparison.
    Local,
}

impl Display for Metric {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Metric::Bounding => "bounding",
            Metric::Local => "local",
        })
    }
}

impl FromStr for Metric {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "bounding" => Ok(Metric::Bounding),
            "local" => Ok(Metric::Local),
            _ => Err(format!(
                "{text:?} is no metric; there are bounding and local"
            )),
        }
    }
}

/// How a mesh tree meshes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MeshOptions {
    /// Which vertices are enabled.
    pub mesher: MesherKind,
    /// What counts as a triangle's error, for the meshers that go by error.
    pub metric: Metric,
    /// Most triangles, for the meshers that can keep to it.
    pub max_triangles: Option<u32>,
    /// Share of the tolerance over which vertices come and go gradually, at most
    /// [`MORPH_SHARES`](super::MORPH_SHARES)`[1]`; less than its least is off, and costs nothing.
    pub morph: f64,
}

impl MeshOptions {
    pub(super) fn mesher(&self) -> Box<dyn Mesher> {
        match self.mesher {
            MesherKind::Quadtree => Box::new(Quadtree::new(self)),
        }
    }
}
