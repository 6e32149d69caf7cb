//! Where received models live: two slots of 16 KB in NOR flash.
//!
//! ```text
//! slot + 0   magic, length, CRC-32 of the blob, sequence number (four little-endian words)
//! slot + 16  the blob
//! ```
//!
//! The words are written last, after the blob has been read back and its CRC has been checked, and the magic
//! number after the other three. So a transfer that breaks anywhere leaves a slot that counts as empty.

use shared_dsp::right::network::crc32;

/// Bytes per slot.
pub const SLOT_BYTES: usize = 0x4000;
/// Bytes of both slots: what a store needs of the flash.
pub const STORE_BYTES: usize = 2 * SLOT_BYTES;
/// Bytes before the blob.
pub const HEADER_BYTES: usize = 16;
/// Longest blob.
pub const BLOB_MAX: usize = SLOT_BYTES - HEADER_BYTES;
/// First word of a slot that holds a whole blob.
pub(crate) const MAGIC: u32 = u32::from_le_bytes(*b"BMS1");

/// One of the two slots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// The one at the lower address.
    A,
    /// The other.
    B,
}

impl Slot {
    /// Both.
    pub const ALL: [Slot; 2] = [Slot::A, Slot::B];

    /// Where it begins, in bytes from the beginning of the store.
    pub const fn offset(self) -> usize {
        match self {
            Slot::A => 0,
            Slot::B => SLOT_BYTES,
        }
    }

    /// The other one.
    pub const fn other(self) -> Self {
        match self {
            Slot::A => Slot::B,
            Slot::B => Slot::A,
        }
    }
}

/// What a slot holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content<'f> {
    /// Nothing, or a transfer that was not finished.
    Empty,
    /// Something that was finished, and is not whole any more.
    Damaged,
    /// A whole blob.
    Blob {
        /// Its bytes.
        blob: &'f [u8],
        /// One more than that of the blob before it, wrapping.
        sequence: u32,
    },
}

/// Looks into a slot of a store's bytes.
pub(crate) fn look(store: &[u8], slot: Slot) -> Content<'_> {
    let Some(bytes) = store.get(slot.offset()..slot.offset() + SLOT_BYTES) else { return Content::Empty };
    let (header, room) = bytes.split_at(HEADER_BYTES);
    let word = |i: usize| u32::from_le_bytes([0, 1, 2, 3].map(|byte| header[4 * i + byte]));
    if word(0) == u32::MAX {
        return Content::Empty;
    }
    match room.get(..word(1) as usize) {
        Some(blob) if word(0) == MAGIC && crc32(blob) == word(2) => Content::Blob { blob, sequence: word(3) },
        _ => Content::Damaged,
    }
}

/// Whether sequence number `a` was given after `b`; both wrap.
pub(crate) fn is_newer(a: u32, b: u32) -> bool {
    // Less than half the range ahead.
    (1..1 << 31).contains(&a.wrapping_sub(b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sequence_numbers_are_compared_across_their_end() {
        assert!(is_newer(2, 1) && !is_newer(1, 2) && !is_newer(1, 1));
        assert!(is_newer(0, u32::MAX) && !is_newer(u32::MAX, 0));
        assert!(is_newer(5, u32::MAX - 5) && !is_newer(u32::MAX - 5, 5));
    }
}
