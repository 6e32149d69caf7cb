//! The boards' own code ([`shared_board`]) in virtual time, for samples from recordings, keys and tests.

use shared_board::hand::Hand;
use shared_board::left::{LeftBoard, Start};
use shared_board::memory::RamEeprom;
use shared_board::models::ModelRequest;
use shared_board::right::RightBoard;
use shared_board::{Identity, STATUS_INTERVAL_MS};
use shared_dsp::left::AdcCounts;
use shared_dsp::left::calibration::Calibration;
use shared_proto::frame::{Decoder, HOST_FRAME_MAX};
use shared_proto::message::Status;

/// Time between two samples of either board.
pub const PERIOD_MS: u64 = 10;

/// Returns a board's outgoing line, which appends frames to a wire that always has room.
pub fn onto(wire: &mut Vec<u8>) -> impl FnMut(&[u8]) -> bool {
    |frame| {
        wire.extend_from_slice(frame);
        true
    }
}

/// A left board. The board's clock shows the low 32 bits of the session's time.
#[derive(Clone, Debug)]
pub struct VirtualLeft {
    board: LeftBoard<RamEeprom>,
    /// The bytes that the board sent at its start.
    begun: Vec<u8>,
}

impl VirtualLeft {
    /// Creates a board that starts now with this EEPROM.
    pub fn start(identity: Identity, memory: RamEeprom) -> Self {
        let mut begun = Vec::new();
        let board = LeftBoard::start(identity, memory, Start::default(), &mut onto(&mut begun));
        VirtualLeft { board, begun }
    }

    /// Begins a period at `time_ms`, with or without a sample.
    pub fn period(&mut self, counts: Option<AdcCounts>, time_ms: u64, wire: &mut Vec<u8>) {
        wire.append(&mut self.begun);
        let now_ms = time_ms as u32;
        if self.board.period(now_ms, &mut onto(wire)) {
            self.board.status(Status::default(), now_ms, &mut onto(wire));
        }
        if let Some(counts) = counts {
            self.board.sample(counts, now_ms, &mut onto(wire));
        }
    }

    /// Processes bytes from the laptop.
    pub fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        wire.append(&mut self.begun);
        for &byte in bytes {
            self.board.receive(byte, now_ms as u32, &mut onto(wire));
        }
    }

    /// The calibration in use.
    pub fn calibration(&self) -> &Calibration {
        self.board.calibration()
    }

    /// Returns the EEPROM, for the board's next start.
    pub fn into_memory(self) -> RamEeprom {
        self.board.into_memory()
    }
}

/// A right board.
#[derive(Clone, Debug)]
pub struct VirtualRight<H> {
    board: RightBoard<H>,
    decoder: Decoder<HOST_FRAME_MAX>,
    number: u32,
    last_status_ms: u64,
}

impl<H: Hand> VirtualRight<H> {
    /// Creates a board that starts now and whose sensor works.
    pub fn start(identity: Identity, hand: H) -> Self {
        let mut board = RightBoard::new(identity, hand);
        board.set_sensor_ok(true);
        VirtualRight { board, decoder: Decoder::new(), number: 0, last_status_ms: 0 }
    }

    /// Processes the sample taken at `time_ms`.
    pub fn sample(&mut self, sample: &H::Sample, time_ms: u64, wire: &mut Vec<u8>) {
        if self.board.sample(sample, time_ms as u32, self.number) {
            self.board.send_due(&mut onto(wire));
        }
        self.number = self.number.wrapping_add(1);
        if time_ms.saturating_sub(self.last_status_ms) >= STATUS_INTERVAL_MS.into() {
            self.last_status_ms = time_ms;
            let counted = Status { bad_frames: self.decoder.counters().damaged(), ..Status::default() };
            self.board.status(counted, time_ms as u32, &mut onto(wire));
        }
    }

    /// Reports that the sensor has no sample: the window starts again, and no state is sent.
    pub fn nothing(&mut self) {
        self.board.gap();
        self.number = self.number.wrapping_add(1);
    }

    /// Processes bytes from the laptop; `store` answers messages about models.
    pub fn receive(
        &mut self,
        bytes: &[u8],
        now_ms: u64,
        wire: &mut Vec<u8>,
        mut store: impl FnMut(&ModelRequest<'_>, &mut Vec<u8>),
    ) {
        for &byte in bytes {
            if let Some(message) = self.decoder.push_host(byte) {
                let request = self.board.receive(&message, true, now_ms as u32, &mut onto(wire));
                if let Some(request) = request {
                    store(&request, wire);
                }
            }
        }
    }
}

/// Answers messages about models for a board that stores none.
pub fn no_store(request: &ModelRequest<'_>, wire: &mut Vec<u8>) {
    request.refuse(&mut onto(wire));
}
