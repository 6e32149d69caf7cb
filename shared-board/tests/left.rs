//! Checks the behaviour of a left board towards the laptop.

mod common;

use common::{Line, frame};
use proptest::prelude::*;
use shared_board::Identity;
use shared_board::calibration_store::next_boot_id;
use shared_board::left::{LeftBoard, Start};
use shared_board::memory::RamEeprom;
use shared_dsp::left::calibration::{CAPTURE_SAMPLES, Calibration};
use shared_dsp::left::{AdcCounts, LeftHand};
use shared_proto::message::{
    AckResult, Board, BoardMessage, CalibrationStep, FaultKind, Heading, HostMessage, LeftState, Mode,
    Status, TiltThresholds, health,
};

/// Readings of x, y, z, index and middle in 10-bit conversions. By the default calibration, the hand is level with straight fingers.
const LEVEL: [u16; 5] = [512, 512, 614, 704, 704];
/// The hand tilted 30° forward.
const FORWARD: [u16; 5] = [563, 512, 601, 704, 704];
const BENT: [u16; 5] = [512, 512, 614, 536, 536];
const PERIOD_MS: u32 = 10;

/// A board in virtual time, and the messages received from it.
struct Rig {
    board: LeftBoard<RamEeprom>,
    line: Line,
    now_ms: u32,
    request: u16,
}

impl Rig {
    fn start(memory: RamEeprom) -> Self {
        Self::started(memory, Start::default())
    }

    fn started(mut memory: RamEeprom, start: Start) -> Self {
        let mut line = Line::default();
        let boot_id = next_boot_id(&mut memory, 0);
        let identity = Identity { board: Board::LeftNano, firmware: "test", boot_id, sample_hz: 100 };
        let board = LeftBoard::start(identity, memory, start, &mut line);
        Rig { board, line, now_ms: 0, request: 0 }
    }

    fn period(&mut self) {
        self.now_ms += PERIOD_MS;
        if self.board.period(self.now_ms, &mut self.line) {
            let counted = Status { bad_frames: 7, ..Status::default() };
            self.board.status(counted, self.now_ms, &mut self.line);
        }
    }

    /// Holds the hand still for this duration.
    fn hold(&mut self, conversions: [u16; 5], ms: u32) {
        for _ in 0..ms / PERIOD_MS {
            self.period();
            let mut counts = AdcCounts::from_ten_bit(conversions);
            // The last bit of a real converter always changes.
            counts.z += u16::from((self.now_ms / PERIOD_MS).is_multiple_of(2));
            self.board.sample(counts, self.now_ms, &mut self.line);
        }
    }

    fn send(&mut self, message: &HostMessage<'_>) {
        for byte in frame(message) {
            self.board.receive(byte, self.now_ms, &mut self.line);
        }
    }

    fn calibrate(&mut self, step: CalibrationStep) -> u16 {
        self.request += 1;
        self.send(&HostMessage::Calibrate { request: self.request, step });
        self.request
    }

    fn last(&self) -> LeftState {
        *self.line.left().last().expect("a state")
    }

    /// Restarts the board with the same EEPROM.
    fn restart(self) -> Self {
        Rig::start(self.board.into_memory())
    }
}

#[test]
fn a_hello_comes_first_and_states_follow_fifty_times_a_second() {
    let mut rig = Rig::start(RamEeprom::blank());
    rig.hold(LEVEL, 1000);
    let first = rig.line.all(|m| Some(matches!(m, BoardMessage::Hello(_))))[0];
    assert!(first);
    let states = rig.line.left();
    // The heading changes from between to neutral.
    // This state is sent immediately, in addition to the regular states.
    assert_eq!(states.len(), 51);
    for (i, state) in states.iter().enumerate() {
        assert_eq!(state.sequence, i as u16);
    }
    assert_eq!(rig.last().heading, Heading::Neutral);
}

#[test]
fn a_change_is_sent_at_once() {
    let mut rig = Rig::start(RamEeprom::blank());
    rig.hold(LEVEL, 100);
    rig.hold(FORWARD, 500);
    rig.hold(LEVEL, 500);
    // A separate `LeftHand` determines when the heading must change.
    let mut hand = LeftHand::new(None, shared_words::TiltThresholds::DEFAULT, 0);
    let mut changes = Vec::new();
    for now_ms in (10..=1100).step_by(10) {
        let pose = if (110..=600).contains(&now_ms) { FORWARD } else { LEVEL };
        let mut counts = AdcCounts::from_ten_bit(pose);
        counts.z += u16::from((now_ms / PERIOD_MS).is_multiple_of(2));
        if hand.step(counts, now_ms).changed {
            changes.push(now_ms);
        }
    }
    assert!(changes.len() >= 3, "neutral, forward, and forward's end: {changes:?}");
    let sent: Vec<u32> = rig.line.left().iter().map(|s| s.board_time_ms).collect();
    assert!(changes.iter().all(|change| sent.contains(change)), "{changes:?} in {sent:?}");
    let commands = rig.line.left().iter().filter(|s| s.heading == Heading::Forward).count();
    assert!(commands > 10, "{commands}");
}

#[test]
fn a_status_comes_every_second_with_what_the_drivers_and_the_decoder_have_counted() {
    let mut rig = Rig::start(RamEeprom::blank());
    rig.hold(LEVEL, 500);
    for byte in [9, 9, 9, 0] {
        rig.board.receive(byte, rig.now_ms, &mut rig.line);
    }
    rig.hold(LEVEL, 2600);
    let statuses = rig.line.statuses();
    assert_eq!(statuses.iter().map(|s| s.uptime_ms).collect::<Vec<_>>(), [1000, 2000, 3000]);
    assert!(statuses.iter().all(|s| s.bad_frames == 8));
}

#[test]
fn who_asks_is_answered_and_who_does_not_know_the_board_is_told() {
    let mut rig = Rig::start(RamEeprom::blank());
    rig.hold(LEVEL, 100);
    let boot_ids = rig.line.hellos();
    rig.line.clear();
    rig.send(&HostMessage::Ping { id: 5 });
    let pong = rig.line.pongs()[0];
    assert_eq!((pong.id, pong.board_time_ms), (5, 100));
    rig.send(&HostMessage::HelloRequest);
    rig.hold(LEVEL, 20);
    assert_eq!(rig.line.hellos(), boot_ids);
    // Only the right board accepts messages about models.
    rig.send(&HostMessage::ModelCommit { request: 3, crc32: 0 });
    assert!(rig.line.acks().is_empty());
}

#[test]
fn idle_silences_states() {
    let mut rig = Rig::start(RamEeprom::blank());
    rig.hold(LEVEL, 100);
    rig.send(&HostMessage::SetMode { request: 2, mode: Mode::Idle });
    assert_eq!(rig.line.acks(), [(2, AckResult::Ok)]);
    rig.line.clear();
    rig.hold(LEVEL, 2000);
    assert!(rig.line.left().is_empty());
    assert_eq!(rig.line.statuses().last().unwrap().mode, Mode::Idle);
    rig.send(&HostMessage::SetMode { request: 3, mode: Mode::Classify });
    rig.hold(LEVEL, 40);
    assert!(!rig.line.left().is_empty());
}

#[test]
fn record_mode_sends_each_sample_as_it_is_judged_and_no_state() {
    let mut rig = Rig::start(RamEeprom::blank());
    rig.hold(LEVEL, 100);
    let before = rig.last().sequence;
    rig.send(&HostMessage::SetMode { request: 1, mode: Mode::Record });
    assert_eq!(rig.line.acks(), [(1, AckResult::Ok)]);
    rig.line.clear();
    rig.hold(LEVEL, 1500);
    assert!(rig.line.left().is_empty(), "nothing to act on");
    let raw = rig.line.all(|m| if let BoardMessage::RawAdc(raw) = m { Some(raw) } else { None });
    assert_eq!(raw.len(), 150);
    for (n, sample) in raw.iter().enumerate() {
        let time_ms = 110 + 10 * n as u32;
        let dither = u16::from((time_ms / 10).is_multiple_of(2));
        assert_eq!((sample.board_time_ms, sample.counts), (time_ms, [4096, 4096, 4912 + dither, 5632, 5632]));
    }
    assert_eq!(rig.line.statuses().last().unwrap().mode, Mode::Record);
    rig.send(&HostMessage::SetMode { request: 2, mode: Mode::Classify });
    rig.hold(LEVEL, 40);
    // The hand processed all samples, so no state is missing between the first and the last one.
    let first = rig.line.left()[0];
    assert_eq!((first.sequence, first.health), (before + 1, health::DEFAULT_CALIBRATION));
    assert_eq!(first.heading, Heading::Neutral);
}

#[test]
fn thresholds_are_taken_if_they_make_sense() {
    let mut rig = Rig::start(RamEeprom::blank());
    rig.hold(LEVEL, 100);
    let wide = TiltThresholds { neutral_mrad: 87, end_mrad: 600, start_mrad: 700 };
    rig.send(&HostMessage::SetThresholds { request: 1, thresholds: wide });
    rig.send(&HostMessage::SetThresholds {
        request: 2,
        thresholds: TiltThresholds { start_mrad: 500, ..wide },
    });
    assert_eq!(rig.line.acks(), [(1, AckResult::Ok), (2, AckResult::OutOfRange)]);
    rig.hold(LEVEL, 100);
    rig.hold(FORWARD, 500);
    assert!(rig.line.left().iter().all(|s| s.heading != Heading::Forward), "30° is too little now");
}

#[test]
fn a_calibration_step_is_acknowledged_twice_and_kept_across_the_restart() {
    let mut rig = Rig::start(RamEeprom::blank());
    rig.hold(LEVEL, 100);
    assert_eq!(rig.last().health, health::DEFAULT_CALIBRATION);
    let moved = [520, 505, 610, 690, 710];
    let request = rig.calibrate(CalibrationStep::Neutral);
    assert_eq!(rig.line.acks(), [(request, AckResult::Started)]);
    // A second request must wait.
    let refused = rig.calibrate(CalibrationStep::Rest);
    assert_eq!(rig.line.acks().last(), Some(&(refused, AckResult::Busy)));
    rig.hold(moved, u32::from(CAPTURE_SAMPLES) * PERIOD_MS + 500);
    assert_eq!(rig.line.acks().last(), Some(&(request, AckResult::Ok)));
    let calibration = *rig.board.calibration();
    assert_ne!(calibration, Calibration::DEFAULT);
    assert_eq!(rig.last().health, 0);

    let mut rig = rig.restart();
    rig.hold(moved, 100);
    assert_eq!(*rig.board.calibration(), calibration);
    assert_eq!((rig.last().health, rig.last().heading), (0, Heading::Neutral));

    let request = rig.calibrate(CalibrationStep::Reset);
    rig.hold(LEVEL, 1000);
    assert_eq!(rig.line.acks(), [(request, AckResult::Started), (request, AckResult::Ok)]);
    let mut rig = rig.restart();
    rig.hold(LEVEL, 100);
    assert_eq!(rig.last().health, health::DEFAULT_CALIBRATION);
}

#[test]
fn a_moving_hand_and_a_worn_out_memory_are_told_apart() {
    let mut rig = Rig::start(RamEeprom::blank());
    rig.hold(LEVEL, 100);
    let request = rig.calibrate(CalibrationStep::Neutral);
    rig.hold(LEVEL, 300);
    rig.hold(FORWARD, 500);
    assert_eq!(rig.line.acks().last(), Some(&(request, AckResult::Unsteady)));

    let mut memory = RamEeprom::blank();
    memory.writes_left = 8;
    let mut rig = Rig::start(memory);
    rig.hold(LEVEL, 100);
    let request = rig.calibrate(CalibrationStep::Neutral);
    rig.hold(LEVEL, 1500);
    assert_eq!(rig.line.acks().last(), Some(&(request, AckResult::StorageFailed)));
}

#[test]
fn what_ended_the_last_run_follows_the_hello() {
    for (fault, expected) in
        [(FaultKind::Watchdog, FaultKind::Watchdog), (FaultKind::Panic, FaultKind::Panic)]
    {
        let start = Start { fault: Some(fault), guided: false };
        let mut rig = Rig::started(RamEeprom::blank(), start);
        rig.hold(LEVEL, 100);
        assert_eq!(rig.line.faults().iter().map(|f| f.kind).collect::<Vec<_>>(), [expected]);
    }
    let mut rig = Rig::start(RamEeprom::blank());
    rig.hold(LEVEL, 100);
    assert!(rig.line.faults().is_empty());
}

#[test]
fn a_damaged_calibration_is_reported_and_defaults_are_used() {
    let mut memory = RamEeprom::with(&Calibration { rest: [5000, 5000], ..Calibration::DEFAULT });
    // The first slot begins at 0x20, because brown-outs can damage address 0.
    *memory.byte_mut(0x25) ^= 1;
    let mut rig = Rig::start(memory);
    rig.hold(LEVEL, 100);
    assert_eq!(rig.line.faults()[0].kind, FaultKind::CalibrationDamaged);
    assert_eq!(*rig.board.calibration(), Calibration::DEFAULT);
}

#[test]
fn a_full_line_owes_the_hello_and_the_last_change() {
    let mut rig = Rig::start(RamEeprom::blank());
    rig.line.is_full = true;
    rig.hold(LEVEL, 100);
    rig.hold(FORWARD, 100);
    rig.line.is_full = false;
    rig.hold(FORWARD, 10);
    assert_eq!(rig.line.hellos().len(), 1);
    let states = rig.line.left();
    assert_eq!((states[0].sequence, states[0].heading), (0, Heading::Forward));
}

#[test]
fn a_converter_that_stops_is_a_fault_after_a_tenth_of_a_second() {
    let mut rig = Rig::start(RamEeprom::blank());
    rig.hold(LEVEL, 100);
    rig.hold(FORWARD, 100);
    rig.line.clear();
    for _ in 0..30 {
        rig.period();
    }
    let states = rig.line.left();
    assert_eq!(states[0].heading, Heading::Forward, "one missing sample changes nothing");
    assert_eq!(rig.last().heading, Heading::Neutral);
    assert_ne!(rig.last().health & health::STUCK, 0);
}

#[test]
fn the_light_guides_a_wearer_without_a_laptop() {
    let start = Start { fault: None, guided: true };
    let mut rig = Rig::started(RamEeprom::blank(), start);
    let mut lit = Vec::new();
    // The wearer has three seconds to prepare, and neutral and rest take 1.3 s.
    // Then there are three more seconds to bend the fingers before *bend*.
    for ms in 0..9000 / PERIOD_MS {
        rig.hold(if ms * PERIOD_MS < 4400 { LEVEL } else { BENT }, PERIOD_MS);
        lit.push(rig.board.light());
    }
    assert!(lit.iter().any(|&on| on) && lit.iter().any(|&on| !on));
    assert!(!rig.board.light());
    let calibration = *rig.board.calibration();
    let mut rig = rig.restart();
    rig.hold(LEVEL, 100);
    assert_eq!(*rig.board.calibration(), calibration);
    assert_eq!(rig.last().health, 0, "calibrated");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// For any input, the output consists of complete frames with consecutive sequence numbers.
    #[test]
    fn noise_from_the_laptop_and_from_the_hand_leaves_the_board_working(
        noise in prop::collection::vec((any::<[u16; 5]>(), prop::collection::vec(any::<u8>(), 0..20)), 1..200),
    ) {
        let mut rig = Rig::start(RamEeprom::blank());
        for (counts, bytes) in &noise {
            rig.period();
            let [x, y, z, index, middle] = counts.map(|v| v % (AdcCounts::MAX + 1));
            rig.board.sample(AdcCounts { x, y, z, index, middle }, rig.now_ms, &mut rig.line);
            for &byte in bytes {
                rig.board.receive(byte, rig.now_ms, &mut rig.line);
            }
        }
        rig.board.receive(0, rig.now_ms, &mut rig.line);
        rig.line.clear();
        rig.send(&HostMessage::SetMode { request: 1, mode: Mode::Classify });
        rig.send(&HostMessage::Ping { id: 1 });
        rig.hold(LEVEL, 200);
        prop_assert_eq!(rig.line.pongs().len(), 1);
        let states = rig.line.left();
        prop_assert!(states.len() >= 10);
        prop_assert!(states.windows(2).all(|w| w[1].sequence == w[0].sequence.wrapping_add(1)));
    }
}
