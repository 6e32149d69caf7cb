//! Plays a left hand from a recording of its converter.

use host_core::observe::Sample;
use shared_board::Identity;
use shared_board::memory::RamEeprom;
use shared_dsp::left::calibration::{Calibration, CaptureError, CaptureStep};
use shared_dsp::left::flex::bend_permille;
use shared_dsp::left::{LeftHand, OVERSAMPLING};
use shared_proto::frame::{HOST_TO_LEFT_FRAME_MAX, encode_host};
use shared_proto::message::{Board as BoardKind, CalibrationStep, HostMessage};
use shared_words::TiltThresholds;

use super::Board;
use super::virtual_board::{PERIOD_MS, VirtualLeft};
use models::adc::AdcRecording;

/// A sample that is late by at most this time belongs to its period. A later sample belongs to no period.
const JITTER_MS: u64 = PERIOD_MS / 2;
/// Time between the starts of two calibration steps: 64 samples, and the time for the EEPROM to store them.
const STEP_MS: u64 = 900;

/// Plays a recording like a Nano, where each sample begins a period of the board's clock.
#[derive(Clone, Debug)]
pub struct LeftBoard {
    recording: AdcRecording,
    next: usize,
    board: VirtualLeft,
    /// Start of the next period if no sample arrives.
    period_ms: u64,
    /// The remaining calibration steps with their times; the next step is last.
    steps: Vec<(u64, CalibrationStep)>,
    /// Samples with a lower index were taken before the last call of `step`.
    before: usize,
}

impl LeftBoard {
    /// Creates a board that starts at time 0 with `calibration` in its EEPROM.
    pub fn new(recording: AdcRecording, calibration: Option<Calibration>, boot_id: u32) -> Self {
        let memory = calibration.map_or_else(RamEeprom::blank, |kept| RamEeprom::with(&kept));
        let identity = Identity {
            board: BoardKind::LeftReplay,
            firmware: env!("CARGO_PKG_VERSION"),
            boot_id,
            sample_hz: 100,
        };
        LeftBoard {
            recording,
            next: 0,
            board: VirtualLeft::start(identity, memory),
            period_ms: 0,
            steps: Vec::new(),
            before: 0,
        }
    }

    /// Calibrates neutral and rest from the first 1.6 s, as if the wearer had requested a calibration.
    /// The hand must be level and still with straight fingers; otherwise, the calibration does not change.
    #[must_use]
    pub fn calibrated_at_start(mut self) -> Self {
        self.steps = vec![(STEP_MS, CalibrationStep::Rest), (0, CalibrationStep::Neutral)];
        self
    }

    /// Sends the pending request to the board as a frame.
    fn calibrate(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        while let Some((_, step)) = self.steps.pop_if(|(at_ms, _)| *at_ms <= now_ms) {
            let message = HostMessage::Calibrate { request: self.steps.len() as u16, step };
            let mut buffer = [0; HOST_TO_LEFT_FRAME_MAX];
            if let Ok(frame) = encode_host(&message, &mut buffer) {
                self.board.receive(frame, now_ms, wire);
            }
        }
    }
}

/// Explains why [`LeftBoard::calibrated_at_start`] refuses a recording.
pub fn refused_at_start(recording: &AdcRecording) -> Vec<String> {
    let mut hand = LeftHand::new(None, TiltThresholds::DEFAULT, 0);
    let mut refused = Vec::new();
    let mut samples = recording.samples.iter().peekable();
    for (from_ms, step, what) in [(0, CaptureStep::Neutral, "neutral"), (STEP_MS, CaptureStep::Rest, "rest")]
    {
        while let Some((time_ms, counts)) = samples.next_if(|(time_ms, _)| *time_ms < from_ms) {
            hand.step(*counts, *time_ms as u32);
        }
        hand.start_capture(step);
        let mut outcome = None;
        while let Some((time_ms, counts)) = samples.next_if(|_| outcome.is_none()) {
            hand.step(*counts, *time_ms as u32);
            outcome = hand.take_captured();
        }
        let why = match (outcome, step) {
            (Some(Ok(new)), _) => {
                hand.set_calibration(Some(new));
                continue;
            }
            (None, _) => "the recording is too short",
            (Some(Err(CaptureError::Moved)), CaptureStep::Neutral) => "the hand moved",
            (Some(Err(CaptureError::Moved)), _) => "a finger moved",
            (Some(Err(CaptureError::Impossible)), CaptureStep::Neutral) => {
                "the hand is not level with the palm down"
            }
            (Some(Err(CaptureError::Impossible)), _) => "a line is open or shorted",
        };
        refused.push(format!(
            "{what} is not taken from {:.1} s on: {why}; record 1.6 s of a still, level hand with straight fingers first, or \
             give a calibration file",
            from_ms as f64 / 1000.0
        ));
    }
    refused
}

impl Board for LeftBoard {
    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        self.before = self.next;
        while let Some(&(time_ms, counts)) = self.recording.samples.get(self.next) {
            let is_on_time = self.next == 0 || time_ms <= self.period_ms + JITTER_MS;
            let at_ms = if is_on_time { time_ms } else { self.period_ms };
            if at_ms > now_ms {
                break;
            }
            let counts = is_on_time.then_some(counts);
            self.next += usize::from(is_on_time);
            self.calibrate(at_ms, wire);
            self.board.period(counts, at_ms, wire);
            self.period_ms = at_ms + PERIOD_MS;
        }
    }

    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        if !self.ended() {
            self.board.receive(bytes, now_ms, wire);
        }
    }

    fn sample(&self) -> Option<Sample<'_>> {
        let (_, reading) = *self.recording.samples.get(self.before..self.next)?.last()?;
        let calibration = self.board.calibration();
        let counts = reading.as_array().map(|sum| (sum + OVERSAMPLING / 2) / OVERSAMPLING);
        let bends_permille = [reading.index, reading.middle];
        let bends_permille =
            [0, 1].map(|i| bend_permille(bends_permille[i], calibration.rest[i], calibration.bend[i]));
        Some(Sample::Left { counts, bends_permille })
    }

    fn ended(&self) -> bool {
        self.next >= self.recording.samples.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_dsp::left::AdcCounts;
    use shared_proto::frame::{BOARD_FRAME_MAX, Decoder};
    use shared_proto::message::{BoardMessage, LeftState, health};

    /// A level hand with straight fingers, whose readings change in the last bit.
    fn still(times_ms: impl Iterator<Item = u64>) -> AdcRecording {
        let samples = times_ms
            .enumerate()
            .map(|(i, t)| (t, AdcCounts::from_ten_bit([512, 512, 614 + (i % 2) as u16, 704, 704])));
        AdcRecording { samples: samples.collect() }
    }

    /// Plays to the end and returns all states.
    fn play(mut board: LeftBoard) -> Vec<LeftState> {
        let mut wire = Vec::new();
        for now_ms in 0.. {
            board.step(now_ms, &mut wire);
            if board.ended() {
                break;
            }
        }
        let mut decoder = Decoder::<BOARD_FRAME_MAX>::new();
        let states = wire.iter().filter_map(|&byte| match decoder.push_board(byte) {
            Some(BoardMessage::Left(state)) => Some(state),
            _ => None,
        });
        states.collect()
    }

    #[test]
    fn samples_that_come_a_little_early_or_late_are_all_taken() {
        let jitter = |n: u64| [0, 3, 5, 1][n as usize % 4];
        let states = play(LeftBoard::new(still((0..200).map(|n| 10 * n + jitter(n))), None, 1));
        // The board sends one state for every two samples, and one more at once for the first neutral sample.
        assert!((100..=101).contains(&states.len()), "{}", states.len());
        assert!(states.iter().all(|s| s.health == health::DEFAULT_CALIBRATION));
    }

    #[test]
    fn a_hole_in_the_recording_is_a_converter_that_delivers_nothing() {
        let states = play(LeftBoard::new(still((0..100).chain(150..200).map(|n| 10 * n)), None, 1));
        let stuck = |from: u32, to: u32| {
            let mut among = states.iter().filter(|s| (from..to).contains(&s.board_time_ms));
            among.all(|s| s.health & health::STUCK != 0)
        };
        assert!(!stuck(0, 1000) && stuck(1100, 1500) && !stuck(1800, 2000), "{states:?}");
        // A sample counts as missing only after its period.
        assert!(
            states.windows(2).all(|w| w[1].board_time_ms - w[0].board_time_ms <= 30),
            "it goes on talking"
        );
    }

    #[test]
    fn neutral_and_rest_are_taken_from_the_first_1600_ms_if_asked_for() {
        let states = play(LeftBoard::new(still((0..200).map(|n| 10 * n)), None, 1).calibrated_at_start());
        let last = states.last().unwrap();
        assert_eq!(last.health, 0, "calibrated");
        let from = states.iter().find(|s| s.board_time_ms > 1600).unwrap();
        assert_eq!(from.health, 0);
    }

    #[test]
    fn a_calibration_that_the_start_does_not_give_is_explained() {
        assert!(refused_at_start(&still((0..200).map(|n| 10 * n))).is_empty());
        let told = |change: fn(u64, &mut AdcCounts)| {
            let mut recording = still((0..200).map(|n| 10 * n));
            recording.samples.iter_mut().for_each(|(time_ms, counts)| change(*time_ms, counts));
            refused_at_start(&recording)
        };
        let moved = told(|time_ms, counts| counts.x += if time_ms < 300 { 0 } else { 200 });
        assert!(moved[0].starts_with("neutral is not taken from 0.0 s on: the hand moved;"), "{moved:?}");
        assert_eq!(moved.len(), 1);
        let turned = told(|_, counts| counts.z = 8 * 410);
        assert!(turned[0].contains("not level with the palm down"), "{turned:?}");
        let fidgeting = told(|time_ms, counts| counts.index -= if time_ms < 1200 { 0 } else { 800 });
        assert!(
            fidgeting[0].starts_with("rest is not taken from 0.9 s on: a finger moved;"),
            "{fidgeting:?}"
        );
        let short = refused_at_start(&still((0..100).map(|n| 10 * n)));
        assert!(short.len() == 1 && short[0].contains("the recording is too short"), "{short:?}");
        // The board confirms this: with its own calibration, its states contain no warning.
        let flags = |recording: AdcRecording| {
            play(LeftBoard::new(recording, None, 1).calibrated_at_start()).last().unwrap().health
        };
        assert_eq!(flags(still((0..200).map(|n| 10 * n))), 0);
    }
}
