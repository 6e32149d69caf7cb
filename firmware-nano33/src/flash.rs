//! Writes to flash with the chip's controller, for images whose radio does not own that controller.

use crate::storage::{Flash, FlashFailed};

/// The flash controller of the chip. While it erases a page, the processor stops for about 85 ms.
pub struct Controller(embassy_nrf::nvmc::Nvmc<'static>);

impl Controller {
    /// Takes the controller.
    pub fn new(nvmc: embassy_nrf::Peri<'static, embassy_nrf::peripherals::NVMC>) -> Self {
        Self(embassy_nrf::nvmc::Nvmc::new(nvmc))
    }
}

impl Flash for Controller {
    async fn erase_page(&mut self, address: u32) -> Result<(), FlashFailed> {
        use embassy_nrf::nvmc::PAGE_SIZE;
        use embedded_storage::nor_flash::NorFlash;
        self.0.erase(address, address + PAGE_SIZE as u32).map_err(|_| FlashFailed)
    }

    async fn write(&mut self, address: u32, words: &[u32]) -> Result<(), FlashFailed> {
        use embedded_storage::nor_flash::NorFlash;
        for (at, word) in (address..).step_by(4).zip(words) {
            self.0.write(at, &word.to_le_bytes()).map_err(|_| FlashFailed)?;
        }
        Ok(())
    }
}
