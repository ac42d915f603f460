//! Too little memory, and pages that do not come.

use super::Case;
use super::stage::{Found, check_history, ground, hold, over_meshers, view, views};
use crate::feed::Feed;
use crate::terrain::{TempDataset, hash, hills, holed_hills};
use escarp_client::mesh::MeshOptions;
use escarp_client::terrain::{Terrain, TerrainStep};
use escarp_proto::geometry::PageId;
use escarp_proto::page::RecordHeader;
use escarp_proto::view::View;
use escarp_proto::wire::{Chunk, Want};
use std::sync::Arc;

const SIDE: u32 = 131;

/// All cases.
pub fn cases() -> Vec<Case> {
    vec![
        pool(),
        caps(),
        missing("hills", hills),
        missing("hills with holes", holed_hills),
        late(),
    ]
}

/// A path over the dataset with leaps.
fn path(n: u32, error_px: f32) -> View {
    let turn = f64::from(n) * 0.7;
    let out = 200.0 + f64::from(hash(n, 1) % 500);
    let eye = [
        1650.0 + turn.cos() * out,
        2650.0 + turn.sin() * out,
        350.0 + f64::from(hash(n, 2) % 400),
    ];
    view(eye, [1650.0, 2650.0, 0.0], error_px)
}

/// Memory for 1, 2, 3 ... pages up to more than there are.
fn pool() -> Case {
    Case::new(
        "memory for 1, 2, 4, ... pages, to more than there are",
        "no crack and the stated bound holds after every eviction; what is on the screen stays",
        || {
            let data = ground(SIDE, SIDE, hills);
            over_meshers(|options| {
                let mut found = Found::default();
                let mut sizes = Vec::new();
                for power in 0..8 {
                    let mut feed = Feed::with_options(&data.dataset, options);
                    let one = page_bytes(&data, options);
                    for n in 0..6 {
                        let view = path(n, 4.0);
                        feed.tree.update(&view);
                        for wish in feed.tree.wishes() {
                            feed.grant(&wish);
                        }
                        feed.tree.update(&view);
                        feed.tree.evict(one << power);
                        let stats = feed.tree.update(&view);
                        hold(
                            &mut feed.tree,
                            &data,
                            &view,
                            stats.excess,
                            stats.wanted == 0,
                            &mut found,
                        );
                        if let Err(why) = check_history(&feed.tree, &data, &view) {
                            found.fault(format!("{} pages: {why}", 1 << power));
                        }
                    }
                    sizes.push(feed.tree.resident());
                }
                let measured = format!(
                    "{sizes:?} pages resident at the end; share of the stated bound at most {:.3}",
                    found.share
                );
                found.outcome_with(measured)
            })
        },
    )
}

/// Bytes that the root page counts for.
fn page_bytes(data: &TempDataset, options: MeshOptions) -> usize {
    let mut feed = Feed::with_options(&data.dataset, options);
    feed.tree.update(&path(0, 4.0));
    for wish in feed.tree.wishes() {
        feed.grant(&wish);
    }
    feed.tree.memory_bytes().max(1)
}

fn chunk(data: &TempDataset, want: &Want) -> Option<Chunk> {
    let id = PageId::from_key(want.page)?;
    let record = data.dataset.record(id).ok()??;
    let header = RecordHeader::read(id, data.dataset.grid().is_finest(id), record.bytes).ok()?;
    let bytes = header.part_bytes(want.first_part, want.last_part)?;
    Some(Chunk {
        page: want.page,
        revision: record.revision,
        first_part: want.first_part,
        last_part: want.last_part,
        bytes: record.bytes[bytes].to_vec(),
    })
}

/// A client with each cap, after a few views.
fn capped(data: &TempDataset, options: MeshOptions) -> (Found, Vec<String>) {
    let manifest = Arc::new(data.dataset.manifest().clone());
    let mut found = Found::default();
    let mut bounds = Vec::new();
    for cap in [
        0,
        1,
        20_000,
        100_000,
        300_000,
        1_000_000,
        10_000_000,
        usize::MAX,
    ] {
        let mut terrain = Terrain::new(manifest.clone(), cap, options);
        let mut rest = None;
        for n in 0..4 {
            rest = settle(&mut terrain, data, &path(n * 5, 1.0));
        }
        match rest {
            None => found.fault(format!("no rest with {cap} bytes")),
            Some(step) if step.excess.is_nan() || !step.refused.is_empty() => {
                found.fault(format!("{cap} bytes: {step:?}"));
            }
            Some(step) => {
                if terrain.tree().memory_bytes() > cap && !step.memory_full {
                    found.fault(format!("more than {cap} bytes, and does not say so"));
                }
                bounds.push(format!("{:.1}", step.excess));
            }
        }
    }
    (found, bounds)
}

/// Updates, and gives what is wanted, until nothing is; `None` if that has no end.
fn settle(terrain: &mut Terrain, data: &TempDataset, view: &View) -> Option<TerrainStep> {
    for _ in 0..200 {
        let step = terrain.update(view);
        if terrain.wants().is_empty() && terrain.waiting() == 0 {
            return Some(step);
        }
        let wants = terrain.wants().to_vec();
        let chunks = wants.iter().filter_map(|want| chunk(data, want));
        chunks.for_each(|chunk| terrain.receive(chunk));
    }
    None
}

/// The whole sync point with a cap, to where nothing more is wanted.
fn caps() -> Case {
    Case::new(
        "a client with a memory cap from 0 to enough",
        "it comes to rest, states a bound, holds at most the cap and what the screen needs, and wants nothing it cannot keep",
        || {
            let data = ground(SIDE, SIDE, hills);
            over_meshers(|options| {
                let (found, bounds) = capped(&data, options);
                found.outcome_with(format!("bounds at rest: {} tolerances", bounds.join(", ")))
            })
        },
    )
}

/// Some pages never come.
fn missing(name: &'static str, heights: fn(u32, u32) -> f64) -> Case {
    Case::new(
        format!("every seventh page never comes, over {name}"),
        "no crack, and the bound that is stated for it holds",
        move || {
            let data = ground(SIDE, SIDE, heights);
            over_meshers(|options| {
                let mut found = Found::default();
                let mut lacking = 0;
                for view in views(&data, 1.0) {
                    let mut feed = Feed::with_options(&data.dataset, options);
                    let lost = |id: PageId| id != PageId::ROOT && id.key() % 7 == 3;
                    let mut stats = feed.tree.update(&view);
                    for _ in 0..60 {
                        let wishes = feed.tree.wishes();
                        let mut granted = false;
                        for wish in wishes.iter().filter(|wish| !lost(wish.page)) {
                            granted |= feed.grant(wish);
                        }
                        stats = feed.tree.update(&view);
                        if !granted {
                            break;
                        }
                    }
                    lacking = lacking.max(stats.wanted);
                    hold(
                        &mut feed.tree,
                        &data,
                        &view,
                        stats.excess,
                        stats.wanted == 0,
                        &mut found,
                    );
                }
                let measured = format!(
                    "up to {lacking} pages lacking; deviation up to {:.1} tolerances, {:.3} of what is stated",
                    found.deviation, found.share
                );
                found.outcome_with(measured)
            })
        },
    )
}

/// One page at a time, in no order.
fn late() -> Case {
    Case::new(
        "pages that arrive one by one in random order",
        "no crack, and the stated bound holds after each",
        || {
            let data = ground(67, 67, hills);
            over_meshers(|options| {
                let mut found = Found::default();
                let mut steps = 0;
                for (i, view) in views(&data, 1.0).into_iter().enumerate() {
                    let mut feed = Feed::with_options(&data.dataset, options);
                    for n in 0..300 {
                        let stats = feed.tree.update(&view);
                        let wishes = feed.tree.wishes();
                        hold(
                            &mut feed.tree,
                            &data,
                            &view,
                            stats.excess,
                            wishes.is_empty(),
                            &mut found,
                        );
                        steps += 1;
                        if wishes.is_empty() {
                            break;
                        }
                        feed.grant(&wishes[hash(n, i as u32) as usize % wishes.len()]);
                    }
                }
                let measured = format!(
                    "{steps} arrivals; at most {:.3} of what is stated",
                    found.share
                );
                found.outcome_with(measured)
            })
        },
    )
}
