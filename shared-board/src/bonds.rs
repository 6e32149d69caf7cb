//! The laptops with which a board has bonded, and the log in flash that stores them.
//!
//! ```text
//! page + 0       magic, sequence number, its complement, one word left blank
//! page + 16 + 48 i   a record: keys, address, flags, CRC-32 (twelve words)
//! ```
//!
//! The log has two pages. New records are appended to the newer page.
//! If there are several records about a laptop, the last one is valid.
//! When the newer page is full, the valid records are copied to the other page.
//! The magic number of that page is written last.
//! The full page is kept until the next copy, so a power cut at any word does no harm.
//! All stored laptops then remain, and a new laptop is either stored or not.

use crate::models::MappedFlash;
use crate::pages::{self, Aligned, HEADER_BYTES, newest, word};
use shared_dsp::right::network::crc32;

/// Maximum number of stored laptops. A new laptop replaces the laptop that bonded longest ago.
pub const REMEMBERED: usize = 4;
/// Number of flash pages that a log occupies.
pub const PAGES: usize = pages::PAGES;

const MAGIC: u32 = u32::from_le_bytes(*b"BMB3");
const RECORD_BYTES: usize = 48;
const CRC_AT: usize = RECORD_BYTES - 4;

/// A bonded laptop, and the keys that it shares with the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bond {
    /// The long term key, which encrypts the link (little-endian).
    pub key: [u8; 16],
    /// The identity resolving key (little-endian), which recognises the laptop's changing address; zeros if the laptop sent none.
    pub resolving: [u8; 16],
    /// The laptop's own address (little-endian).
    pub address: [u8; 6],
    /// Whether the laptop's address is random. Otherwise, the manufacturer has assigned it.
    pub address_is_random: bool,
    /// Whether a person compared numbers during the pairing.
    pub authenticated: bool,
    /// Whether the laptop requests states whenever it is connected.
    /// A bonded laptop expects the board to remember this setting while it is away.
    pub listens: bool,
}

impl Bond {
    /// Returns whether this bond and `other` are with the same laptop.
    pub fn is_of_same_laptop(&self, other: &Self) -> bool {
        let same_address = self.address == other.address && self.address_is_random == other.address_is_random;
        same_address || (self.resolving != [0; 16] && self.resolving == other.resolving)
    }

    fn record(&self) -> [u8; RECORD_BYTES] {
        let mut record = [0; RECORD_BYTES];
        record[..16].copy_from_slice(&self.key);
        record[16..32].copy_from_slice(&self.resolving);
        record[32..38].copy_from_slice(&self.address);
        record[38] = self.address_is_random.into();
        record[39] = u8::from(self.listens) | u8::from(self.authenticated) << 1;
        let crc = crc32(&record[..CRC_AT]);
        record[CRC_AT..].copy_from_slice(&crc.to_le_bytes());
        record
    }

    /// Returns `None` if the record was not completely written.
    fn from_record(record: &[u8]) -> Option<Self> {
        let bytes = |at: usize| record.get(at..at + 16)?.try_into().ok();
        if word(record, CRC_AT) != Some(crc32(record.get(..CRC_AT)?)) {
            return None;
        }
        Some(Self {
            key: bytes(0)?,
            resolving: bytes(16)?,
            address: record.get(32..38)?.try_into().ok()?,
            address_is_random: record[38] & 1 != 0,
            listens: record[39] & 1 != 0,
            authenticated: record[39] & 2 != 0,
        })
    }
}

/// The stored laptops. The newest bond is the last one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Laptops([Option<Bond>; REMEMBERED]);

impl Laptops {
    /// All of them.
    pub fn iter(&self) -> impl Iterator<Item = &Bond> {
        self.0.iter().flatten()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.iter().next().is_none()
    }

    /// Returns whether this bond would replace a bond that was paired with a passkey by one that was not.
    /// A stranger can claim to be any laptop, and "just works" asks nobody.
    pub fn would_be_weakened_by(&self, bond: &Bond) -> bool {
        let stronger = |kept: &Bond| kept.authenticated && kept.is_of_same_laptop(bond);
        !bond.authenticated && self.iter().any(stronger)
    }

    /// Stores a laptop as the newest bond.
    /// The bond replaces the laptop's earlier bond, or the oldest bond if there is no room.
    pub fn keep(&mut self, bond: Bond) {
        let same = self.0.iter().position(|kept| kept.is_some_and(|kept| kept.is_of_same_laptop(&bond)));
        let free = self.0.iter().position(Option::is_none);
        let place = same.or(free).unwrap_or(0);
        // The bonds after the removed bond move up, so that blank places remain at the end.
        let used = free.unwrap_or(REMEMBERED);
        let end = if same.is_none() && free.is_some() { used + 1 } else { used };
        self.0[place..end].rotate_left(1);
        self.0[end - 1] = Some(bond);
    }
}

/// The flash could not store a bond.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotKept;

/// Stores laptops in two pages of flash.
#[derive(Clone, Debug)]
pub struct BondLog<F> {
    flash: F,
    laptops: Laptops,
}

impl<F: MappedFlash> BondLog<F> {
    /// Reads the stored laptops. The log occupies the flash's first [`PAGES`] pages.
    pub fn open(flash: F) -> Self {
        let laptops =
            newest(flash.mapped(), F::ERASE_SIZE, MAGIC).map_or(Laptops::default(), |(_, page)| read(page));
        Self { flash, laptops }
    }

    /// The laptops that are stored in flash.
    pub fn laptops(&self) -> Laptops {
        self.laptops
    }

    /// Returns the flash, for the board's next start.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Stores this laptop. If exactly the same bond is already stored, nothing is written.
    ///
    /// # Errors
    /// Fails if the flash could not store the bond. The bonds that were stored before remain.
    pub async fn keep(&mut self, bond: Bond) -> Result<(), NotKept> {
        if self.laptops.iter().any(|kept| *kept == bond) {
            return Ok(());
        }
        let mut laptops = self.laptops;
        laptops.keep(bond);
        match self.room() {
            Some(at) => self.write_record(at, &bond).await?,
            None => self.start_page(&laptops).await?,
        }
        self.laptops = laptops;
        Ok(())
    }

    /// Returns the place of the next record in the newest page, if there is room.
    /// This place follows the last record, even if that record is incomplete.
    fn room(&self) -> Option<usize> {
        let (start, page) = newest(self.flash.mapped(), F::ERASE_SIZE, MAGIC)?;
        let records = page.get(HEADER_BYTES..)?.chunks_exact(RECORD_BYTES);
        let total = records.len();
        let used = records.rev().position(|record| record.iter().any(|&b| b != 0xFF));
        let free = used.map_or(0, |blanks| total - blanks);
        (free < total).then_some(start + HEADER_BYTES + free * RECORD_BYTES)
    }

    /// Copies the valid records to the page that is not the newest.
    async fn start_page(&mut self, laptops: &Laptops) -> Result<(), NotKept> {
        let (start, sequence) = pages::erase_next(&mut self.flash, MAGIC).await.map_err(|_| NotKept)?;
        for (i, bond) in laptops.iter().enumerate() {
            self.write_record(start + HEADER_BYTES + i * RECORD_BYTES, bond).await?;
        }
        pages::finish(&mut self.flash, start, sequence, MAGIC).await.map_err(|_| NotKept)?;
        match newest(self.flash.mapped(), F::ERASE_SIZE, MAGIC) {
            Some((at, bytes)) if at == start && read(bytes) == *laptops => Ok(()),
            _ => Err(NotKept),
        }
    }

    async fn write_record(&mut self, at: usize, bond: &Bond) -> Result<(), NotKept> {
        let record = Aligned(bond.record());
        self.flash.write(at as u32, &record.0).await.map_err(|_| NotKept)?;
        let written = self.flash.mapped().get(at..at + RECORD_BYTES);
        if written == Some(&record.0[..]) { Ok(()) } else { Err(NotKept) }
    }
}

fn read(page: &[u8]) -> Laptops {
    let mut laptops = Laptops::default();
    for record in page.get(HEADER_BYTES..).unwrap_or_default().chunks_exact(RECORD_BYTES) {
        if let Some(bond) = Bond::from_record(record) {
            laptops.keep(bond);
        }
    }
    laptops
}
