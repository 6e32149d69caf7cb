//! Where the calibration is kept: two slots in EEPROM, written in turn, one byte per call.
//!
//! ```text
//! 0x020 slot 0 (20 bytes)   0x040 slot 1 (20 bytes)   0x060 count of power-ups (4 bytes)
//! ```
//!
//! Address 0 stays empty: it is what a supply that fails during a write hits, since the address register holds 0 after a
//! reset.
//!
//! A new record goes to the slot that is not in use, so a power cut at any moment leaves the last good
//! one. What a record looks like, and which slot counts, is `shared_dsp::left_calibration`'s.

use crate::{eeprom, restart};
use shared_dsp::left_calibration::{Calibration, RECORD_BYTES, Record, Stored};

const SLOTS: [u16; 2] = [0x020, 0x040];
const POWER_UPS: u16 = 0x060;

/// Makes a number that no other start has: of power-ups, which are counted here, and of starts since the last one, which
/// RAM remembers. A program that fails and restarts for ever must not wear out the EEPROM.
#[inline(never)]
pub fn next_boot_id() -> u32 {
    let mut bytes = [0; 4];
    for (i, byte) in bytes.iter_mut().enumerate() {
        *byte = eeprom::read(POWER_UPS + i as u16);
    }
    let mut power_ups = u32::from_le_bytes(bytes);
    let starts = restart::starts();
    // Also each time that RAM's count has run over.
    if starts == 0 {
        power_ups = power_ups.wrapping_add(1);
        for (i, (new, old)) in power_ups.to_le_bytes().into_iter().zip(bytes).enumerate() {
            if new != old {
                eeprom::write(POWER_UPS + i as u16, new);
            }
        }
    }
    power_ups << 8 | u32::from(starts)
}

#[inline(never)]
fn read_slot(slot: usize) -> [u8; RECORD_BYTES] {
    let mut bytes = [0; RECORD_BYTES];
    for (i, byte) in bytes.iter_mut().enumerate() {
        *byte = eeprom::read(SLOTS[slot] + i as u16);
    }
    bytes
}

/// How a job in [`Store`] stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// No job, or not done yet.
    None,
    /// Written and read back.
    Done,
    /// Read back differently.
    Failed,
}

struct Job {
    slot: usize,
    bytes: [u8; RECORD_BYTES],
    at: usize,
    /// Erase the other slot afterwards.
    then_other: bool,
}

/// The two slots.
pub struct Store {
    /// The slot in use, and its generation.
    slot: usize,
    generation: u8,
    job: Option<Job>,
}

impl Store {
    /// Reads both slots.
    #[inline(never)]
    pub fn load() -> (Self, Stored) {
        let stored = Stored::choose([&read_slot(0), &read_slot(1)]);
        let (slot, generation) = match stored {
            Stored::Good { record, slot } => (slot, record.generation),
            Stored::Blank | Stored::Damaged => (1, 0),
        };
        (Self { slot, generation, job: None }, stored)
    }

    /// Begins to keep a calibration.
    pub fn keep(&mut self, calibration: &Calibration) {
        let record = Record { generation: self.generation.wrapping_add(1), calibration: *calibration };
        self.begin(record.to_bytes(), false);
    }

    /// Begins to forget every calibration: the slot not in use first.
    pub fn forget(&mut self) {
        self.begin([0xFF; RECORD_BYTES], true);
    }

    #[inline(never)]
    fn begin(&mut self, bytes: [u8; RECORD_BYTES], then_other: bool) {
        self.job = Some(Job { slot: 1 - self.slot, bytes, at: 0, then_other });
    }

    /// Is a job under way?
    pub fn is_busy(&self) -> bool {
        self.job.is_some()
    }

    /// Writes at most one byte. Called once per sample.
    #[inline(never)]
    pub fn poll(&mut self) -> Progress {
        let Some(job) = &mut self.job else { return Progress::None };
        if eeprom::is_busy() {
            return Progress::None;
        }
        while job.at < RECORD_BYTES {
            let (address, byte) = (SLOTS[job.slot] + job.at as u16, job.bytes[job.at]);
            job.at += 1;
            if eeprom::read(address) != byte {
                eeprom::write(address, byte);
                return Progress::None;
            }
        }
        let (slot, written) = (job.slot, read_slot(job.slot) == job.bytes);
        if job.then_other {
            job.then_other = false;
            job.slot = 1 - slot;
            job.at = 0;
            return Progress::None;
        }
        let generation = job.bytes[1];
        self.job = None;
        if !written {
            return Progress::Failed;
        }
        self.slot = slot;
        self.generation = generation;
        Progress::Done
    }
}
