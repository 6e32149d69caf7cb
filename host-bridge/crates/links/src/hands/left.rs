//! The left hand from a recording of its converter.

use shared_dsp::flex::bend_permille;
use shared_dsp::left::{AdcCounts, LeftHand, LeftOutput};
use shared_dsp::left_calibration::{Calibration, CalibrationStep};
use shared_dsp::tilt::{self, TiltThresholds};
use shared_proto::message::{
    Board as BoardKind, BoardMessage, Heading, Hello, LeftState, PROTOCOL_MAJOR, PROTOCOL_MINOR,
};

use super::{Board, Port};
use crate::adc::AdcRecording;
use host_core::observe::Sample;

/// States are sent this often, and at once on a change.
const STATE_INTERVAL_MS: u64 = 20;

/// Plays a recording as the Nano would.
#[derive(Clone, Debug)]
pub struct LeftBoard {
    recording: AdcRecording,
    next: usize,
    hand: LeftHand,
    port: Port,
    boot_id: u32,
    sequence: u16,
    last_sent_ms: Option<u64>,
    said_hello: bool,
    /// Calibration steps still to be taken, the next one last.
    captures: Vec<CalibrationStep>,
    /// Samples before this one were taken before the last step.
    before: usize,
}

impl LeftBoard {
    /// A board that starts at time 0; `calibration` is what its EEPROM holds.
    pub fn new(recording: AdcRecording, calibration: Option<Calibration>, boot_id: u32) -> Self {
        LeftBoard {
            recording,
            next: 0,
            hand: LeftHand::new(calibration, TiltThresholds::DEFAULT, 0),
            port: Port::default(),
            boot_id,
            sequence: 0,
            last_sent_ms: None,
            said_hello: false,
            captures: Vec::new(),
            before: 0,
        }
    }

    /// Takes neutral and rest from the first 1.3 s, as if the wearer had asked for it: the hand level and
    /// still, the fingers straight. Where it is not, the calibration stays what it was.
    #[must_use]
    pub fn calibrated_at_start(mut self) -> Self {
        self.captures = vec![CalibrationStep::Rest, CalibrationStep::Neutral];
        self
    }

    fn calibrate(&mut self) {
        if let Some(Ok(calibration)) = self.hand.take_captured() {
            self.hand.set_calibration(Some(calibration));
        }
        if !self.hand.is_capturing()
            && let Some(step) = self.captures.pop()
        {
            self.hand.start_capture(step);
        }
    }

    fn hello(&mut self, wire: &mut Vec<u8>) {
        let hello = Hello {
            major: PROTOCOL_MAJOR,
            minor: PROTOCOL_MINOR,
            board: BoardKind::LeftReplay,
            firmware: env!("CARGO_PKG_VERSION"),
            boot_id: self.boot_id,
            model_id: 0,
            sample_hz: 100,
        };
        self.port.send(&BoardMessage::Hello(hello), wire);
    }

    fn send(&mut self, output: LeftOutput, time_ms: u64, wire: &mut Vec<u8>) {
        self.last_sent_ms = Some(time_ms);
        let state = LeftState {
            sequence: self.sequence,
            board_time_ms: time_ms as u32,
            pitch_mrad: output.pitch_mrad,
            roll_mrad: output.roll_mrad,
            heading: heading_on_the_wire(output.heading),
            index_bends: output.index_bends,
            middle_bends: output.middle_bends,
            stop: output.stop,
            health: output.health,
        };
        self.sequence = self.sequence.wrapping_add(1);
        self.port.send(&BoardMessage::Left(state), wire);
    }
}

impl Board for LeftBoard {
    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        if !self.said_hello && !self.ended() {
            self.said_hello = true;
            self.hello(wire);
        }
        self.before = self.next;
        while let Some(&(time_ms, counts)) = self.recording.samples.get(self.next)
            && time_ms <= now_ms
        {
            self.next += 1;
            self.calibrate();
            // The board's wrapping clock.
            let output = self.hand.step(AdcCounts::from_ten_bit(counts), time_ms as u32);
            let due = self.last_sent_ms.is_none_or(|sent| time_ms - sent >= STATE_INTERVAL_MS);
            if due || output.changed {
                self.send(output, time_ms, wire);
            }
        }
    }

    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        if self.port.is_asked_for_hello(bytes, now_ms, wire) && !self.ended() {
            self.hello(wire);
        }
    }

    fn sample(&self) -> Option<Sample<'_>> {
        let (_, counts) = *self.recording.samples.get(self.before..self.next)?.last()?;
        let (reading, calibration) = (AdcCounts::from_ten_bit(counts), self.hand.calibration());
        let bends_permille = [reading.index, reading.middle];
        let bends_permille =
            [0, 1].map(|i| bend_permille(bends_permille[i], calibration.rest[i], calibration.bend[i]));
        Some(Sample::Left { counts, bends_permille })
    }

    fn ended(&self) -> bool {
        self.next >= self.recording.samples.len()
    }
}

/// The hand's heading as the wire names it.
pub fn heading_on_the_wire(heading: tilt::Heading) -> Heading {
    match heading {
        tilt::Heading::Neutral => Heading::Neutral,
        tilt::Heading::Between => Heading::Between,
        tilt::Heading::Forward => Heading::Forward,
        tilt::Heading::Backward => Heading::Backward,
        tilt::Heading::Left => Heading::Left,
        tilt::Heading::Right => Heading::Right,
    }
}
