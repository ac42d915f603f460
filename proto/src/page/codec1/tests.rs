//! What the oracle of pages does not ask: how small records are, and how bad they can get.

use super::*;
use crate::page::{Codec, Record, RecordHeader};

fn page(samples: [Option<i32>; PAGE_AREA]) -> Page {
    Page::new(PageId::new(8, 37, 90).unwrap(), &samples, None).unwrap()
}

fn dense_bytes(page: &Page) -> usize {
    Record::encode(page, Codec::Dense).bytes().len()
}

#[test]
fn white_noise_of_any_height_costs_little_more_than_its_bits() {
    for bits in 1..=30 {
        let mut noise = Noise(bits);
        let samples = std::array::from_fn(|_| Some((noise.next() >> (64 - bits)) as i32));
        let raw = PAGE_AREA * bits as usize / 8;
        let dense = dense_bytes(&page(samples));
        assert!(dense <= raw + 12, "{bits} bits: {dense} bytes, raw {raw}");
    }
}

#[test]
fn smooth_ground_costs_a_few_bytes() {
    let flat = page([Some(1234); PAGE_AREA]);
    assert!(dense_bytes(&flat) <= 8);
    let ramp = page(std::array::from_fn(|i| {
        Some((i % PAGE_SAMPLES + 2 * (i / PAGE_SAMPLES)) as i32)
    }));
    assert!(dense_bytes(&ramp) <= 24, "{}", dense_bytes(&ramp));
}

#[test]
fn a_prefix_of_parts_with_bytes_of_the_next_is_refused() {
    let mut noise = Noise(5);
    let noise = page(std::array::from_fn(|_| Some((noise.next() >> 54) as i32)));
    let record = Record::encode(&noise, Codec::Dense);
    let header = RecordHeader::read(noise.id(), true, record.bytes()).unwrap();
    assert_eq!(header.record_len(), record.bytes().len());
    let end = header.part_bytes(0, 2).unwrap().end;
    assert!(Page::decode(noise.id(), true, 2, &record.bytes()[..end]).is_ok());
    assert_eq!(
        Page::decode(noise.id(), true, 2, &record.bytes()[..end + 3]),
        Err(PageError::Long {
            page: noise.id(),
            part: 2,
            left: 3
        })
    );
}

/// SplitMix64 (Steele, Lea and Flood, 2014).
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }
}
