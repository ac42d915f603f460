use super::*;
use proptest::prelude::*;
use std::collections::BTreeMap;

fn written(entries: &[(u8, usize, u32)]) -> Vec<u8> {
    let mut out = Vec::new();
    write(entries, &mut out);
    out
}

/// Read and checked, as a family is.
fn read(bytes: &[u8], records: usize) -> Result<Table<'_>, String> {
    let mut reader = Reader::new(bytes);
    let table = Table::read(&mut reader).ok_or("cut short")?;
    table.check(records)?;
    match reader.left() {
        0 => Ok(table),
        left => Err(format!("{left} bytes left")),
    }
}

fn tables() -> impl Strategy<Value = Vec<(u8, usize, u32)>> {
    let all = prop::collection::btree_map(any::<u8>(), (1usize..=8192, any::<u32>()), 1..=256);
    let whole = prop::collection::vec((60usize..=120, any::<u32>()), PAGE_SLOTS);
    let whole = whole.prop_map(|of| (0..=u8::MAX).zip(of).collect::<BTreeMap<_, _>>());
    let listed = |map: BTreeMap<u8, (usize, u32)>| {
        let entries = map.into_iter();
        entries.map(|(slot, (bytes, revision))| (slot, bytes, revision))
    };
    prop_oneof![all, whole].prop_map(move |map| listed(map).collect())
}

proptest! {
    #[test]
    fn a_table_says_of_each_slot_what_was_written(entries in tables()) {
        let bytes = written(&entries);
        let records = entries.iter().map(|&(_, bytes, _)| bytes).sum();
        let table = read(&bytes, records).unwrap();
        prop_assert_eq!(table.len(), entries.len());
        let mut start = 0;
        let mut expected = BTreeMap::new();
        for &(slot, bytes, revision) in &entries {
            expected.insert(slot, Entry { slot, start, bytes, revision });
            start += bytes;
        }
        prop_assert!(table.entries().eq(expected.values().copied()));
        for slot in 0..=u8::MAX {
            prop_assert_eq!(table.find(slot), expected.get(&slot).copied());
        }
    }

    #[test]
    fn any_bytes_are_a_table_or_refused(
        bytes in prop::collection::vec(any::<u8>(), 0..1400),
        records in 0usize..10_000,
    ) {
        if let Ok(table) = read(&bytes, records) {
            prop_assert!(table.entries().all(|entry| entry.start + entry.bytes <= records));
        }
    }

    #[test]
    fn a_table_with_a_changed_byte_stays_within_its_records(
        entries in tables(),
        at in any::<prop::sample::Index>(),
        byte in any::<u8>(),
    ) {
        let mut bytes = written(&entries);
        let at = at.index(bytes.len());
        bytes[at] = byte;
        let records = entries.iter().map(|&(_, bytes, _)| bytes).sum();
        if let Ok(table) = read(&bytes, records) {
            prop_assert!(table.entries().all(|entry| entry.start + entry.bytes <= records));
            prop_assert_eq!(table.entries().count(), table.len());
        }
    }
}

#[test]
fn a_full_family_of_records_of_alike_lengths_costs_less_than_five_bytes_a_page() {
    let of = |slot: u8| (slot, 60 + usize::from(slot) % 64, u32::from(slot));
    let entries: Vec<_> = (0..=u8::MAX).map(of).collect();
    assert_eq!(written(&entries).len(), 1 + 3 + 256 * 6 / 8 + 256 * 4);
}

#[test]
fn wrong_tables_are_refused_with_what_is_wrong() {
    let entries = [(3, 10, 0), (9, 12, 0)];
    let bytes = written(&entries);
    assert_eq!(bytes[..7], [1, 3, 9, 10, 0, 2, 0b1000]);
    assert_eq!(
        read(&bytes, 23).unwrap_err(),
        "records of 22 bytes in a space of 23"
    );
    let mut unsorted = bytes.clone();
    unsorted.swap(1, 2);
    assert_eq!(
        read(&unsorted, 22).unwrap_err(),
        "slots of a family that do not ascend"
    );
    let mut wide = bytes.clone();
    wide[5] = 17;
    wide.extend([0; 4]);
    assert_eq!(
        read(&wide, 22).unwrap_err(),
        "lengths of 17 bits, allowed are 0..=16"
    );
    let many: Vec<_> = (0..40).map(|slot| (slot, 1, 0)).collect();
    let mut mapped = written(&many);
    mapped[1] = 0x7f;
    assert_eq!(read(&mapped, 40).unwrap_err(), "39 slots of 40 records");
}
