//! Chunks that wait, pages that are refused, and another mesher, without a server.

use super::*;
use crate::app::fake::manifest;
use crate::mesh::{Contradiction, MesherKind};
use escarp_proto::geometry::{GridLevels, PAGE_SAMPLES, PAGE_SLOTS, Slot};
use escarp_proto::georef::{Georef, Plane};
use escarp_proto::page::{ChildSlot, Codec, PAGE_AREA, Record, RecordHeader, revision};
use std::cell::Cell;
use std::time::Duration;

const MEMORY: usize = 64 << 20;

/// Two levels of pages of a wavy land.
struct Land {
    grid: GridLevels,
    georef: Georef,
}

impl Land {
    fn new() -> Land {
        Land {
            grid: GridLevels::new(8).unwrap(),
            georef: Georef {
                origin_m: [0.0; 2],
                sample_spacing_m: [10.0; 2],
                quantum_m: 0.1,
                plane: Plane::Local,
            },
        }
    }

    fn terrain(&self, options: MeshOptions) -> Terrain {
        let manifest = manifest(self.grid, 257, [-9000, 9000], self.georef.clone());
        Terrain::new(Arc::new(manifest), MEMORY, options)
    }

    fn samples(&self, id: PageId) -> [Option<i32>; PAGE_AREA] {
        let ((x0, y0), stride) = (self.grid.page_origin(id), self.grid.page_stride(id));
        std::array::from_fn(|at| {
            let x = f64::from(x0 + (at % PAGE_SAMPLES) as u32 * stride);
            let y = f64::from(y0 + (at / PAGE_SAMPLES) as u32 * stride);
            Some(((x * 0.05).sin() * 5000.0 + (y * 0.31).cos() * 900.0 + x * y % 7.0) as i32)
        })
    }

    fn child(&self, slot: Slot) -> (Page, ChildSlot) {
        let id = PageId::ROOT.child(slot).unwrap();
        let heights = Box::new(self.samples(id).map(|sample| sample.unwrap_or(0)));
        Page::with_slot(id, heights, None, None).unwrap()
    }

    fn root(&self) -> Page {
        let slots: [_; PAGE_SLOTS] =
            std::array::from_fn(|i| self.child(Slot::from_index(i as u8)).1);
        Page::new(
            PageId::ROOT,
            &self.samples(PageId::ROOT),
            Some(Box::new(slots)),
        )
        .unwrap()
    }

    /// All pages, the root first.
    fn chunks(&self) -> Vec<Chunk> {
        let children = (0..PAGE_SLOTS).map(|i| self.child(Slot::from_index(i as u8)).0);
        let pages = std::iter::once(self.root()).chain(children);
        pages
            .map(|page| chunk(&page, 0, page.last_part()))
            .collect()
    }
}

fn chunk(page: &Page, first_part: u8, last_part: u8) -> Chunk {
    let record = Record::encode(page, Codec::Dense);
    let header = RecordHeader::read(page.id(), page.is_finest(), record.bytes()).unwrap();
    let bytes = header.part_bytes(first_part, last_part).unwrap();
    Chunk {
        page: page.id().key(),
        revision: revision(page.id(), record.bytes()),
        first_part,
        last_part,
        bytes: record.bytes()[bytes].to_vec(),
    }
}

fn view() -> View {
    View {
        eye_m: [1300.0, 900.0, 900.0],
        direction: [0.3, 1.0, -0.4],
        velocity_m_s: [0.0; 3],
        fov_y: 1.0,
        viewport_px: [1280, 720],
        max_screen_error_px: 1.0,
    }
}

#[test]
fn with_a_frame_budget_pages_wait_and_the_mesh_ends_the_same() {
    let land = Land::new();
    let mut whole = land.terrain(MeshOptions::default());
    land.chunks()
        .into_iter()
        .for_each(|chunk| whole.receive(chunk));
    assert!(!whole.has_room());
    let all = whole.update(&view());
    assert_eq!((all.waiting, all.lacking), (0, 0));
    // Each look at the clock takes a fifth of a millisecond, so that a page takes 0.6 ms to 1 ms.
    let clock = Cell::new(Duration::ZERO);
    let now = || {
        clock.set(clock.get() + Duration::from_micros(200));
        clock.get()
    };
    for (budget_ms, most_pages) in [(0, 1), (4, 8), (20, 40)] {
        let mut terrain = land.terrain(MeshOptions::default());
        land.chunks()
            .into_iter()
            .for_each(|chunk| terrain.receive(chunk));
        let (mut last, mut frames) = (terrain.waiting(), 0);
        while last > 0 {
            let budget = Duration::from_millis(budget_ms);
            let mut stages = Stages::begin(&now, Some(budget), Duration::ZERO);
            let mut step = TerrainStep::default();
            terrain.link_arrived(&mut step, &mut stages);
            let step = terrain.finish(&view(), step, &mut stages);
            let linked = last - step.waiting;
            assert!(
                (1..=most_pages).contains(&linked),
                "{budget_ms} ms: {linked}"
            );
            // It takes at most a page longer than it may, but for the mesh itself.
            let pages_ms = step.times.decode_ms + step.times.link_ms;
            assert!(pages_ms <= budget_ms as f32 + 1.0, "{pages_ms}");
            assert!(step.times.update_ms > 0.0 && step.times.triangulate_ms > 0.0);
            (last, frames) = (step.waiting, frames + 1);
        }
        assert!(frames >= 257 / most_pages, "{frames} frames");
        terrain.update(&view());
        assert_eq!(terrain.tree().flags(), whole.tree().flags(), "{budget_ms}");
    }
}

#[test]
fn a_page_that_contradicts_is_wanted_from_its_first_part_once_more_and_then_missing() {
    let land = Land::new();
    let mut terrain = land.terrain(MeshOptions::default());
    let (truth, _) = land.child(Slot::at(8, 6));
    let id = truth.id();
    // All but this one is here.
    let others = land
        .chunks()
        .into_iter()
        .filter(|chunk| chunk.page != id.key());
    others.for_each(|chunk| terrain.receive(chunk));
    terrain.update(&view());
    let mut samples = land.samples(id);
    // In the last part: the first ones are as they should be.
    samples[PAGE_SAMPLES + 1] = samples[PAGE_SAMPLES + 1].map(|height| height + 9000);
    let lie = Page::new(id, &samples, None).unwrap();
    let wanted = |terrain: &Terrain| {
        let want = terrain.wants().iter().find(|want| want.page == id.key());
        want.map(|want| want.first_part)
    };
    assert_eq!(wanted(&terrain), Some(0));
    terrain.receive(chunk(&truth, 0, 2));
    terrain.update(&view());
    assert_eq!(wanted(&terrain), Some(3));
    // Its later parts and all that waits of it go, its first ones stay.
    terrain.receive(chunk(&lie, 0, 4));
    terrain.receive(Chunk {
        first_part: 3,
        ..chunk(&lie, 3, 4)
    });
    let step = terrain.update(&view());
    let refused: Vec<_> = step.refused.iter().map(|r| (r.page, r.again)).collect();
    assert_eq!(refused, [(id, true)], "{:?}", step.refused);
    assert_eq!(terrain.tree().page(id).map(Page::parts), Some(2));
    assert_eq!(wanted(&terrain), Some(0));
    // Parts that do not begin at the first are of no use, nor are no more than are here.
    terrain.receive(chunk(&truth, 3, 4));
    let step = terrain.update(&view());
    assert_eq!((step.orphans, step.refused), (vec![id], vec![]));
    terrain.receive(chunk(&lie, 0, 4));
    let step = terrain.update(&view());
    let [refusal] = &step.refused[..] else {
        panic!("{:?}", step.refused);
    };
    let off = matches!(
        refusal.why,
        LinkError::Contradiction {
            what: Contradiction::Error { .. },
            ..
        }
    );
    assert!(off && !refusal.again, "{refusal:?}");
    assert_eq!(wanted(&terrain), None);
    assert!(step.lacking > 0);
    terrain.forget_misses();
    terrain.update(&view());
    assert_eq!(wanted(&terrain), Some(0));
    terrain.receive(chunk(&truth, 0, 4));
    assert_eq!(terrain.update(&view()).refused, []);
    assert_eq!(terrain.tree().page(id), Some(&truth));
}

#[test]
fn a_refused_page_that_comes_without_what_is_missing_is_refused_again() {
    let land = Land::new();
    let mut terrain = land.terrain(MeshOptions::default());
    let (truth, _) = land.child(Slot::at(8, 6));
    terrain.receive(chunk(&land.root(), 0, 5));
    terrain.receive(chunk(&truth, 0, 2));
    terrain.receive(Chunk {
        bytes: vec![0xff; 9],
        ..chunk(&truth, 3, 4)
    });
    assert!(terrain.update(&view()).refused[0].again);
    terrain.receive(chunk(&truth, 0, 2));
    let step = terrain.update(&view());
    assert_eq!(step.refused[0].why, LinkError::Repeated(truth.id()));
    assert!(!step.refused[0].again);
}

#[test]
fn another_mesher_works_on_the_pages_that_are_here() {
    let land = Land::new();
    let mut terrain = land.terrain(MeshOptions::default());
    land.chunks()
        .into_iter()
        .for_each(|chunk| terrain.receive(chunk));
    let before = terrain.update(&view());
    let (flags, pages) = (terrain.tree().flags(), terrain.tree().resident());
    for &mesher in MesherKind::ALL {
        let options = MeshOptions {
            mesher,
            ..MeshOptions::default()
        };
        assert_eq!(terrain.set_options(options), []);
        assert_eq!(terrain.tree().resident(), pages);
        let step = terrain.update(&view());
        assert_eq!(step.lacking, 0, "{mesher}");
        assert!(step.triangles > 2, "{mesher}");
    }
    assert_eq!(terrain.set_options(MeshOptions::default()), []);
    let after = terrain.update(&view());
    assert_eq!(terrain.tree().flags(), flags);
    assert_eq!(
        (after.triangles, after.excess),
        (before.triangles, before.excess)
    );
}
