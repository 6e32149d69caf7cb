//! Receives a model from the laptop and stores it in flash.
//!
//! ```text
//! Begin -> Started ... Ok(0) -> Chunk -> Ok(next) ... Chunk -> Ok(size) -> Commit -> Ok
//! ```
//!
//! A piece at an unexpected offset is refused, and the answer contains the expected offset.
//! A laptop that missed an acknowledgement continues at that offset. A new `Begin` starts again from the beginning.
//! A transfer always uses the inactive slot, so no failure can damage the running model.

use crate::slots::{BLOB_MAX, Content, HEADER_BYTES, MAGIC, SLOT_BYTES, Slot, is_newer, look};
use crate::{FrameOut, send};
use embedded_storage_async::nor_flash::NorFlash;
use shared_dsp::right::features::{HOP, WINDOW};
use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::{Model, crc32};
use shared_proto::message::{Ack, AckResult, BoardBody, HostMessage, MODEL_CHUNK_MAX, ModelBegin, ModelInfo};

/// NOR flash that can also be read like memory, as in a microcontroller.
///
/// The store uses the first [`STORE_BYTES`](crate::slots::STORE_BYTES).
/// The length of a write is a multiple of four bytes, and its address and its source are aligned to four.
pub trait MappedFlash: NorFlash {
    /// Returns all bytes of the flash.
    fn mapped(&self) -> &[u8];
}

/// A message about models.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ModelRequest<'r> {
    /// Announces a model.
    Begin(ModelBegin<'r>),
    /// Contains a piece of the model.
    Chunk {
        /// The answer repeats this number.
        request: u16,
        /// Offset of the data in the blob, in bytes.
        offset: u32,
        /// The piece.
        data: &'r [u8],
    },
    /// All pieces were sent, so the board must verify and store the model.
    Commit {
        /// The answer repeats this number.
        request: u16,
        /// CRC-32 of the complete model.
        crc32: u32,
    },
    /// Announces a new image for the board. Its pieces follow in the same way as those of a model.
    /// An [`ImageStore`](crate::images::ImageStore) answers this request.
    Image {
        /// The answer repeats this number.
        request: u16,
        /// Size of the file in bytes.
        size: u32,
        /// CRC-32 of the file.
        crc32: u32,
    },
    /// Asks whether this image is running. An [`ImageStore`](crate::images::ImageStore) answers this request.
    Confirm {
        /// The answer repeats this number.
        request: u16,
        /// CRC-32 of the file.
        crc32: u32,
    },
}

impl<'r> ModelRequest<'r> {
    /// Returns the request in a laptop's message, if the message is about models or images.
    pub fn of(message: &HostMessage<'r>) -> Option<Self> {
        Some(match *message {
            HostMessage::ModelBegin(begin) => Self::Begin(begin),
            HostMessage::ModelChunk { request, offset, data } => {
                Self::Chunk { request, offset, data: data.0 }
            }
            HostMessage::ModelCommit { request, crc32 } => Self::Commit { request, crc32 },
            HostMessage::ImageBegin { request, size, crc32 } => Self::Image { request, size, crc32 },
            HostMessage::ImageConfirm { request, crc32 } => Self::Confirm { request, crc32 },
            _ => return None,
        })
    }

    /// Answers requests for a board that stores no models.
    pub fn refuse(&self, out: &mut impl FrameOut) {
        let (Self::Begin(ModelBegin { request, .. })
        | Self::Chunk { request, .. }
        | Self::Commit { request, .. }
        | Self::Image { request, .. }
        | Self::Confirm { request, .. }) = *self;
        acknowledge(request, AckResult::Unsupported, 0, out);
    }
}

/// The models that an image can run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Runs {
    /// Number of values per sample of the sensor. A model may read fewer.
    pub axes: u8,
    /// Samples per second.
    pub sample_hz: u16,
}

impl Runs {
    /// Returns whether a model with these requirements can run.
    pub fn takes(self, needs: &ModelInfo<'_>) -> bool {
        FeatureKind::from_id(needs.recipe)
            .is_some_and(|recipe| recipe.runs_on(usize::from(needs.axes), usize::from(self.axes)))
            && needs.sample_hz == self.sample_hz
            && usize::from(needs.window) == WINDOW
    }

    /// Returns whether this blob is a model that can run.
    pub fn takes_blob(self, blob: &[u8]) -> bool {
        Model::parse(blob).is_ok_and(|model| {
            let info = model.info();
            self.takes(&crate::hand::model_info_on_the_wire(info)) && usize::from(info.hop) == HOP
        })
    }
}

/// A stored model that this image can run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StoredModel {
    /// The slot in which the model is stored.
    pub slot: Slot,
    /// Length of the model's blob in bytes.
    pub len: usize,
}

impl StoredModel {
    /// Returns where the blob begins in the store, in bytes.
    pub const fn offset(self) -> usize {
        self.slot.offset() + HEADER_BYTES
    }
}

/// The contents of the store when the board starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Found {
    /// The newest valid model that this image can run.
    pub model: Option<StoredModel>,
    /// Whether a slot contains damaged data, or a model that cannot run on this image.
    pub damaged: bool,
}

#[derive(Clone, Copy, Debug)]
struct Transfer {
    slot: Slot,
    size: u32,
    model_id: u32,
    next: u32,
}

/// Receives one model at a time into the inactive slot.
#[derive(Clone, Debug)]
pub struct ModelStore<F> {
    flash: F,
    runs: Runs,
    running: Option<Slot>,
    transfer: Option<Transfer>,
}

impl<F: MappedFlash> ModelStore<F> {
    /// Searches for the model to run. The caller runs the result, or the compiled-in model if there is none.
    pub fn open(flash: F, runs: Runs) -> (Self, Found) {
        let mut found = Found { model: None, damaged: false };
        let mut newest = 0;
        for slot in Slot::ALL {
            match look(flash.mapped(), slot) {
                Content::Empty => {}
                Content::Blob { blob, sequence } if runs.takes_blob(blob) => {
                    if found.model.is_none() || is_newer(sequence, newest) {
                        newest = sequence;
                        found.model = Some(StoredModel { slot, len: blob.len() });
                    }
                }
                Content::Blob { .. } | Content::Damaged => found.damaged = true,
            }
        }
        (Self { flash, runs, running: found.model.map(|place| place.slot), transfer: None }, found)
    }

    /// Sets the number of axes that the driver has detected. Models received later must be able to run with them.
    pub fn set_axes(&mut self, axes: u8) {
        self.runs.axes = axes;
    }

    /// Returns the flash.
    pub fn flash(&self) -> &F {
        &self.flash
    }

    /// Returns the flash, for use at the board's next start.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Executes a request and answers it.
    /// After this function has erased a page, it calls `pause`.
    /// During this pause, a board reads the samples that its sensor stored while the page was erased.
    pub async fn answer(
        &mut self,
        request: &ModelRequest<'_>,
        pause: impl AsyncFnMut(),
        out: &mut impl FrameOut,
    ) {
        let (request, result) = match *request {
            ModelRequest::Begin(begin) => (begin.request, self.begin(&begin, pause, out).await),
            ModelRequest::Chunk { request, offset, data } => (request, self.chunk(offset, data).await),
            ModelRequest::Commit { request, crc32 } => (request, self.commit(crc32).await),
            // This board does not support image updates.
            ModelRequest::Image { .. } | ModelRequest::Confirm { .. } => return request.refuse(out),
        };
        acknowledge(request, result, self.transfer.map_or(0, |t| t.next), out);
    }

    /// Refuses a model that this image cannot run, or erases its slot.
    async fn begin(
        &mut self,
        begin: &ModelBegin<'_>,
        mut pause: impl AsyncFnMut(),
        out: &mut impl FrameOut,
    ) -> AckResult {
        self.transfer = None;
        let fits = self.runs.takes(&begin.info)
            && begin.scaling == ModelBegin::DATA_SHEET_SCALING
            && (1..=BLOB_MAX).contains(&(begin.size as usize));
        if !fits {
            return AckResult::ModelDoesNotFit;
        }
        acknowledge(begin.request, AckResult::Started, 0, out);
        let slot = self.target();
        for page in (slot.offset()..slot.offset() + SLOT_BYTES).step_by(F::ERASE_SIZE) {
            if self.flash.erase(page as u32, (page + F::ERASE_SIZE) as u32).await.is_err() {
                return AckResult::StorageFailed;
            }
            pause().await;
        }
        self.transfer = Some(Transfer { slot, size: begin.size, model_id: begin.info.model_id, next: 0 });
        AckResult::Ok
    }

    async fn chunk(&mut self, offset: u32, data: &[u8]) -> AckResult {
        let Some(transfer) = &mut self.transfer else { return AckResult::WrongOffset };
        if offset != transfer.next {
            return AckResult::WrongOffset;
        }
        let end = u64::from(offset) + data.len() as u64;
        let is_last = end == u64::from(transfer.size);
        if data.is_empty() || end > u64::from(transfer.size) || (!data.len().is_multiple_of(4) && !is_last) {
            return AckResult::OutOfRange;
        }
        // The last piece is padded with bits of value 1, which have no effect in flash.
        let mut aligned = Aligned([0xFF; MODEL_CHUNK_MAX]);
        let Some(place) = aligned.0.get_mut(..data.len()) else { return AckResult::OutOfRange };
        place.copy_from_slice(data);
        let words = &aligned.0[..data.len().next_multiple_of(4)];
        let at = transfer.slot.offset() + HEADER_BYTES + offset as usize;
        if self.flash.write(at as u32, words).await.is_err() {
            // A word of flash cannot be written twice, so the transfer must start again.
            self.transfer = None;
            return AckResult::StorageFailed;
        }
        transfer.next = end as u32;
        AckResult::Ok
    }

    /// Stores the model if it is complete, matches the announcement and can run.
    async fn commit(&mut self, crc: u32) -> AckResult {
        let Some(transfer) = self.transfer.filter(|t| t.next == t.size) else {
            return AckResult::WrongOffset;
        };
        let start = transfer.slot.offset() + HEADER_BYTES;
        let blob = self.flash.mapped().get(start..start + transfer.size as usize).unwrap_or_default();
        let result = if crc != transfer.model_id || crc32(blob) != crc {
            AckResult::BadChecksum
        } else if !self.runs.takes_blob(blob) {
            AckResult::ModelDoesNotFit
        } else if self.validate(&transfer, crc).await.is_err() {
            AckResult::StorageFailed
        } else {
            AckResult::Ok
        };
        self.transfer = None;
        result
    }

    /// Makes the written blob valid, so that the board uses it after its next start.
    async fn validate(&mut self, transfer: &Transfer, crc: u32) -> Result<(), ()> {
        let mut newest = None;
        for slot in Slot::ALL {
            if let Content::Blob { sequence, .. } = look(self.flash.mapped(), slot)
                && newest.is_none_or(|newest| is_newer(sequence, newest))
            {
                newest = Some(sequence);
            }
        }
        let sequence = newest.map_or(1, |newest| newest.wrapping_add(1));
        let mut words = Aligned([0; HEADER_BYTES]);
        for (place, word) in words.0.chunks_exact_mut(4).zip([MAGIC, transfer.size, crc, sequence]) {
            place.copy_from_slice(&word.to_le_bytes());
        }
        // The magic number is written last, because without it the slot counts as empty.
        let at = transfer.slot.offset() as u32;
        self.flash.write(at + 4, &words.0[4..]).await.map_err(drop)?;
        self.flash.write(at, &words.0[..4]).await.map_err(drop)?;
        match look(self.flash.mapped(), transfer.slot) {
            Content::Blob { .. } => Ok(()),
            Content::Empty | Content::Damaged => Err(()),
        }
    }

    /// Returns the slot that a transfer uses.
    fn target(&self) -> Slot {
        if let Some(running) = self.running {
            return running.other();
        }
        // If the compiled-in model runs, the newer of the stored models is preserved.
        let [a, b] = Slot::ALL.map(|slot| look(self.flash.mapped(), slot));
        match (a, b) {
            (Content::Blob { sequence: a, .. }, Content::Blob { sequence: b, .. }) if is_newer(a, b) => {
                Slot::B
            }
            (Content::Blob { .. }, Content::Blob { .. }) => Slot::A,
            (Content::Blob { .. }, _) => Slot::B,
            _ => Slot::A,
        }
    }
}

/// A buffer aligned for flash controllers, which accept only complete words.
#[repr(align(4))]
pub(crate) struct Aligned<const N: usize>(pub(crate) [u8; N]);

pub(crate) fn acknowledge(request: u16, result: AckResult, next_offset: u32, out: &mut impl FrameOut) {
    send::<{ Ack::FRAME_MAX }>(&Ack { request, result, next_offset }, out);
}
