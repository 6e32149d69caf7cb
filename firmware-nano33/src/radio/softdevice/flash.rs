//! Writes to flash through the SoftDevice, which owns the flash controller.

use crate::storage::{Flash, FlashFailed, PAGE_BYTES};

/// The SoftDevice's flash calls, which fit between radio events. Only one user may call them at a time.
/// While a link begins, changes or ends, the radio may leave no time.
/// The SoftDevice then gives up, and this code repeats the request.
#[derive(Clone, Copy)]
pub struct SoftDeviceFlash;

static CALLS: embassy_sync::mutex::Mutex<
    embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex,
    Option<Calls>,
> = embassy_sync::mutex::Mutex::new(None);

/// Tasks may share this type, because there is one executor on one core.
struct Calls(nrf_softdevice::Flash);

// SAFETY: the calls have no state except a flag. The marker only keeps the type on one core.
unsafe impl Send for Calls {}

impl SoftDeviceFlash {
    /// Takes the calls, once.
    pub fn new(softdevice: &nrf_softdevice::Softdevice) -> Self {
        if let Ok(mut calls) = CALLS.try_lock() {
            *calls = Some(Calls(nrf_softdevice::Flash::take(softdevice)));
        }
        Self
    }
}

/// Number of times that an operation is requested, and the pause between requests.
const TRIES: usize = 5;
const PAUSE: embassy_time::Duration = embassy_time::Duration::from_millis(50);

impl Flash for SoftDeviceFlash {
    async fn erase_page(&mut self, address: u32) -> Result<(), FlashFailed> {
        use embedded_storage_async::nor_flash::NorFlash;
        let mut calls = CALLS.lock().await;
        let calls = calls.as_mut().ok_or(FlashFailed)?;
        for _ in 0..TRIES {
            if calls.0.erase(address, address + PAGE_BYTES).await.is_ok() {
                return Ok(());
            }
            embassy_time::Timer::after(PAUSE).await;
        }
        Err(FlashFailed)
    }

    async fn write(&mut self, address: u32, words: &[u32]) -> Result<(), FlashFailed> {
        use embedded_storage_async::nor_flash::NorFlash;
        // SAFETY: words may be read as bytes, and the length in bytes is the same.
        let bytes = unsafe { core::slice::from_raw_parts(words.as_ptr().cast::<u8>(), words.len() * 4) };
        let mut calls = CALLS.lock().await;
        let calls = calls.as_mut().ok_or(FlashFailed)?;
        for _ in 0..TRIES {
            // Writing the same words again has no effect.
            if calls.0.write(address, bytes).await.is_ok() {
                return Ok(());
            }
            embassy_time::Timer::after(PAUSE).await;
        }
        Err(FlashFailed)
    }
}
