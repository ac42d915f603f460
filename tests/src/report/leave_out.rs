//! What a scene does not need, and what leaving it out saves.

use super::measure::judge::Judge;
use super::measure::surface::FullSurface;
use super::measure::tally::Promise;
use super::measure::triangles;
use super::supply::Supply;
use super::variant::Variant;
use anyhow::{Context, Result};
use escarp_client::mesh::MeshTree;
use escarp_proto::geometry::{PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, PageId};
use escarp_proto::page::{RecordHeader, SLOT_PART};
use escarp_proto::view::View;
use escarp_tiles::dataset::Dataset;
use serde::Serialize;
use std::collections::HashMap;

/// Bytes, pages and triangles of one view, with nothing there before.
#[derive(Debug, Clone, Serialize)]
pub struct LeaveOut {
    /// The mesher.
    pub mesher: Variant,
    /// The tolerance, pixels.
    pub error_px: f32,
    /// The whole dataset on disk, bytes.
    pub dataset_bytes: u64,
    /// Bytes of the parts of records that came.
    pub received_bytes: u64,
    /// Bytes of the parts that hold an enabled vertex, or the slot of a page that is used.
    pub used_bytes: u64,
    /// `received_bytes` over `used_bytes`.
    pub received_over_used: f64,
    /// Pages with a record in the dataset.
    pub dataset_pages: u64,
    /// Pages that came.
    pub received_pages: u64,
    /// Pages with triangles.
    pub drawn_pages: u64,
    /// Of those, pages whose box may be seen.
    pub seen_pages: u64,
    /// Triangles of the full-resolution surface, holes not counted.
    pub full_triangles: u64,
    /// Those of them in view: two a sample in view.
    pub full_seen_triangles: u64,
    /// Triangles of the mesh.
    pub triangles: u64,
    /// Triangles in pages that may be seen: what a renderer draws.
    pub sent_triangles: u64,
    /// Triangles of which any may be seen.
    pub seen_triangles: u64,
    /// Memory of the mesh tree, bytes.
    pub memory_bytes: u64,
    /// Bytes of vertices and indices for the GPU.
    pub gpu_bytes: u64,
}

/// Converges a view from nothing, and counts.
///
/// # Errors
/// Those of [`Supply::converge`] and [`FullSurface::measure`].
pub fn measure(surface: &FullSurface<'_>, variant: Variant, view: &View) -> Result<LeaveOut> {
    let dataset = surface.dataset;
    let mut supply = Supply::new(dataset, variant);
    let converged = supply.converge(view)?;
    let tree = &supply.tree;
    let promise = Promise::of(view.max_screen_error_px.into(), converged.stats.excess);
    let mesh = triangles(tree);
    let in_view = surface.measure(&mesh, view, promise)?.samples;
    let full_triangles = full_triangles(dataset);
    let judge = Judge::new(&dataset.manifest().georef, view);
    let mut out = LeaveOut {
        mesher: variant,
        error_px: view.max_screen_error_px,
        dataset_bytes: dataset.total_bytes(),
        received_bytes: supply.bytes,
        used_bytes: used_bytes(dataset, tree)?,
        received_over_used: 0.0,
        dataset_pages: dataset.manifest().pages,
        received_pages: 0,
        drawn_pages: 0,
        seen_pages: 0,
        full_triangles,
        full_seen_triangles: ((2.0 * in_view).round() as u64).min(full_triangles),
        triangles: 0,
        sent_triangles: 0,
        seen_triangles: 0,
        memory_bytes: tree.memory_bytes() as u64,
        gpu_bytes: 0,
    };
    for page in tree.pages() {
        out.received_pages += u64::from(dataset.record(page.id())?.is_some());
    }
    out.received_over_used = out.received_bytes as f64 / out.used_bytes.max(1) as f64;
    for mesh in tree.meshes() {
        let triangles = mesh.indices.len() as u64 / 3;
        out.triangles += triangles;
        out.drawn_pages += 1;
        out.gpu_bytes += (size_of_val(&mesh.vertices[..]) + size_of_val(&mesh.indices[..])) as u64;
        if judge.may_see(&mesh.bounds) {
            out.seen_pages += 1;
            out.sent_triangles += triangles;
        }
    }
    let seen = mesh
        .iter()
        .filter(|triangle| triangle.drawn && judge.may_see(&judge.box_of(&triangle.corners)));
    out.seen_triangles = seen.count() as u64;
    Ok(out)
}

/// Two a cell, less those in holes, as far as the number of samples with data says.
fn full_triangles(dataset: &Dataset) -> u64 {
    let manifest = dataset.manifest();
    let [width, height] = manifest.samples.map(u64::from);
    let cells = (width.saturating_sub(1) * height.saturating_sub(1)) as f64;
    let valid = manifest.valid_samples as f64 / (width * height).max(1) as f64;
    (2.0 * cells * valid).round() as u64
}

/// Bytes of the parts without which the mesh could not be what it is.
///
/// # Errors
/// If the dataset is damaged.
pub fn used_bytes(dataset: &Dataset, tree: &MeshTree) -> Result<u64> {
    parts_of(tree).used_bytes(dataset, &UsedParts::default())
}

/// The last part of each page that is here, and of each that the mesh could not do without.
#[derive(Debug, Clone, Default)]
pub struct UsedParts {
    resident: HashMap<PageId, u8>,
    used: HashMap<PageId, u8>,
}

/// Those of a mesh.
pub fn parts_of(tree: &MeshTree) -> UsedParts {
    let mut used: HashMap<PageId, u8> = HashMap::new();
    for flags in tree.flags().into_iter().filter(|flags| flags.enabled) {
        let part = part_of(flags.sample as usize);
        let kept = used.entry(flags.page).or_insert(0);
        *kept = (*kept).max(part);
    }
    let pages: Vec<PageId> = used.keys().copied().collect();
    for page in pages {
        if let Some((parent, _)) = page.parent() {
            used.insert(parent, SLOT_PART);
        }
    }
    let resident = tree.pages().map(|page| (page.id(), page.parts())).collect();
    UsedParts { resident, used }
}

impl UsedParts {
    /// The last part of a page that the mesh could not do without.
    pub fn last_used(&self, page: PageId) -> Option<u8> {
        self.used.get(&page).copied()
    }

    /// Bytes of the parts that the mesh could not do without, and that were not here before.
    ///
    /// # Errors
    /// If the dataset is damaged.
    pub fn used_bytes(&self, dataset: &Dataset, before: &UsedParts) -> Result<u64> {
        beyond(dataset, &self.used, &before.resident)
    }

    /// Bytes of the parts that are here, and were not before.
    ///
    /// # Errors
    /// If the dataset is damaged.
    pub fn resident_bytes(&self, dataset: &Dataset, before: &UsedParts) -> Result<u64> {
        beyond(dataset, &self.resident, &before.resident)
    }
}

/// Bytes of some parts, less those of others.
fn beyond(
    dataset: &Dataset,
    parts: &HashMap<PageId, u8>,
    before: &HashMap<PageId, u8>,
) -> Result<u64> {
    let mut bytes = 0;
    for (&page, &part) in parts {
        let first = before.get(&page).map_or(0, |had| had + 1);
        let finest = dataset.grid().is_finest(page);
        if first <= part
            && let Some(record) = dataset.record(page)?
        {
            let header = RecordHeader::read(page, finest, record.bytes)?;
            let range = header.part_bytes(first, part);
            bytes += range
                .with_context(|| format!("page {page} has no part {part}"))?
                .len() as u64;
        }
    }
    Ok(bytes)
}

/// Part of a record that holds a vertex; corners of a page are in the header's.
fn part_of(sample: usize) -> u8 {
    let both = (sample % PAGE_SAMPLES) | (sample / PAGE_SAMPLES) | PAGE_CELLS;
    PAGE_LEVELS - (both.trailing_zeros() as u8).min(PAGE_LEVELS)
}
