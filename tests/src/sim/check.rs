//! What must hold of a client's mesh in each frame.

use super::ground::Ground;
use crate::measure::{check_cracks, measure, triangles};
use crate::terrain::TempDataset;
use escarp_client::app::StepStats;
use escarp_client::mesh::MeshTree;
use escarp_client::terrain::Terrain;
use escarp_proto::view::View;

/// What rounding may add to a measured deviation, in tolerances.
const ROUNDING: f64 = 1e-9;

/// The generation that a terrain shows.
///
/// # Errors
/// If there is none of its manifest.
pub fn shown<'a>(ground: &'a Ground, terrain: &Terrain) -> Result<&'a TempDataset, String> {
    let manifest = terrain.manifest();
    let none = || format!("generation {} was never published", manifest.generation);
    ground.samples(manifest).ok_or_else(none)
}

/// No crack, and no height but those of this generation. Triangles, drawn or not.
///
/// # Errors
/// What does not hold.
pub fn check_mesh(tree: &MeshTree, data: &TempDataset) -> Result<usize, String> {
    let triangles = triangles(tree);
    for triangle in triangles.iter().filter(|triangle| triangle.drawn) {
        for (x, y, height) in triangle.corners {
            let sample = data.sample(x, y);
            if sample != Some(height) {
                let generation = data.dataset.manifest().generation;
                return Err(format!(
                    "vertex {x}, {y} is at {height}, and at {sample:?} in generation {generation}"
                ));
            }
        }
    }
    check_cracks(tree, data.dataset.grid().cells_per_side())
}

/// The stated bound holds of what is in view.
///
/// # Errors
/// What does not hold.
pub fn check_bound(
    tree: &MeshTree,
    data: &TempDataset,
    view: &View,
    stats: &StepStats,
) -> Result<(), String> {
    let used = View {
        max_screen_error_px: stats.tolerance_px,
        ..*view
    };
    let stated = stats.bound_px / f64::from(stats.tolerance_px);
    let found = measure(tree, data, &used, true);
    match found.largest <= stated.max(1.0) + ROUNDING {
        true => Ok(()),
        false => Err(format!("the stated bound is {stated}, but {found:?}")),
    }
}

/// A mesh to which nothing is to be added keeps the tolerance.
///
/// # Errors
/// What does not hold.
pub fn check_converged(
    tree: &MeshTree,
    data: &TempDataset,
    view: &View,
    stats: &StepStats,
) -> Result<(), String> {
    let excess = stats.bound_px / f64::from(stats.tolerance_px);
    if !stats.converged || excess > 1.0 {
        return Err(format!("at rest, but not converged: {stats:?}"));
    }
    let used = View {
        max_screen_error_px: stats.tolerance_px,
        ..*view
    };
    let found = measure(tree, data, &used, tree.options().cull);
    let right = found.largest <= 1.0 + ROUNDING && (found.left_out, found.covered) == (0, 0);
    match right {
        true => Ok(()),
        false => Err(format!("converged, but {found:?}")),
    }
}
