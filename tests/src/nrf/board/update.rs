//! Emulates the slot of the running image, which the core sees as memory and the second stage writes as flash.

use unicorn_engine::Unicorn;

use super::super::flash::PAGE;
use super::{Board, World, layout};

/// Registers of the flash controller.
const CONFIG: u32 = 0x4001_E504;
const ERASE_PAGE: u32 = 0x4001_E508;

/// Returns the addresses of slot A, if the board has a second stage.
fn slot_a(world: &World) -> Option<std::ops::Range<usize>> {
    let end = world.soc.images.start;
    (end > 0).then(|| (end - layout::IMAGE_MAX) as usize..end as usize)
}

impl Board {
    /// Processes a write to a register of the flash controller, before the write takes effect.
    /// The core has already written to the slot's memory directly.
    /// When the controller leaves write mode, these words are transferred to flash one after another.
    pub(super) fn before_flash(uc: &mut Unicorn<'_, World>, address: u32, value: u32) {
        if address != CONFIG || value & 3 == 1 || !uc.get_data().soc.nvmc.may_write() {
            return;
        }
        let Some(slot) = slot_a(uc.get_data()) else { return };
        let written = uc.mem_read_as_vec(slot.start as u64, slot.len()).expect("flash");
        let soc = &mut uc.get_data_mut().soc;
        for (i, word) in written.chunks_exact(4).enumerate() {
            let at = slot.start + 4 * i;
            if soc.flash[at..at + 4] != *word {
                let word = u32::from_le_bytes([word[0], word[1], word[2], word[3]]);
                soc.nvmc.program(&mut soc.flash, at, word, soc.now);
            }
        }
    }

    /// Processes a page that the flash controller has erased.
    pub(super) fn after_flash(uc: &mut Unicorn<'_, World>, address: u32, value: u32) {
        let at = value as usize / PAGE * PAGE;
        if address == ERASE_PAGE && slot_a(uc.get_data()).is_some_and(|slot| slot.contains(&at)) {
            let page = uc.get_data().soc.flash[at..at + PAGE].to_vec();
            uc.mem_write(at as u64, &page).expect("flash");
        }
    }

    /// Turns the power off and on again. The contents of the flash are preserved.
    pub fn power_cycle(&mut self) {
        if let Some(slot) = slot_a(self.uc.get_data()) {
            let flash = self.soc().flash[slot.clone()].to_vec();
            self.uc.mem_write(slot.start as u64, &flash).expect("flash");
        }
        self.in_bootloader = false;
        self.reset(0);
    }
}
