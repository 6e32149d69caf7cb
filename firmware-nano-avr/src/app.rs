//! Connects [`LeftBoard`] to the registers.
//! Its inputs are samples, received bytes and time. Its outputs are frames, EEPROM writes and the LED state.

use crate::pins::Light;
use crate::restart::{self, Cause};
use crate::serial::{self, Serial};
use crate::{adc, clock, eeprom, stack};
use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;
use embedded_hal::digital::OutputPin;
use embedded_io::{Read, ReadReady, Write};
use shared_board::Identity;
use shared_board::calibration_store::{Eeprom, next_boot_id};
use shared_board::left::{LeftBoard, Start};
use shared_proto::message::{Board, FaultKind, Status};

/// Maximum number of received bytes handled per pass, so that a flood of bytes cannot delay a sample.
const BYTES_AT_ONCE: usize = 16;

/// The chip's EEPROM.
struct Memory;

impl Eeprom for Memory {
    fn is_busy(&self) -> bool {
        eeprom::is_busy()
    }

    fn read(&self, address: u16) -> u8 {
        eeprom::read(address)
    }

    fn write(&mut self, address: u16, byte: u8) {
        eeprom::write(address, byte);
    }
}

/// The complete firmware state around [`LeftBoard`].
pub struct App {
    board: LeftBoard<Memory>,
    period: u32,
    last_status_period: u32,
}

/// The only [`App`]. It is in static memory, so the size of `.bss` includes the app.
static mut APP: MaybeUninit<App> = MaybeUninit::uninit();

/// Creates the [`App`]. With `guided`, the app starts a calibration and guides the wearer with the LED.
/// This function must be called only once per start.
/// The function is not inlined.
/// Otherwise, its temporary copy of the app would occupy the stack of `main` permanently.
#[inline(never)]
pub fn install(cause: Cause, guided: bool) -> &'static mut App {
    // Safety: no other code uses `APP` at this point. Interrupts are still disabled and never access it.
    let place = unsafe { &mut *addr_of_mut!(APP) };
    let identity = Identity {
        board: Board::LeftNano,
        firmware: env!("CARGO_PKG_VERSION"),
        boot_id: next_boot_id(&mut Memory, restart::starts()),
        sample_hz: clock::SAMPLE_HZ,
    };
    let fault = match cause {
        Cause::Watchdog => Some(FaultKind::Watchdog),
        Cause::Panic => Some(FaultKind::Panic),
        Cause::Ordinary => None,
    };
    let board = LeftBoard::start(identity, Memory, Start { fault, guided }, &mut queue);
    place.write(App { board, period: 0, last_status_period: 0 })
}

/// Queues a frame completely or not at all. This function never waits for the serial line.
fn queue(frame: &[u8]) -> bool {
    frame.len() <= serial::room() && Serial.write_all(frame).is_ok()
}

impl App {
    /// Returns whether any work is pending. Call this with interrupts disabled.
    pub fn has_work(&self) -> bool {
        self.period != clock::periods() || adc::has_sample() || Serial.read_ready() == Ok(true)
    }

    /// Does all pending work.
    pub fn poll(&mut self) {
        if let Some(counts) = adc::take_sample() {
            self.board.sample(counts, self.now_ms(), &mut queue);
        }
        let period = clock::periods();
        if period != self.period {
            self.period = period;
            restart::all_is_well();
            // The converter finishes this sample 5 ms after the tick.
            if self.board.period(self.now_ms(), &mut queue) {
                self.status();
            }
            let _ = Light.set_state(self.board.light().into());
        }
        let mut bytes = [0; BYTES_AT_ONCE];
        if Serial.read_ready() == Ok(true)
            && let Ok(count) = Serial.read(&mut bytes)
        {
            for &byte in &bytes[..count] {
                self.board.receive(byte, self.now_ms(), &mut queue);
            }
        }
    }

    fn now_ms(&self) -> u32 {
        self.period.wrapping_mul(clock::PERIOD_MS)
    }

    #[inline(never)]
    fn status(&mut self) {
        let since = self.period.wrapping_sub(self.last_status_period);
        self.last_status_period = self.period;
        let counted = Status {
            dropped_samples: adc::dropped(),
            sensor_errors: adc::restarts(),
            bad_frames: serial::lost().into(),
            free_stack_bytes: stack::least_free().into(),
            load_permille: clock::take_load_permille(since),
            ..Status::default()
        };
        self.board.status(counted, self.now_ms(), &mut queue);
    }
}
