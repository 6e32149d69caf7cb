//! Stores the bytes of a small EEPROM in two pages of flash, for left boards whose chip has no EEPROM.
//!
//! ```text
//! page + 0       the header of `pages`
//! page + 16 + 4i one written byte: its address, the byte, and the complement of both
//! ```
//!
//! Each written byte is one word, and the last word about an address counts. An interrupted write leaves a word whose
//! halves are not complements of each other, because writing only clears bits. Such a word does not count.
//! When a page is full, the bytes are copied to the other page. A power cut therefore has the same effect as with a real
//! EEPROM: each byte is either written or not.

use crate::models::MappedFlash;
use crate::pages::{self, Aligned, HEADER_BYTES, newest, word};

/// Number of bytes that are stored.
pub const BYTES: usize = 128;
/// Number of flash pages that the log occupies.
pub const PAGES: usize = pages::PAGES;

const MAGIC: u32 = u32::from_le_bytes(*b"BME1");
const BLANK: u8 = 0xFF;

/// The flash did not store a byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotWritten;

/// The stored bytes and their flash.
#[derive(Clone, Debug)]
pub struct EepromLog<F> {
    flash: F,
    bytes: [u8; BYTES],
}

impl<F: MappedFlash> EepromLog<F> {
    /// Reads the stored bytes. The log occupies the flash's first [`PAGES`] pages. Bytes that were never written are 0xFF.
    pub fn open(flash: F) -> Self {
        let bytes =
            newest(flash.mapped(), F::ERASE_SIZE, MAGIC).map_or([BLANK; BYTES], |(_, page)| read(page));
        Self { flash, bytes }
    }

    /// The stored bytes.
    pub fn bytes(&self) -> &[u8; BYTES] {
        &self.bytes
    }

    /// Returns the flash, for the board's next start.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Stores a byte.
    ///
    /// # Errors
    /// If the address is too large, or if the flash did not store the byte. All other bytes remain as they were.
    pub async fn write(&mut self, address: u16, byte: u8) -> Result<(), NotWritten> {
        let place = self.bytes.get(usize::from(address)).ok_or(NotWritten)?;
        if *place == byte {
            return Ok(());
        }
        let mut bytes = self.bytes;
        bytes[usize::from(address)] = byte;
        match self.room() {
            Some(at) => self.append(at, address, byte).await?,
            None => self.start_page(&bytes).await?,
        }
        self.bytes = bytes;
        Ok(())
    }

    /// Returns the place of the next word in the newest page, if it has room. It is behind the last word, complete or not.
    fn room(&self) -> Option<usize> {
        let (start, page) = newest(self.flash.mapped(), F::ERASE_SIZE, MAGIC)?;
        let words = page.get(HEADER_BYTES..)?.chunks_exact(4);
        let total = words.len();
        let used = words.rev().position(|word| word.iter().any(|&b| b != BLANK));
        let free = used.map_or(0, |blanks| total - blanks);
        (free < total).then_some(start + HEADER_BYTES + 4 * free)
    }

    /// Copies the bytes to the page that is not the newest.
    async fn start_page(&mut self, bytes: &[u8; BYTES]) -> Result<(), NotWritten> {
        let (start, sequence) = pages::erase_next(&mut self.flash, MAGIC).await.map_err(|_| NotWritten)?;
        let mut at = start + HEADER_BYTES;
        for (address, &byte) in (0..).zip(bytes) {
            if byte != BLANK {
                self.append(at, address, byte).await?;
                at += 4;
            }
        }
        pages::finish(&mut self.flash, start, sequence, MAGIC).await.map_err(|_| NotWritten)?;
        match newest(self.flash.mapped(), F::ERASE_SIZE, MAGIC) {
            Some((at, page)) if at == start && read(page) == *bytes => Ok(()),
            _ => Err(NotWritten),
        }
    }

    async fn append(&mut self, at: usize, address: u16, byte: u8) -> Result<(), NotWritten> {
        let half = address | u16::from(byte) << 8;
        let full = u32::from(half) | u32::from(!half) << 16;
        self.flash.write(at as u32, &Aligned(full.to_le_bytes()).0).await.map_err(|_| NotWritten)?;
        if word(self.flash.mapped(), at) == Some(full) { Ok(()) } else { Err(NotWritten) }
    }
}

fn read(page: &[u8]) -> [u8; BYTES] {
    let mut bytes = [BLANK; BYTES];
    for word in page.get(HEADER_BYTES..).unwrap_or_default().chunks_exact(4) {
        if word[0] == !word[2]
            && word[1] == !word[3]
            && let Some(place) = bytes.get_mut(usize::from(word[0]))
        {
            *place = word[1];
        }
    }
    bytes
}
