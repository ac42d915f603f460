//! `escarp-client view`.

use super::arguments::{LookArgs, ServerArgs};
use crate::app::viewer::{self, ViewerOptions};
use anyhow::Result;
use clap::Args;

#[derive(Debug, Args)]
pub(super) struct ViewArgs {
    #[command(flatten)]
    server: ServerArgs,
    #[command(flatten)]
    look: LookArgs,
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
    Ok(viewer::run(args.server.open(), options)?)
}
