//! Lists of pages: the key of an entry goes as its difference to the key of the entry before it.
//!
//! Keys have the level in their highest byte and the place on a Morton curve below, so that a list
//! that is sorted by keys takes 1 to 3 bytes for each, instead of 9.

use super::{Chunk, Have, Want};
use bincode::de::{BorrowDecoder, Decoder};
use bincode::enc::Encoder;
use bincode::error::{DecodeError, EncodeError};
use bincode::{BorrowDecode, Decode, Encode};

/// The largest part that a chunk can name.
const MAX_PART: u8 = 15;

/// An entry of a list of pages.
pub(super) trait Entry {
    fn key(&mut self) -> &mut u64;
}

impl Entry for u64 {
    fn key(&mut self) -> &mut u64 {
        self
    }
}

impl Entry for Want {
    fn key(&mut self) -> &mut u64 {
        &mut self.page
    }
}

impl Entry for Have {
    fn key(&mut self) -> &mut u64 {
        &mut self.page
    }
}

impl Entry for Chunk {
    fn key(&mut self) -> &mut u64 {
        &mut self.page
    }
}

/// Puts differences in the place of keys: small numbers for small ones, whatever their sign.
pub(super) fn to_differences(list: &mut [impl Entry]) {
    let mut before = 0u64;
    for entry in list {
        let key = entry.key();
        let difference = key.wrapping_sub(before) as i64;
        before = *key;
        *key = (difference << 1 ^ difference >> 63) as u64;
    }
}

/// The other way round.
pub(super) fn to_keys(list: &mut [impl Entry]) {
    let mut before = 0u64;
    for entry in list {
        let key = entry.key();
        let difference = *key >> 1 ^ (*key & 1).wrapping_neg();
        before = before.wrapping_add(difference);
        *key = before;
    }
}

// By hand, as revisions are checksums: shorter as they are than as numbers that are often small.

impl Encode for Have {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        self.page.encode(encoder)?;
        self.revision.to_le_bytes().encode(encoder)?;
        self.parts.encode(encoder)
    }
}

impl<C> Decode<C> for Have {
    fn decode<D: Decoder<Context = C>>(decoder: &mut D) -> Result<Have, DecodeError> {
        Ok(Have {
            page: u64::decode(decoder)?,
            revision: u32::from_le_bytes(<[u8; 4]>::decode(decoder)?),
            parts: u8::decode(decoder)?,
        })
    }
}

impl<'de, C> BorrowDecode<'de, C> for Have {
    fn borrow_decode<D: BorrowDecoder<'de, Context = C>>(
        decoder: &mut D,
    ) -> Result<Have, DecodeError> {
        Have::decode(decoder)
    }
}

impl Encode for Chunk {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        self.page.encode(encoder)?;
        self.revision.to_le_bytes().encode(encoder)?;
        let [first, last] = [self.first_part, self.last_part].map(|part| part.min(MAX_PART));
        (last << 4 | first).encode(encoder)?;
        self.bytes.encode(encoder)
    }
}

impl<C> Decode<C> for Chunk {
    fn decode<D: Decoder<Context = C>>(decoder: &mut D) -> Result<Chunk, DecodeError> {
        let page = u64::decode(decoder)?;
        let revision = u32::from_le_bytes(<[u8; 4]>::decode(decoder)?);
        let parts = u8::decode(decoder)?;
        Ok(Chunk {
            page,
            revision,
            first_part: parts & MAX_PART,
            last_part: parts >> 4,
            bytes: Vec::decode(decoder)?,
        })
    }
}

impl<'de, C> BorrowDecode<'de, C> for Chunk {
    fn borrow_decode<D: BorrowDecoder<'de, Context = C>>(
        decoder: &mut D,
    ) -> Result<Chunk, DecodeError> {
        Chunk::decode(decoder)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn differences_come_back_as_the_keys_that_they_were(keys in prop::collection::vec(any::<u64>(), 0..20)) {
            let mut list = keys.clone();
            to_differences(&mut list);
            to_keys(&mut list);
            prop_assert_eq!(list, keys);
        }
    }

    #[test]
    fn neighbours_differ_by_small_numbers_in_either_order() {
        let mut keys = [4 << 56 | 1000u64, 4 << 56 | 1003, 4 << 56 | 1001, 0];
        to_differences(&mut keys);
        assert_eq!(keys[1..3], [6, 3]);
    }
}
