//! Writes to flash while the radio pauses.
//! Between radio events, mpsl grants a time slot in which we may use the flash controller.
//!
//! A page is erased in pieces of 10 ms.
//! If the radio grants no slot, the request is repeated with a higher priority.
//! The link may then miss one event.
//! Such a miss is harmless, because the supervision timeout is a hundred times as long as a piece.

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::mutex::Mutex;
use embassy_time::{Duration, Timer};
use nrf_mpsl::MultiprotocolServiceLayer;

/// The radio left no time for a flash operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoSlot;

/// Bytes per erasable page.
const PAGE_BYTES: u32 = 0x1000;

/// The time slots, which only one user may request at a time.
#[derive(Clone, Copy)]
pub struct SlotFlash;

/// The time slots may move between tasks, because there is only one executor on one core.
struct Slots(nrf_mpsl::Flash<'static>);

// SAFETY: as explained above, this value never leaves the only thread.
unsafe impl Send for Slots {}

static SLOTS: Mutex<CriticalSectionRawMutex, Option<Slots>> = Mutex::new(None);

/// Number of attempts for an operation, and the pause between two attempts.
const TRIES: usize = 5;
const PAUSE: Duration = Duration::from_millis(50);

impl SlotFlash {
    /// Takes the flash controller. This is possible only once.
    pub fn take(
        mpsl: &'static MultiprotocolServiceLayer<'static>,
        nvmc: embassy_nrf::Peri<'static, embassy_nrf::peripherals::NVMC>,
    ) -> Self {
        if let Ok(mut slots) = SLOTS.try_lock() {
            *slots = Some(Slots(nrf_mpsl::Flash::take(mpsl, nvmc)));
        }
        Self
    }

    /// Erases a page, which sets all its bits to one.
    ///
    /// # Errors
    /// Fails if the radio gave no slot for a quarter of a second.
    pub async fn erase_page(self, address: u32) -> Result<(), NoSlot> {
        let mut slots = SLOTS.lock().await;
        let slots = slots.as_mut().ok_or(NoSlot)?;
        for _ in 0..TRIES {
            if slots.0.erase(address, address + PAGE_BYTES).await.is_ok() {
                return Ok(());
            }
            Timer::after(PAUSE).await;
        }
        Err(NoSlot)
    }

    /// Writes words to erased flash. The address is a multiple of 4.
    ///
    /// # Errors
    /// Fails for the same reason as [`SlotFlash::erase_page`].
    pub async fn write(self, address: u32, words: &[u32]) -> Result<(), NoSlot> {
        // SAFETY: any words are valid as bytes, and the length in bytes is the same.
        let bytes = unsafe { core::slice::from_raw_parts(words.as_ptr().cast::<u8>(), words.len() * 4) };
        let mut slots = SLOTS.lock().await;
        let slots = slots.as_mut().ok_or(NoSlot)?;
        for _ in 0..TRIES {
            // Writing the same words again changes nothing.
            if slots.0.write(address, bytes).await.is_ok() {
                return Ok(());
            }
            Timer::after(PAUSE).await;
        }
        Err(NoSlot)
    }
}
