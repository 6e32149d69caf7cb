//! One byte of EEPROM at a time.

use avr_device::atmega328p::{EEPROM, Peripherals};
use avr_device::interrupt;
use core::arch::asm;

/// Safety: EEPROM belongs to this module.
fn eeprom() -> EEPROM {
    unsafe { Peripherals::steal() }.EEPROM
}

/// Is a byte still being written (3.4 ms)?
pub fn is_busy() -> bool {
    eeprom().eecr.read().eepe().bit_is_set()
}

/// Reads a byte. Waits for a write that is under way.
pub fn read(address: u16) -> u8 {
    while is_busy() {}
    let eeprom = eeprom();
    eeprom.eear.write(|w| w.bits(address));
    eeprom.eecr.write(|w| w.eere().set_bit());
    eeprom.eedr.read().bits()
}

/// Starts writing a byte (erase and write in one). Waits for a write that is under way.
pub fn write(address: u16, byte: u8) {
    while is_busy() {}
    let eeprom = eeprom();
    eeprom.eear.write(|w| w.bits(address));
    eeprom.eedr.write(|w| w.bits(byte));
    // EEPE must follow EEMPE within four cycles.
    // Safety: two bits of EECR (0x1F in I/O space).
    interrupt::free(|_| unsafe { asm!("sbi 0x1F, 2", "sbi 0x1F, 1") });
}
