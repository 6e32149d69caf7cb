//! Reads five analog channels after each clock tick.
//! The converter's interrupt sums eight conversions of each channel.
//!
//! Before it reads a channel, the converter measures ground once, which empties its sampling capacitor.
//! Without this measurement, an open channel would repeat its neighbour's voltage.
//! With this measurement, an open channel reads near 0, which counts as a fault.
//!
//! The reference is always AREF, which is wired to 3.3 V.
//! **Any other setting connects an internal source to that pin and shorts the board's 3.3 V supply.**
//! For this reason, only one function in this file writes the multiplexer register.

use avr_device::atmega328p::{ADC, Peripherals};
use avr_device::interrupt::{self, CriticalSection, Mutex};
use core::cell::{Cell, RefCell};
use shared_dsp::left::{AdcCounts, OVERSAMPLING};

/// A3 is the index finger and A4 the middle finger.
/// A0, A1 and A2 carry x, y and z. The accelerometer is read last to keep its delay short.
const CHANNELS: [u8; 5] = [3, 4, 0, 1, 2];
/// The multiplexer's ground.
const GROUND: u8 = 0b1111;
/// The converter's clock is the CPU clock / 128 = 125 kHz. Full resolution requires 50 to 200 kHz.
/// One conversion takes 13 clocks, which are 104 µs.
const PRESCALER: u8 = 0b111;
/// If a sample is unfinished after this number of sample periods, the converter hangs.
const PATIENCE: u8 = 3;

struct Burst {
    channel: usize,
    grounding: bool,
    taken: u16,
    sums: [u16; 5],
    running: bool,
    late: u8,
    finished: Option<AdcCounts>,
}

static BURST: Mutex<RefCell<Burst>> = Mutex::new(RefCell::new(Burst {
    channel: 0,
    grounding: true,
    taken: 0,
    sums: [0; 5],
    running: false,
    late: 0,
    finished: None,
}));
static DROPPED: Mutex<Cell<u32>> = Mutex::new(Cell::new(0));
static RESTARTS: Mutex<Cell<u32>> = Mutex::new(Cell::new(0));

/// Safety: only this module uses the converter, and callers disable interrupts first.
fn converter() -> ADC {
    unsafe { Peripherals::steal() }.ADC
}

/// Selects a channel with AREF as the reference (REFS1 and REFS0 are 0) and right-aligned results (ADLAR is 0).
fn select(adc: &ADC, channel: u8) {
    adc.admux.write(|w| unsafe { w.bits(channel & 0x0F) });
}

fn convert(adc: &ADC) {
    // ADEN, ADSC and ADIE.
    adc.adcsra.write(|w| unsafe { w.bits(0b1100_1000 | PRESCALER) });
}

/// Enables the converter. Call this with interrupts disabled.
pub fn start() {
    let adc = converter();
    select(&adc, GROUND);
    adc.adcsrb.write(|w| unsafe { w.bits(0) });
    // The digital input buffers of A0 to A4 are not needed and would draw current.
    adc.didr0.write(|w| unsafe { w.bits(0b0001_1111) });
    // Sets ADEN to enable the converter, and clears ADIF by writing 1 to it.
    adc.adcsra.write(|w| unsafe { w.bits(0b1001_0000 | PRESCALER) });
}

/// Starts the sample of this period. If the previous sample was not finished or not fetched, it counts as dropped.
pub fn begin_sample(cs: CriticalSection<'_>) {
    let mut burst = BURST.borrow(cs).borrow_mut();
    let count = |counter: &Mutex<Cell<u32>>| {
        let counter = counter.borrow(cs);
        counter.set(counter.get().wrapping_add(1));
    };
    if burst.finished.take().is_some() {
        count(&DROPPED);
    }
    if burst.running {
        count(&DROPPED);
        burst.late += 1;
        if burst.late < PATIENCE {
            return;
        }
        count(&RESTARTS);
        converter().adcsra.write(|w| unsafe { w.bits(0) });
        start();
    }
    burst.late = 0;
    burst.channel = 0;
    burst.taken = 0;
    burst.sums = [0; 5];
    burst.grounding = true;
    burst.running = true;
    let adc = converter();
    select(&adc, GROUND);
    convert(&adc);
}

#[avr_device::interrupt(atmega328p)]
fn ADC() {
    interrupt::free(|cs| {
        let mut burst = BURST.borrow(cs).borrow_mut();
        let adc = converter();
        let value = adc.adc.read().bits();
        if !burst.running {
            return;
        }
        let channel = burst.channel;
        if burst.grounding {
            burst.grounding = false;
            select(&adc, CHANNELS[channel]);
        } else {
            burst.sums[channel] += value;
            burst.taken += 1;
            if burst.taken == OVERSAMPLING {
                burst.taken = 0;
                burst.grounding = true;
                burst.channel += 1;
                select(&adc, GROUND);
                if burst.channel == CHANNELS.len() {
                    let [index, middle, x, y, z] = burst.sums;
                    burst.running = false;
                    burst.finished = Some(AdcCounts { x, y, z, index, middle });
                    return;
                }
            }
        }
        convert(&adc);
    });
}

/// Returns the finished sample of this period, at most once.
pub fn take_sample() -> Option<AdcCounts> {
    interrupt::free(|cs| BURST.borrow(cs).borrow_mut().finished.take())
}

/// Returns whether a finished sample is waiting.
pub fn has_sample() -> bool {
    interrupt::free(|cs| BURST.borrow(cs).borrow().finished.is_some())
}

/// Number of samples since start that were not taken, or were not fetched in time.
pub fn dropped() -> u32 {
    interrupt::free(|cs| DROPPED.borrow(cs).get())
}

/// Number of times since start that the firmware restarted a hanging converter.
pub fn restarts() -> u32 {
    interrupt::free(|cs| RESTARTS.borrow(cs).get())
}
