//! From connecting, and from a teleport, to the picture: every kind of client over every line.

use super::client::{Job, Kind, Sight};
use super::figures::Outcome;
use super::lab::{End, Lab, SERVER, beside};
use super::places::Ground;
use super::server::Server;
use super::shaper::Cell;
use anyhow::{Context, Result};
use escarp_proto::view::View;
use escarp_tiles::dataset::Dataset;
use std::path::Path;

/// Names of the legs.
pub const LEGS: [&str; 2] = ["from connecting", "after a teleport"];

/// What is measured.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Lines.
    pub cells: Vec<Cell>,
    /// Clients.
    pub kinds: Vec<Kind>,
    /// Times that a streaming client is measured over a line with loss; else it is once.
    pub repeats: u32,
    /// The tolerance, pixels.
    pub error_px: f32,
    /// Longest time for a leg, seconds.
    pub limit_s: f64,
    /// Parameters of the kernel at both ends.
    pub parameters: Vec<(String, String)>,
}

impl Plan {
    /// Round trips of 0, 50 and 200 ms; 1, 10 and 100 Mbit/s; 0 and 1 % of loss.
    pub fn usual_cells() -> Vec<Cell> {
        let mut cells = Vec::new();
        for loss_percent in [0.0, 1.0] {
            for mbit_s in [1.0, 10.0, 100.0] {
                for round_trip_ms in [0.0, 50.0, 200.0] {
                    cells.push(Cell {
                        round_trip_ms,
                        mbit_s,
                        loss_percent,
                    });
                }
            }
        }
        cells
    }

    /// What is lost differs from run to run; a client that takes minutes is measured once all the
    /// same.
    fn repeats(&self, cell: &Cell, kind: Kind) -> u32 {
        match cell.loss_percent > 0.0 && kind != Kind::Tiles {
            true => self.repeats,
            false => 1,
        }
    }
}

/// What a client looks at: from connecting, and after a teleport.
///
/// # Errors
/// If the dataset is damaged, or has no ground.
pub fn views(dataset: &Dataset, error_px: f32) -> Result<[View; 2]> {
    let ground = Ground::new(dataset);
    Ok([
        ground.view([0.3, 0.3], 45.0, error_px)?,
        ground.view([0.7, 0.6], 270.0, error_px)?,
    ])
}

/// Measures a dataset.
///
/// # Errors
/// What a lab needs, and what a client says that fails.
pub fn measure(folder: &Path, plan: &Plan, step: &dyn Fn(&str)) -> Result<Vec<Outcome>> {
    let dataset = Dataset::open(folder).with_context(|| format!("{}", folder.display()))?;
    let views = views(&dataset, plan.error_px)?.map(Sight::from);
    let lab = Lab::new()?;
    lab.set_parameters(&plan.parameters)?;
    let mut command = lab.command(End::Server, &beside("escarp-server")?);
    command
        .arg(folder)
        .args(["--listen", &format!("{SERVER}:8787")]);
    let server = Server::start(command)?;
    let mut outcomes = Vec::new();
    for &cell in &plan.cells {
        for &kind in &plan.kinds {
            step(&format!("{cell} {kind}"));
            let job = Job {
                kind,
                url: server.url.clone(),
                views: views.to_vec(),
                limit_s: plan.limit_s,
                dataset: Some(folder.to_path_buf()),
            };
            let runs = (0..plan.repeats(&cell, kind)).map(|repeat| {
                lab.line.set(cell, u64::from(repeat));
                lab.measure("line-client", &job)
                    .with_context(|| format!("{cell} {kind}"))
            });
            let runs = runs.collect::<Result<_>>()?;
            outcomes.push(Outcome { cell, kind, runs });
        }
    }
    Ok(outcomes)
}
