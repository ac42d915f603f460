//! The real server and real clients over lines of given delay, bandwidth and loss, in network
//! namespaces. Where these cannot be made, nothing is tested, and a line says so.

use escarp_tests::nets::client::Kind;
use escarp_tests::nets::convergence::{Plan, measure};
use escarp_tests::nets::lab::Lab;
use escarp_tests::nets::shaper::Cell;
use escarp_tests::programs::{Desk, program};
use std::process::Command;

fn is_possible() -> bool {
    let lab = Lab::new();
    if let Err(why) = &lab {
        println!("not tested: {why:#}");
    }
    lab.is_ok()
}

#[test]
fn every_client_converges_over_a_line_with_delay_and_loss_and_nothing_is_left_behind() {
    if !is_possible() {
        return;
    }
    // They are built where they are not yet.
    program("escarp-server");
    let desk = Desk::new();
    let dataset = desk.dataset();
    let cell = Cell {
        round_trip_ms: 40.0,
        mbit_s: 10.0,
        loss_percent: 1.0,
    };
    let plan = Plan {
        cells: vec![cell],
        kinds: Kind::ALL.to_vec(),
        repeats: 1,
        error_px: 2.0,
        limit_s: 50.0,
        parameters: Vec::new(),
    };
    let outcomes = measure(&dataset, &plan, &|_| {}).expect("it is measured");
    assert_eq!(outcomes.len(), Kind::ALL.len());
    for outcome in &outcomes {
        for (number, leg) in outcome.runs[0].iter().enumerate() {
            let name = format!("{}, leg {number}", outcome.kind);
            let last = leg.moments.last().expect("moments");
            assert!(
                last.bound_px.is_some_and(|px| px <= 2.0),
                "{name}: {last:?}"
            );
            // A client of tiles is watched only until it has converged.
            let settles = outcome.kind != Kind::Tiles;
            assert!(leg.converged_s.is_some(), "{name}");
            assert!(leg.settled_s.is_some() || !settles, "{name}");
            assert!(leg.used_bytes <= leg.page_bytes, "{name}");
            assert!(leg.page_bytes <= Some(leg.bytes), "{name}");
        }
        // Bytes that came are bytes that were carried: the line was between them.
        let first = &outcome.runs[0][0];
        let opened_s = first.opened_s.expect("it connected");
        assert!(
            opened_s >= 0.080,
            "two round trips before anything is known: {opened_s}"
        );
        assert!(first.bytes > 0);
    }
    let left = Command::new("ip").args(["netns", "list"]).output();
    let left = String::from_utf8_lossy(&left.expect("ip runs").stdout).into_owned();
    let own = format!("escarp-{}-", std::process::id());
    assert!(!left.contains(&own), "{left}");
}
