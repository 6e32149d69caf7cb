//! A model on its way from the laptop to flash.
//!
//! ```text
//! Begin -> Started ... Ok(0) -> Chunk -> Ok(next) ... Chunk -> Ok(size) -> Commit -> Ok
//! ```
//!
//! A piece at another offset than the wanted one is refused with the wanted one, so a laptop whose
//! acknowledgement was lost goes on from there. A new `Begin` starts over. Nothing that breaks touches
//! the model that runs.

use embassy_time::{Duration, Timer};
use shared_dsp::mlp::{Model, crc32};
use shared_proto::message::{Ack, AckResult, BoardMessage, ModelBegin};

use crate::classify;
use crate::link::Link;
use crate::storage::{BLOB_MAX, Flash, Store};

struct Announced {
    size: u32,
    model_id: u32,
    next: u32,
}

/// The receiving end.
pub struct Transfer<F> {
    store: Store<F>,
    announced: Option<Announced>,
}

impl<F: Flash> Transfer<F> {
    /// Nothing announced yet.
    pub fn new(store: Store<F>) -> Self {
        Self { store, announced: None }
    }

    fn ack(&self, request: u16, result: AckResult) -> BoardMessage<'static> {
        let next_offset = self.announced.as_ref().map_or(0, |a| a.next);
        BoardMessage::Ack(Ack { request, result, next_offset })
    }

    /// A model is announced: refused where this image cannot run it, else room is made.
    pub async fn begin(&mut self, link: Link, begin: &ModelBegin<'_>) {
        self.announced = None;
        let info = &begin.info;
        let fits = classify::can_run(info.recipe, usize::from(info.axes), info.sample_hz, info.window)
            && begin.size as usize <= BLOB_MAX
            && begin.size > 0;
        if !fits {
            return link.send(&self.ack(begin.request, AckResult::ModelDoesNotFit));
        }
        link.send(&self.ack(begin.request, AckResult::Started));
        // Erasing a page stops the processor for 85 ms; the sensor's FIFO holds 134 ms.
        let pause = async || Timer::after(Duration::from_millis(40)).await;
        let result = match self.store.begin(pause).await {
            Ok(()) => {
                self.announced = Some(Announced { size: begin.size, model_id: info.model_id, next: 0 });
                AckResult::Ok
            }
            Err(_) => AckResult::StorageFailed,
        };
        link.send(&self.ack(begin.request, result));
    }

    /// A piece of the model.
    pub async fn chunk(&mut self, request: u16, offset: u32, data: &[u8]) -> BoardMessage<'static> {
        let Some(announced) = &mut self.announced else {
            return self.ack(request, AckResult::WrongOffset);
        };
        let end = u64::from(offset) + data.len() as u64;
        let is_last = end == u64::from(announced.size);
        let result = if offset != announced.next {
            AckResult::WrongOffset
        } else if data.is_empty() || end > u64::from(announced.size) || (data.len() % 4 != 0 && !is_last) {
            AckResult::OutOfRange
        } else if self.store.write(offset, data).await.is_err() {
            // Flash cannot be written twice: start over.
            self.announced = None;
            AckResult::StorageFailed
        } else {
            announced.next = end as u32;
            AckResult::Ok
        };
        self.ack(request, result)
    }

    /// Keeps the model where it is whole, is the announced one and runs on this image.
    pub async fn commit(&mut self, request: u16, crc: u32) -> BoardMessage<'static> {
        let Some(announced) = &self.announced else {
            return self.ack(request, AckResult::WrongOffset);
        };
        if announced.next != announced.size {
            return self.ack(request, AckResult::WrongOffset);
        }
        let size = announced.size;
        let blob = self.store.written(size as usize);
        let result = if crc != announced.model_id || crc32(blob) != crc {
            AckResult::BadChecksum
        } else if !Model::parse(blob).is_ok_and(|m| classify::fits(&m)) {
            AckResult::ModelDoesNotFit
        } else if self.store.commit(size, crc).await.is_err() {
            AckResult::StorageFailed
        } else {
            AckResult::Ok
        };
        self.announced = None;
        self.ack(request, result)
    }
}
