//! Records of pages: hostile ones, and those of arbitrary pages.

use escarp_proto::err8::Err8;
use escarp_proto::geometry::PAGE_SAMPLES;
use escarp_proto::geometry::{PAGE_SLOTS, PageId, Slot};
use escarp_proto::page::{
    Bounds, ChildSlot, Codec, MAX_HEIGHT, MAX_RECORD_BYTES, PAGE_AREA, Page, Range, Record,
    RecordHeader, level_step,
};

/// A record from the network: decoded part by part, and whole.
pub fn page(data: &[u8]) {
    let Some((&first, record)) = data.split_first() else {
        return;
    };
    let finest = first & 1 == 1;
    let id = PageId::ROOT;
    let Ok(header) = RecordHeader::read(id, finest, record) else {
        return;
    };
    let mut parts: Option<Page> = None;
    for part in 1..=header.last_part() {
        let first = if parts.is_some() { part } else { 0 };
        let Some(bytes) = header.part_bytes(first, part).and_then(|r| record.get(r)) else {
            return;
        };
        let longer = match parts.take() {
            None => Page::decode(id, finest, part, bytes),
            Some(mut page) => page.extend(part, bytes).map(|()| page),
        };
        let Ok(page) = longer else { return };
        Bounds::derive(&page, None);
        parts = Some(page);
    }
    let whole = Page::decode(
        id,
        finest,
        header.last_part(),
        &record[..header.record_len()],
    );
    assert_eq!(whole.ok(), parts, "parts one by one are the whole");
}

/// A page of arbitrary samples and slots: both codecs give back what was encoded, whole and after
/// every part, and every bound can be derived.
pub fn codec(data: &[u8]) {
    let Some(page) = arbitrary_page(data) else {
        return;
    };
    let [plain, dense] = [Codec::Plain, Codec::Dense].map(|codec| Stored::new(&page, codec));
    assert_eq!(plain.whole(), page);
    assert_eq!(dense.whole(), page);
    let mut grown = [plain.prefix(1), dense.prefix(1)];
    for part in 1..=page.last_part() {
        let both = [plain.prefix(part), dense.prefix(part)];
        assert_same(&both[0], &both[1], part);
        for ((stored, grown), cut) in [&plain, &dense].into_iter().zip(&mut grown).zip(&both) {
            if part > 1 {
                grown.extend(part, stored.part(part)).expect("own part");
            }
            assert_same(grown, cut, part);
        }
        assert_eq!(
            Bounds::derive(&both[0], None),
            Bounds::derive(&both[1], None)
        );
        for at in arrived(both[0].depth()) {
            assert_eq!(
                both[0].is_valid(at),
                page.is_valid(at),
                "part {part}, sample {at}"
            );
            let height = both[0].height(at);
            assert_eq!(height, page.height(at), "part {part}, sample {at}");
        }
    }
    assert_eq!(grown, [page.clone(), page], "grown part by part");
}

/// A page as one codec has it.
struct Stored<'a> {
    of: &'a Page,
    record: Record,
    header: RecordHeader,
}

impl<'a> Stored<'a> {
    fn new(of: &'a Page, codec: Codec) -> Stored<'a> {
        let record = Record::encode(of, codec);
        assert!(record.bytes().len() <= MAX_RECORD_BYTES);
        let header = RecordHeader::read(of.id(), of.is_finest(), record.bytes());
        let header = header.expect("own header");
        assert_eq!(header.record_len(), record.bytes().len());
        Stored { of, record, header }
    }

    fn part(&self, part: u8) -> &[u8] {
        let place = self.header.part_bytes(part, part).expect("a part");
        &self.record.bytes()[place]
    }

    fn prefix(&self, last: u8) -> Page {
        let place = self.header.part_bytes(0, last).expect("parts");
        let bytes = &self.record.bytes()[place];
        Page::decode(self.of.id(), self.of.is_finest(), last, bytes).expect("own parts")
    }

    fn whole(&self) -> Page {
        self.prefix(self.of.last_part())
    }
}

/// Samples that have arrived with so many levels.
fn arrived(depth: u8) -> impl Iterator<Item = usize> {
    let step = level_step(depth);
    let along = move || (0..PAGE_SAMPLES).step_by(step);
    along().flat_map(move |row| along().map(move |column| row * PAGE_SAMPLES + column))
}

/// Two pages say the same, whatever else their decoders keep.
fn assert_same(a: &Page, b: &Page, part: u8) {
    assert_eq!((a.parts(), a.depth()), (b.parts(), b.depth()));
    assert_eq!(
        (a.has_holes(), a.has_slots()),
        (b.has_holes(), b.has_slots())
    );
    for level in 1..=a.depth() {
        assert_eq!(
            a.rest_bound(level),
            b.rest_bound(level),
            "rest of part {level}"
        );
    }
    for at in arrived(a.depth()) {
        let [a, b] = [a, b].map(|page| (page.is_valid(at), page.height(at)));
        assert_eq!(a, b, "part {part}, sample {at}");
    }
    for slot in 0..PAGE_SLOTS {
        let slot = Slot::from_index(slot as u8);
        assert_eq!(a.slot(slot), b.slot(slot), "part {part}, {slot:?}");
    }
}

/// Words of the input; when it ends, zeros, or (flag) what a generator makes of it.
struct Words<'a> {
    data: &'a [u8],
    state: Option<u32>,
}

impl Words<'_> {
    fn next(&mut self) -> i32 {
        let (word, rest) = self.data.split_at(self.data.len().min(4));
        self.data = rest;
        if let Ok(word) = word.try_into() {
            let word = i32::from_le_bytes(word);
            self.state = self
                .state
                .map(|state| state.rotate_left(5) ^ word as u32 | 1);
            return word;
        }
        let Some(state) = &mut self.state else {
            return 0;
        };
        // Marsaglia, "Xorshift RNGs", 2003.
        *state ^= *state << 13;
        *state ^= *state >> 17;
        *state ^= *state << 5;
        *state as i32
    }
}

fn arbitrary_page(data: &[u8]) -> Option<Page> {
    let (&[flags, more], data) = data.split_first_chunk()?;
    let (finest, holes, shift) = (flags & 1 == 1, flags & 2 == 2, flags >> 2 & 31);
    let state = (more & 1 == 1).then_some(1);
    let mut words = Words { data, state };
    let samples: [Option<i32>; PAGE_AREA] = std::array::from_fn(|_| {
        let word = words.next();
        let height = (word >> shift).clamp(-MAX_HEIGHT, MAX_HEIGHT);
        (!holes || word & 1 == 0).then_some(height)
    });
    let slots = (!finest).then(|| Box::new(std::array::from_fn(|_| slot(&mut words, more))));
    Some(Page::new(PageId::ROOT, &samples, slots).expect("heights are in range"))
}

/// Any slot; with flag 2 only full ones.
fn slot(words: &mut Words<'_>, flags: u8) -> ChildSlot {
    const _: () = assert!(PAGE_SLOTS == 256);
    let word = words.next();
    let error = Err8((word >> 8) as u8 >> (flags >> 4 & 7));
    if flags & 2 == 2 {
        return ChildSlot::Full(error);
    }
    match word & 7 {
        0..=2 => ChildSlot::Full(error),
        3 | 4 => ChildSlot::Cut(error),
        5 => ChildSlot::Empty,
        _ => {
            let lo = (words.next() >> (word >> 16 & 31)).clamp(-MAX_HEIGHT, MAX_HEIGHT);
            let span = (words.next() >> (word >> 21 & 31)).unsigned_abs();
            let hi = lo.saturating_add_unsigned(span).min(MAX_HEIGHT);
            ChildSlot::Mixed(Range { lo, hi })
        }
    }
}
