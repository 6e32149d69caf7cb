//! The CRC-32 of zip and Ethernet, computed bit by bit.
//! A table would take half of the left board's RAM.
//! The crate `crc` would take 1.4 KB of the left board's flash if it were called for each byte.

/// A running checksum. It is also used for model ids and for stored data on boards.
///
/// ```
/// # use shared_proto::crc::Crc32;
/// let mut crc = Crc32::new();
/// crc.update(b"1234");
/// crc.update(b"56789");
/// assert_eq!(crc.finish(), 0xCBF4_3926); // the check value that every catalogue gives
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crc32(u32);

impl Crc32 {
    /// Creates the checksum of an empty sequence of bytes.
    pub const fn new() -> Self {
        Self(u32::MAX)
    }

    /// Returns the checksum of `bytes`.
    pub fn of(bytes: &[u8]) -> u32 {
        let mut crc = Self::new();
        crc.update(bytes);
        crc.finish()
    }

    /// Adds more bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.0 ^= u32::from(byte);
            for _ in 0..8 {
                let low_bit = self.0 & 1;
                self.0 >>= 1;
                if low_bit == 1 {
                    self.0 ^= 0xEDB8_8320;
                }
            }
        }
    }

    /// Returns the checksum of all bytes that were added so far.
    pub const fn finish(self) -> u32 {
        !self.0
    }
}

impl Default for Crc32 {
    fn default() -> Self {
        Self::new()
    }
}
