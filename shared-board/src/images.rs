//! Stores a new image from the laptop in slot B, and asks the second stage to install it.
//!
//! An image arrives in the same kind of pieces as a model.
//! Each page is erased when its first piece arrives.

use crate::FrameOut;
use crate::models::{Aligned, MappedFlash, ModelRequest, acknowledge};
use crate::update::{
    END, IMAGE_MAX, JOURNAL, NEW_IMAGE, PAGE_BYTES, Progress, SLOT_B, Source, read_journal, word,
};
use shared_dsp::right::network::crc32;
use shared_proto::message::{AckResult, MODEL_CHUNK_MAX};

/// Size in bytes of the flash that the store needs for slot B and the journal.
pub const STORE_BYTES: usize = (END - SLOT_B) as usize;
const JOURNAL_AT: u32 = JOURNAL - SLOT_B;

/// What the caller must do after a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Then {
    /// The request is not about images, so the model store must answer it.
    Pass,
    /// The caller need not do anything.
    Stay,
    /// Restart the board after the answer has been sent.
    Restart,
}

#[derive(Clone, Copy, Debug)]
struct Transfer {
    size: u32,
    crc32: u32,
    next: u32,
}

/// Receives one image at a time.
#[derive(Clone, Debug)]
pub struct ImageStore<F> {
    flash: F,
    transfer: Option<Transfer>,
}

impl<F: MappedFlash> ImageStore<F> {
    /// Creates the store. Offset 0 of `flash` is the start of slot B.
    pub fn new(flash: F) -> Self {
        Self { flash, transfer: None }
    }

    /// Returns the flash.
    pub fn flash(&self) -> &F {
        &self.flash
    }

    /// Returns the flash, so that it can be used again after a restart of the board.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Executes a request about an image and answers it. This function calls `pause` after it has erased a page.
    pub async fn answer(
        &mut self,
        request: &ModelRequest<'_>,
        source: Source,
        pause: impl AsyncFnMut(),
        out: &mut impl FrameOut,
    ) -> Then {
        let (request, result) = match *request {
            ModelRequest::Begin(_) => {
                self.transfer = None;
                return Then::Pass;
            }
            ModelRequest::Image { request, size, crc32 } => (request, self.begin(size, crc32).await),
            ModelRequest::Confirm { request, crc32 } => (request, self.confirm(crc32).await),
            _ if self.transfer.is_none() => return Then::Pass,
            ModelRequest::Chunk { request, offset, data } => (request, self.chunk(offset, data, pause).await),
            ModelRequest::Commit { request, crc32 } => {
                let result = self.commit(crc32, source).await;
                acknowledge(request, result, self.next(), out);
                return if result == AckResult::Ok { Then::Restart } else { Then::Stay };
            }
        };
        acknowledge(request, result, self.next(), out);
        Then::Stay
    }

    fn next(&self) -> u32 {
        self.transfer.map_or(0, |transfer| transfer.next)
    }

    /// Records that the running image has said hello. From then on, the image is permanent.
    pub async fn said_hello(&mut self) -> AckResult {
        match self.journal() {
            Some((_, Progress::OnTrial)) => self.mark(word::CONFIRMED, 0).await,
            _ => AckResult::Ok,
        }
    }

    fn journal(&self) -> Option<(crate::update::Request, Progress)> {
        let bytes = self.flash.mapped().get(JOURNAL_AT as usize..)?;
        read_journal(|number| {
            let at = 4 * number as usize;
            bytes.get(at..at + 4).map_or(word::BLANK, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        })
    }

    async fn mark(&mut self, number: u32, value: u32) -> AckResult {
        let bytes = Aligned(value.to_le_bytes());
        match self.flash.write(JOURNAL_AT + 4 * number, &bytes.0).await {
            Ok(()) => AckResult::Ok,
            Err(_) => AckResult::StorageFailed,
        }
    }

    async fn begin(&mut self, size: u32, crc32: u32) -> AckResult {
        self.transfer = None;
        if size > IMAGE_MAX || !size.is_multiple_of(4) || size == 0 {
            return AckResult::OutOfRange;
        }
        // Until the new image has said hello, slot B contains the old image, which the board may still need.
        if matches!(self.journal(), Some((_, Progress::OnTrial))) {
            return AckResult::Busy;
        }
        // A half-erased journal must not look like an interrupted exchange.
        if self.journal().is_some() && self.mark(word::MAGIC, 0).await != AckResult::Ok {
            return AckResult::StorageFailed;
        }
        if self.flash.erase(JOURNAL_AT, JOURNAL_AT + PAGE_BYTES).await.is_err() {
            return AckResult::StorageFailed;
        }
        self.transfer = Some(Transfer { size, crc32, next: 0 });
        AckResult::Ok
    }

    async fn chunk(&mut self, offset: u32, data: &[u8], mut pause: impl AsyncFnMut()) -> AckResult {
        let Some(transfer) = &mut self.transfer else { return AckResult::WrongOffset };
        if offset != transfer.next {
            return AckResult::WrongOffset;
        }
        let len = data.len() as u32;
        let mut words = Aligned([0xFF; MODEL_CHUNK_MAX]);
        let Some(place) = words.0.get_mut(..data.len()) else { return AckResult::OutOfRange };
        if data.is_empty() || !len.is_multiple_of(4) || len > transfer.size - offset {
            return AckResult::OutOfRange;
        }
        place.copy_from_slice(data);
        let next = offset + len;
        let first_page = offset.next_multiple_of(PAGE_BYTES);
        let erases = first_page < next;
        let at = NEW_IMAGE + first_page;
        let failed = (erases && self.flash.erase(at, at + PAGE_BYTES).await.is_err())
            || self.flash.write(NEW_IMAGE + offset, &words.0[..data.len()]).await.is_err();
        if failed {
            self.transfer = None;
            return AckResult::StorageFailed;
        }
        transfer.next = next;
        if erases {
            pause().await;
        }
        AckResult::Ok
    }

    async fn commit(&mut self, crc: u32, source: Source) -> AckResult {
        let Some(transfer) = self.transfer.filter(|transfer| transfer.next == transfer.size) else {
            return AckResult::WrongOffset;
        };
        self.transfer = None;
        let start = NEW_IMAGE as usize;
        let file = self.flash.mapped().get(start..start + transfer.size as usize).unwrap_or_default();
        if crc != transfer.crc32 || crc32(file) != crc {
            return AckResult::BadChecksum;
        }
        let from = if source == Source::Cable { word::CABLE } else { word::AIR };
        // The magic number is written last, because only the magic number makes a request valid.
        for (number, value) in [
            (word::SIZE, transfer.size),
            (word::CRC, crc),
            (word::SOURCE, from),
            (word::MAGIC, word::REQUESTED),
        ] {
            if self.mark(number, value).await != AckResult::Ok {
                return AckResult::StorageFailed;
            }
        }
        AckResult::Ok
    }

    /// Returns the result of the update to this image. If the image is running, this call makes it permanent.
    async fn confirm(&mut self, crc32: u32) -> AckResult {
        match self.journal() {
            Some((request, _)) if request.crc32 != crc32 => AckResult::BadChecksum,
            Some((_, Progress::OnTrial | Progress::Confirmed)) => self.said_hello().await,
            Some((_, Progress::Refused)) => AckResult::ImageRefused,
            Some((_, Progress::WentBack)) => AckResult::ImageWentBack,
            Some((_, Progress::Waiting)) => AckResult::Busy,
            None => AckResult::WrongOffset,
        }
    }
}
