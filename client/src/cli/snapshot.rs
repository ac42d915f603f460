//! `escarp-client snapshot`.

use super::arguments::{FOV_Y, LookArgs, ServerArgs};
use crate::app::headless::{Driver, Painter, save};
use crate::camera::look_at;
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use std::time::Duration;

#[derive(Debug, Args)]
pub(super) struct SnapshotArgs {
    #[command(flatten)]
    server: ServerArgs,
    #[command(flatten)]
    look: LookArgs,
    /// Picture to write
    #[arg(short, long, value_name = "FILE.png")]
    output: PathBuf,
    /// Longest wait for the picture to come within the tolerance, seconds
    #[arg(long, default_value_t = 60, value_name = "S")]
    wait: u64,
}

pub(super) fn run(args: &SnapshotArgs) -> Result<()> {
    let mut driver = Driver::new(args.server.open());
    let wait = Duration::from_secs(args.wait);
    let manifest = driver.connect(wait)?;
    let connected_s = driver.now().as_secs_f64();
    let (eye, look) = args.look.resolve(&manifest);
    let view = look_at(eye, look, FOV_Y, args.look.size.0, args.look.error_px);
    view.check()?;
    // The first wishes travel while the adapter is being opened.
    driver.step(&view);
    let mut painter = Painter::new(&manifest, args.look.size.0)?;
    let stats = driver.settle(&view, wait)?;
    let first_s = driver.first_picture().map_or(f64::NAN, |t| t.as_secs_f64());
    let settled_s = driver.now().as_secs_f64();
    let image = painter.paint(&driver.client, view, args.look.wireframe)?;
    save(&image, &args.output)?;
    println!(
        "{}: {} triangles, {} pages, {} bytes received, error bound {:.3} px of {} px; \
         connected after {connected_s:.3} s, first triangles after {first_s:.3} s, all here after \
         {settled_s:.3} s",
        args.output.display(),
        stats.triangles,
        stats.pages_resident,
        stats.bytes_received,
        stats.bound_px,
        args.look.error_px,
    );
    if !stats.converged {
        eprintln!(
            "warning: the picture is not within the tolerance: {} pages are missing; {}",
            stats.pages_wanted,
            crate::app::TerrainClient::status(&driver.client)
        );
    }
    Ok(())
}
