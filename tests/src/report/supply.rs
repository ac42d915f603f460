//! A mesh tree fed from a dataset without a network, stage by stage, and what each stage took.

use super::clock::timed;
use super::variant::Variant;
use anyhow::{Context, Result, ensure};
use escarp_client::mesh::{MeshTree, UpdateStats, Wish};
use escarp_proto::page::{Page, RecordHeader};
use escarp_proto::view::View;
use escarp_tiles::dataset::Dataset;
use serde::Serialize;

/// A mesh that wishes for more after so many updates does not converge.
const MOST_ROUNDS: u32 = 500;
/// Memory that a mesh tree may take, bytes.
pub const MOST_TREE_BYTES: usize = 3 << 30;

/// CPU time of the stages of a frame, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Stages {
    /// From records to pages.
    pub decode_ms: f64,
    /// Pages into the tree.
    pub link_ms: f64,
    /// The mesher's update.
    pub update_ms: f64,
    /// From enabled vertices to triangles.
    pub triangulate_ms: f64,
}

impl Stages {
    /// All of them.
    pub fn total_ms(&self) -> f64 {
        self.decode_ms + self.link_ms + self.mesh_ms()
    }

    /// What a frame costs when no page comes.
    pub fn mesh_ms(&self) -> f64 {
        self.update_ms + self.triangulate_ms
    }

    /// Adds another frame's.
    pub fn add(&mut self, other: &Stages) {
        self.decode_ms += other.decode_ms;
        self.link_ms += other.link_ms;
        self.update_ms += other.update_ms;
        self.triangulate_ms += other.triangulate_ms;
    }

    /// All of them over a number.
    pub fn over(&self, number: usize) -> Stages {
        let n = number.max(1) as f64;
        Stages {
            decode_ms: self.decode_ms / n,
            link_ms: self.link_ms / n,
            update_ms: self.update_ms / n,
            triangulate_ms: self.triangulate_ms / n,
        }
    }
}

/// A frame that has all that it wished for.
#[derive(Debug, Clone, Copy)]
pub struct Converged {
    /// Of the last update; changes, splits and merges are those of all.
    pub stats: UpdateStats,
    /// What it took.
    pub stages: Stages,
    /// Triangles of the mesh.
    pub triangles: u64,
    /// Updates that it took.
    pub rounds: u32,
}

/// A mesh tree and the dataset that it is of.
pub struct Supply<'a> {
    /// The tree.
    pub tree: MeshTree,
    dataset: &'a Dataset,
    /// Bytes of the parts that were granted.
    pub bytes: u64,
}

impl<'a> Supply<'a> {
    /// A tree without pages.
    pub fn new(dataset: &'a Dataset, variant: Variant) -> Supply<'a> {
        let manifest = dataset.manifest();
        let (grid, georef) = (manifest.grid_levels, manifest.georef.clone());
        Supply {
            tree: MeshTree::with_options(grid, georef, variant.options()),
            dataset,
            bytes: 0,
        }
    }

    /// Updates and grants all wishes until there are none, then triangulates.
    ///
    /// # Errors
    /// If the dataset is damaged, the mesh does not converge, or takes more memory than allowed.
    pub fn converge(&mut self, view: &View) -> Result<Converged> {
        self.converge_noting(view, &mut |_| {})
    }

    /// As [`converge`](Self::converge), and shows the wishes of each update before they are granted.
    ///
    /// # Errors
    /// As [`converge`](Self::converge).
    pub fn converge_noting(
        &mut self,
        view: &View,
        note: &mut dyn FnMut(&[Wish]),
    ) -> Result<Converged> {
        let mut stages = Stages::default();
        let (mut changes, mut splits, mut merges) = (0, 0, 0);
        for rounds in 1..=MOST_ROUNDS {
            let (mut stats, ms) = timed(|| self.tree.update(view));
            stages.update_ms += ms;
            changes += stats.changes;
            splits += stats.splits;
            merges += stats.merges;
            let wishes = self.tree.wishes();
            if wishes.is_empty() {
                let (triangles, ms) = timed(|| self.tree.triangulate());
                stages.triangulate_ms += ms;
                (stats.changes, stats.splits, stats.merges) = (changes, splits, merges);
                return Ok(Converged {
                    stats,
                    stages,
                    triangles,
                    rounds,
                });
            }
            note(&wishes);
            self.grant(&wishes, &mut stages)?;
        }
        anyhow::bail!("the mesh still wishes for pages after {MOST_ROUNDS} updates")
    }

    fn grant(&mut self, wishes: &[Wish], stages: &mut Stages) -> Result<()> {
        let (pages, ms) = timed(|| {
            let pages = wishes.iter().map(|wish| self.decode(wish));
            pages.collect::<Result<Vec<Page>>>()
        });
        stages.decode_ms += ms;
        let pages = pages?;
        let (linked, ms) = timed(|| -> Result<()> {
            for page in pages {
                self.tree.link(page)?;
            }
            Ok(())
        });
        stages.link_ms += ms;
        linked?;
        let bytes = self.tree.memory_bytes();
        ensure!(
            bytes <= MOST_TREE_BYTES,
            "the mesh takes {} MiB, allowed are {} MiB: ask for a larger error or a smaller picture",
            bytes >> 20,
            MOST_TREE_BYTES >> 20
        );
        Ok(())
    }

    /// What a client would have of a page once the wish is granted.
    fn decode(&mut self, wish: &Wish) -> Result<Page> {
        let finest = self.dataset.grid().is_finest(wish.page);
        let record = self.dataset.record(wish.page)?;
        let record = record.with_context(|| format!("page {} has no record", wish.page))?;
        let header = RecordHeader::read(wish.page, finest, record.bytes)?;
        let want = wish.to_want();
        let range = header
            .part_bytes(want.first_part, want.last_part)
            .with_context(|| format!("page {} has no part {}", wish.page, want.last_part))?;
        let bytes = &record.bytes[range];
        self.bytes += bytes.len() as u64;
        match self.tree.page(wish.page).filter(|_| want.first_part > 0) {
            Some(page) => {
                let mut page = page.clone();
                page.extend(want.last_part, bytes)?;
                Ok(page)
            }
            None => Ok(Page::decode(wish.page, finest, want.last_part, bytes)?),
        }
    }
}
