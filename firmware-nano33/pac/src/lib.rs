//! Only what nrf-softdevice 0.1.0 uses of `nrf52840-pac`, without that crate's interrupt table.
//!
//! nrf-softdevice wants the old register crate and embassy-nrf the new one (`nrf-pac`). Each of them
//! brings a table `__INTERRUPTS`; two tables either do not link or, worse, link silently with the
//! handlers of the other one missing. Here the only table is embassy-nrf's. Both crates name the
//! SoftDevice's event interrupt differently (`SWI2_EGU2` here, `EGU2_SWI2` there): `memory.x`
//! assigns one to the other, and the test `nrf_vectors` reads the linked image to prove it.
#![no_std]

pub use cortex_m::peripheral::NVIC;
pub use cortex_m_rt::interrupt;

pub use self::Interrupt as interrupt;

/// The interrupts that the SoftDevice owns or raises.
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
    /// AES-CCM and address resolution.
    CCM_AAR = 15,
    /// The SoftDevice has an event for the application.
    SWI2_EGU2 = 22,
    /// The SoftDevice's own.
    SWI5_EGU5 = 25,
}

// SAFETY: the numbers are those of the nRF52840's vector table.
unsafe impl cortex_m::interrupt::InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}
