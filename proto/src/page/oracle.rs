//! Naive oracles and properties of pages: every bound is held against a scan of all samples.

use super::*;
use crate::geometry::{Edge, GridLevels, Quadrant};
use proptest::prelude::*;

type Samples = [Option<i32>; PAGE_AREA];
type Point = (usize, usize);

/// A vertex triangle in samples of the full page.
struct Triangle([Point; 3]);

impl Triangle {
    /// Twice the signed area spanned by `a`, `b` and `p`.
    fn side(a: Point, b: Point, p: Point) -> i64 {
        let d = |q: Point| (q.0 as i64 - a.0 as i64, q.1 as i64 - a.1 as i64);
        let (b, p) = (d(b), d(p));
        b.0 * p.1 - b.1 * p.0
    }

    /// Largest distance of any sample from the plane, rounded up; barycentric, in integers.
    fn deviation(&self, height: impl Fn(Point) -> i64) -> u32 {
        let [a, b, c] = self.0;
        let area = Self::side(a, b, c);
        let mut largest = 0;
        for y in 0..PAGE_SAMPLES {
            for x in 0..PAGE_SAMPLES {
                let p = (x, y);
                let w = [
                    Self::side(b, c, p),
                    Self::side(c, a, p),
                    Self::side(a, b, p),
                ];
                if w.iter().all(|w| w * area.signum() >= 0) {
                    let plane = w[0] * height(a) + w[1] * height(b) + w[2] * height(c);
                    let scaled = (area * height(p) - plane).unsigned_abs();
                    largest = largest.max(scaled.div_ceil(area.unsigned_abs()));
                }
            }
        }
        largest as u32
    }
}

/// Edge triangle of a square, by its level in the page.
fn edge_triangle((level, column, row): (u8, usize, usize), edge: Edge) -> Triangle {
    let side = level_step(level);
    let (x, y) = (column * side, row * side);
    let centre = (x + side / 2, y + side / 2);
    let (sw, se, nw, ne) = ((x, y), (x + side, y), (x, y + side), (x + side, y + side));
    Triangle(match edge {
        Edge::East => [centre, se, ne],
        Edge::North => [centre, ne, nw],
        Edge::West => [centre, nw, sw],
        Edge::South => [centre, sw, se],
    })
}

fn halves((level, column, row): (u8, usize, usize), rises: bool) -> [Triangle; 2] {
    let side = level_step(level);
    let (x, y) = (column * side, row * side);
    let (sw, se, nw, ne) = ((x, y), (x + side, y), (x, y + side), (x + side, y + side));
    if rises {
        [Triangle([sw, se, ne]), Triangle([sw, ne, nw])]
    } else {
        [Triangle([sw, se, nw]), Triangle([se, ne, nw])]
    }
}

fn squares(depth: u8) -> impl Iterator<Item = (u8, usize, usize)> {
    (0..depth).flat_map(|level| {
        (0..1 << level).flat_map(move |row| (0..1 << level).map(move |column| (level, column, row)))
    })
}

fn page_id() -> PageId {
    PageId::new(8, 37, 90).unwrap()
}

/// A grid whose finest pages are the children of [`page_id`].
fn grid() -> GridLevels {
    GridLevels::new(16).unwrap()
}

/// A page above two more levels of pages, and the finest samples below a cell, row by row.
fn expanded(page: &Page, slot: Slot) -> Vec<i32> {
    let grid = GridLevels::new(20).unwrap();
    let child = page.implied_child(slot, grid).unwrap();
    let side = PAGE_CELLS * PAGE_CELLS + 1;
    let mut samples = vec![0; side * side];
    for i in 0..PAGE_SLOTS {
        let below = Slot::from_index(i as u8);
        let finest = child.implied_child(below, grid).unwrap();
        let (column, row) = below.position();
        for at in 0..PAGE_AREA {
            let x = column * PAGE_CELLS + at % PAGE_SAMPLES;
            let y = row * PAGE_CELLS + at / PAGE_SAMPLES;
            samples[y * side + x] = finest.height(at);
        }
    }
    samples
}

fn terrain() -> impl Strategy<Value = Samples> {
    let smooth =
        (any::<i16>(), any::<i8>(), any::<i8>(), any::<i8>()).prop_map(|(base, a, b, c)| {
            std::array::from_fn(|i| {
                let (x, y) = ((i % PAGE_SAMPLES) as i32, (i / PAGE_SAMPLES) as i32);
                Some(
                    i32::from(base)
                        + i32::from(a) * x
                        + i32::from(b) * y
                        + i32::from(c) * x * y / 7,
                )
            })
        });
    let noise = prop::collection::vec(-1000..1000i32, PAGE_AREA)
        .prop_map(|v| std::array::from_fn(|i| Some(v[i])));
    let extreme = prop::collection::vec(-MAX_HEIGHT..=MAX_HEIGHT, PAGE_AREA)
        .prop_map(|v| std::array::from_fn(|i| Some(v[i])));
    let spike = (0..PAGE_AREA, -MAX_HEIGHT..=MAX_HEIGHT).prop_map(|(at, height)| {
        let mut samples = [Some(7); PAGE_AREA];
        samples[at] = Some(height);
        samples
    });
    prop_oneof![smooth, noise, extreme, spike]
}

fn holed() -> impl Strategy<Value = Samples> {
    let mask = prop_oneof![
        prop::collection::vec(any::<bool>(), PAGE_AREA),
        (0..PAGE_SAMPLES)
            .prop_map(|edge| (0..PAGE_AREA).map(|i| i % PAGE_SAMPLES > edge).collect())
    ];
    (terrain(), mask).prop_map(|(samples, mask)| {
        std::array::from_fn(|i| if mask[i] { samples[i] } else { None })
    })
}

fn slots() -> impl Strategy<Value = Box<[ChildSlot; PAGE_SLOTS]>> {
    let slot = prop_oneof![
        8 => any::<u8>().prop_map(|code| ChildSlot::Full(Err8(code))),
        1 => any::<u8>().prop_map(|code| ChildSlot::Cut(Err8(code))),
        1 => Just(ChildSlot::Empty),
        1 => (-5000..5000i32, 0..90).prop_map(|(lo, span)| ChildSlot::Mixed(Range { lo, hi: lo + span })),
    ];
    let full = prop_oneof![
        any::<u8>().prop_map(|code| ChildSlot::Full(Err8(code))),
        any::<u8>().prop_map(|code| ChildSlot::Cut(Err8(code))),
    ];
    let any_slots = prop::collection::vec(slot, PAGE_SLOTS);
    prop_oneof![any_slots, prop::collection::vec(full, PAGE_SLOTS)]
        .prop_map(|v| Box::new(std::array::from_fn(|i| v[i])))
}

fn codecs() -> impl Strategy<Value = Codec> {
    prop_oneof![Just(Codec::Plain), Just(Codec::Dense)]
}

pub(crate) fn whole_page() -> impl Strategy<Value = Page> {
    let samples = prop_oneof![terrain(), holed()];
    (samples, prop::option::of(slots()))
        .prop_map(|(samples, slots)| Page::new(page_id(), &samples, slots).unwrap())
}

proptest! {
    #[test]
    fn a_record_decodes_to_the_page_in_every_split_of_its_parts(page in whole_page(), split in 1u8..5, codec in codecs()) {
        let record = Record::encode(&page, codec);
        prop_assert!(record.bytes().len() <= MAX_RECORD_BYTES);
        let header = RecordHeader::read(page.id(), page.is_finest(), record.bytes()).unwrap();
        prop_assert_eq!(header.record_len(), record.bytes().len());
        for (first, last) in (0..=6).flat_map(|first| (0..=6).map(move |last| (first, last))) {
            let found = RecordHeader::find_parts(page.id(), page.is_finest(), record.bytes(), first, last);
            prop_assert_eq!(found.unwrap(), header.part_bytes(first, last).filter(|_| first <= last));
        }
        let last = page.last_part();
        let split = split.min(last);
        let first = &record.bytes()[header.part_bytes(0, split).unwrap()];
        let mut back = Page::decode(page.id(), page.is_finest(), split, first).unwrap();
        if split < last {
            let rest = &record.bytes()[header.part_bytes(split + 1, last).unwrap()];
            back.extend(last, rest).unwrap();
        }
        prop_assert_eq!(back, page);
    }

    #[test]
    fn both_codecs_say_the_same_of_a_page_after_every_part(page in whole_page()) {
        let after = |codec: Codec, parts: u8| {
            let record = Record::encode(&page, codec);
            let header = RecordHeader::read(page.id(), page.is_finest(), record.bytes()).unwrap();
            let bytes = &record.bytes()[header.part_bytes(0, parts).unwrap()];
            let mut page = Page::decode(page.id(), page.is_finest(), parts, bytes).unwrap();
            page.stream = None;
            page
        };
        for parts in 1..=page.last_part() {
            prop_assert_eq!(after(Codec::Plain, parts), after(Codec::Dense, parts));
        }
    }

    #[test]
    fn a_record_that_is_cut_or_goes_on_is_refused_or_tells_of_another_page(page in whole_page(), codec in codecs(), cut: prop::sample::Index) {
        let mut bytes = Record::encode(&page, codec).bytes().to_vec();
        let cut = cut.index(bytes.len());
        let decode = |bytes: &[u8]| Page::decode(page.id(), page.is_finest(), page.last_part(), bytes);
        let cut = decode(&bytes[..cut]);
        bytes.push(0);
        let longer = decode(&bytes);
        match codec {
            Codec::Plain => prop_assert!(cut.is_err() && longer.is_err()),
            // The stream ends in a known state: another length that ends in it, too, says something else.
            Codec::Dense => prop_assert!(cut.as_ref() != Ok(&page) && longer.as_ref() != Ok(&page)),
        }
    }

    #[test]
    fn hostile_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..2000), finest: bool, tag in 0u8..64) {
        let mut bytes = bytes;
        if let Some(first) = bytes.first_mut() { *first = tag; }
        for parts in 0..7 {
            if let Ok(page) = Page::decode(page_id(), finest, parts, &bytes) {
                let _ = Bounds::derive(&page, None);
            }
        }
    }

    #[test]
    fn a_flipped_byte_decodes_to_something_bounded_or_is_refused(page in whole_page(), codec in codecs(), at: prop::sample::Index, flip in 1u8..) {
        let mut bytes = Record::encode(&page, codec).bytes().to_vec();
        let at = at.index(bytes.len());
        let before = revision(page.id(), &bytes);
        bytes[at] ^= flip;
        prop_assert_ne!(revision(page.id(), &bytes), before);
        if let Ok(page) = Page::decode(page.id(), page.is_finest(), page.last_part(), &bytes) {
            let _ = Bounds::derive(&page, None);
        }
    }

    #[test]
    fn bounds_hold_at_every_sample_of_a_finest_page_for_every_prefix(samples in terrain(), codec in codecs()) {
        let whole = Page::new(page_id(), &samples, None).unwrap();
        let record = Record::encode(&whole, codec);
        let header = RecordHeader::read(whole.id(), true, record.bytes()).unwrap();
        for parts in 1..=4 {
            let prefix = &record.bytes()[header.part_bytes(0, parts).unwrap()];
            let page = Page::decode(whole.id(), true, parts, prefix).unwrap();
            let bounds = Bounds::derive(&page, None);
            let height = |(x, y): Point| i64::from(whole.height(y * PAGE_SAMPLES + x));
            for square in squares(parts) {
                let (level, column, row) = square;
                for edge in Edge::ALL {
                    let measured = edge_triangle(square, edge).deviation(height);
                    let promised = bounds.square(level, column, row).edges[edge as usize];
                    prop_assert!(measured <= promised, "{square:?} {edge:?}: {measured} > {promised}");
                }
                let root = page_id().square();
                let (x, y) = if level == 0 { (root.x, root.y) } else { (column as u32, row as u32) };
                for half in halves(square, Quadrant::of(x, y).rises()) {
                    prop_assert!(half.deviation(height) <= bounds.box_error(level, column, row).error);
                }
            }
        }
    }

    #[test]
    fn the_bound_of_a_square_is_the_exact_largest_deviation_below_it(samples in terrain()) {
        let page = Page::new(page_id(), &samples, None).unwrap();
        let bounds = Bounds::derive(&page, None);
        let height = |(x, y): Point| i64::from(page.height(y * PAGE_SAMPLES + x));
        let root = page_id().square();
        let rises = |(level, column, row): (u8, usize, usize)| match level {
            0 => Quadrant::of(root.x, root.y).rises(),
            _ => Quadrant::of(column as u32, row as u32).rises(),
        };
        // The root's bound is saturated: the largest of the exact errors of all triangles in it.
        let exact = squares(4).flat_map(|square| {
            let edges = Edge::ALL.map(|edge| edge_triangle(square, edge).deviation(height));
            let halves = halves(square, rises(square)).map(|half| half.deviation(height));
            edges.into_iter().chain(halves)
        });
        prop_assert_eq!(bounds.box_error(0, 0, 0).error, exact.max().unwrap());
    }

    #[test]
    fn the_quick_way_derives_what_the_plain_one_does(
        page in whole_page(),
        promise in prop::option::of(0..MAX_SPAN),
        id in prop_oneof![Just(page_id()), Just(PageId::new(8, 38, 90).unwrap())],
        codec in codecs(),
    ) {
        let page = Page { id, ..page };
        let record = Record::encode(&page, codec);
        let header = RecordHeader::read(page.id(), page.is_finest(), record.bytes()).unwrap();
        let promise = promise.map(|error| BoxError { error, ..Bounds::derive(&page, None).box_error(0, 0, 0) });
        for parts in 1..=page.last_part() {
            let prefix = &record.bytes()[header.part_bytes(0, parts).unwrap()];
            let page = Page::decode(page.id(), page.is_finest(), parts, prefix).unwrap();
            for promise in [None, promise] {
                prop_assert_eq!(Bounds::derive(&page, promise), Bounds::derive_plain(&page, promise));
            }
        }
    }

    #[test]
    fn a_page_and_its_slot_are_judged_as_its_bounds_say(samples in terrain()) {
        let heights = Box::new(samples.map(|sample| sample.unwrap()));
        let (page, slot) = Page::with_slot(page_id(), heights, None, None).unwrap();
        let bounds = Bounds::derive_plain(&page, None);
        prop_assert_eq!(slot, bounds.slot());
        for level in 1..=PAGE_LEVELS {
            let of_level = (0..1 << (2 * level)).map(|i| bounds.box_error(level, i % (1 << level), i >> level).error);
            prop_assert_eq!(Some(page.rest[level as usize - 1]), Err8::covering(of_level.max().unwrap()));
        }
    }

    #[test]
    fn bounds_never_grow_when_parts_arrive(page in whole_page(), codec in codecs()) {
        let record = Record::encode(&page, codec);
        let header = RecordHeader::read(page.id(), page.is_finest(), record.bytes()).unwrap();
        let promise = Bounds::derive(&page, None).box_error(0, 0, 0);
        // Ranges and bounds are cut off there.
        let cut_off = promise.range.lo == -MAX_HEIGHT || promise.range.hi == MAX_HEIGHT;
        prop_assume!(!cut_off && promise.error < MAX_SPAN);
        let bounds = |parts: u8| {
            let prefix = &record.bytes()[header.part_bytes(0, parts).unwrap()];
            let page = Page::decode(page.id(), page.is_finest(), parts, prefix).unwrap();
            Bounds::derive(&page, Some(promise))
        };
        for parts in 2..=page.last_part() {
            let (fewer, more) = (bounds(parts - 1), bounds(parts));
            for (level, column, row) in squares(more.depth()) {
                let square = more.square(level, column, row);
                let own = more.box_error(level, column, row);
                let down = level.saturating_sub(fewer.depth());
                let before = fewer.box_error(level - down, column >> down, row >> down);
                prop_assert!(own.error <= before.error && before.range.contains(own.range), "{parts} parts, level {level}: {own:?}, before {before:?}, {promise:?}");
                if level < fewer.depth() {
                    let before = fewer.square(level, column, row);
                    for edge in 0..4 {
                        prop_assert!(square.edges[edge] <= before.edges[edge]);
                    }
                }
            }
        }
    }

    #[test]
    fn errors_and_ranges_are_nested(page in whole_page(), codec in codecs()) {
        let record = Record::encode(&page, codec);
        let header = RecordHeader::read(page.id(), page.is_finest(), record.bytes()).unwrap();
        let promise = Bounds::derive(&page, None).box_error(0, 0, 0);
        for parts in 1..=page.last_part() {
            let prefix = &record.bytes()[header.part_bytes(0, parts).unwrap()];
            let page = Page::decode(page.id(), page.is_finest(), parts, prefix).unwrap();
            let bounds = Bounds::derive(&page, Some(promise));
            for (level, column, row) in squares(bounds.depth()) {
                let square = bounds.square(level, column, row);
                let own = bounds.box_error(level, column, row);
                prop_assert!(own.error <= promise.error && promise.range.contains(own.range));
                for edge in Edge::ALL {
                    prop_assert!(square.edges[edge as usize] <= own.error);
                }
                for quadrant in Quadrant::ALL {
                    let (dx, dy) = quadrant.offset();
                    let child = bounds.box_error(level + 1, 2 * column + dx as usize, 2 * row + dy as usize);
                    let edges = quadrant.edges().map(|edge| square.edges[edge as usize]);
                    prop_assert!(square.range.contains(child.range));
                    prop_assert!(child.error <= edges[0].max(edges[1]));
                }
            }
        }
    }
}

proptest! {
    #[test]
    fn below_a_cut_cell_the_surface_is_within_the_bound_and_neighbours_share_their_border(
        samples in terrain(), at in 0u8..255, rounded: bool,
    ) {
        // Of corners that are multiples of 256 quanta nothing is rounded.
        let samples = samples.map(|h| h.map(|h| if rounded { h } else { h / 256 * 256 }));
        let cell = Slot::from_index(at);
        let (column, row) = cell.position();
        prop_assume!(column < 15);
        let slots = Box::new([ChildSlot::Cut(Err8::covering(2).unwrap()); PAGE_SLOTS]);
        let page = Page::new(page_id(), &samples, Some(slots)).unwrap();
        let below = expanded(&page, cell);
        let east = expanded(&page, Slot::at(column + 1, row));
        let side = (PAGE_CELLS * PAGE_CELLS) as i64;
        let width = side as usize + 1;
        let corner = |dx, dy| i64::from(page.height((row + dy) * PAGE_SAMPLES + column + dx));
        let corners = [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)];
        let rises = (column + row) % 2 == 0;
        for (i, height) in below.iter().enumerate() {
            let (u, v) = ((i % width) as i64, (i / width) as i64);
            let plane = flat::two_triangles(corners, rises, (u, v), side);
            let down = plane - side * i64::from(*height);
            prop_assert!((0..2 * side).contains(&down));
            prop_assert!(rounded || down == 0);
        }
        for v in 0..width {
            prop_assert_eq!(below[v * width + width - 1], east[v * width]);
        }
    }

    #[test]
    fn a_page_is_cut_exactly_if_it_is_what_its_corners_imply(
        corners in prop::array::uniform4(-3000..3000i32), wrong in prop::option::of(0..PAGE_AREA), evenly: bool,
    ) {
        let corners = corners.map(|h| if evenly { h / 16 * 16 } else { h });
        let id = page_id().child(Slot::at(2, 7)).unwrap();
        let implied = implied_heights(id, corners);
        let mut heights = implied;
        if let Some(at) = wrong {
            heights[at] += 1;
        }
        let told = implied_slot(id, grid(), &heights, None);
        let page = Page::new(id, &heights.map(Some), None).unwrap();
        let bounds = Bounds::derive(&page, None);
        if let Some(slot) = told {
            // Its bound is one that the page itself would have.
            let (ChildSlot::Full(error) | ChildSlot::Cut(error)) = slot else { panic!("{slot:?}") };
            let own = bounds.box_error(0, 0, 0).error;
            prop_assert!(own <= error.bound(), "{own} {error:?}");
            prop_assert_eq!(slot == ChildSlot::Full(Err8(0)), own == 0);
            let slots = Box::new([slot; PAGE_SLOTS]);
            let flat: Samples = [Some(0); PAGE_AREA];
            let mut above = Page::new(page_id(), &flat, Some(slots)).unwrap();
            for (i, at) in [0, 16, 272, 288].into_iter().enumerate() {
                let corner = (7 + i / 2) * PAGE_SAMPLES + 2 + i % 2;
                above.heights[corner] = page.height(at);
            }
            let child = above.implied_child(Slot::at(2, 7), grid()).unwrap();
            prop_assert!((0..PAGE_AREA).all(|i| child.height(i) == page.height(i)));
        } else {
            prop_assert!(wrong.is_some());
        }
        // A wrong corner makes another page, that may be one of its own corners.
        let is_corner = wrong.is_some_and(|at| [0, 16, 272, 288].contains(&at));
        prop_assert!(wrong.is_none() || is_corner || told.is_none());
    }
}

#[test]
fn a_page_is_not_cut_above_one_that_is_stored() {
    let id = PageId::new(4, 3, 2).unwrap();
    let samples = implied_heights(id, [5, 9, 100, 7]);
    let cut = ChildSlot::Cut(Err8(1));
    let with = |slot| {
        let mut slots = [cut; PAGE_SLOTS];
        slots[77] = slot;
        implied_slot(id, grid(), &samples, Some(&slots))
    };
    let three = Err8::covering(3).unwrap();
    assert_eq!(with(cut), Some(ChildSlot::Cut(three)));
    assert_eq!(with(ChildSlot::Full(Err8(0))), Some(ChildSlot::Cut(three)));
    assert_eq!(with(ChildSlot::Full(Err8(1))), None);
    assert_eq!(with(ChildSlot::Empty), None);
    assert_eq!(with(ChildSlot::Mixed(Range { lo: 0, hi: 9 })), None);
}

#[test]
fn a_record_that_claims_cut_slots_has_some() {
    let samples = [Some(3); PAGE_AREA];
    let mut slots = Box::new([ChildSlot::Full(Err8(4)); PAGE_SLOTS]);
    slots[9] = ChildSlot::Cut(Err8(2));
    let page = Page::new(page_id(), &samples, Some(slots)).unwrap();
    let mut bytes = Record::encode(&page, Codec::Plain).bytes().to_vec();
    assert_eq!(Page::decode(page.id(), false, 5, &bytes), Ok(page.clone()));
    // Two bits a slot; slot 9 is in byte 2 of the kinds.
    let kinds = bytes.len() - PAGE_SLOTS - PAGE_SLOTS / 4;
    assert_eq!(bytes[kinds + 2], 3 << 2);
    for wrong in [0, 1 << 2, 2 << 2] {
        bytes[kinds + 2] = wrong;
        assert!(Page::decode(page.id(), false, 5, &bytes).is_err());
    }
    let finest = Page::new(page_id(), &samples, None).unwrap();
    for codec in [Codec::Plain, Codec::Dense] {
        let mut bytes = Record::encode(&finest, codec).bytes().to_vec();
        bytes[0] |= 0x40;
        assert!(RecordHeader::read(finest.id(), true, &bytes).is_err());
    }
}

#[test]
fn below_a_flat_cell_the_parents_triangles_are_the_surface() {
    let samples =
        std::array::from_fn(|i| Some(((i % PAGE_SAMPLES) * 32 + (i / PAGE_SAMPLES) * 16) as i32));
    let slots = Box::new([ChildSlot::Full(Err8(0)); PAGE_SLOTS]);
    let parent = Page::new(page_id(), &samples, Some(slots)).unwrap();
    let child = parent.implied_child(Slot::at(3, 5), grid()).unwrap();
    for i in 0..PAGE_AREA {
        let (x, y) = (3 * 16 + i % PAGE_SAMPLES, 5 * 16 + i / PAGE_SAMPLES);
        assert_eq!(child.height(i), (x * 2 + y) as i32);
    }
    assert_eq!(
        Bounds::derive(&child, None).slot(),
        ChildSlot::Full(Err8(0))
    );
}

#[test]
fn a_finest_cell_with_three_samples_holds_a_triangle_only_on_the_right_side_of_its_diagonal() {
    // Cell (0, 0) rises from south-west to north-east.
    let without = |hole: usize| {
        let mut samples = [Some(0); PAGE_AREA];
        samples[hole] = None;
        Page::new(page_id(), &samples, None)
            .unwrap()
            .slot(Slot::at(0, 0))
            .kind()
    };
    assert_eq!(without(0), Kind::Empty);
    assert_eq!(without(1), Kind::Mixed);
    assert_eq!(without(PAGE_SAMPLES), Kind::Mixed);
    assert_eq!(without(PAGE_SAMPLES + 1), Kind::Empty);
}

#[test]
fn heights_beyond_the_limit_are_refused() {
    let mut samples = [Some(0); PAGE_AREA];
    samples[5] = Some(MAX_HEIGHT + 1);
    assert!(Page::new(page_id(), &samples, None).is_err());
}

/// The bytes of a block of the format's specification.
fn worked_example(number: usize) -> Vec<u8> {
    let spec = include_str!("../../../tiles/FORMAT.md");
    let block = spec.split("```hex").nth(number).unwrap();
    let hex = block.split("```").next().unwrap();
    hex.split_whitespace()
        .map(|byte| u8::from_str_radix(byte, 16).unwrap())
        .collect()
}

#[test]
fn the_worked_examples_of_the_format_decode() {
    let mut plain = worked_example(1);
    plain.resize(plain.len() + 17 + 57 + 209, 0);
    for (codec, bytes) in [(Codec::Plain, plain), (Codec::Dense, worked_example(2))] {
        let page = Page::decode(page_id(), true, 4, &bytes).unwrap();
        for i in 0..PAGE_AREA {
            let height = (i % PAGE_SAMPLES + 2 * (i / PAGE_SAMPLES)) as i32;
            assert_eq!(page.height(i), height);
        }
        assert_eq!(Record::encode(&page, codec).bytes(), bytes);
    }
}
