//! Sends a model or a new image to a board in pieces, and processes the acknowledgements. Sans-IO.
//!
//! ```text
//! Begin ──Ok──► Chunk at the offset the board wants ──… Ok(size)──► Commit ──Ok──► Done
//!   ▲             │ no answer for a second, or link interrupted: the same piece again
//!   └─────────────┘ board restarted or forgot its place: from the start
//! ```

use shared_board::hand::model_info_on_the_wire;
use shared_dsp::right::network::{Model, ModelError, crc32};
use shared_proto::message::{Ack, AckResult, Bytes, HostMessage, MODEL_CHUNK_MAX, ModelBegin};

use crate::talk::{ModelNeeds, advice};

/// A request without an answer is repeated after this time.
const REPEAT_MS: u64 = 1000;
/// `Begin` takes longer, because the board erases four pages of flash.
const REPEAT_BEGIN_MS: u64 = 3000;
/// Maximum number of times a transfer may start again.
const MOST_BEGINS: u32 = 20;

/// The state of a transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Stage {
    /// To be announced.
    Begin,
    /// The board expects the piece at this offset.
    Chunk(u32),
    /// All pieces were sent, and the board must verify and store them.
    Commit,
    /// The model is stored and will be used after the next restart.
    Done,
    /// The transfer was abandoned, with the reason and a remedy.
    Failed(String),
}

/// One transfer.
#[derive(Clone, Debug)]
pub struct Upload {
    blob: Vec<u8>,
    /// CRC-32 of the model or image.
    model_id: u32,
    is_image: bool,
    stage: Stage,
    request: u16,
    asked_ms: Option<u64>,
    /// The board has reported that it is working on the request.
    started: bool,
    begins: u32,
}

/// Returns the reason why a model does not fit a board, or `None` if it fits.
///
/// The model's labels may differ from those of the running model, because they are part of the new model.
pub fn misfit(model: &Model<'_>, board: &ModelNeeds) -> Option<String> {
    let info = model.info();
    if !info.recipe.runs_on(info.axes, usize::from(board.board_axes)) {
        return Some(format!(
            "the model is made for {} axes, the board has {}; train one for {1} axes (models train --axes {1}), or use a \
             board that has them (firmware-nano33/README.md)",
            info.axes, board.board_axes
        ));
    }
    let pairs = [
        ("samples per second", info.sample_hz, board.sample_hz),
        ("samples per window", info.window, board.window),
    ];
    let (what, model_has, board_has) = pairs.into_iter().find(|(_, model, board)| model != board)?;
    Some(format!(
        "the model is made for {model_has} {what}, the board runs {board_has}; train one with {board_has} \
         (models train), or flash firmware-nano33 for {model_has}"
    ))
}

impl Upload {
    /// Creates a transfer of this blob, which has not begun. Its first message has the number `request`.
    ///
    /// # Errors
    /// Returns [`ModelError`] if the bytes are not a model.
    pub fn new(blob: &[u8], request: u16) -> Result<Self, ModelError> {
        let model_id = Model::parse(blob)?.info().model_id;
        Ok(Self::of(blob, model_id, false, request))
    }

    /// Creates the transfer of a new image file.
    pub fn image(file: &[u8], request: u16) -> Self {
        Self::of(file, crc32(file), true, request)
    }

    fn of(blob: &[u8], model_id: u32, is_image: bool, request: u16) -> Self {
        let blob = blob.to_vec();
        Self {
            blob,
            model_id,
            is_image,
            stage: Stage::Begin,
            request,
            asked_ms: None,
            started: false,
            begins: 0,
        }
    }

    /// CRC-32 of the model or image.
    pub fn model_id(&self) -> u32 {
        self.model_id
    }

    /// The transfer's state.
    pub fn stage(&self) -> &Stage {
        &self.stage
    }

    /// Returns the number of bytes that the board has acknowledged, and the total number.
    pub fn progress(&self) -> (usize, usize) {
        let done = match self.stage {
            Stage::Chunk(offset) => offset as usize,
            Stage::Commit | Stage::Done => self.blob.len(),
            Stage::Begin | Stage::Failed(_) => 0,
        };
        (done, self.blob.len())
    }

    /// Returns the message to send now, if any.
    /// Each message is returned once. It is returned again if no answer arrives.
    /// Call [`Upload::unsent`] if the link did not accept the message.
    pub fn poll(&mut self, now_ms: u64) -> Option<HostMessage<'_>> {
        let patience_ms =
            if self.stage == Stage::Begin || self.started { REPEAT_BEGIN_MS } else { REPEAT_MS };
        if self.asked_ms.is_some_and(|asked| now_ms.saturating_sub(asked) < patience_ms) {
            return None;
        }
        let request = self.request;
        if self.stage == Stage::Begin {
            self.begins += 1;
            if self.begins > MOST_BEGINS {
                self.stage = Stage::Failed(format!(
                    "the transfer started over {MOST_BEGINS} times; check the cable and try again"
                ));
            }
        }
        if matches!(self.stage, Stage::Done | Stage::Failed(_)) {
            return None;
        }
        self.asked_ms = Some(now_ms);
        self.started = false;
        Some(match self.stage {
            Stage::Begin if self.is_image => {
                HostMessage::ImageBegin { request, size: self.blob.len() as u32, crc32: self.model_id }
            }
            Stage::Begin => HostMessage::ModelBegin(ModelBegin {
                request,
                // The blob was parsed when the transfer was created.
                info: model_info_on_the_wire(Model::parse(&self.blob).ok()?.info()),
                scaling: ModelBegin::DATA_SHEET_SCALING,
                size: self.blob.len() as u32,
            }),
            Stage::Chunk(offset) => {
                let start = (offset as usize).min(self.blob.len());
                let end = (start + MODEL_CHUNK_MAX).min(self.blob.len());
                HostMessage::ModelChunk { request, offset, data: Bytes(&self.blob[start..end]) }
            }
            Stage::Commit => HostMessage::ModelCommit { request, crc32: self.model_id },
            Stage::Done | Stage::Failed(_) => return None,
        })
    }

    /// Reports that the last message was not sent. It will be sent again as soon as possible.
    pub fn unsent(&mut self) {
        self.asked_ms = None;
        if self.stage == Stage::Begin {
            self.begins = self.begins.saturating_sub(1);
        }
    }

    /// Reports that the board has restarted and forgotten the transfer.
    pub fn restarted(&mut self) {
        match self.stage {
            Stage::Done | Stage::Failed(_) => {}
            // The board restarts to install the image. Only the answer was lost.
            Stage::Commit if self.is_image => self.go(Stage::Done),
            _ => self.go(Stage::Begin),
        }
    }

    /// An answer came.
    pub fn ack(&mut self, ack: &Ack) {
        if ack.request != self.request || self.asked_ms.is_none() {
            return;
        }
        let size = self.blob.len() as u32;
        let wanted = |offset: u32| if offset >= size { Stage::Commit } else { Stage::Chunk(offset) };
        match ack.result {
            AckResult::Started => self.started = true,
            AckResult::Ok if self.stage == Stage::Commit => self.go(Stage::Done),
            AckResult::Ok => self.go(wanted(ack.next_offset)),
            // The board does not know the announced model, or has forgotten it.
            AckResult::WrongOffset if ack.next_offset == 0 => self.go(Stage::Begin),
            AckResult::WrongOffset => self.go(wanted(ack.next_offset)),
            AckResult::BadChecksum | AckResult::StorageFailed => self.go(Stage::Begin),
            // The request is sent again after the normal delay.
            AckResult::Busy => {}
            result => self.go(Stage::Failed(advice(result).to_owned())),
        }
    }

    fn go(&mut self, stage: Stage) {
        self.stage = stage;
        self.request = self.request.wrapping_add(1);
        self.asked_ms = None;
        self.started = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use shared_board::memory::{RamFlash, at_once};
    use shared_board::models::{MappedFlash as _, ModelRequest, ModelStore, Runs};
    use shared_proto::frame::{BOARD_FRAME_MAX, Decoder};
    use shared_proto::message::BoardMessage;

    fn blob() -> Vec<u8> {
        crate::hands::ModelFile::bundled().unwrap().blob().to_vec()
    }

    /// Simulates the board with the boards' own model store.
    struct Receiver(ModelStore<RamFlash>);

    impl Receiver {
        fn new() -> Self {
            Receiver(open(RamFlash::blank()))
        }

        fn take(&mut self, message: &HostMessage<'_>) -> Vec<Ack> {
            let request = match *message {
                HostMessage::ModelBegin(begin) => ModelRequest::Begin(begin),
                HostMessage::ModelChunk { request, offset, data } => {
                    ModelRequest::Chunk { request, offset, data: data.0 }
                }
                HostMessage::ModelCommit { request, crc32 } => ModelRequest::Commit { request, crc32 },
                _ => return Vec::new(),
            };
            let mut acks = Vec::new();
            let mut decoder = Decoder::<BOARD_FRAME_MAX>::new();
            at_once(self.0.answer(&request, async || (), &mut |frame: &[u8]| {
                for &byte in frame {
                    if let Some(BoardMessage::Ack(ack)) = decoder.push_board(byte) {
                        acks.push(ack);
                    }
                }
                true
            }));
            acks
        }

        fn restart(&mut self) {
            self.0 = open(self.0.flash().clone());
        }

        /// Returns the CRC of the model that runs after a restart.
        fn kept(&self) -> Option<u32> {
            let (store, found) = ModelStore::open(self.0.flash().clone(), RUNS);
            found.model.map(|place| crc32(&store.flash().mapped()[place.offset()..][..place.len]))
        }
    }

    const RUNS: Runs = Runs { axes: 9, sample_hz: 100 };

    fn open(flash: RamFlash) -> ModelStore<RamFlash> {
        ModelStore::open(flash, RUNS).0
    }

    #[test]
    fn a_good_line_takes_one_message_per_piece() {
        let blob = blob();
        let mut upload = Upload::new(&blob, 0).unwrap();
        let mut board = Receiver::new();
        let mut messages = 0;
        while *upload.stage() != Stage::Done {
            let message = upload.poll(messages).expect("nothing to wait for");
            messages += 1;
            for ack in board.take(&message) {
                upload.ack(&ack);
            }
        }
        assert_eq!(messages as usize, 2 + blob.len().div_ceil(MODEL_CHUNK_MAX));
        assert_eq!(board.kept(), Some(crc32(&blob)));
    }

    #[test]
    fn a_model_for_other_axes_is_refused_before_anything_is_sent() {
        let blob = blob();
        let model = Model::parse(&blob).unwrap();
        let info = model.info();
        let mut board = ModelNeeds {
            model_id: 1,
            recipe: 0,
            axes: info.axes as u8,
            board_axes: 9,
            sample_hz: info.sample_hz,
            window: info.window,
            labels: vec!["x".to_owned()],
        };
        assert_eq!(misfit(&model, &board), None);
        // The model reads no magnetometer.
        board.board_axes = 6;
        assert_eq!(misfit(&model, &board), None);
        board.board_axes = 3;
        let text = misfit(&model, &board).unwrap();
        assert!(text.contains("axes, the board has 3"), "{text}");
        board.board_axes = 9;
        board.window = 100;
        assert!(misfit(&model, &board).unwrap().contains("samples per window"));
    }

    #[test]
    fn a_refusal_ends_it_with_advice() {
        let blob = blob();
        let mut upload = Upload::new(&blob, 5).unwrap();
        upload.poll(0);
        upload.ack(&Ack { request: 5, result: AckResult::ModelDoesNotFit, next_offset: 0 });
        let Stage::Failed(text) = upload.stage() else { panic!("{:?}", upload.stage()) };
        assert!(text.contains("models train"), "{text}");
        assert_eq!(upload.poll(10_000), None);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]
        /// Messages may be lost or repeated, and the board may restart a few times.
        /// The complete model is stored nevertheless.
        #[test]
        fn losses_repetitions_and_restarts_only_cost_time(
            fates in prop::collection::vec(0u8..20, 0..200),
        ) {
            let blob = blob();
            let mut upload = Upload::new(&blob, u16::MAX - 3).unwrap();
            let mut board = Receiver::new();
            let mut fates = fates.into_iter();
            let (mut restarts, mut now_ms) = (0, 0u64);
            while *upload.stage() != Stage::Done && now_ms < 3_600_000 {
                now_ms += 10;
                let Some(message) = upload.poll(now_ms) else { continue };
                match fates.next() {
                    Some(0) => {} // the message is lost
                    Some(1) => { board.take(&message); } // the answer is lost
                    Some(2) => {
                        // It arrives twice.
                        let mut acks = board.take(&message);
                        acks.extend(board.take(&message));
                        acks.iter().for_each(|ack| upload.ack(ack));
                    }
                    Some(3) if restarts < 5 => {
                        restarts += 1;
                        board.restart();
                        upload.restarted();
                    }
                    Some(4) => upload.unsent(),
                    _ => board.take(&message).iter().for_each(|ack| upload.ack(ack)),
                }
            }
            prop_assert_eq!(upload.stage(), &Stage::Done);
            prop_assert_eq!(board.kept(), Some(crc32(&blob)));
        }
    }
}
