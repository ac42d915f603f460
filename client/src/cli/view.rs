//! `escarp-client view`.

use super::arguments::{FrameBudget, LookArgs, MeshArgs, ServerArgs};
use crate::app::viewer::{self, ViewerOptions};
use anyhow::Result;
use clap::Args;

#[derive(Debug, Args)]
pub(super) struct ViewArgs {
    #[command(flatten)]
    server: ServerArgs,
    #[command(flatten)]
    look: LookArgs,
    #[command(flatten)]
    mesh: MeshArgs,
    /// Most milliseconds of a frame's work; pages that arrive faster wait. Or auto: half of what the
    /// rest of a frame takes, 8 at least and 125 at most; or none
    #[arg(long, default_value = "auto", value_name = "MS")]
    frame_budget_ms: FrameBudget,
}

pub(super) fn run(args: ViewArgs) -> Result<()> {
    let options = ViewerOptions {
        title: "Escarp".into(),
        size: args.look.size.0,
        error_px: args.look.error_px,
        wireframe: args.look.wireframe,
        start: args.look.given(),
        ..ViewerOptions::default()
    };
    let client = args
        .server
        .open(&args.mesh.in_motion(), args.frame_budget_ms)?;
    Ok(viewer::run(client, options)?)
}
