//! Flash and UICR with their controller (NVMC): writing clears bits, and erasing sets all bits of a page.

use super::time::{ms, us};

/// Size of a page in bytes.
pub const PAGE: usize = 4096;

/// The flash controller.
#[derive(Clone, Debug, Default)]
pub struct Nvmc {
    config: u32,
    /// ICACHECNF: whether the instruction cache is on.
    pub cache: bool,
    /// Cycle until which the core is suspended.
    pub busy_until: u64,
    /// Number of pages erased since the start.
    pub erased: u64,
    /// Number of words written since the start.
    pub written: u64,
    /// ERASEPAGEPARTIALCFG: duration of a partial erase in ms.
    partial_ms: u64,
    /// The page that is being erased in parts, and the total duration so far.
    partly: (usize, u64),
    /// The operation (a word or a page) at which power fails, for tests of interrupted transfers.
    pub fails_after: Option<u64>,
}

impl Nvmc {
    /// Whether writes are enabled.
    pub fn may_write(&self) -> bool {
        self.config & 3 == 1
    }

    /// Resets the controller together with the chip.
    pub fn reset(&mut self) {
        // A partially erased page remains in that state.
        *self = Self { erased: self.erased, written: self.written, ..Self::default() };
    }

    fn works(&mut self) -> bool {
        match &mut self.fails_after {
            Some(0) => false,
            Some(left) => {
                *left -= 1;
                true
            }
            None => true,
        }
    }

    /// Writes a word into memory.
    pub fn program(&mut self, memory: &mut [u8], offset: usize, value: u32, now: u64) {
        if !self.works() {
            return;
        }
        if let Some(place) = memory.get_mut(offset..offset + 4) {
            for (byte, new) in place.iter_mut().zip(value.to_le_bytes()) {
                *byte &= new;
            }
            self.written += 1;
            self.busy_until = now.max(self.busy_until) + us(41);
        }
    }

    /// Erases a page.
    pub fn erase(&mut self, memory: &mut [u8], offset: usize, now: u64) {
        if !self.works() {
            return;
        }
        let start = offset / PAGE * PAGE;
        if let Some(page) = memory.get_mut(start..start + PAGE) {
            page.fill(0xFF);
            self.erased += 1;
            self.busy_until = now.max(self.busy_until) + ms(85);
        }
    }

    /// Erases a page for a part of the required time.
    /// The page is blank when the parts add up to the required time.
    pub fn erase_partly(&mut self, memory: &mut [u8], offset: usize, now: u64) {
        let part = ms(self.partial_ms.clamp(1, 127));
        let start = offset / PAGE * PAGE;
        let before = if self.partly.0 == start { self.partly.1 } else { 0 };
        self.partly = (start, before + part);
        if self.partly.1 < ms(85) {
            // The content of the page between two parts is undefined.
            if self.works()
                && let Some(page) = memory.get_mut(start..start + PAGE)
            {
                page.iter_mut().step_by(3).for_each(|byte| *byte |= 0x5A);
                self.busy_until = now.max(self.busy_until) + part;
            }
            return;
        }
        self.partly = (usize::MAX, 0);
        let busy = now.max(self.busy_until) + part;
        self.erase(memory, offset, now);
        self.busy_until = busy;
    }

    /// Returns whether erasing is enabled.
    pub fn may_erase(&self) -> bool {
        self.config & 3 == 2
    }

    /// Reads a register.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            0x400 | 0x408 => 1,
            0x504 => self.config,
            0x540 => u32::from(self.cache),
            _ => 0,
        }
    }

    /// Writes the configuration. The caller owns the memory and therefore performs the erasing.
    pub fn write(&mut self, offset: u32, value: u32) {
        match offset {
            0x504 => self.config = value,
            0x51C => self.partial_ms = value.into(),
            0x540 => self.cache = value & 1 != 0,
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn writing_clears_bits_and_only_erasing_sets_them() {
        let mut nvmc = Nvmc::default();
        let mut memory = vec![0xFF; 2 * PAGE];
        nvmc.program(&mut memory, 8, 0xFFFF_00FF, 0);
        nvmc.program(&mut memory, 8, 0x0FFF_FFFF, 0);
        assert_eq!(memory[8..12], [0xFF, 0x00, 0xFF, 0x0F]);
        assert_eq!(nvmc.busy_until, us(82));
        nvmc.erase(&mut memory, 100, 0);
        assert!(memory.iter().all(|&b| b == 0xFF));
        assert_eq!(nvmc.busy_until, us(82) + ms(85));
    }
    #[test]
    fn a_page_erased_in_parts_is_blank_when_they_add_up_to_its_time() {
        let mut nvmc = Nvmc::default();
        let mut memory = vec![0; PAGE];
        nvmc.write(0x51C, 10);
        for part in 1..=9 {
            assert!(memory.iter().any(|&b| b != 0xFF), "before part {part}");
            nvmc.erase_partly(&mut memory, 0, ms(100 * part));
            assert_eq!(nvmc.busy_until, ms(100 * part + 10));
        }
        assert!(memory.iter().all(|&b| b == 0xFF));
        assert_eq!(nvmc.erased, 1);
    }
}
