//! Reads and writes single bytes of EEPROM.

use avr_device::atmega328p::{EEPROM, Peripherals};
use avr_device::interrupt;
use core::arch::asm;

/// Safety: only this module uses the EEPROM.
fn eeprom() -> EEPROM {
    unsafe { Peripherals::steal() }.EEPROM
}

/// Returns whether a write is in progress. A write takes 3.4 ms.
pub fn is_busy() -> bool {
    eeprom().eecr.read().eepe().bit_is_set()
}

/// Waits until any write in progress has finished, and then reads a byte.
pub fn read(address: u16) -> u8 {
    while is_busy() {}
    let eeprom = eeprom();
    eeprom.eear.write(|w| w.bits(address));
    eeprom.eecr.write(|w| w.eere().set_bit());
    eeprom.eedr.read().bits()
}

/// Waits until any write in progress has finished, and then starts to erase and write a byte.
pub fn write(address: u16, byte: u8) {
    while is_busy() {}
    let eeprom = eeprom();
    eeprom.eear.write(|w| w.bits(address));
    eeprom.eedr.write(|w| w.bits(byte));
    // EEPE must be set within four cycles after EEMPE.
    // Safety: this sets two bits of EECR (0x1F in I/O space).
    interrupt::free(|_| unsafe { asm!("sbi 0x1F, 2", "sbi 0x1F, 1") });
}
