//! The files of a report.

use super::conduct::Report;
use super::plot::Drawing;
use super::plot::font::Font;
use super::plot::png::png;
use super::plot::svg::{Colours, svg};
use super::sections::{Plot, sections};
use super::{html, tables};
use anyhow::{Context, Result};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Makes a report's folders, before anything is measured.
///
/// # Errors
/// If they cannot be made, or written to.
pub fn prepare(folder: &Path) -> Result<()> {
    let plots = folder.join("plots");
    std::fs::create_dir_all(&plots)
        .with_context(|| format!("cannot make the folder {}", plots.display()))?;
    // What cannot be written is better known before than after minutes of work; a report that is
    // there already stays whole until then.
    for name in ["report.json", "report.html"] {
        let path = folder.join(name);
        std::fs::OpenOptions::new()
            .append(true)
            .create(true)
            .open(&path)
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

fn file(path: &Path, bytes: &[u8]) -> Result<()> {
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

/// Writes all files of a report.
///
/// # Errors
/// If a file cannot be written.
pub fn report(folder: &Path, report: &Report) -> Result<()> {
    let json = serde_json::to_vec_pretty(report)?;
    file(&folder.join("report.json"), &json)?;
    for (name, table) in [
        ("runs.csv", tables::runs_csv(report)),
        ("frames.csv", tables::frames_csv(report)),
        ("ratios.csv", tables::cdf_csv(report)),
        ("pops.csv", tables::pops_csv(report)),
        ("cold-starts.csv", tables::cold_csv(report)),
    ] {
        file(&folder.join(name), table.csv().as_bytes())?;
    }
    let font = Font::load().context("the program's font is damaged")?;
    let sections = sections(report);
    let mut svgs = Vec::new();
    let mut drawings = Vec::new();
    for section in &sections {
        let mut own = Vec::new();
        for (name, plot) in &section.plots {
            let drawing = match plot {
                Plot::Chart(chart) => chart.draw(&font),
                Plot::Bars(bars) => bars.draw(&font),
            };
            own.push(svg(&drawing, Colours::OfPage));
            drawings.push((*name, drawing));
        }
        svgs.push(own);
    }
    drawings
        .par_iter()
        .try_for_each(|(name, drawing)| plot(&folder.join("plots"), name, drawing))?;
    file(
        &folder.join("report.html"),
        html::page(report, &sections, &svgs).as_bytes(),
    )
}

fn plot(folder: &Path, name: &str, drawing: &Drawing) -> Result<()> {
    file(
        &folder.join(format!("{name}.svg")),
        svg(drawing, Colours::Light).as_bytes(),
    )?;
    file(&folder.join(format!("{name}.png")), &png(drawing)?)
}

/// Writes a page with a link to each report.
///
/// # Errors
/// If it cannot be written.
pub fn index(folder: &Path, reports: &[(Report, PathBuf)]) -> Result<()> {
    let link = |path: &PathBuf| {
        let below = path.strip_prefix(folder).unwrap_or(path);
        // A folder's name may hold what means something in an address.
        let encode = |b: u8| match b {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' | b'.' | b'/' => {
                (b as char).to_string()
            }
            b => format!("%{b:02X}"),
        };
        let name: String = below.to_string_lossy().bytes().map(encode).collect();
        format!("{name}/report.html")
    };
    let links: Vec<(&Report, String)> = reports
        .iter()
        .map(|(report, path)| (report, link(path)))
        .collect();
    file(&folder.join("index.html"), html::index(&links).as_bytes())
}
