//! CRC-32 of zip and Ethernet, bit by bit: a table would cost the left board half its RAM, and the crate `crc`, fed byte by
//! byte as frames are, 1.4 KB of its flash.

/// A running checksum. It is also a model's id, and protects what boards store.
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
    /// Of nothing yet.
    pub const fn new() -> Self {
        Self(u32::MAX)
    }

    /// Of all of `bytes`.
    pub fn of(bytes: &[u8]) -> u32 {
        let mut crc = Self::new();
        crc.update(bytes);
        crc.finish()
    }

    /// Takes more bytes.
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

    /// The checksum of the bytes so far.
    pub const fn finish(self) -> u32 {
        !self.0
    }
}

impl Default for Crc32 {
    fn default() -> Self {
        Self::new()
    }
}
