//! What decides which vertices of a surface are enabled.

use super::distance::Distance;
use super::levels::Levels;
use super::local::LocalQuadtree;
use super::morph::{MORPH_SHARES, Morph};
use super::quadtree::Quadtree;
use super::roam::Roam;
use super::surface::{Index, Surface};
use escarp_proto::view::View;
use escarp_proto::wire::Scope;
use std::fmt::{self, Debug, Display};
use std::str::FromStr;
use thiserror::Error;

/// Allowed ratios of distance to size. At the largest, squares of one level reach 128 of their
/// sides from the eye: at most `(2 * 128 + 2)^2` are split, whatever the tolerance.
pub const SPLIT_RATIOS: [f64; 2] = [1.0, 128.0];
/// Allowed levels of blocks: all samples, every second, fourth, eighth each way.
pub const BLOCK_LEVELS: [u8; 2] = [1, 4];

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

    /// Makes the next update test all anew, as after a change that no one foresaw. For measuring.
    fn forget(&mut self) {}

    /// A page has gone; none of its vertices was enabled, and another may take its index.
    fn unlinked(&mut self, page: Index);

    /// Whether it wants to know which vertices are enabled and disabled (`Surface::take_flips`).
    fn follows_flips(&self) -> bool {
        false
    }

    /// Memory that it takes, bytes, near enough for a cap.
    fn memory_bytes(&self) -> usize {
        0
    }

    /// Holds what it keeps from update to update against a recomputation, after an update for
    /// this view.
    ///
    /// # Errors
    /// What differs.
    fn check(&self, _: &Surface, _: &View) -> Result<(), String> {
        Ok(())
    }
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
    /// ROAM (Duchaineau et al., 1997; Turner, 2000), by the same bounds: the same mesh, but decided
    /// triangle by triangle, and able to keep to a number of triangles.
    Roam,
    /// Squares split by the ratio of distance to size alone.
    Distance,
    /// Blocks of fixed levels, chosen or by distance.
    Levels,
}

impl MesherKind {
    /// All of them.
    pub const ALL: &[MesherKind] = &[
        MesherKind::Quadtree,
        MesherKind::Roam,
        MesherKind::Distance,
        MesherKind::Levels,
    ];

    /// Its name, as options and reports have it.
    pub const fn name(self) -> &'static str {
        match self {
            MesherKind::Quadtree => "quadtree",
            MesherKind::Roam => "roam",
            MesherKind::Distance => "distance",
            MesherKind::Levels => "levels",
        }
    }

    /// Whether its converged mesh is within the tolerance.
    pub const fn keeps_tolerance(self) -> bool {
        matches!(self, MesherKind::Quadtree | MesherKind::Roam)
    }

    /// Whether it keeps to [`MeshOptions::max_triangles`] by itself.
    pub const fn keeps_triangles(self) -> bool {
        matches!(self, MesherKind::Roam)
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
    /// Share of the tolerance over which vertices come and go gradually, in [`MORPH_SHARES`]; 0 is
    /// off. For meshers that keep the tolerance; others take no notice of it.
    pub morph: f64,
    /// Vertices after whose change an update leaves the rest to the next one, for the meshers that
    /// can go on there.
    pub max_changes: Option<u32>,
    /// Ratio of distance to size within which `distance` and `levels` split, in [`SPLIT_RATIOS`];
    /// `None`: it follows the tolerance.
    pub split_ratio: Option<f64>,
    /// Level of all blocks of `levels`, in [`BLOCK_LEVELS`]; `None`: by distance.
    pub level: Option<u8>,
    /// Whether `quadtree`, by the bounding metric, leaves triangles that cannot be seen as they
    /// are: fewer triangles and pages, of which those beside the picture come when it turns there.
    pub cull: bool,
}

/// An option that no mesher can keep to.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{option} is {found}, allowed is {allowed}")]
pub struct MeshOptionsError {
    /// The option.
    pub option: &'static str,
    /// Its value.
    pub found: String,
    /// What may stand there.
    pub allowed: String,
}

impl MeshOptions {
    /// # Errors
    /// The first option that is out of its range.
    pub fn check(&self) -> Result<(), MeshOptionsError> {
        let error = |option, found: String, allowed: String| {
            Err(MeshOptionsError {
                option,
                found,
                allowed,
            })
        };
        let [least, most] = SPLIT_RATIOS;
        let allowed = |ratio: &f64| (least..=most).contains(ratio);
        if let Some(ratio) = self.split_ratio.filter(|ratio| !allowed(ratio)) {
            return error(
                "split_ratio",
                ratio.to_string(),
                format!("{least}..={most}"),
            );
        }
        let [least, most] = BLOCK_LEVELS;
        let allowed = |level: &u8| (least..=most).contains(level);
        if let Some(level) = self.level.filter(|level| !allowed(level)) {
            return error("level", level.to_string(), format!("{least}..={most}"));
        }
        let [least, most] = MORPH_SHARES;
        if self.morph != 0.0 && !(least..=most).contains(&self.morph) {
            let allowed = format!("0 or {least}..={most}");
            return error("morph", self.morph.to_string(), allowed);
        }
        Ok(())
    }

    /// The morph, if there is to be one: weights go by the bounds that the mesher tests.
    pub(super) fn morph(&self) -> Option<Morph> {
        let tested = self.mesher.keeps_tolerance() && self.metric == Metric::Bounding;
        Morph::of(self.morph).filter(|_| tested)
    }

    /// The view that triangles are really tested by, for one that is looked at: a morph needs a
    /// narrower tolerance.
    pub fn tested(&self, view: &View) -> View {
        self.morph().map_or(*view, |morph| morph.tested(view))
    }

    /// What of the terrain the mesh can use, if what it needs for a view is what
    /// `escarp_proto::select` finds: the pages of the quadtree by the bounding metric. `None` for
    /// the others.
    pub fn scope(&self) -> Option<Scope> {
        let selects = self.mesher == MesherKind::Quadtree && self.metric == Metric::Bounding;
        selects.then_some(match self.cull {
            true => Scope::InView,
            false => Scope::All,
        })
    }

    pub(super) fn mesher(&self) -> Box<dyn Mesher> {
        match self.mesher {
            MesherKind::Quadtree => match self.metric {
                Metric::Bounding => Box::new(Quadtree::new(self)),
                Metric::Local => Box::new(LocalQuadtree::default()),
            },
            MesherKind::Roam => Box::new(Roam::new(self)),
            MesherKind::Distance => Box::new(Distance::new(self)),
            MesherKind::Levels => Box::new(Levels::new(self)),
        }
    }
}
