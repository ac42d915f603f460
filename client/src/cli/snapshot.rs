//! `escarp-client snapshot`.

use super::arguments::{FOV_Y, FrameBudget, LookArgs, MeshArgs, ServerArgs};
use crate::app::TerrainClient;
use crate::app::headless::{Driver, Painter, save};
use crate::camera::look_at;
use anyhow::{Result, bail};
use clap::Args;
use std::path::{Path, PathBuf};
use std::time::Duration;

#[derive(Debug, Args)]
pub(super) struct SnapshotArgs {
    #[command(flatten)]
    server: ServerArgs,
    #[command(flatten)]
    look: LookArgs,
    #[command(flatten)]
    mesh: MeshArgs,
    /// Most milliseconds of a step's work; pages that arrive faster wait. Or none
    #[arg(long, default_value = "none", value_name = "MS")]
    frame_budget_ms: FrameBudget,
    /// Picture to write
    #[arg(short, long, value_name = "FILE.png")]
    output: PathBuf,
    /// Longest wait for the picture to come within the tolerance, seconds
    #[arg(long, default_value_t = 60, value_name = "S", value_parser = clap::value_parser!(u64).range(..=86_400))]
    wait: u64,
}

pub(super) fn run(args: &SnapshotArgs) -> Result<()> {
    check_output(&args.output)?;
    let mut driver = Driver::new(args.server.open(&args.mesh, args.frame_budget_ms)?);
    let wait = Duration::from_secs(args.wait);
    let manifest = driver.connect(wait)?;
    let connected_s = driver.now().as_secs_f64();
    let (eye, look) = args.look.resolve(&manifest);
    let view = look_at(eye, look, FOV_Y, args.look.size.0, args.look.error_px);
    // The first wishes travel while the adapter is being opened.
    driver.step(&view);
    let mut painter = Painter::new(&manifest, args.look.size.0)?;
    let stats = driver.settle(&view, wait)?;
    let first = match driver.first_picture() {
        Some(time) => format!("first triangles after {:.3} s", time.as_secs_f64()),
        None => "no triangles".into(),
    };
    let settled_s = driver.now().as_secs_f64();
    for note in driver.client.notes() {
        eprintln!("note: {note}; the nearest that is allowed is shown");
    }
    let (view, _) = view.clamped();
    driver.check_same(&manifest)?;
    let painted = painter.paint(&driver.client, view, args.look.wireframe)?;
    save(&painted.image, &args.output)?;
    println!(
        "{}: {} triangles, {} pages, {} bytes received, error bound {:.3} px of {}; \
         connected after {connected_s:.3} s, {first}, settled after \
         {settled_s:.3} s",
        args.output.display(),
        stats.triangles,
        stats.pages_resident,
        stats.bytes_received,
        stats.bound_px,
        tolerance(stats.tolerance_px, args.look.error_px),
    );
    args.mesh.report_budget(std::iter::once(stats.triangles));
    if !stats.converged {
        let (lost, reasons) = driver.client.lost_pages();
        let why = match lost {
            0 => driver.client.status(),
            _ => format!("{lost} pages lost: {}", reasons.join("; ")),
        };
        bail!(
            "the picture is not within {} px: {} pages are missing ({why})",
            stats.tolerance_px,
            stats.pages_wanted
        );
    }
    Ok(())
}

/// The tolerance that was kept, and the one that was asked for if a budget widened it.
fn tolerance(used_px: f32, wished_px: f32) -> String {
    match used_px > wished_px {
        true => format!("{used_px:.3} px, widened from {wished_px} px to keep to the budget"),
        false => format!("{wished_px} px"),
    }
}

/// Says what is wrong with a path before anything is done for it.
fn check_output(path: &Path) -> Result<()> {
    if path
        .extension()
        .is_none_or(|ending| !ending.eq_ignore_ascii_case("png"))
    {
        bail!(
            "{}: pictures are PNG files; give a name that ends in .png",
            path.display()
        );
    }
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
        bail!("{}: there is no such folder", folder.display());
    }
    Ok(())
}
