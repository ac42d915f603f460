//! A family's table: which slots have records, how long these are, and their revisions. Lengths
//! take the bits of their spread in this family, slots none where all 256 have a record.

use escarp_proto::bytes::Reader;
use escarp_proto::geometry::PAGE_SLOTS;

/// A table, as it lies in the segment.
#[derive(Debug, Clone, Copy)]
pub(super) struct Table<'a> {
    count: usize,
    slots: Slots<'a>,
    lengths: Lengths<'a>,
    revisions: &'a [u8],
}

/// What a table says of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) struct Entry {
    pub(in super::super) slot: u8,
    /// Of its first byte, after the table.
    pub(in super::super) start: usize,
    pub(in super::super) bytes: usize,
    pub(in super::super) revision: u32,
}

#[derive(Debug, Clone, Copy)]
enum Slots<'a> {
    All,
    /// One bit a slot.
    Map(&'a [u8]),
    /// One byte a record.
    List(&'a [u8]),
}

/// Bytes of a [`Slots::Map`]: fewer records are listed.
const MAP: usize = PAGE_SLOTS / 8;
/// Bits of a length above the shortest.
const MOST_BITS: u32 = 16;

/// No table is longer: number, slots, lengths, revisions. A listed slot takes a byte of each of
/// fewer records than [`MAP`] has bytes.
pub(super) const MAX_BYTES: usize =
    1 + MAP + 3 + PAGE_SLOTS * MOST_BITS as usize / 8 + 4 * PAGE_SLOTS;

impl<'a> Slots<'a> {
    fn read(count: usize, reader: &mut Reader<'a>) -> Option<Slots<'a>> {
        Some(match count {
            PAGE_SLOTS => Slots::All,
            MAP.. => Slots::Map(reader.take(MAP)?),
            _ => Slots::List(reader.take(count)?),
        })
    }

    fn has(self, slot: u8) -> bool {
        match self {
            Slots::All => true,
            Slots::Map(map) => map[usize::from(slot / 8)] >> (slot % 8) & 1 == 1,
            Slots::List(list) => list.contains(&slot),
        }
    }

    fn iter(self) -> impl Iterator<Item = u8> + 'a {
        (0..=u8::MAX).filter(move |&slot| self.has(slot))
    }

    fn check(self, count: usize) -> Result<(), String> {
        match self {
            Slots::List(list) if !list.is_sorted_by(|a, b| a < b) => {
                Err("slots of a family that do not ascend".into())
            }
            Slots::Map(map) => {
                let there: u32 = map.iter().map(|bits| bits.count_ones()).sum();
                match there as usize == count {
                    true => Ok(()),
                    false => Err(format!("{there} slots of {count} records")),
                }
            }
            _ => Ok(()),
        }
    }
}

/// Lengths of records, of `width` bits each above the shortest.
#[derive(Debug, Clone, Copy)]
struct Lengths<'a> {
    shortest: usize,
    width: u32,
    packed: &'a [u8],
}

impl<'a> Lengths<'a> {
    fn read(count: usize, reader: &mut Reader<'a>) -> Option<Lengths<'a>> {
        let shortest = usize::from(reader.u16()?);
        let width = u32::from(reader.u8()?);
        let packed = reader.take((count * width as usize).div_ceil(8))?;
        Some(Lengths {
            shortest,
            width,
            packed,
        })
    }

    /// To be taken as many as there are records.
    fn iter(self) -> impl Iterator<Item = usize> + 'a {
        let mut bytes = self.packed.iter();
        let (mut held, mut bits) = (0u32, 0);
        std::iter::repeat_with(move || {
            while bits < self.width {
                held |= u32::from(bytes.next().copied().unwrap_or(0)) << bits;
                bits += 8;
            }
            let above = held & ((1 << self.width) - 1);
            held >>= self.width;
            bits -= self.width;
            self.shortest + above as usize
        })
    }
}

impl<'a> Table<'a> {
    /// The table at a cursor. `None` if it is cut short.
    pub(super) fn read(reader: &mut Reader<'a>) -> Option<Table<'a>> {
        let count = usize::from(reader.u8()?) + 1;
        let slots = Slots::read(count, reader)?;
        let lengths = Lengths::read(count, reader)?;
        let revisions = reader.take(4 * count)?;
        Some(Table {
            count,
            slots,
            lengths,
            revisions,
        })
    }

    /// Whether it is the table of records of so many bytes; why not. To be called before anything
    /// else is asked of it.
    pub(super) fn check(&self, there: usize) -> Result<(), String> {
        self.slots.check(self.count)?;
        let width = self.lengths.width;
        if width > MOST_BITS {
            return Err(format!(
                "lengths of {width} bits, allowed are 0..={MOST_BITS}"
            ));
        }
        let bytes: usize = self.lengths.iter().take(self.count).sum();
        match bytes == there {
            true => Ok(()),
            false => Err(format!("records of {bytes} bytes in a space of {there}")),
        }
    }

    /// Number of records, 1 to 256.
    pub(super) fn len(&self) -> usize {
        self.count
    }

    /// What it says of each record, by slot.
    pub(super) fn entries(&self) -> impl Iterator<Item = Entry> + 'a {
        let mut start = 0;
        let (revisions, _) = self.revisions.as_chunks::<4>();
        let lengths = self.lengths.iter().zip(revisions);
        self.slots.iter().zip(lengths).map(move |(slot, of)| {
            let (bytes, revision) = of;
            start += bytes;
            Entry {
                slot,
                start: start - bytes,
                bytes,
                revision: u32::from_le_bytes(*revision),
            }
        })
    }

    /// What it says of the record in a slot.
    pub(super) fn find(&self, slot: u8) -> Option<Entry> {
        match self.slots.has(slot) {
            true => self.entries().find(|entry| entry.slot == slot),
            false => None,
        }
    }
}

/// Writes the table of records: slot, length in bytes, revision of each, by slot, ascending. There
/// are 1 to 256 of them.
pub(super) fn write(entries: &[(u8, usize, u32)], out: &mut Vec<u8>) {
    out.push(entries.len().saturating_sub(1) as u8);
    write_slots(entries, out);
    let lengths = || entries.iter().map(|&(_, bytes, _)| bytes);
    let shortest = lengths().min().unwrap_or(0);
    let spread = lengths().max().unwrap_or(0) - shortest;
    let width = usize::BITS - spread.leading_zeros();
    out.extend((shortest as u16).to_le_bytes());
    out.push(width as u8);
    pack(lengths().map(|bytes| bytes - shortest), width, out);
    for (_, _, revision) in entries {
        out.extend(revision.to_le_bytes());
    }
}

fn write_slots(entries: &[(u8, usize, u32)], out: &mut Vec<u8>) {
    let slots = || entries.iter().map(|&(slot, _, _)| slot);
    match entries.len() {
        PAGE_SLOTS => {}
        MAP.. => {
            let mut map = [0; MAP];
            slots().for_each(|slot| map[usize::from(slot / 8)] |= 1 << (slot % 8));
            out.extend(map);
        }
        _ => out.extend(slots()),
    }
}

fn pack(numbers: impl Iterator<Item = usize>, width: u32, out: &mut Vec<u8>) {
    let (mut held, mut bits) = (0, 0);
    for number in numbers {
        held |= number << bits;
        bits += width;
        while bits >= 8 {
            out.push(held as u8);
            held >>= 8;
            bits -= 8;
        }
    }
    if bits > 0 {
        out.push(held as u8);
    }
}

#[cfg(test)]
mod tests;
