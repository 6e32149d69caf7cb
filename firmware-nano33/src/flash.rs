//! Writes to flash, either through the chip's controller or through the SoftDevice, which then owns the controller.

#[cfg(feature = "ble")]
use crate::storage::PAGE_BYTES;
use crate::storage::{Flash, FlashFailed};

/// The chip's controller. Erasing a page stops the processor for about 85 ms.
#[cfg(not(feature = "ble"))]
pub struct Controller(embassy_nrf::nvmc::Nvmc<'static>);

#[cfg(not(feature = "ble"))]
impl Controller {
    /// Takes the controller.
    pub fn new(nvmc: embassy_nrf::Peri<'static, embassy_nrf::peripherals::NVMC>) -> Self {
        Self(embassy_nrf::nvmc::Nvmc::new(nvmc))
    }
}

#[cfg(not(feature = "ble"))]
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

/// The SoftDevice's flash calls, which run between radio events. Only one user at a time may call them.
/// The SoftDevice gives up if the radio leaves no time, for example while a link starts, changes or ends.
/// The operation is then repeated.
#[cfg(feature = "ble")]
#[derive(Clone, Copy)]
pub struct SoftDeviceFlash;

#[cfg(feature = "ble")]
static CALLS: embassy_sync::mutex::Mutex<
    embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex,
    Option<Calls>,
> = embassy_sync::mutex::Mutex::new(None);

/// Marks the calls as safe to move between tasks, because there is one executor on one core.
#[cfg(feature = "ble")]
struct Calls(nrf_softdevice::Flash);

// SAFETY: the only state of the calls is a flag, and the type's marker only restricts it to one core.
#[cfg(feature = "ble")]
unsafe impl Send for Calls {}

#[cfg(feature = "ble")]
impl SoftDeviceFlash {
    /// Takes the calls, once.
    pub fn new(softdevice: &nrf_softdevice::Softdevice) -> Self {
        if let Ok(mut calls) = CALLS.try_lock() {
            *calls = Some(Calls(nrf_softdevice::Flash::take(softdevice)));
        }
        Self
    }
}

/// Maximum number of attempts per operation, and the pause between two attempts.
#[cfg(feature = "ble")]
const TRIES: usize = 5;
#[cfg(feature = "ble")]
const PAUSE: embassy_time::Duration = embassy_time::Duration::from_millis(50);

#[cfg(feature = "ble")]
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
        // SAFETY: any word is valid as bytes, and the length in bytes is the same.
        let bytes = unsafe { core::slice::from_raw_parts(words.as_ptr().cast::<u8>(), words.len() * 4) };
        let mut calls = CALLS.lock().await;
        let calls = calls.as_mut().ok_or(FlashFailed)?;
        for _ in 0..TRIES {
            // Writing the same words a second time does not change the flash.
            if calls.0.write(address, bytes).await.is_ok() {
                return Ok(());
            }
            embassy_time::Timer::after(PAUSE).await;
        }
        Err(FlashFailed)
    }
}
