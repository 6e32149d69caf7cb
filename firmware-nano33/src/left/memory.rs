//! The left hand's calibration: an EEPROM whose bytes a task writes to flash, beside the radio.

use core::sync::atomic::{AtomicBool, AtomicU8, Ordering};

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use shared_board::calibration_store::Eeprom;
use shared_board::eeprom_log::{BYTES, EepromLog};
use shared_board::models::MappedFlash;

/// The bytes in flash.
static STORED: [AtomicU8; BYTES] = [const { AtomicU8::new(0xFF) }; BYTES];
/// Whether a byte is being written.
static IS_BUSY: AtomicBool = AtomicBool::new(false);
/// The address and value of this byte.
static WANTED: Signal<CriticalSectionRawMutex, (u16, u8)> = Signal::new();

/// The EEPROM as the board's logic uses it.
#[derive(Clone, Copy, Debug)]
pub struct Memory;

impl Eeprom for Memory {
    fn is_busy(&self) -> bool {
        IS_BUSY.load(Ordering::Relaxed)
    }

    fn read(&self, address: u16) -> u8 {
        STORED.get(usize::from(address)).map_or(0xFF, |byte| byte.load(Ordering::Relaxed))
    }

    fn write(&mut self, address: u16, byte: u8) {
        IS_BUSY.store(true, Ordering::Relaxed);
        WANTED.signal((address, byte));
    }
}

/// Sets the bytes that were found in flash.
pub fn fill(bytes: &[u8; BYTES]) {
    for (stored, &byte) in STORED.iter().zip(bytes) {
        stored.store(byte, Ordering::Relaxed);
    }
}

/// Writes bytes to flash without end.
/// A byte that was not written keeps its value, which the calibration's store notices.
pub async fn save<F: MappedFlash>(mut log: EepromLog<F>) -> ! {
    loop {
        let (address, byte) = WANTED.wait().await;
        if log.write(address, byte).await.is_ok()
            && let Some(stored) = STORED.get(usize::from(address))
        {
            stored.store(byte, Ordering::Relaxed);
        }
        IS_BUSY.store(false, Ordering::Relaxed);
    }
}
