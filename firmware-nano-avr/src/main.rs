//! The left hand's firmware: an Arduino Nano (ATmega328P, 16 MHz) with an ADXL335 and two flex sensors.
//!
//! This crate holds pins, converter, serial line, timer, EEPROM and watchdog. What the board says, when, and what
//! it answers is `shared_board`'s, every judgement (what a tilt means, what a bend is, what a fault is)
//! `shared_dsp`'s, every byte on the wire `shared_proto`'s.
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

/// Where avr-libc's start code arrives: up to 2.2 it calls `main` from `.init9`, from 2.3 on it runs into what stands there.
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
            // Everything that interrupts touch is set up.
            unsafe { interrupt::enable() };
        } else {
            let asleep_at = clock::ticks_in_period();
            // `sei` takes effect after the instruction behind it, so no interrupt fits between the
            // question and the sleep, if these two stand together.
            unsafe { asm!("sei", "sleep") };
            clock::add_sleep_since(asleep_at);
        }
    }
}

/// Lets SLEEP stop the processor, and nothing else (idle): without SMCR.SE it does nothing.
fn allow_sleep() {
    const SE_IDLE: u8 = 1;
    // Safety: a register that nobody else writes.
    unsafe { avr_device::atmega328p::Peripherals::steal() }.CPU.smcr.write(|w| unsafe { w.bits(SE_IDLE) });
}
