//! Firmware of the left hand: an Arduino Nano (ATmega328P, 16 MHz) with an ADXL335 and two flex sensors.
//!
//! This crate contains the drivers for pins, converter, serial line, timer, EEPROM and watchdog.
//! `shared_board` defines which messages the board sends, when it sends them, and how it replies.
//! `shared_dsp` interprets tilts and bends, and detects faults.
//! `shared_proto` defines every byte on the wire.
//!
//! ```text
//!  TIMER1 100 Hz ─▶ adc: 45 conversions, 4.7 ms ─▶ app ─▶ shared_board::left ─▶ serial
//!                                                   ▲ ▼
//!                               serial (laptop) ────┘ eeprom
//! ```
#![no_std]
#![no_main]
#![feature(abi_avr_interrupt, asm_experimental_arch)]

mod adc;
mod app;
mod clock;
mod eeprom;
mod pins;
mod restart;
mod serial;
mod stack;

use avr_device::interrupt;
use core::arch::asm;

/// Entry point for avr-libc's start code.
/// The start code of avr-libc up to 2.2 calls `main` from `.init9`.
/// From version 2.3 on, the start code falls through into the code in this section.
#[unsafe(link_section = ".init9")]
#[unsafe(export_name = "main")]
extern "C" fn main() -> ! {
    let cause = restart::begin();
    stack::paint();
    pins::start();
    serial::start();
    adc::start();
    let app = app::install(cause, pins::calibration_wanted());
    clock::start();
    allow_sleep();
    restart::arm();
    loop {
        app.poll();
        interrupt::disable();
        if app.has_work() {
            // At this point, all state that interrupts use has been initialised.
            unsafe { interrupt::enable() };
        } else {
            let asleep_at = clock::ticks_in_period();
            // `sei` takes effect after the next instruction.
            // Because `sleep` directly follows `sei`, no interrupt can occur between the check for work and the sleep.
            unsafe { asm!("sei", "sleep") };
            clock::add_sleep_since(asleep_at);
        }
    }
}

/// Enables SLEEP in idle mode, which stops only the processor. Without the bit SMCR.SE, SLEEP has no effect.
fn allow_sleep() {
    const SE_IDLE: u8 = 1;
    // Safety: no other code writes this register.
    unsafe { avr_device::atmega328p::Peripherals::steal() }.CPU.smcr.write(|w| unsafe { w.bits(SE_IDLE) });
}
