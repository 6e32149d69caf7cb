//! Firmware updates: the flash layout of the board, the file format of a new image, and the state of an update.
//!
//! ```text
//! base             second stage, which updates never change
//! base +  0x6000   slot A: the image that runs
//! base + 0x46000   slot B: one spare page and the other image
//! base + 0x87000   journal: the request, and the progress of the second stage
//! ```
//!
//! A new image is stored in slot B after the spare page.
//! The second stage exchanges the images page by page ([`crate::swap`]).
//! After this exchange, slot B contains the old image at its start and the spare page at its end.

use shared_dsp::right::network::crc32;

/// Bytes per erasable page.
pub const PAGE_BYTES: u32 = 0x1000;
/// Bytes that the second stage may occupy.
pub const STAGE_BYTES: u32 = 0x6000;
/// Maximum size of an image in bytes, including its [trailer](Trailer) and signature.
pub const IMAGE_MAX: u32 = 0x4_0000;
/// Offset of slot A from the base.
pub const SLOT_A: u32 = STAGE_BYTES;
/// Offset of slot B from the base.
pub const SLOT_B: u32 = SLOT_A + IMAGE_MAX;
/// Offset of a new image from the start of slot B.
pub const NEW_IMAGE: u32 = PAGE_BYTES;
/// Offset of the journal from the base.
pub const JOURNAL: u32 = SLOT_B + IMAGE_MAX + PAGE_BYTES;
/// Offset of the first byte after all these areas.
pub const END: u32 = JOURNAL + PAGE_BYTES;

/// Size of the public key in bytes. The key is the last part of the second stage.
pub const KEY_BYTES: usize = 32;
/// Offset of the public key from the base.
/// If the flash is blank there, the board accepts no updates over Bluetooth.
pub const KEY_AT: u32 = STAGE_BYTES - KEY_BYTES as u32;

/// Size of a signature in bytes. The signature is the last part of an image file.
pub const SIGNATURE_BYTES: usize = 64;
/// Number of bytes in an image file after the linked image.
pub const TAIL_BYTES: usize = TRAILER_BYTES + SIGNATURE_BYTES;

const TRAILER_BYTES: usize = 32;
const VERSION_BYTES: usize = 16;
const TRAILER_MAGIC: [u8; 4] = *b"BMUP";

/// The description of an image. In an image file, it is between the linked image and the signature.
///
/// ```text
/// 0 magic  4 origin  8 board  12 version (16 bytes)  28 CRC-32 of all bytes before it
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trailer {
    /// The address for which the image is linked.
    pub origin: u32,
    /// The number by which the protocol identifies the board.
    pub board: u8,
    /// The version as text, padded with zeros.
    pub version: [u8; VERSION_BYTES],
}

/// The reason why some bytes are not a valid image file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NotAnImage {
    /// An image file cannot have this length.
    Length,
    /// The description is missing.
    Kind,
    /// The checksum differs.
    Damaged,
}

impl Trailer {
    /// Reads the description at the end of an image file, and checks the file's checksum.
    ///
    /// # Errors
    /// Fails if the file is not an image or is damaged. This function does not check the signature.
    pub fn read(file: &[u8]) -> Result<Self, NotAnImage> {
        let whole =
            file.len() > TAIL_BYTES && file.len() <= IMAGE_MAX as usize && file.len().is_multiple_of(4);
        let start = file.len().checked_sub(TAIL_BYTES).filter(|_| whole).ok_or(NotAnImage::Length)?;
        let word =
            |at: usize| file.get(at..at + 4).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        if word(start) != u32::from_le_bytes(TRAILER_MAGIC) {
            return Err(NotAnImage::Kind);
        }
        let crc_at = start + TRAILER_BYTES - 4;
        if crc32(&file[..crc_at]) != word(crc_at) {
            return Err(NotAnImage::Damaged);
        }
        let mut version = [0; VERSION_BYTES];
        version.copy_from_slice(&file[start + 12..start + 12 + VERSION_BYTES]);
        Ok(Self { origin: word(start + 4), board: word(start + 8) as u8, version })
    }

    /// Returns the version without its padding.
    pub fn version(&self) -> &str {
        let len = self.version.iter().position(|&byte| byte == 0).unwrap_or(VERSION_BYTES);
        core::str::from_utf8(&self.version[..len]).unwrap_or("?")
    }

    /// Creates the file for a linked image, with space for a signature.
    #[cfg(any(test, feature = "host"))]
    pub fn file(&self, image: &[u8]) -> std::vec::Vec<u8> {
        let mut file = image.to_vec();
        file.resize(image.len().next_multiple_of(4), 0xFF);
        file.extend(TRAILER_MAGIC);
        file.extend(self.origin.to_le_bytes());
        file.extend(u32::from(self.board).to_le_bytes());
        file.extend(self.version);
        file.extend(crc32(&file).to_le_bytes());
        file.extend([0; SIGNATURE_BYTES]);
        file
    }
}

/// The connection over which an image arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// A USB cable. Anyone who can plug in a cable can also press reset twice, so no signature is needed.
    Cable,
    /// Bluetooth. The second stage refuses an image without a valid signature.
    Air,
}

/// Numbers and values of the journal's words.
pub(crate) mod word {
    /// The magic number, which the running image writes last.
    pub const MAGIC: u32 = 0;
    /// Size of the new file in bytes.
    pub const SIZE: u32 = 1;
    /// CRC-32 of the new file.
    pub const CRC: u32 = 2;
    /// The source of the file: [`CABLE`], or Bluetooth for any other value.
    pub const SOURCE: u32 = 3;
    /// Mark: the second stage has refused the image.
    pub const REFUSED: u32 = 8;
    /// Mark: the new image has been started.
    pub const TRIED: u32 = 9;
    /// Mark: the new image has said hello.
    pub const CONFIRMED: u32 = 10;
    /// The second stage has restored the old image.
    pub const WENT_BACK: u32 = 11;
    /// The first mark of the exchange, which makes two marks for each page.
    pub const FORTH: u32 = 16;
    /// Value of [`MAGIC`].
    pub const REQUESTED: u32 = u32::from_le_bytes(*b"BMJ1");
    /// Value of [`SOURCE`] for a cable.
    pub const CABLE: u32 = 0x600D_CAB1;
    /// Value of [`SOURCE`] for Bluetooth.
    pub const AIR: u32 = 0;
    /// Value of a mark that has not been made.
    pub const BLANK: u32 = u32::MAX;
}

/// The update that the journal requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// Size of the new file in bytes.
    pub size: u32,
    /// CRC-32 of the complete file.
    pub crc32: u32,
    /// The connection over which the file arrived.
    pub source: Source,
}

/// The progress of an update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// The new image is waiting for the exchange, or the exchange is in progress.
    Waiting,
    /// The second stage has refused the new image, and the old image is running.
    Refused,
    /// The new image is running, but has not said hello yet.
    OnTrial,
    /// The new image is running, and is permanent.
    Confirmed,
    /// The second stage has restored the old image.
    WentBack,
}

/// Reads a journal whose words `word` returns. The result is `None` if no update was requested.
pub fn read_journal(word: impl Fn(u32) -> u32) -> Option<(Request, Progress)> {
    if word(self::word::MAGIC) != self::word::REQUESTED {
        return None;
    }
    let source = if word(self::word::SOURCE) == self::word::CABLE { Source::Cable } else { Source::Air };
    let request = Request { size: word(self::word::SIZE), crc32: word(self::word::CRC), source };
    let is_set = |mark: u32| word(mark) != self::word::BLANK;
    let progress = if is_set(self::word::REFUSED) {
        Progress::Refused
    } else if is_set(self::word::WENT_BACK) {
        Progress::WentBack
    } else if is_set(self::word::CONFIRMED) {
        Progress::Confirmed
    } else if is_set(self::word::TRIED) {
        Progress::OnTrial
    } else {
        Progress::Waiting
    };
    Some((request, progress))
}
