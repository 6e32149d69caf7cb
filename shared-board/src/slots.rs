//! The layout in which NOR flash stores received models: two slots of 16 KB.
//!
//! ```text
//! slot + 0   magic, length, CRC-32 of the blob, sequence number (four little-endian words)
//! slot + 16  the blob
//! ```
//!
//! The header is written only after the blob was read back and its CRC was checked.
//! The magic number is the last word that is written.
//! If a transfer is interrupted at any point, its slot therefore counts as empty.

use shared_dsp::right::network::crc32;

/// Bytes per slot.
pub const SLOT_BYTES: usize = 0x4000;
/// Size of both slots in bytes, which is the flash that a store needs.
pub const STORE_BYTES: usize = 2 * SLOT_BYTES;
/// Number of bytes in a slot before the blob.
pub const HEADER_BYTES: usize = 16;
/// Maximum length of a blob.
pub const BLOB_MAX: usize = SLOT_BYTES - HEADER_BYTES;
/// First word of a slot that contains a complete blob.
pub(crate) const MAGIC: u32 = u32::from_le_bytes(*b"BMS1");

/// One of the two slots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// The slot at the lower address.
    A,
    /// The slot at the higher address.
    B,
}

impl Slot {
    /// Both slots.
    pub const ALL: [Slot; 2] = [Slot::A, Slot::B];

    /// Returns the slot's offset in the store, in bytes.
    pub const fn offset(self) -> usize {
        match self {
            Slot::A => 0,
            Slot::B => SLOT_BYTES,
        }
    }

    /// Returns the other slot.
    pub const fn other(self) -> Self {
        match self {
            Slot::A => Slot::B,
            Slot::B => Slot::A,
        }
    }
}

/// The contents of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content<'f> {
    /// The slot is empty, or contains an incomplete transfer.
    Empty,
    /// The slot contains a blob that was complete but is now damaged.
    Damaged,
    /// A valid blob.
    Blob {
        /// The bytes of the blob.
        blob: &'f [u8],
        /// The sequence number, which increases by one with each blob and wraps.
        sequence: u32,
    },
}

/// Reads a slot of a store.
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

/// Returns whether sequence number `a` is later than `b`. Both numbers wrap.
pub(crate) fn is_newer(a: u32, b: u32) -> bool {
    // A later number is ahead by less than half the range.
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
