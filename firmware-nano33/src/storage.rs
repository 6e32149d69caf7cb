//! Defines the layout of the image's flash and stores received models in the two slots of `shared_board`.

use embassy_time::Duration;
use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use shared_board::models::MappedFlash;
#[cfg(not(feature = "left"))]
use shared_board::{models::StoredModel, slots::STORE_BYTES};

#[cfg(feature = "trouble")]
use crate::boards;

/// Start address of the two slots. All memory layouts in `src/boards` end the image at or below this address.
pub const SLOTS_START: u32 = 0x000D_8000;
/// Address of the page before the slots, which stores the keys of the laptop that bonded last.
#[cfg(feature = "ble")]
pub const BOND_PAGE: u32 = SLOTS_START - PAGE_BYTES;
/// The two pages before the slots hold the log of bonds.
#[cfg(feature = "trouble")]
pub const BONDS_START: u32 = SLOTS_START - BONDS_BYTES as u32;
/// Bytes of that log.
#[cfg(feature = "trouble")]
pub const BONDS_BYTES: usize = shared_board::bonds::PAGES * PAGE_BYTES as usize;
/// Address of slot B, which is followed by the journal of the image exchange.
#[cfg(feature = "trouble")]
pub const IMAGES_START: u32 = boards::BASE + shared_board::update::SLOT_B;
/// Start of the last two pages of the model slots.
/// A left hand has no models, and stores its calibration in these pages, away from the slots' headers.
#[cfg(feature = "left")]
const CALIBRATIONS_START: u32 = 0x000E_0000 - CALIBRATIONS_BYTES as u32;
#[cfg(feature = "left")]
const CALIBRATIONS_BYTES: usize = shared_board::eeprom_log::PAGES * PAGE_BYTES as usize;
/// The log of the left hand's calibration.
#[cfg(feature = "left")]
pub type Calibrations<F> = Region<F, CALIBRATIONS_START, CALIBRATIONS_BYTES>;
/// Bytes per erasable page.
pub const PAGE_BYTES: u32 = 0x1000;
/// Pause after the erasure of a page, during which the processor stops for 85 ms. The sensor's FIFO holds 134 ms.
pub const PAUSE: Duration = Duration::from_millis(40);
/// Maximum number of words per call of [`Flash::write`].
const WORDS_AT_ONCE: usize = 32;

/// A flash operation failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FlashFailed;

impl NorFlashError for FlashFailed {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

/// Flash operations that the storage requires.
pub trait Flash {
    /// Erases a page, which sets all its bits to one.
    async fn erase_page(&mut self, address: u32) -> Result<(), FlashFailed>;
    /// Writes words to erased flash. The address must be a multiple of 4.
    async fn write(&mut self, address: u32, words: &[u32]) -> Result<(), FlashFailed>;
}

/// A part of a controller's flash.
pub struct Region<F, const START: u32, const BYTES: usize>(pub F);

/// The flash for a new image and the journal.
#[cfg(feature = "trouble")]
pub type Images<F> = Region<F, IMAGES_START, { shared_board::images::STORE_BYTES }>;

/// The flash for the two model slots.
#[cfg(not(feature = "left"))]
pub type Slots<F> = Region<F, SLOTS_START, STORE_BYTES>;

impl<F, const START: u32, const BYTES: usize> ErrorType for Region<F, START, BYTES> {
    type Error = FlashFailed;
}

impl<F: Flash, const START: u32, const BYTES: usize> ReadNorFlash for Region<F, START, BYTES> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashFailed> {
        let start = offset as usize;
        let found = self.mapped().get(start..start + bytes.len()).ok_or(FlashFailed)?;
        bytes.copy_from_slice(found);
        Ok(())
    }

    fn capacity(&self) -> usize {
        BYTES
    }
}

impl<F: Flash, const START: u32, const BYTES: usize> NorFlash for Region<F, START, BYTES> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = PAGE_BYTES as usize;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashFailed> {
        for page in (from..to).step_by(PAGE_BYTES as usize) {
            self.0.erase_page(START + page).await?;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashFailed> {
        let mut at = START + offset;
        for piece in bytes.chunks(4 * WORDS_AT_ONCE) {
            let mut words = [u32::MAX; WORDS_AT_ONCE];
            let mut used = 0;
            for word in piece.chunks_exact(4) {
                words[used] = u32::from_le_bytes([word[0], word[1], word[2], word[3]]);
                used += 1;
            }
            self.0.write(at, &words[..used]).await?;
            at += piece.len() as u32;
        }
        Ok(())
    }
}

impl<F: Flash, const START: u32, const BYTES: usize> MappedFlash for Region<F, START, BYTES> {
    fn mapped(&self) -> &[u8] {
        mapped(START, BYTES)
    }
}

/// Returns the data of a stored model.
#[cfg(not(feature = "left"))]
pub fn blob(place: StoredModel) -> &'static [u8] {
    stored(place.offset(), place.len)
}

#[cfg(not(feature = "left"))]
fn stored(offset: usize, len: usize) -> &'static [u8] {
    mapped(SLOTS_START + offset as u32, len.min(STORE_BYTES.saturating_sub(offset)))
}

fn mapped(start: u32, len: usize) -> &'static [u8] {
    // SAFETY: this is memory-mapped flash that the linker does not use.
    // The flash changes only through `Flash`.
    // A `ModelStore` keeps no reference while it writes, and never writes to the slot of the running model.
    // The same holds for a `BondLog`. An `ImageStore` keeps no reference while it writes either.
    unsafe { core::slice::from_raw_parts(start as *const u8, len) }
}
