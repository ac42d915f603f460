//! Pages that contradict a root page of a slope, or a page beside them.

use crate::mesh::{Contradiction, LinkError, MeshTree};
use escarp_proto::err8::Err8;
use escarp_proto::geometry::{GridLevels, PAGE_CELLS, PAGE_SAMPLES, PAGE_SLOTS, PageId, Slot};
use escarp_proto::georef::{Georef, Plane};
use escarp_proto::page::{ChildSlot, Codec, PAGE_AREA, Page, Range, Record, RecordHeader};

/// Quanta that the surface may be from a cell's two triangles.
const PROMISED: u32 = 50;
const CENTRE: usize = 8 * PAGE_SAMPLES + 8;

type Samples = [Option<i32>; PAGE_AREA];

fn full() -> ChildSlot {
    ChildSlot::Full(Err8::covering(PROMISED).unwrap())
}

/// A tree of a root page of a slope, whose slots all say the same.
fn tree(slot: ChildSlot) -> MeshTree {
    tree_with(slot, |_| {})
}

fn tree_with(slot: ChildSlot, change: impl Fn(&mut Samples)) -> MeshTree {
    let georef = Georef {
        origin_m: [0.0; 2],
        sample_spacing_m: [10.0; 2],
        quantum_m: 0.1,
        plane: Plane::Local,
    };
    let mut samples = std::array::from_fn(|at| {
        let (x, y) = (at % PAGE_SAMPLES, at / PAGE_SAMPLES);
        Some(slope(x as u32 * 16, y as u32 * 16))
    });
    change(&mut samples);
    let slots = Some(Box::new([slot; PAGE_SLOTS]));
    let mut tree = MeshTree::new(GridLevels::new(8).unwrap(), georef);
    tree.link(Page::new(PageId::ROOT, &samples, slots).unwrap())
        .unwrap();
    tree
}

fn slope(x: u32, y: u32) -> i32 {
    (40 * x + 7 * y) as i32
}

/// The page below a cell of the root, which is the slope but for what is changed.
fn page(column: u32, row: u32, change: impl Fn(&mut Samples)) -> Page {
    let id = PageId::ROOT
        .child(Slot::at(column as usize, row as usize))
        .unwrap();
    let mut samples = std::array::from_fn(|at| {
        let (x, y) = (at % PAGE_SAMPLES, at / PAGE_SAMPLES);
        Some(slope(column * 16 + x as u32, row * 16 + y as u32))
    });
    change(&mut samples);
    Page::new(id, &samples, None).unwrap()
}

fn raise(at: usize, by: i32) -> impl Fn(&mut Samples) {
    move |samples| samples[at] = samples[at].map(|height| height + by)
}

/// The first parts of a page, as they come.
fn prefix(page: &Page, parts: u8) -> Page {
    let record = Record::encode(page, Codec::Plain);
    let header = RecordHeader::read(page.id(), page.is_finest(), record.bytes()).unwrap();
    let bytes = header.part_bytes(0, parts).unwrap();
    Page::decode(page.id(), page.is_finest(), parts, &record.bytes()[bytes]).unwrap()
}

fn refusal(tree: &mut MeshTree, page: Page) -> Contradiction {
    let (id, before) = (page.id(), tree.resident());
    let error = tree.link(page).unwrap_err();
    assert!(error.to_string().contains(&id.to_string()), "{error}");
    assert_eq!(tree.resident(), before);
    match error {
        LinkError::Contradiction { page, what } if page == id => what,
        other => panic!("{other}"),
    }
}

#[test]
fn a_page_that_keeps_the_promise_is_linked_with_any_of_its_parts() {
    for by in [0, 1, 49, 50, -50] {
        for at in [CENTRE, 1, PAGE_SAMPLES + 1, 4 * PAGE_SAMPLES + 4] {
            let page = page(3, 4, raise(at, by));
            let mut growing = tree(full());
            for parts in 1..=4 {
                tree(full()).link(prefix(&page, parts)).unwrap();
                growing.link(prefix(&page, parts)).unwrap();
            }
        }
    }
}

#[test]
fn a_page_farther_off_than_promised_is_refused_as_soon_as_it_shows() {
    let bound = Err8::covering(PROMISED).unwrap().bound() as i32;
    for by in [bound + 2, -bound - 2, 100_000] {
        // The centre is in the first part, the others come later, but are announced before.
        for at in [CENTRE, 4 * PAGE_SAMPLES + 4, PAGE_SAMPLES + 1] {
            for parts in 1..=4 {
                let page = prefix(&page(3, 4, raise(at, by)), parts);
                let what = refusal(&mut tree(full()), page);
                let off = matches!(what, Contradiction::Error { found, promised }
                    if found > promised && promised == bound as u32);
                assert!(off, "{at} {by} {parts}: {what:?}");
            }
        }
    }
    let whole = page(3, 4, raise(CENTRE, bound + 1));
    let what = refusal(&mut tree(full()), whole);
    assert!(matches!(what, Contradiction::Error { .. }), "{what:?}");
}

#[test]
fn a_page_that_grows_worse_is_refused_and_stays_as_it_was() {
    let (good, bad) = (page(3, 4, |_| {}), page(3, 4, raise(1, 70)));
    let mut tree = tree(full());
    tree.link(prefix(&good, 2)).unwrap();
    refusal(&mut tree, prefix(&bad, 4));
    assert_eq!(tree.page(good.id()), Some(&prefix(&good, 2)));
    tree.link(good).unwrap();
}

#[test]
fn a_corner_of_another_height_or_that_is_a_hole_is_refused() {
    for corner in [0, 16, PAGE_AREA - 17, PAGE_AREA - 1] {
        for parts in [1, 4] {
            let page = prefix(&page(5, 0, raise(corner, 1)), parts);
            let what = refusal(&mut tree(full()), page);
            assert!(matches!(what, Contradiction::Corner { .. }), "{what:?}");
        }
        let holed = page(5, 0, |samples| samples[corner] = None);
        let range = Range { lo: 0, hi: 20_000 };
        let what = refusal(&mut tree(ChildSlot::Mixed(range)), holed);
        assert_eq!(what, Contradiction::CornerHole);
    }
}

#[test]
fn holes_where_there_is_surface_and_surface_where_there_is_none_are_refused() {
    let holed = || page(2, 2, |samples| samples[CENTRE] = None);
    let range = Range { lo: 0, hi: 20_000 };
    for parts in [1, 4] {
        for (slot, page) in [
            (full(), holed()),
            (ChildSlot::Full(Err8(0)), holed()),
            (ChildSlot::Mixed(range), page(2, 2, |_| {})),
            (ChildSlot::Empty, page(2, 2, |_| {})),
            (ChildSlot::Empty, holed()),
        ] {
            let what = refusal(&mut tree(slot), prefix(&page, parts));
            assert!(
                matches!(what, Contradiction::Kind { .. }),
                "{slot:?}: {what:?}"
            );
        }
        let mut tree = tree(ChildSlot::Mixed(range));
        tree.link(prefix(&holed(), parts)).unwrap();
    }
}

#[test]
fn heights_that_leave_their_range_beside_an_outline_are_refused() {
    let holed = || page(2, 2, |samples| samples[CENTRE] = None);
    let own = Range {
        lo: slope(32, 32),
        hi: slope(48, 48),
    };
    tree(ChildSlot::Mixed(own)).link(holed()).unwrap();
    for promised in [
        Range {
            hi: own.hi - 1,
            ..own
        },
        Range {
            lo: own.lo + 1,
            ..own
        },
    ] {
        let what = refusal(&mut tree(ChildSlot::Mixed(promised)), holed());
        let found = own;
        assert_eq!(what, Contradiction::Range { found, promised });
    }
}

#[test]
fn a_record_where_nothing_is_stored_must_be_what_is_implied() {
    let flat = |change: fn(&mut Samples)| page(1, 1, change);
    tree(ChildSlot::Full(Err8(0))).link(flat(|_| {})).unwrap();
    let bump = flat(|samples| samples[CENTRE] = Some(slope(24, 24) + 1));
    let what = refusal(&mut tree(ChildSlot::Full(Err8(0))), bump);
    assert!(
        matches!(what, Contradiction::Error { promised: 0, .. }),
        "{what:?}"
    );
}

#[test]
fn of_two_pages_that_disagree_on_a_shared_sample_the_newcomer_is_refused() {
    // (column, row) of the second page, and the same sample of the two.
    let beside = [
        ((4, 3), 8 * PAGE_SAMPLES + 16, 8 * PAGE_SAMPLES),
        ((2, 3), 8 * PAGE_SAMPLES, 8 * PAGE_SAMPLES + 16),
        ((3, 4), PAGE_AREA - 9, 8),
        ((3, 2), 8, PAGE_AREA - 9),
    ];
    for ((column, row), here, there) in beside {
        for parts in [(1, 1), (1, 4), (4, 2), (4, 4)] {
            let first = page(3, 3, raise(here, 5));
            let mut tree = tree(full());
            tree.link(prefix(&first, parts.0)).unwrap();
            let second = page(column, row, |_| {});
            let what = refusal(&mut tree, prefix(&second, parts.1));
            let Contradiction::Border {
                beside,
                found,
                expected,
            } = what
            else {
                panic!("{what:?}");
            };
            assert_eq!((beside, expected - found), (first.id(), 5));
            tree.link(page(column, row, raise(there, 5))).unwrap();
        }
    }
}

#[test]
fn a_shared_sample_counts_only_once_both_pages_have_it() {
    let mut tree = tree(full());
    // The second sample of the border is in part 4.
    tree.link(prefix(&page(3, 3, raise(PAGE_CELLS + PAGE_SAMPLES, 5)), 3))
        .unwrap();
    let second = page(4, 3, |_| {});
    tree.link(prefix(&second, 4)).unwrap();
    let what = refusal(&mut tree, page(3, 3, raise(PAGE_CELLS + PAGE_SAMPLES, 5)));
    assert!(matches!(what, Contradiction::Border { .. }), "{what:?}");
}

#[test]
fn a_shared_sample_that_is_a_hole_in_one_of_two_stored_pages_is_refused() {
    let slot = ChildSlot::Mixed(Range { lo: 0, hi: 20_000 });
    let mut tree = tree(slot);
    let east = 8 * PAGE_SAMPLES + 16;
    let first = page(3, 3, |samples| samples[east] = None);
    tree.link(first).unwrap();
    let second = |row: usize| page(4, 3, move |samples| samples[row * PAGE_SAMPLES] = None);
    let what = refusal(&mut tree, second(9));
    assert!(matches!(what, Contradiction::BorderHole { .. }), "{what:?}");
    tree.link(second(8)).unwrap();
}

#[test]
fn a_corner_that_is_a_hole_above_and_below_is_no_contradiction() {
    let slot = ChildSlot::Mixed(Range { lo: 0, hi: 20_000 });
    let mut tree = tree_with(slot, |samples| samples[0] = None);
    tree.link(page(0, 0, |samples| samples[0] = None)).unwrap();
}
