//! Where received models live: two slots of 16 KB at the end of the image's flash.
//!
//! ```text
//! slot + 0   magic, length, CRC-32 of the blob, sequence number (four little-endian words)
//! slot + 16  the blob
//! ```
//!
//! The four words are written last, after the blob has been read back and its CRC has been checked, so
//! a transfer that breaks anywhere leaves a slot that counts as empty. The valid slot with the highest
//! sequence number is used at start. The model that runs is never overwritten: a transfer goes to the
//! other slot.

use shared_dsp::mlp::{Model, crc32};

/// Start of the slots; the layouts in `src/boards` end the image's flash here.
pub const SLOTS_START: u32 = 0x000D_8000;
/// The page before them holds the keys of the laptop that bonded last.
#[cfg(feature = "ble")]
pub const BOND_PAGE: u32 = SLOTS_START - PAGE_BYTES;
/// Bytes per slot.
pub const SLOT_BYTES: u32 = 0x4000;
/// Bytes per erasable page.
pub const PAGE_BYTES: u32 = 0x1000;
/// Longest blob.
pub const BLOB_MAX: usize = SLOT_BYTES as usize - HEADER_BYTES;
const HEADER_BYTES: usize = 16;
const MAGIC: u32 = u32::from_le_bytes(*b"BMS1");

/// The flash did not take the data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FlashFailed;

/// What the storage needs of the flash controller.
pub trait Flash {
    /// Sets a page to all ones.
    async fn erase_page(&mut self, address: u32) -> Result<(), FlashFailed>;
    /// Writes words to erased flash. The address is a multiple of 4.
    async fn write(&mut self, address: u32, words: &[u32]) -> Result<(), FlashFailed>;
}

/// One of the two slots.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum Slot {
    /// The one at the lower address.
    A,
    /// The other.
    B,
}

impl Slot {
    fn address(self) -> u32 {
        match self {
            Slot::A => SLOTS_START,
            Slot::B => SLOTS_START + SLOT_BYTES,
        }
    }

    fn bytes(self) -> &'static [u8] {
        // SAFETY: memory-mapped flash that the linker gives to nobody. It changes only through
        // `Flash`, and no reference into a slot is held while that slot is written (see `Store`).
        unsafe { core::slice::from_raw_parts(self.address() as *const u8, SLOT_BYTES as usize) }
    }

    fn word(self, index: usize) -> u32 {
        let b = &self.bytes()[index * 4..index * 4 + 4];
        u32::from_le_bytes([b[0], b[1], b[2], b[3]])
    }

    /// The blob and its sequence number; an error where something is there but damaged.
    fn read(self) -> Result<Option<(&'static [u8], u32)>, ()> {
        if self.word(0) == u32::MAX {
            return Ok(None);
        }
        let len = self.word(1) as usize;
        if self.word(0) != MAGIC || len > BLOB_MAX {
            return Err(());
        }
        let blob = &self.bytes()[HEADER_BYTES..HEADER_BYTES + len];
        if crc32(blob) == self.word(2) { Ok(Some((blob, self.word(3)))) } else { Err(()) }
    }
}

/// What was found at start.
pub struct Found {
    /// The newest intact model that this image can run.
    pub model: Option<(Slot, &'static [u8])>,
    /// A slot holds something damaged, or a model that this image cannot run.
    pub damaged: bool,
}

/// Looks for the model to run. `fits` says whether this image can run it.
pub fn find(fits: impl Fn(&Model<'static>) -> bool) -> Found {
    let mut found = Found { model: None, damaged: false };
    let mut newest = 0;
    for slot in [Slot::A, Slot::B] {
        match slot.read() {
            Ok(None) => {}
            Ok(Some((blob, sequence))) if Model::parse(blob).is_ok_and(|m| fits(&m)) => {
                if found.model.is_none() || sequence > newest {
                    newest = sequence;
                    found.model = Some((slot, blob));
                }
            }
            _ => found.damaged = true,
        }
    }
    found
}

/// Receives one model at a time into the slot that is not in use.
pub struct Store<F> {
    flash: F,
    running: Option<Slot>,
}

impl<F: Flash> Store<F> {
    /// A store; `running` is the slot whose model runs.
    pub fn new(flash: F, running: Option<Slot>) -> Self {
        Self { flash, running }
    }

    fn target(&self) -> Slot {
        match self.running {
            Some(Slot::A) => Slot::B,
            Some(Slot::B) => Slot::A,
            // The compiled-in model runs: keep the newer one, whatever it is.
            None => match (Slot::A.read(), Slot::B.read()) {
                (Ok(Some((_, a))), Ok(Some((_, b)))) => {
                    if a > b {
                        Slot::B
                    } else {
                        Slot::A
                    }
                }
                (Ok(Some(_)), _) => Slot::B,
                _ => Slot::A,
            },
        }
    }

    /// Empties the slot, page by page with a pause, in which the sensor's FIFO is fetched.
    pub async fn begin(&mut self, pause: impl AsyncFn()) -> Result<(), FlashFailed> {
        let start = self.target().address();
        for page in 0..SLOT_BYTES / PAGE_BYTES {
            self.flash.erase_page(start + page * PAGE_BYTES).await?;
            pause().await;
        }
        Ok(())
    }

    /// Writes a piece. The offset is a multiple of 4; a last piece is padded with ones.
    pub async fn write(&mut self, offset: u32, data: &[u8]) -> Result<(), FlashFailed> {
        let mut words = [u32::MAX; shared_proto::message::MODEL_CHUNK_MAX / 4 + 1];
        let mut used = 0;
        for piece in data.chunks(4) {
            let mut word = [0xFF; 4];
            word[..piece.len()].copy_from_slice(piece);
            words[used] = u32::from_le_bytes(word);
            used += 1;
        }
        let address = self.target().address() + HEADER_BYTES as u32 + offset;
        self.flash.write(address, &words[..used]).await
    }

    /// The blob as it stands in flash.
    pub fn written(&self, len: usize) -> &'static [u8] {
        &self.target().bytes()[HEADER_BYTES..HEADER_BYTES + len.min(BLOB_MAX)]
    }

    /// Makes the written blob valid: from the next start on it is used.
    pub async fn commit(&mut self, len: u32, crc: u32) -> Result<(), FlashFailed> {
        let sequence = [Slot::A, Slot::B]
            .into_iter()
            .filter_map(|s| s.read().ok().flatten())
            .map(|(_, sequence)| sequence)
            .max()
            .map_or(1, |s| s.wrapping_add(1));
        let slot = self.target();
        self.flash.write(slot.address(), &[MAGIC, len, crc, sequence]).await?;
        if matches!(slot.read(), Ok(Some(_))) { Ok(()) } else { Err(FlashFailed) }
    }
}
