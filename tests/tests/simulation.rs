//! Server and clients under virtual time: whatever happens to lines, machines and datasets, there
//! is no crack, no wrong height, the bound holds, and in the end all converges.

use escarp_tests::sim::{Campaign, Script};
use std::env;

/// How many seeds a run of all tests takes. More: `escarp-report simulate`, or `ESCARP_SEEDS`.
const SEEDS: u64 = 64;

#[test]
fn whatever_happens_no_crack_no_wrong_height_the_bound_holds_and_all_converges() {
    let seeds = env::var("ESCARP_SEEDS").ok();
    let seeds = seeds.map_or(SEEDS, |text| {
        text.parse().expect("ESCARP_SEEDS is a number")
    });
    let campaign = Campaign::new();
    let (tally, mut failures) = campaign.run_seeds(0..seeds, &|| {});
    println!("{tally:?}");
    let failed: Vec<u64> = failures.iter().map(|f| f.script.seed).collect();
    if let Some(first) = failures.drain(..).next() {
        panic!(
            "seeds {failed:?} fail; the first:\n{}",
            campaign.shorten(first)
        );
    }
}

#[test]
fn a_seed_is_the_same_run_every_time() {
    let campaign = Campaign::new();
    // In the last one, the order of keys in a message mattered.
    for seed in (0..10).chain([2522]) {
        let runs = [0, 1].map(|_| campaign.run(&Script::of(seed)).expect("it holds"));
        assert_eq!(runs[0], runs[1], "seed {seed}");
    }
}
