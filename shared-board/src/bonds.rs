//! The laptops that a board has bonded with, and the log in flash that remembers them.
//!
//! ```text
//! page + 0       magic, sequence number, its complement, one word left blank
//! page + 16 + 48 i   a record: keys, address, flags, CRC-32 (twelve words)
//! ```
//!
//! There are two pages. Records are appended to the newer one, and the last record about a laptop counts. When it is full, what
//! counts is copied to the other page, whose magic is written last; the full page stays until the next time. So power may fail at any
//! word: what was remembered before is remembered, and the laptop that was being written is remembered or not.

use crate::models::MappedFlash;
use crate::slots::is_newer;
use shared_dsp::right::network::crc32;

/// Laptops that are remembered. The one that bonded longest ago makes room for another.
pub const REMEMBERED: usize = 4;
/// Pages of flash that a log takes.
pub const PAGES: usize = 2;

const MAGIC: u32 = u32::from_le_bytes(*b"BMB3");
const HEADER_BYTES: usize = 16;
const RECORD_BYTES: usize = 48;
const CRC_AT: usize = RECORD_BYTES - 4;

/// A laptop and the keys that board and laptop share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bond {
    /// Encrypts the link (the long term key, little-endian).
    pub key: [u8; 16],
    /// Tells whose changing address an address is (the identity resolving key, little-endian); zeros if the laptop gave none.
    pub resolving: [u8; 16],
    /// The laptop's own address, little-endian.
    pub address: [u8; 6],
    /// The address is a random one, not one that was bought.
    pub address_is_random: bool,
    /// Somebody compared numbers while pairing.
    pub authenticated: bool,
    /// It wants states whenever it is connected. A bonded laptop may rely on that after an absence.
    pub listens: bool,
}

impl Bond {
    /// Whether both are about one laptop.
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

    /// None if the record was not finished.
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

/// The laptops that are remembered, the newest bond last.
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

    /// Remembers a laptop as the newest, in place of what was known of it, or of the oldest if there is no room.
    pub fn keep(&mut self, bond: Bond) {
        let same = self.0.iter().position(|kept| kept.is_some_and(|kept| kept.is_of_same_laptop(&bond)));
        let free = self.0.iter().position(Option::is_none);
        let place = same.or(free).unwrap_or(0);
        // Those behind it move up; blanks stay at the end.
        let used = free.unwrap_or(REMEMBERED);
        let end = if same.is_none() && free.is_some() { used + 1 } else { used };
        self.0[place..end].rotate_left(1);
        self.0[end - 1] = Some(bond);
    }
}

/// The flash did not take a bond.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotKept;

/// Remembers laptops in two pages of flash.
#[derive(Clone, Debug)]
pub struct BondLog<F> {
    flash: F,
    laptops: Laptops,
}

impl<F: MappedFlash> BondLog<F> {
    /// Reads what is remembered. The flash's first [`PAGES`] pages are the log's.
    pub fn open(flash: F) -> Self {
        let laptops =
            newest(flash.mapped(), F::ERASE_SIZE).map_or(Laptops::default(), |(_, page)| read(page));
        Self { flash, laptops }
    }

    /// The laptops that flash remembers.
    pub fn laptops(&self) -> Laptops {
        self.laptops
    }

    /// The flash, for the board's next start.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Remembers this laptop. Nothing is written if it is remembered just so.
    ///
    /// # Errors
    /// If the flash did not take it; what was remembered before still is.
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

    /// Where the next record of the newest page goes, if it has room: behind the last one, torn ones included.
    fn room(&self) -> Option<usize> {
        let (start, page) = newest(self.flash.mapped(), F::ERASE_SIZE)?;
        let records = page.get(HEADER_BYTES..)?.chunks_exact(RECORD_BYTES);
        let total = records.len();
        let used = records.rev().position(|record| record.iter().any(|&b| b != 0xFF));
        let free = used.map_or(0, |blanks| total - blanks);
        (free < total).then_some(start + HEADER_BYTES + free * RECORD_BYTES)
    }

    /// Copies what counts to the page that is not the newest.
    async fn start_page(&mut self, laptops: &Laptops) -> Result<(), NotKept> {
        let page = F::ERASE_SIZE;
        let (start, sequence) = match newest(self.flash.mapped(), page) {
            Some((0, bytes)) => (page, word(bytes, 4).unwrap_or(0).wrapping_add(1)),
            Some((_, bytes)) => (0, word(bytes, 4).unwrap_or(0).wrapping_add(1)),
            None => (0, 1),
        };
        self.flash.erase(start as u32, (start + page) as u32).await.map_err(|_| NotKept)?;
        for (i, bond) in laptops.iter().enumerate() {
            self.write_record(start + HEADER_BYTES + i * RECORD_BYTES, bond).await?;
        }
        let mut numbers = Aligned([0; 8]);
        numbers.0[..4].copy_from_slice(&sequence.to_le_bytes());
        numbers.0[4..].copy_from_slice(&(!sequence).to_le_bytes());
        self.flash.write(start as u32 + 4, &numbers.0).await.map_err(|_| NotKept)?;
        // From this word on the page counts.
        self.flash.write(start as u32, &Aligned(MAGIC.to_le_bytes()).0).await.map_err(|_| NotKept)?;
        match newest(self.flash.mapped(), page) {
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

/// The newest whole page and where it begins.
fn newest(store: &[u8], page_bytes: usize) -> Option<(usize, &[u8])> {
    let mut best: Option<(usize, &[u8], u32)> = None;
    for (i, page) in store.chunks_exact(page_bytes).take(PAGES).enumerate() {
        let (Some(MAGIC), Some(sequence), Some(complement)) = (word(page, 0), word(page, 4), word(page, 8))
        else {
            continue;
        };
        if sequence == !complement && best.is_none_or(|(.., best)| is_newer(sequence, best)) {
            best = Some((i * page_bytes, page, sequence));
        }
    }
    best.map(|(start, page, _)| (start, page))
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

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

/// Flash controllers take whole words.
#[repr(align(4))]
struct Aligned<const N: usize>([u8; N]);
