//! Overviews.

use super::*;

fn drawn(made: &Made, width_px: u32) -> Overview {
    let frame = made.frame();
    overview(
        &mut made.pages(),
        &frame,
        width_px,
        &HeightLimits::default(),
    )
    .unwrap()
}

fn pixel(overview: &Overview, column: u32, row: u32) -> [u8; 4] {
    let at = 4 * (row * overview.size_px[0] + column) as usize;
    overview.rgba[at..at + 4].try_into().unwrap()
}

#[test]
fn an_overview_has_the_shape_of_the_land_and_is_clear_where_no_data_is() {
    // 3,320 m east, 5,400 m north; the lake is 60 columns from the west, 50 rows from the north.
    let made = Made::hills([333, 271], true);
    let overview = drawn(&made, 333);
    assert_eq!(overview.size_px, [333, 542]);
    assert_eq!(pixel(&overview, 60, 100), [0; 4]);
    assert_eq!(pixel(&overview, 2, 2), [0; 4]);
    assert_eq!(pixel(&overview, 60, 300)[3], 255);
    let small = drawn(&made, 20);
    assert_eq!((small.size_px, small.rgba.len()), ([20, 33], 20 * 33 * 4));
}

#[test]
fn where_a_page_has_few_samples_of_a_picture_it_is_less_sharp_and_not_refused() {
    // Ten samples a pixel: a stride of 8 has 4 squares in a page, one of 16 has 256 in the page above.
    let made = Made::hills([1025, 1025], false);
    let frame = made.frame();
    let limits = HeightLimits {
        pages: 50,
        ..HeightLimits::default()
    };
    let read = |pages: u64, limits: &HeightLimits| {
        let mut pages = Pages::new(&made.dataset, Work::new(pages, 0, &GOES_ON));
        overview(&mut pages, &frame, 100, limits)
    };
    let refused = read(limits.pages, &HeightLimits::default());
    assert!(matches!(refused, Err(HeightError::TooMuch { .. })));
    let coarse = read(limits.pages, &limits).unwrap();
    let fine = drawn(&made, 100);
    assert_eq!(coarse.size_px, fine.size_px);
    let there = |overview: &Overview| {
        overview
            .rgba
            .chunks(4)
            .filter(|rgba| rgba[3] == 255)
            .count()
    };
    assert_eq!(there(&coarse), there(&fine));
}

#[test]
fn slopes_towards_the_light_are_brighter() {
    let ridge = Made::of(&mut function([201, 101], |x, _| {
        500.0 - 5.0 * (f64::from(x) - 100.0).abs()
    }));
    let overview = drawn(&ridge, 200);
    let bright = |column| pixel(&overview, column, 50)[1];
    // The same height on both sides.
    assert!(
        bright(49) > bright(150) + 30,
        "{} {}",
        bright(49),
        bright(150)
    );
}

#[test]
fn a_narrow_strip_keeps_to_the_limit_and_a_wrong_width_is_refused() {
    let strip = Made::of(&mut function([2, 3000], |x, y| f64::from(x + y)));
    let overview = drawn(&strip, 500);
    assert_eq!(overview.size_px, [1, 1024]);
    for width_px in [0, 1025] {
        let refused = super::overview(
            &mut strip.pages(),
            &strip.frame(),
            width_px,
            &HeightLimits::default(),
        );
        assert!(matches!(refused, Err(HeightError::Usage { .. })));
    }
}
