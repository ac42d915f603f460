//! Where meshes are examined: views of a dataset, and what is held against each mesh.

use super::{Outcome, Verdict};
use crate::feed::Feed;
use crate::measure::{check_cracks, is_grid_line, measure};
use crate::terrain::{FunctionSource, TempDataset};
use escarp_client::mesh::{MeshOptions, MeshTree, MesherKind};
use escarp_proto::geometry::PAGE_SAMPLES;
use escarp_proto::page::{MAX_HEIGHT, PAGE_AREA};
use escarp_proto::view::{FARTHEST_EYE_M, View};

/// No case takes more updates than this until nothing is wished for.
const MOST_UPDATES: u32 = 200;
/// What rounding in double precision may add to a measured share of a bound.
pub const ROUNDING: f64 = 1e-9;

/// A dataset from a function of column and row, 10 m apart, in whole metres.
pub fn ground(
    width: u32,
    height: u32,
    heights: impl Fn(u32, u32) -> f64 + Send + 'static,
) -> TempDataset {
    TempDataset::build(&mut FunctionSource::new(width, height, heights))
}

/// A view of 1280 x 720 px.
pub fn view(eye_m: [f64; 3], look_m: [f64; 3], error_px: f32) -> View {
    let way: [f64; 3] = std::array::from_fn(|i| look_m[i] - eye_m[i]);
    let longest = way.iter().fold(0.0f64, |most, v| most.max(v.abs()));
    let direction = match longest > 0.0 {
        true => way.map(|v| (v / longest) as f32),
        false => [0.0, 1.0, 0.0],
    };
    View {
        eye_m,
        direction,
        velocity_m_s: [0.0; 3],
        fov_y: 1.0,
        viewport_px: [1280, 720],
        max_screen_error_px: error_px,
    }
}

/// Eyes over a dataset: in its middle, a little over and within its heights, at a corner, aside,
/// and in orbit. All look at the middle.
pub fn views(data: &TempDataset, error_px: f32) -> Vec<View> {
    let [x, y, z] = data.dataset.manifest().extent_m();
    let [dx, dy] = data.dataset.manifest().georef.sample_spacing_m;
    let middle = [x, y, z].map(|[from, to]| from + (to - from) / 2.0);
    let size = (x[1] - x[0]).max(y[1] - y[0]).max(dx).max(dy);
    let eyes = [
        [
            middle[0] + dx * 0.3,
            middle[1] + dy * 0.4,
            z[1] + size * 0.02,
        ],
        [
            middle[0] - dx * 0.2,
            middle[1] - dy * 0.1,
            middle[2] + dx * 0.05,
        ],
        [x[0] + dx * 0.3, y[0] + dy * 0.2, z[0] + dx * 0.1],
        [x[0] - size, y[1] + size, z[1] + size],
        [middle[0], middle[1], z[1] + size * 100.0],
    ];
    let within = |eye: [f64; 3]| eye.map(|v| v.clamp(-FARTHEST_EYE_M, FARTHEST_EYE_M));
    eyes.map(|eye| view(within(eye), middle, error_px)).to_vec()
}

/// What an examination of meshes came to.
#[derive(Debug, Clone, Default)]
pub struct Found {
    /// Most drawn triangles of any mesh.
    pub triangles: usize,
    /// Largest measured deviation, in tolerances.
    pub deviation: f64,
    /// Largest share of the stated bound that was measured.
    pub share: f64,
    /// Largest stated bound, in tolerances.
    pub excess: f64,
    /// Most updates until nothing was wished for.
    pub updates: u32,
    /// Samples and crossings compared.
    pub compared: u64,
    /// Edges of triangles, and how many are not on lines that finest triangles lie between.
    pub edges: u64,
    /// See [`edges`](Self::edges).
    pub leaving: u64,
    /// What does not hold.
    pub faults: Vec<String>,
}

impl Found {
    /// Both together.
    pub fn and(mut self, other: Found) -> Found {
        self.triangles = self.triangles.max(other.triangles);
        self.deviation = self.deviation.max(other.deviation);
        self.share = self.share.max(other.share);
        self.excess = self.excess.max(other.excess);
        self.updates = self.updates.max(other.updates);
        self.compared += other.compared;
        self.edges += other.edges;
        self.leaving += other.leaving;
        self.faults.extend(other.faults);
        self
    }

    /// Notes a fault.
    pub fn fault(&mut self, what: impl Into<String>) {
        self.faults.push(what.into());
    }

    /// The row's outcome.
    pub fn outcome(self) -> Outcome {
        let measured = match self.compared {
            0 => "nothing is in view".into(),
            _ => format!(
                "deviation {} in {} triangles",
                short(self.deviation),
                self.triangles
            ),
        };
        self.outcome_with(measured)
    }

    /// The row's outcome, with other words for what was measured.
    pub fn outcome_with(self, measured: impl Into<String>) -> Outcome {
        let verdict = match self.faults.first() {
            None => Verdict::Holds,
            Some(first) => Verdict::Fails(format!("{first} ({} in all)", self.faults.len())),
        };
        Outcome {
            measured: measured.into(),
            verdict,
        }
    }
}

/// A deviation in three digits, or without decimals where it is large.
pub fn short(deviation: f64) -> String {
    match deviation < 100.0 {
        true => format!("{deviation:.3}"),
        false => format!("{deviation:.0}"),
    }
}

/// The meshers that take part.
pub fn meshers() -> impl Iterator<Item = MeshOptions> {
    MesherKind::ALL.iter().map(|&mesher| MeshOptions {
        mesher,
        ..MeshOptions::default()
    })
}

/// Runs a case with every mesher. It holds if it does with each.
pub fn over_meshers(check: impl Fn(MeshOptions) -> Outcome) -> Outcome {
    let several = MesherKind::ALL.len() > 1;
    let mut measured = Vec::new();
    let mut verdict = Verdict::Holds;
    for options in meshers() {
        let name = options.mesher.name();
        let said = |text: &str| match several {
            true => format!("{name} {text}"),
            false => text.to_owned(),
        };
        let outcome = check(options);
        measured.push(said(&outcome.measured));
        verdict = match (verdict, outcome.verdict) {
            (Verdict::Fails(all), Verdict::Fails(why)) => {
                Verdict::Fails(format!("{all}; {}", said(&why)))
            }
            (failed @ Verdict::Fails(_), _) => failed,
            (_, Verdict::Fails(why)) => Verdict::Fails(said(&why)),
            (Verdict::Holds, other) | (other, Verdict::Holds) => other,
            (bounded, _) => bounded,
        };
    }
    Outcome {
        measured: measured.join("; "),
        verdict,
    }
}

/// Converges from nothing on each view, and holds against the mesh all that must hold of any.
pub fn examine(data: &TempDataset, options: MeshOptions, views: &[View]) -> Found {
    let mut found = Found::default();
    for view in views {
        if let Err(error) = view.check() {
            found.fault(format!("the case itself is wrong: {error}"));
            continue;
        }
        let mut feed = Feed::with_options(&data.dataset, options);
        match feed.converge_within(MOST_UPDATES, view) {
            Err(why) => found.fault(why),
            Ok(stats) => hold(&mut feed.tree, data, view, stats.excess, true, &mut found),
        }
    }
    found
}

/// Holds a mesh against the data: no crack, deviation within what is stated, buffers in order;
/// once converged, within the tolerance if the mesher keeps to it.
pub fn hold(
    tree: &mut MeshTree,
    data: &TempDataset,
    view: &View,
    excess: f64,
    converged: bool,
    found: &mut Found,
) {
    let keeps = tree.options().mesher.keeps_tolerance();
    if excess.is_nan() || (converged && keeps && excess > 1.0) {
        found.fault(format!("the stated bound is {excess} tolerances"));
    }
    if let Err(why) = check_cracks(tree, data.dataset.grid().cells_per_side()) {
        found.fault(why);
    }
    check_buffers(tree, found);
    found.excess = found.excess.max(excess);
    if !excess.is_finite() {
        return;
    }
    let deviation = measure(tree, data, view, true);
    let stated = excess.max(1.0);
    found.compared += deviation.samples + deviation.crossings;
    found.deviation = found.deviation.max(deviation.largest);
    found.share = found.share.max(deviation.largest / stated);
    if deviation.largest.is_nan() || deviation.largest > stated + ROUNDING {
        let (largest, worst) = (deviation.largest, deviation.worst);
        found.fault(format!(
            "deviation of {largest} tolerances where {stated} are stated: {worst:?}"
        ));
    }
    if converged && keeps && (deviation.left_out > 0 || deviation.covered > 0) {
        let (left_out, covered) = (deviation.left_out, deviation.covered);
        found.fault(format!(
            "outlines: {left_out} samples left out, {covered} holes covered"
        ));
    }
}

/// What goes to the GPU is in order: finite, in range, and as many triangles as the mesh has.
fn check_buffers(tree: &mut MeshTree, found: &mut Found) {
    let triangles = tree.triangulate();
    let mut drawn = 0;
    tree.visit_triangles(|triangle| {
        drawn += u64::from(triangle.drawn);
        let [a, b, c] = triangle.corners;
        let leaving = [(a, b), (b, c), (c, a)].map(|(from, to)| !is_grid_line(from, to));
        found.edges += 3;
        found.leaving += leaving.iter().filter(|leaves| **leaves).count() as u64;
    });
    if triangles != drawn {
        found.fault(format!(
            "{triangles} triangles to draw, {drawn} in the mesh"
        ));
    }
    found.triangles = found.triangles.max(drawn as usize);
    for mesh in tree.meshes() {
        let sound = mesh.vertices.len() == PAGE_SAMPLES * PAGE_SAMPLES
            && mesh.indices.len().is_multiple_of(3)
            && mesh.indices.iter().all(|&i| usize::from(i) < PAGE_AREA);
        let used = || mesh.indices.iter().map(|&i| mesh.vertices[usize::from(i)]);
        let heights = || used().all(|vertex| vertex.height.abs() <= MAX_HEIGHT);
        let bounded = (0..3).all(|axis| {
            let (min, max) = (mesh.bounds.min[axis], mesh.bounds.max[axis]);
            min.is_finite() && max.is_finite() && min <= max
        });
        if !sound || !heights() || !bounded {
            found.fault(format!("the buffers of page {} are not in order", mesh.id));
        }
    }
}

/// Whether what the mesher keeps is what a recomputation gives, and every flag and count what the
/// same pages and view give from nothing.
pub fn check_history(tree: &MeshTree, data: &TempDataset, view: &View) -> Result<(), String> {
    tree.check(view)?;
    // ROAM's order of splits depends on the way there.
    if tree.options().mesher == MesherKind::Roam {
        return Ok(());
    }
    let manifest = data.dataset.manifest();
    let (grid, georef) = (manifest.grid_levels, manifest.georef.clone());
    let mut anew = MeshTree::with_options(grid, georef, *tree.options());
    let mut pages: Vec<_> = tree.pages().cloned().collect();
    pages.sort_by_key(|page| page.id().key());
    for page in pages {
        anew.link(page).map_err(|error| error.to_string())?;
    }
    anew.update(view);
    let (found, right) = (tree.flags(), anew.flags());
    if found == right {
        return Ok(());
    }
    let differ = found.iter().filter(|flag| !right.contains(flag)).count()
        + right.iter().filter(|flag| !found.contains(flag)).count();
    Err(format!(
        "{differ} of {} flags are not those of a recomputation",
        right.len()
    ))
}
