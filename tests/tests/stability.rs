//! Every row of the stability table comes out as it is stated.

use escarp_tests::stability::{GROUPS, Row, render};

/// Runs a group. `ESCARP_STABILITY=1` prints its rows.
fn rows(group: &str) -> Vec<Row> {
    let group = GROUPS.iter().find(|known| known.name == group);
    let group = group.expect("a group of that name");
    (group.cases)()
        .iter()
        .map(|case| case.row(group.name))
        .collect()
}

/// A row that fails must be known to, and one that is known to must still fail.
fn comes_out(group: &str) {
    let rows = rows(group);
    assert!(!rows.is_empty());
    if std::env::var_os("ESCARP_STABILITY").is_some() {
        println!("{}", render::markdown(&rows, 4));
    }
    let other: Vec<&Row> = rows.iter().filter(|row| !row.is_expected()).collect();
    assert!(other.is_empty(), "{other:#?}");
}

#[test]
fn meshes_hold_over_ground_of_every_shape() {
    comes_out("Shapes of the ground");
}

#[test]
fn the_promise_holds_on_real_ground_from_a_valley_to_orbit() {
    comes_out("The promise on real ground");
}

#[test]
fn meshes_hold_at_every_scale_and_coordinate() {
    comes_out("Scales and coordinates");
}

#[test]
fn meshes_hold_for_every_eye_and_view() {
    comes_out("Eyes and views");
}

#[test]
fn what_is_no_number_or_out_of_range_is_refused_or_a_hole() {
    comes_out("Input that is no number, or out of range");
}

#[test]
fn meshes_hold_while_the_eye_jitters_and_creeps() {
    comes_out("Motion");
}

#[test]
fn after_any_leap_the_mesh_is_that_of_a_recomputation() {
    comes_out("Leaps");
}

#[test]
fn meshes_hold_with_too_little_memory_and_pages_that_do_not_come() {
    comes_out("Memory and missing pages");
}

#[test]
fn meshes_hold_in_the_deepest_grid_and_deeper_ones_are_refused() {
    comes_out("Depth of the grid");
}

#[test]
fn what_meets_the_gpu_is_within_a_tenth_of_a_pixel_or_known_not_to_be() {
    comes_out("Numerics: single against double precision and exact integers");
}

#[test]
fn results_move_no_more_than_their_inputs_let_them() {
    comes_out("Numerics: conditioning");
}

#[test]
fn every_group_has_a_test() {
    let source = include_str!("stability.rs");
    for group in GROUPS {
        assert!(
            source.contains(&format!("comes_out(\"{}\")", group.name)),
            "{}",
            group.name
        );
    }
}
