//! Tests that the log in flash behaves like an EEPROM, whenever the power fails.

use proptest::prelude::*;
use shared_board::calibration_store::{CalibrationStore, Eeprom, Progress};
use shared_board::eeprom_log::{BYTES, EepromLog, NotWritten};
use shared_board::memory::{RamFlash, at_once};
use shared_dsp::left::calibration::{Calibration, Stored};

/// Number of written bytes that fit a page: 4096 bytes without a header of 16 bytes, at four bytes each.
const PER_PAGE: u32 = 1020;

fn bytes(flash: &RamFlash) -> [u8; BYTES] {
    *EepromLog::open(flash.clone()).bytes()
}

fn write(flash: RamFlash, address: u16, byte: u8) -> (RamFlash, Result<(), NotWritten>) {
    let mut log = EepromLog::open(flash);
    let result = at_once(log.write(address, byte));
    (log.into_flash(), result)
}

#[test]
fn blank_flash_reads_as_a_blank_eeprom_and_written_bytes_stay() {
    assert_eq!(bytes(&RamFlash::blank()), [0xFF; BYTES]);
    let (flash, result) = write(RamFlash::blank(), 0x20, 7);
    assert_eq!(result, Ok(()));
    let (flash, result) = write(flash, 127, 0);
    assert_eq!(result, Ok(()));
    let mut wanted = [0xFF; BYTES];
    (wanted[0x20], wanted[127]) = (7, 0);
    assert_eq!(bytes(&flash), wanted);
    assert_eq!(write(flash, 128, 0).1, Err(NotWritten));
}

#[test]
fn an_equal_byte_costs_no_flash_and_a_full_page_is_followed_by_the_other_one() {
    let mut log = EepromLog::open(RamFlash::blank());
    for i in 0..3 * PER_PAGE {
        at_once(log.write((i % 128) as u16, (i % 251) as u8)).unwrap();
    }
    let wanted = *log.bytes();
    let flash = log.into_flash();
    assert_eq!(bytes(&flash), wanted);
    let operations = flash.operations;
    let (flash, result) = write(flash, 5, wanted[5]);
    assert_eq!((result, flash.operations), (Ok(()), operations));
}

#[test]
fn flash_full_of_something_else_is_a_blank_eeprom_and_takes_bytes() {
    let mut flash = RamFlash::blank();
    for offset in 0..0x2000 {
        *flash.byte_mut(offset) = ((offset * 37) >> 3) as u8;
    }
    assert_eq!(bytes(&flash), [0xFF; BYTES]);
    let (flash, result) = write(flash, 3, 4);
    assert_eq!((result, bytes(&flash)[3]), (Ok(()), 4));
}

/// The log as the memory of a calibration, whose writes end at the next poll.
struct Memory(EepromLog<RamFlash>);

impl Eeprom for Memory {
    fn is_busy(&self) -> bool {
        false
    }

    fn read(&self, address: u16) -> u8 {
        self.0.bytes()[usize::from(address)]
    }

    fn write(&mut self, address: u16, byte: u8) {
        // A failed write leaves the old byte, which the store notices.
        let _ = at_once(self.0.write(address, byte));
    }
}

fn calibration(number: u16) -> Calibration {
    Calibration { rest: [5000 + number, 5000 + 2 * number], ..Calibration::DEFAULT }
}

fn stored(flash: &RamFlash) -> Option<Calibration> {
    match CalibrationStore::load(Memory(EepromLog::open(flash.clone()))).1 {
        Stored::Good { record, .. } => Some(record.calibration),
        Stored::Blank => None,
        Stored::Damaged => panic!("a damaged calibration"),
    }
}

/// Stores a calibration, and cuts the power after this many flash operations.
fn keep(
    mut flash: RamFlash,
    calibration: &Calibration,
    cut_after: Option<u32>,
    torn: u32,
) -> (RamFlash, Progress) {
    (flash.cut_after, flash.torn) = (cut_after, torn);
    let (mut store, _) = CalibrationStore::load(Memory(EepromLog::open(flash)));
    store.keep(calibration);
    let progress = loop {
        match store.poll() {
            Progress::None => {}
            end => break end,
        }
    };
    let mut flash = store.into_memory().0.into_flash();
    flash.power_up();
    (flash, progress)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// Wherever the power fails, also while pages change, either the old or the new calibration is stored.
    #[test]
    fn a_power_cut_leaves_the_old_calibration_or_the_new_one(
        before in 1u16..120,
        cut_after in 0u32..200,
        torn: u32,
    ) {
        let mut flash = RamFlash::blank();
        for number in 0..before {
            let (kept, progress) = keep(flash, &calibration(number), None, 1);
            prop_assert_eq!(progress, Progress::Done);
            flash = kept;
        }
        let old = calibration(before - 1);
        let (flash, progress) = keep(flash, &calibration(before), Some(cut_after), torn);
        let now = stored(&flash);
        prop_assert!(now == Some(old) || now == Some(calibration(before)), "{:?}", now);
        if progress == Progress::Done {
            prop_assert_eq!(now, Some(calibration(before)));
        }
        // And the next calibration is stored.
        let (flash, progress) = keep(flash, &calibration(before + 1), None, 1);
        prop_assert_eq!(progress, Progress::Done);
        prop_assert_eq!(stored(&flash), Some(calibration(before + 1)));
    }
}
