//! The registers around [`LeftBoard`]: its samples, bytes and time in, its frames, EEPROM and light out.

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

/// Received bytes handled in one go, so that a flood cannot keep a sample waiting.
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

/// The whole board behind its registers.
pub struct App {
    board: LeftBoard<Memory>,
    period: u32,
    last_status_period: u32,
}

/// The one [`App`]. In static memory, so that `.bss` shows what it takes.
static mut APP: MaybeUninit<App> = MaybeUninit::uninit();

/// Makes the [`App`]; `guided` starts the calibration that one light guides. Called once per start. Not
/// inlined: its copy on the stack would stay there for ever.
#[inline(never)]
pub fn install(cause: Cause, guided: bool) -> &'static mut App {
    // Safety: the only use of `APP`, before interrupts are on; they never touch it.
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

/// Queues a frame, whole or not at all: nothing here ever waits for the line.
fn queue(frame: &[u8]) -> bool {
    frame.len() <= serial::room() && Serial.write_all(frame).is_ok()
}

impl App {
    /// Is there anything to do? Interrupts are off.
    pub fn has_work(&self) -> bool {
        self.period != clock::periods() || adc::has_sample() || Serial.read_ready() == Ok(true)
    }

    /// Does all there is to do.
    pub fn poll(&mut self) {
        if let Some(counts) = adc::take_sample() {
            self.board.sample(counts, self.now_ms(), &mut queue);
        }
        let period = clock::periods();
        if period != self.period {
            self.period = period;
            restart::all_is_well();
            // Its sample follows 5 ms later.
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
