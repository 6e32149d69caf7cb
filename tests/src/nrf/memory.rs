//! The chip's memories, which the core and the peripherals' EasyDMA share.

/// Start address of RAM.
pub const RAM_START: u32 = 0x2000_0000;
/// Size of RAM in bytes.
pub const RAM_BYTES: usize = 256 * 1024;
/// Size of flash in bytes.
pub const FLASH_BYTES: usize = 1024 * 1024;

/// RAM at a fixed address, so that the emulated core can use it directly.
pub struct Ram(Box<[u64]>);

impl Default for Ram {
    fn default() -> Self {
        // As after a power-up, the content is not zero.
        Self(vec![0xA5A5_5A5A_A5A5_5A5A; RAM_BYTES / 8].into_boxed_slice())
    }
}

impl Ram {
    /// Returns a pointer for the core's memory map.
    pub fn as_mut_ptr(&mut self) -> *mut u8 {
        self.0.as_mut_ptr().cast()
    }

    fn bytes(&self) -> &[u8] {
        // SAFETY: u64 has no padding, and a weaker alignment is valid.
        unsafe { std::slice::from_raw_parts(self.0.as_ptr().cast(), RAM_BYTES) }
    }

    /// Reads memory for EasyDMA, or returns `None` if a part is not RAM (EasyDMA cannot read flash).
    pub fn get(&self, address: u32, len: usize) -> Option<&[u8]> {
        let start = address.checked_sub(RAM_START)? as usize;
        self.bytes().get(start..start.checked_add(len)?)
    }

    /// Returns a word, or 0 outside RAM.
    pub fn word(&self, address: u32) -> u32 {
        self.get(address, 4).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
    }

    /// Writes memory for EasyDMA. Returns false if a part is not RAM.
    pub fn put(&mut self, address: u32, data: &[u8]) -> bool {
        let Some(start) = address.checked_sub(RAM_START) else { return false };
        let start = start as usize;
        // SAFETY: this is the same case as in `bytes`.
        let bytes = unsafe { std::slice::from_raw_parts_mut(self.0.as_mut_ptr().cast::<u8>(), RAM_BYTES) };
        match start.checked_add(data.len()).and_then(|end| bytes.get_mut(start..end)) {
            Some(place) => {
                place.copy_from_slice(data);
                true
            }
            None => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn easy_dma_reaches_ram_and_nothing_else() {
        let mut ram = Ram::default();
        assert!(ram.put(RAM_START + 8, &[1, 2, 3]));
        assert_eq!(ram.get(RAM_START + 8, 3), Some(&[1, 2, 3][..]));
        assert_eq!(ram.get(0x1000, 4), None);
        assert!(!ram.put(RAM_START + RAM_BYTES as u32 - 1, &[0, 0]));
        assert_eq!(ram.get(u32::MAX, 4), None);
    }
}
