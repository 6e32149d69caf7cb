//! Firmware of the left hand: an Arduino Nano (ATmega328P, 16 MHz) with an ADXL335 and two flex sensors.
//!
//! This crate contains the drivers for pins, converter, serial line, timer, EEPROM and watchdog.
//! `shared_board` defines the messages that the board sends, their timing and its replies.
//! `shared_dsp` judges tilts, bends and faults.
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
/// Up to avr-libc 2.2 the start code calls `main` from `.init9`;
/// from 2.3 on it falls through into the code placed there.
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
            // All state that interrupts use is initialised at this point.
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

/// Enables SLEEP in idle mode, which stops only the processor. Without SMCR.SE, the instruction has no effect.
fn allow_sleep() {
    const SE_IDLE: u8 = 1;
    // Safety: nothing else writes this register.
    unsafe { avr_device::atmega328p::Peripherals::steal() }.CPU.smcr.write(|w| unsafe { w.bits(SE_IDLE) });
}
