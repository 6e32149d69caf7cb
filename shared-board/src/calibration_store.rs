//! Stores the left hand's calibration in two EEPROM slots that are written alternately, one byte per call.
//!
//! ```text
//! 0x020 slot 0 (20 bytes)   0x040 slot 1 (20 bytes)   0x060 count of power-ups (4 bytes)
//! ```
//!
//! Address 0 remains unused.
//! If the supply voltage fails during a write, address 0 can be damaged, because the address register is 0 after a reset.
//!
//! A new record goes to the unused slot, so a power cut at any moment preserves the last valid record.
//! `shared_dsp::left::calibration` defines the records and selects the valid slot.

use shared_dsp::left::calibration::{Calibration, RECORD_BYTES, Record, Stored};

const SLOTS: [u16; 2] = [0x020, 0x040];
const POWER_UPS: u16 = 0x060;

/// Non-volatile memory that is written byte by byte. Bytes that were never written read 0xFF.
pub trait Eeprom {
    /// Returns whether a write is in progress.
    fn is_busy(&self) -> bool;
    /// Reads a byte, after waiting for a write in progress if necessary.
    fn read(&self, address: u16) -> u8;
    /// Starts to write a byte, after waiting for a write in progress if necessary.
    fn write(&mut self, address: u16, byte: u8);
}

/// Generates a number that is unique to this start.
/// The number combines a count of power-ups, which is stored here, with `starts`.
/// `starts` counts the earlier starts since the last power-up and is kept in RAM.
/// A program that restarts for ever therefore does not wear out the EEPROM.
#[inline(never)]
pub fn next_boot_id(memory: &mut impl Eeprom, starts: u8) -> u32 {
    let mut bytes = [0; 4];
    for (i, byte) in bytes.iter_mut().enumerate() {
        *byte = memory.read(POWER_UPS + i as u16);
    }
    let mut power_ups = u32::from_le_bytes(bytes);
    // The count is also incremented when the counter in RAM has wrapped.
    if starts == 0 {
        power_ups = power_ups.wrapping_add(1);
        for (i, (new, old)) in power_ups.to_le_bytes().into_iter().zip(bytes).enumerate() {
            if new != old {
                memory.write(POWER_UPS + i as u16, new);
            }
        }
    }
    power_ups << 8 | u32::from(starts)
}

#[inline(never)]
fn read_slot(memory: &impl Eeprom, slot: usize) -> [u8; RECORD_BYTES] {
    let mut bytes = [0; RECORD_BYTES];
    for (i, byte) in bytes.iter_mut().enumerate() {
        *byte = memory.read(SLOTS[slot] + i as u16);
    }
    bytes
}

/// The progress of a write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// No write has finished.
    None,
    /// A write has finished, and the byte was verified.
    Done,
    /// A write has finished, but the stored byte differs from the written byte.
    Failed,
}

#[derive(Clone, Debug)]
struct Job {
    slot: usize,
    bytes: [u8; RECORD_BYTES],
    at: usize,
    /// Whether the other slot must be erased afterwards.
    then_other: bool,
}

/// The two slots.
#[derive(Clone, Debug)]
pub struct CalibrationStore<M> {
    memory: M,
    /// The active slot, and the generation of its record.
    slot: usize,
    generation: u8,
    job: Option<Job>,
}

impl<M: Eeprom> CalibrationStore<M> {
    /// Reads both slots.
    #[inline(never)]
    pub fn load(memory: M) -> (Self, Stored) {
        let stored = Stored::choose([&read_slot(&memory, 0), &read_slot(&memory, 1)]);
        let (slot, generation) = match stored {
            Stored::Good { record, slot } => (slot, record.generation),
            Stored::Blank | Stored::Damaged => (1, 0),
        };
        (Self { memory, slot, generation, job: None }, stored)
    }

    /// Begins to store a calibration.
    pub fn keep(&mut self, calibration: &Calibration) {
        let record = Record { generation: self.generation.wrapping_add(1), calibration: *calibration };
        self.begin(record.to_bytes(), false);
    }

    /// Begins to delete all calibrations, starting with the inactive slot.
    pub fn forget(&mut self) {
        self.begin([0xFF; RECORD_BYTES], true);
    }

    #[inline(never)]
    fn begin(&mut self, bytes: [u8; RECORD_BYTES], then_other: bool) {
        self.job = Some(Job { slot: 1 - self.slot, bytes, at: 0, then_other });
    }

    /// Returns whether a write is in progress.
    pub fn is_busy(&self) -> bool {
        self.job.is_some()
    }

    /// Writes at most one byte. Call it once per sample.
    #[inline(never)]
    pub fn poll(&mut self) -> Progress {
        let Some(job) = &mut self.job else { return Progress::None };
        if self.memory.is_busy() {
            return Progress::None;
        }
        while job.at < RECORD_BYTES {
            let (address, byte) = (SLOTS[job.slot] + job.at as u16, job.bytes[job.at]);
            job.at += 1;
            if self.memory.read(address) != byte {
                self.memory.write(address, byte);
                return Progress::None;
            }
        }
        let (slot, written) = (job.slot, read_slot(&self.memory, job.slot) == job.bytes);
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

    /// Returns the memory, for use at the board's next start.
    pub fn into_memory(self) -> M {
        self.memory
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::memory::RamEeprom;
    use proptest::prelude::*;

    fn other(n: i16) -> Calibration {
        let mut calibration = Calibration::DEFAULT;
        calibration.zero[0] += n;
        calibration
    }

    fn run(store: &mut CalibrationStore<RamEeprom>) -> Progress {
        (0..100).map(|_| store.poll()).find(|p| *p != Progress::None).expect("ends within 100 calls")
    }

    fn kept(memory: RamEeprom) -> Option<Calibration> {
        match CalibrationStore::load(memory).1 {
            Stored::Good { record, .. } => Some(record.calibration),
            Stored::Blank | Stored::Damaged => None,
        }
    }

    #[test]
    fn what_was_kept_is_there_after_the_next_start_until_it_is_forgotten() {
        let (mut store, stored) = CalibrationStore::load(RamEeprom::blank());
        assert_eq!(stored, Stored::Blank);
        for n in 1..=3 {
            store.keep(&other(n));
            assert_eq!(run(&mut store), Progress::Done);
            assert_eq!(kept(store.clone().into_memory()), Some(other(n)));
        }
        store.forget();
        assert_eq!(run(&mut store), Progress::Done);
        assert_eq!(CalibrationStore::load(store.into_memory()).1, Stored::Blank);
    }

    #[test]
    fn one_byte_is_written_per_call_and_none_while_one_is_under_way() {
        let mut memory = RamEeprom::blank();
        memory.busy_for = 2;
        let (mut store, _) = CalibrationStore::load(memory);
        store.keep(&other(1));
        let mut before = 0;
        while store.is_busy() {
            store.poll();
            assert!(store.memory.writes <= before + 1);
            before = store.memory.writes;
        }
        assert!(before > 10);
    }

    #[test]
    fn a_memory_that_keeps_nothing_is_reported() {
        let mut memory = RamEeprom::blank();
        memory.writes_left = 5;
        let (mut store, _) = CalibrationStore::load(memory);
        store.keep(&other(1));
        assert_eq!(run(&mut store), Progress::Failed);
    }

    #[test]
    fn no_two_starts_have_the_same_number() {
        let mut memory = RamEeprom::blank();
        let mut seen = std::collections::BTreeSet::new();
        for _ in 0..300 {
            for restarts in 0..3 {
                assert!(seen.insert(next_boot_id(&mut memory, restarts)));
            }
        }
    }

    proptest! {
        /// Power may fail at any byte of any write. The next start then finds the old or the new calibration.
        #[test]
        fn a_power_cut_costs_the_new_calibration_at_most(cut in 0u32..25, rounds in 0i16..4) {
            let (mut store, _) = CalibrationStore::load(RamEeprom::blank());
            for n in 0..rounds {
                store.keep(&other(n));
                run(&mut store);
            }
            let old = kept(store.clone().into_memory());
            store.memory.writes_left = cut;
            store.keep(&other(1000));
            while store.is_busy() {
                store.poll();
            }
            let found = kept(store.into_memory());
            prop_assert!(found == old || found == Some(other(1000)), "{:?}", found);
        }
    }
}
