//! Simulated EEPROM and NOR flash for tests on a laptop, including power cuts.

use crate::calibration_store::{CalibrationStore, Eeprom, Progress};
use crate::models::MappedFlash;
use crate::slots::STORE_BYTES;
use core::cell::Cell;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use shared_dsp::left::calibration::Calibration;
use std::vec;
use std::vec::Vec;

/// Runs a future that never waits, such as a [`ModelStore`](crate::models::ModelStore) with a [`RamFlash`].
///
/// # Panics
/// Panics if the future waits.
pub fn at_once<F: Future>(future: F) -> F::Output {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(outcome) => outcome,
        Poll::Pending => panic!("nothing waits for memory"),
    }
}

/// An EEPROM in RAM.
#[derive(Clone, Debug)]
pub struct RamEeprom {
    bytes: [u8; 128],
    /// Number of bytes written.
    pub writes: u32,
    /// Number of bytes that will still be stored before a power cut. All later writes are lost.
    pub writes_left: u32,
    /// Number of calls after a write for which `is_busy` returns true.
    pub busy_for: u32,
    busy: Cell<u32>,
}

impl RamEeprom {
    /// Creates an EEPROM that was never written.
    pub fn blank() -> Self {
        Self { bytes: [0xFF; 128], writes: 0, writes_left: u32::MAX, busy_for: 0, busy: Cell::new(0) }
    }

    /// Creates an EEPROM in which a board has stored this calibration.
    pub fn with(calibration: &Calibration) -> Self {
        let (mut store, _) = CalibrationStore::load(Self::blank());
        store.keep(calibration);
        while store.poll() == Progress::None {}
        store.into_memory()
    }

    /// Returns a byte, so that a test can damage it.
    pub fn byte_mut(&mut self, address: usize) -> &mut u8 {
        &mut self.bytes[address]
    }
}

impl Eeprom for RamEeprom {
    fn is_busy(&self) -> bool {
        let left = self.busy.get();
        self.busy.set(left.saturating_sub(1));
        left > 0
    }

    fn read(&self, address: u16) -> u8 {
        self.bytes.get(usize::from(address)).copied().unwrap_or(0xFF)
    }

    fn write(&mut self, address: u16, byte: u8) {
        self.writes += 1;
        self.busy.set(self.busy_for);
        if self.writes_left == 0 {
            return;
        }
        self.writes_left -= 1;
        if let Some(place) = self.bytes.get_mut(usize::from(address)) {
            *place = byte;
        }
    }
}

/// NOR flash in RAM. Writing clears bits, and erasing sets all bits of a page.
#[derive(Clone, Debug)]
pub struct RamFlash {
    bytes: Vec<u8>,
    /// Number of words that were written and pages that were erased.
    pub operations: u32,
    /// Number of operations until a power cut, which interrupts the last operation at any bit.
    /// Later operations have no effect.
    pub cut_after: Option<u32>,
    /// Selects the bits that an interrupted operation has already changed.
    pub torn: u32,
}

impl RamFlash {
    /// Erased flash.
    pub fn blank() -> Self {
        Self::of(STORE_BYTES)
    }

    /// Creates erased flash of this size.
    pub fn of(bytes: usize) -> Self {
        Self { bytes: vec![0xFF; bytes], operations: 0, cut_after: None, torn: 1 }
    }

    /// Restores the power.
    pub fn power_up(&mut self) {
        self.cut_after = None;
    }

    /// Returns a byte, so that a test can damage it.
    pub fn byte_mut(&mut self, offset: usize) -> &mut u8 {
        &mut self.bytes[offset]
    }

    fn random(&mut self) -> u8 {
        self.torn = self.torn.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.torn >> 24) as u8
    }

    /// Sets bytes to `new`. A power cut interrupts this after only some of their bits have changed.
    fn operate(&mut self, offset: usize, new: &[u8]) -> Result<(), NorFlashErrorKind> {
        let is_cut = match &mut self.cut_after {
            Some(0) => return Err(NorFlashErrorKind::Other),
            Some(left) => {
                *left -= 1;
                *left == 0
            }
            None => false,
        };
        self.operations += 1;
        for (i, &new) in new.iter().enumerate() {
            let reached = if is_cut { self.random() } else { 0xFF };
            let old = self.bytes[offset + i];
            self.bytes[offset + i] = (new & reached) | (old & !reached);
        }
        if is_cut { Err(NorFlashErrorKind::Other) } else { Ok(()) }
    }
}

impl ErrorType for RamFlash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for RamFlash {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        let start = offset as usize;
        let found = self.bytes.get(start..start + bytes.len()).ok_or(NorFlashErrorKind::OutOfBounds)?;
        bytes.copy_from_slice(found);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for RamFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 0x1000;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        if !from.is_multiple_of(0x1000) || !to.is_multiple_of(0x1000) {
            return Err(NorFlashErrorKind::NotAligned);
        }
        if from > to || to as usize > self.bytes.len() {
            return Err(NorFlashErrorKind::OutOfBounds);
        }
        (from..to).step_by(0x1000).try_for_each(|page| self.operate(page as usize, &[0xFF; 0x1000]))
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        let start = offset as usize;
        if !offset.is_multiple_of(4) || !bytes.len().is_multiple_of(4) || bytes.as_ptr().align_offset(4) != 0
        {
            return Err(NorFlashErrorKind::NotAligned);
        }
        let old = self.bytes.get(start..start + bytes.len()).ok_or(NorFlashErrorKind::OutOfBounds)?;
        // Only an erased page accepts arbitrary bytes.
        // Real flash would silently mix the old bytes with the new ones.
        assert!(old.iter().zip(bytes).all(|(old, new)| old & new == *new), "written without being erased");
        bytes.chunks(4).enumerate().try_for_each(|(i, word)| self.operate(start + 4 * i, word))
    }
}

impl MappedFlash for RamFlash {
    fn mapped(&self) -> &[u8] {
        &self.bytes
    }
}
