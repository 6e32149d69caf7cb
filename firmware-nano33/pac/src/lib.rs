//! Replaces `nrf52840-pac`. It has only the items that nrf-softdevice 0.1.0 uses, and no interrupt table.
//!
//! nrf-softdevice depends on the old register crate, and embassy-nrf depends on the new crate (`nrf-pac`).
//! Each register crate defines a table `__INTERRUPTS`.
//! Two tables either fail to link or, worse, link silently without the handlers of one crate.
//! With this replacement, the image contains only embassy-nrf's table.
//! The two crates use different names for the SoftDevice's event interrupt: `SWI2_EGU2` here and `EGU2_SWI2` there.
//! `memory.x` defines one of these names as an alias of the other.
//! The test `nrf_vectors` checks this in the linked image.
#![no_std]

pub use cortex_m::peripheral::NVIC;
pub use cortex_m_rt::interrupt;

pub use self::Interrupt as interrupt;

/// The interrupts that the SoftDevice reserves for itself or triggers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(non_camel_case_types)]
#[repr(u16)]
pub enum Interrupt {
    /// Clock and power.
    POWER_CLOCK = 0,
    /// Radio.
    RADIO = 1,
    /// Timer 0.
    TIMER0 = 8,
    /// Real time counter 0.
    RTC0 = 11,
    /// Temperature.
    TEMP = 12,
    /// Random numbers.
    RNG = 13,
    /// AES block.
    ECB = 14,
    /// Interrupt of AES-CCM encryption and Bluetooth address resolution.
    CCM_AAR = 15,
    /// Interrupt by which the SoftDevice reports an event to the application.
    SWI2_EGU2 = 22,
    /// The SoftDevice's own.
    SWI5_EGU5 = 25,
}

// SAFETY: the numbers match the vector table of the nRF52840.
unsafe impl cortex_m::interrupt::InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}
