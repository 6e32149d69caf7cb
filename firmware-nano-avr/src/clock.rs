//! The 100 Hz sample clock (TIMER1) and the time since start.

use avr_device::atmega328p::Peripherals;
use avr_device::interrupt::{self, Mutex};
use core::cell::Cell;
use shared_dsp::left::flex::permille;

/// Samples per second.
pub const SAMPLE_HZ: u16 = 100;
/// Time between two samples.
pub const PERIOD_MS: u32 = 1000 / SAMPLE_HZ as u32;
/// TIMER1 ticks per sample, at 2 MHz.
const TICKS: u16 = (16_000_000 / 8 / SAMPLE_HZ as u32) as u16;

static PERIODS: Mutex<Cell<u32>> = Mutex::new(Cell::new(0));
/// Ticks asleep since the last question.
static ASLEEP: Mutex<Cell<u32>> = Mutex::new(Cell::new(0));

/// Starts the clock at 0.
pub fn start() {
    // Safety: TIMER1 belongs to this module, and interrupts are off.
    let tc1 = unsafe { Peripherals::steal() }.TC1;
    tc1.tccr1a.write(|w| unsafe { w.bits(0) });
    tc1.tccr1b.write(|w| unsafe { w.bits(0) });
    tc1.tcnt1.write(|w| w.bits(0));
    tc1.ocr1a.write(|w| w.bits(TICKS - 1));
    tc1.tifr1.write(|w| unsafe { w.bits(0xFF) });
    tc1.timsk1.write(|w| w.ocie1a().set_bit());
    // Clear on compare (WGM12), clock / 8 (CS11).
    tc1.tccr1b.write(|w| unsafe { w.bits(0b0000_1010) });
}

#[avr_device::interrupt(atmega328p)]
fn TIMER1_COMPA() {
    interrupt::free(|cs| {
        let periods = PERIODS.borrow(cs);
        periods.set(periods.get().wrapping_add(1));
        crate::adc::begin_sample(cs);
    });
}

/// Sample periods since start, wrapping.
pub fn periods() -> u32 {
    interrupt::free(|cs| PERIODS.borrow(cs).get())
}

/// TIMER1's count within the present period.
pub fn ticks_in_period() -> u16 {
    // Safety: a read; the two bytes share a latch with the interrupt's accesses, hence no interrupts.
    interrupt::free(|_| unsafe { Peripherals::steal() }.TC1.tcnt1.read().bits())
}

/// Books the time asleep since [`ticks_in_period`] was `then`, less than one period ago.
pub fn add_sleep_since(then: u16) {
    let now = ticks_in_period();
    let slept = if now >= then { now - then } else { now + TICKS - then };
    interrupt::free(|cs| {
        let asleep = ASLEEP.borrow(cs);
        asleep.set(asleep.get().wrapping_add(u32::from(slept)));
    });
}

/// Share of `periods` that the board was awake, in parts per thousand, since the last question.
pub fn take_load_permille(periods: u32) -> u16 {
    let asleep = interrupt::free(|cs| ASLEEP.borrow(cs).replace(0));
    // In units of 64 ticks, so that the product with 1000 fits for 2 seconds.
    1000u16.saturating_sub(permille(asleep >> 6, (periods * u32::from(TICKS)) >> 6))
}
