//! Eyes that jitter, creep, and leap.

use super::stage::{Found, ROUNDING, check_history, ground, hold, over_meshers, view};
use super::{Case, Outcome, Verdict};
use crate::feed::Feed;
use crate::terrain::{FunctionSource, TempDataset, hash, hills, holed_hills};
use escarp_proto::view::View;

const SIDE: u32 = 131;

/// All cases.
pub fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for origin_m in [0.0, 2e7, 9e11] {
        cases.push(creeping(origin_m));
    }
    cases.extend([creeping_after_leaps(), jitter(), still()]);
    cases
}

/// Cases of leaps.
pub fn leaps() -> Vec<Case> {
    vec![
        teleports("hills", hills),
        teleports("hills with holes", holed_hills),
    ]
}

fn random(n: u32, i: u32, span: f64) -> f64 {
    f64::from(hash(n, i)) / f64::from(u32::MAX) * span
}

fn settle(feed: &mut Feed<'_>, view: &View, found: &mut Found) -> f64 {
    match feed.converge_within(200, view) {
        Ok(stats) => stats.excess,
        Err(why) => {
            found.fault(why);
            f64::INFINITY
        }
    }
}

fn teleports(name: &str, heights: fn(u32, u32) -> f64) -> Case {
    Case::new(
        format!("400 teleports over {name}, pages arriving late and being evicted"),
        "after each, every flag and count equals a recomputation from nothing; no crack",
        move || {
            let data = ground(99, 99, heights);
            over_meshers(|options| {
                let mut found = Found::default();
                let mut feed = Feed::with_options(&data.dataset, options);
                let mut enabled = 0;
                for n in 0..400 {
                    let eye = [
                        900.0 + random(n, 1, 1200.0),
                        1900.0 + random(n, 2, 1200.0),
                        10f64.powf(random(n, 3, 5.0)),
                    ];
                    let look = [
                        1000.0 + random(n, 4, 980.0),
                        2000.0 + random(n, 5, 980.0),
                        0.0,
                    ];
                    let view = view(eye, look, 2f32.powi((hash(n, 6) % 6) as i32));
                    feed.tree.update(&view);
                    let few = hash(n, 7) as usize % 60;
                    for wish in feed.tree.wishes().into_iter().take(few) {
                        feed.grant(&wish);
                    }
                    if hash(n, 8).is_multiple_of(5) {
                        feed.tree.evict(hash(n, 9) as usize % 600_000);
                    }
                    let stats = feed.tree.update(&view);
                    enabled += feed.tree.flags().len();
                    if let Err(why) = check_history(&feed.tree, &data, &view) {
                        found.fault(format!("teleport {n}: {why}"));
                    }
                    // The measure is naive, and its cases are many.
                    if n.is_multiple_of(8) {
                        let converged = stats.wanted == 0;
                        hold(
                            &mut feed.tree,
                            &data,
                            &view,
                            stats.excess,
                            converged,
                            &mut found,
                        );
                    }
                }
                let measured = format!(
                    "{enabled} flags compared; deviation at most {:.3} of what is stated",
                    found.share
                );
                found.outcome_with(measured)
            })
        },
    )
}

fn far_hills(origin_m: f64) -> TempDataset {
    let source = FunctionSource::new(SIDE, SIDE, hills);
    TempDataset::build(&mut source.with(|info| {
        info.placement.x0 = origin_m;
        info.placement.y0 = origin_m + f64::from(SIDE - 1) * 10.0;
    }))
}

/// Creeps over the ground, and holds the mesh on the way against one from nothing.
fn creep(
    feed: &mut Feed<'_>,
    data: &TempDataset,
    (from, step_m, steps): ([f64; 3], f64, u32),
    found: &mut Found,
) -> (u64, u64) {
    let (mut changes, mut squares) = (0, 0);
    for n in 0..=steps {
        let eye = [
            from[0] + f64::from(n) * step_m,
            from[1] + f64::from(n) * step_m * 0.5,
            from[2],
        ];
        let view = view(eye, [from[0] + 600.0, from[1] + 500.0, 0.0], 1.0);
        let excess = match n {
            0 => settle(feed, &view, found),
            _ => {
                let stats = feed.tree.update(&view);
                changes += stats.changes;
                squares += stats.squares;
                match stats.wanted {
                    0 => stats.excess,
                    _ => settle(feed, &view, found),
                }
            }
        };
        if n.is_multiple_of(steps / 8) {
            hold(&mut feed.tree, data, &view, excess, true, found);
            if let Err(why) = check_history(&feed.tree, data, &view) {
                found.fault(format!("step {n}: {why}"));
            }
        }
    }
    (changes, squares)
}

fn creeping(origin_m: f64) -> Case {
    Case::new(
        format!("2000 steps of 1 mm at coordinates of {origin_m:e} m"),
        "deviation within the tolerance all the way; the mesh is that of a recomputation",
        move || {
            let data = far_hills(origin_m);
            over_meshers(|options| {
                let mut found = Found::default();
                let mut feed = Feed::with_options(&data.dataset, options);
                let from = [origin_m + 400.0, origin_m + 500.0, 340.0];
                let (changes, squares) = creep(&mut feed, &data, (from, 1e-3, 2000), &mut found);
                let measured = format!(
                    "deviation {:.3}; {:.2} vertices changed and {:.0} squares tested a step",
                    found.deviation,
                    changes as f64 / 2000.0,
                    squares as f64 / 2000.0
                );
                found.outcome_with(measured)
            })
        },
    )
}

/// How far the eye has gone is a sum; small steps must not be lost in a large one.
fn creeping_after_leaps() -> Case {
    Case::new(
        "3000 steps of 1 mm after 20 leaps of 1e12 m",
        "deviation within the tolerance all the way; the mesh is that of a recomputation",
        || {
            let data = far_hills(0.0);
            over_meshers(|options| {
                let mut found = Found::default();
                let mut feed = Feed::with_options(&data.dataset, options);
                let from = [400.0, 500.0, 340.0];
                let near = view(from, [1000.0, 1000.0, 0.0], 1.0);
                let far = view([1e12, -1e12, 1e12], [1000.0, 1000.0, 0.0], 1.0);
                for _ in 0..10 {
                    settle(&mut feed, &far, &mut found);
                    settle(&mut feed, &near, &mut found);
                }
                creep(&mut feed, &data, (from, 1e-3, 3000), &mut found);
                let measured = format!("deviation {:.3}", found.deviation);
                found.outcome_with(measured)
            })
        },
    )
}

/// Finds, between two eyes, a place where the mesh changes, and shakes the eye about it.
fn jitter() -> Case {
    Case::new(
        "an eye that shakes by one unit in the last place about a threshold",
        "the mesh changes by what hangs on one test, and comes back; deviation within the tolerance",
        || {
            let data = ground(SIDE, SIDE, hills);
            over_meshers(|options| {
                let mut found = Found::default();
                let at = |x: f64| view([x, 2500.0, 340.0], [1600.0, 2600.0, 0.0], 12.0);
                let mesh = |x: f64| {
                    let mut feed = Feed::with_options(&data.dataset, options);
                    let _ = feed.converge_within(200, &at(x));
                    feed.tree.flags()
                };
                // Half the interval in which it changes until there is nothing between its ends.
                let (mut low, mut high) = (1400.0f64, 1410.0f64);
                let first = mesh(low);
                for _ in 0..60 {
                    let middle = low + (high - low) / 2.0;
                    if middle <= low || middle >= high {
                        break;
                    }
                    match mesh(middle) == first {
                        true => low = middle,
                        false => high = middle,
                    }
                }
                let mut feed = Feed::with_options(&data.dataset, options);
                settle(&mut feed, &at(low), &mut found);
                settle(&mut feed, &at(high), &mut found);
                settle(&mut feed, &at(low), &mut found);
                let mut most = 0;
                for shake in 0..40 {
                    let view = at(if shake % 2 == 0 { high } else { low });
                    let stats = feed.tree.update(&view);
                    most = most.max(stats.changes);
                    hold(&mut feed.tree, &data, &view, stats.excess, true, &mut found);
                    if let Err(why) = check_history(&feed.tree, &data, &view) {
                        found.fault(why);
                    }
                }
                let apart = high - low;
                let all = feed.tree.flags().iter().filter(|flag| flag.enabled).count();
                let measured = format!(
                    "{most} of {all} vertices change a shake, {apart:.1e} m apart; deviation {:.3}",
                    found.deviation
                );
                if !found.faults.is_empty() {
                    return found.outcome_with(measured);
                }
                Outcome {
                    measured,
                    verdict: Verdict::Bounded(format!(
                        "{most} vertices a shake, all within the tolerance"
                    )),
                }
            })
        },
    )
}

fn still() -> Case {
    Case::new(
        "an eye that stands still for 1000 updates",
        "nothing changes, and after the first nothing is tested",
        || {
            let data = ground(SIDE, SIDE, hills);
            over_meshers(|options| {
                let mut found = Found::default();
                let mut feed = Feed::with_options(&data.dataset, options);
                let view = view([1400.0, 2500.0, 340.0], [1600.0, 2600.0, 0.0], 1.0);
                settle(&mut feed, &view, &mut found);
                let first = feed.tree.update(&view);
                let (mut changes, mut squares) = (0, 0);
                for _ in 0..1000 {
                    let stats = feed.tree.update(&view);
                    changes += stats.changes;
                    squares += stats.squares;
                    if stats.excess > first.excess.max(1.0) + ROUNDING {
                        found.fault("the bound grows");
                    }
                }
                if changes > 0 {
                    found.fault("the mesh changes");
                }
                let each = squares as f64 / 1000.0;
                found.outcome_with(format!(
                    "{changes} changes, {each:.0} squares tested an update"
                ))
            })
        },
    )
}
