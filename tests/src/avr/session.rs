//! A running board with decoded messages, from the laptop's point of view.

use std::path::Path;

use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, encode_host};
use shared_proto::message::{
    Ack, AckResult, BoardMessage, CalibrationStep, Fault, HostMessage, LeftState, RawAdc, Status,
};

use super::nano::{CYCLES_PER_MS, EEPROM_BYTES, Nano, Voltages};

/// The content of an EEPROM that was never written.
pub const BLANK: [u8; EEPROM_BYTES] = [0xFF; EEPROM_BYTES];

/// A decoded message without borrowed parts.
#[derive(Clone, Debug, PartialEq)]
pub enum Seen {
    /// Boot id and firmware version.
    Hello(u32, String),
    /// A state of the hand.
    Left(LeftState),
    /// A sample, in record mode.
    Raw(RawAdc),
    /// The counters of the board.
    Status(Status),
    /// A fault report.
    Fault(Fault),
    /// A reply to a request.
    Ack(Ack),
    /// A reply to a ping, with its id.
    Pong(u32),
}

/// A board with all messages that the laptop receives from it.
pub struct LeftRig {
    /// The emulated board.
    pub nano: Nano,
    decoder: Decoder<BOARD_FRAME_MAX>,
    /// Number of bytes sent so far.
    pub bytes: u64,
    request: u16,
}

impl LeftRig {
    /// Powers a board.
    pub fn new(image: &Path, eeprom: &[u8; EEPROM_BYTES], voltages: Box<dyn Voltages>) -> Self {
        Self { nano: Nano::new(image, eeprom, voltages), decoder: Decoder::new(), bytes: 0, request: 0 }
    }

    /// Milliseconds since power-on.
    pub fn now_ms(&self) -> f64 {
        self.nano.now_ms()
    }

    /// Runs for some time and returns all messages of that time, with their time of arrival in ms.
    pub fn run_ms(&mut self, ms: f64) -> Vec<(f64, Seen)> {
        self.nano.run_ms(ms);
        self.heard()
    }

    /// Returns all messages since the last call.
    ///
    /// # Panics
    /// Panics if the board sends anything other than intact frames, because this line causes no errors.
    pub fn heard(&mut self) -> Vec<(f64, Seen)> {
        let mut seen = Vec::new();
        while let Some((cycle, byte)) = self.nano.sent() {
            self.bytes += 1;
            let Some(message) = self.decoder.push_board(byte) else { continue };
            let message = match message {
                BoardMessage::Hello(hello) => Seen::Hello(hello.boot_id, hello.firmware.to_string()),
                BoardMessage::Left(state) => Seen::Left(state),
                BoardMessage::RawAdc(raw) => Seen::Raw(raw),
                BoardMessage::Status(status) => Seen::Status(status),
                BoardMessage::Fault(fault) => Seen::Fault(fault),
                BoardMessage::Ack(ack) => Seen::Ack(ack),
                BoardMessage::Pong(pong) => Seen::Pong(pong.id),
                other => panic!("a left board does not send {other:?}"),
            };
            seen.push((cycle as f64 / CYCLES_PER_MS as f64, message));
        }
        let counters = self.decoder.counters();
        // A restart may interrupt a frame, which then counts as damaged.
        assert!(counters.damaged() <= self.nano.resets() + 8, "damaged frames: {counters:?}");
        seen
    }

    /// Number of damaged frames, for example because a restart interrupted them.
    pub fn damaged(&self) -> u32 {
        self.decoder.counters().damaged()
    }

    /// Returns the states that arrive in the next `ms`.
    pub fn states(&mut self, ms: f64) -> Vec<(f64, LeftState)> {
        self.run_ms(ms)
            .into_iter()
            .filter_map(|(t, m)| if let Seen::Left(s) = m { Some((t, s)) } else { None })
            .collect()
    }

    /// Sends a message to the board.
    pub fn send(&mut self, message: &HostMessage<'_>) {
        let mut buffer = [0; 256];
        let frame = encode_host(message, &mut buffer).expect("a buffer that is large enough");
        self.nano.send(frame);
    }

    /// Requests a calibration step and waits for its end.
    pub fn calibrate(&mut self, step: CalibrationStep) -> AckResult {
        self.request += 1;
        let request = self.request;
        self.send(&HostMessage::Calibrate { request, step });
        for _ in 0..400 {
            for (_, seen) in self.run_ms(10.0) {
                if let Seen::Ack(ack) = seen
                    && ack.request == request
                    && ack.result != AckResult::Started
                {
                    return ack.result;
                }
            }
        }
        panic!("no acknowledgement of {step:?} within 4 s");
    }
}
