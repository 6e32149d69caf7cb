//! Checks the behaviour of a right board towards the laptop.

mod common;

use common::{Line, frame};
use proptest::prelude::*;
use shared_board::Identity;
use shared_board::hand::{CountHand, Hand, ValueHand};
use shared_board::models::ModelRequest;
use shared_board::right::{Light, RightBoard};
use shared_dsp::right::decision::DecisionConfig;
use shared_dsp::right::network::{MAX_AXES, MAX_LABELS, Model};
use shared_dsp::right::{RightHand, RightOutput};
use shared_proto::frame::{HOST_FRAME_MAX, parse_host};
use shared_proto::message::{
    About, AckResult, Board, BoardMessage, Bytes, FaultKind, HostMessage, Image, Mode, ModelBegin, ModelInfo,
    ResetCause, Sensor, Signal, Status, Text, TiltThresholds, health,
};

const SCALE: [f32; 3] = [0.01, 0.07, 0.014];
const LABELS: [&str; 3] = ["idle", "a", "b"];

/// A network with three axes and some weights.
fn blob() -> Vec<u8> {
    common::model(&LABELS, 3, 8, |i| (((i * 37) % 255) as i8).max(-127))
}

fn hand(blob: &[u8]) -> CountHand<'_, 3> {
    let model = Model::parse(blob).expect("a model");
    CountHand::new(RightHand::new(model, DecisionConfig::default()).expect("three axes"), SCALE)
}

fn identity() -> Identity {
    Identity { board: Board::RightNano33, firmware: "test", boot_id: 9, sample_hz: 100 }
}

struct Rig<'m> {
    board: RightBoard<CountHand<'m, 3>>,
    line: Line,
    number: u32,
}

/// Sequence number, board time, health and number of scores of a state.
type State = (u16, u32, u8, usize);

impl<'m> Rig<'m> {
    fn new(blob: &'m [u8]) -> Self {
        let mut board = RightBoard::new(identity(), hand(blob));
        board.set_sensor_ok(true);
        Rig { board, line: Line::default(), number: 0 }
    }

    fn samples(&mut self, count: u32) {
        for _ in 0..count {
            let n = self.number as i16;
            if self.board.sample(&[n, n.wrapping_mul(3), -n], self.number * 10, self.number) {
                self.board.send_due(&mut self.line);
            }
            self.number += 1;
        }
    }

    fn send<'r>(&mut self, message: &HostMessage<'r>) -> Option<ModelRequest<'r>> {
        self.board.receive(message, true, self.number * 10, &mut self.line)
    }

    fn states(&self) -> Vec<State> {
        self.line.all(|m| match m {
            BoardMessage::Right(s) => Some((s.sequence, s.board_time_ms, s.health, s.scores.len())),
            _ => None,
        })
    }

    /// Returns the number of the first sample and the counts of each raw batch.
    fn raw(&self) -> Vec<(u32, Vec<i16>)> {
        self.line.all(|m| match m {
            BoardMessage::RawImu(raw) => {
                assert_eq!((raw.axes, raw.scale), (3, SCALE));
                let counts = raw.counts.chunks_exact(2).map(|c| i16::from_le_bytes([c[0], c[1]]));
                Some((raw.first_sample, counts.collect()))
            }
            _ => None,
        })
    }
}

#[test]
fn a_state_goes_out_each_hop_and_says_gap_until_the_window_is_full() {
    let blob = blob();
    let mut rig = Rig::new(&blob);
    rig.samples(240);
    let states = rig.states();
    assert_eq!(states.len(), 30);
    for (i, (sequence, time_ms, flags, scores)) in states.into_iter().enumerate() {
        assert_eq!((usize::from(sequence), time_ms as usize), (i, 80 * (i + 1) - 10));
        // The window of 200 samples is full at the 25th hop. Every state has one score per label.
        assert_eq!(flags, if i < 24 { health::GAP } else { 0 }, "hop {i}");
        assert_eq!(scores, LABELS.len());
    }
}

#[test]
fn a_start_is_announced_once_and_who_asks_hears_of_the_model_and_the_faults() {
    let blob = blob();
    let mut rig = Rig::new(&blob);
    rig.samples(240);
    assert_eq!(rig.line.hellos(), [9]);
    assert!(rig.line.all(|m| Some(matches!(m, BoardMessage::Hello(_))))[0], "first of all");
    rig.board.report(FaultKind::Watchdog, 0, 1, &mut rig.line);
    rig.board.report(FaultKind::SensorMissing, 0x6B, 2, &mut rig.line);
    rig.line.clear();
    rig.send(&HostMessage::HelloRequest);
    assert_eq!(rig.line.hellos(), [9]);
    let labels = rig.line.all(|m| match m {
        BoardMessage::ModelInfo(info) => Some((info.axes, info.labels.to_string())),
        _ => None,
    });
    assert_eq!(labels, [(3, "idle,a,b".to_owned())]);
    let kinds: Vec<_> = rig.line.faults().iter().map(|f| f.kind).collect();
    assert_eq!(kinds, [FaultKind::Watchdog, FaultKind::SensorMissing]);
    rig.send(&HostMessage::Ping { id: 3 });
    assert_eq!((rig.line.pongs()[0].id, rig.line.pongs()[0].board_time_ms), (3, 2400));
}

#[test]
fn the_left_hands_requests_are_refused_and_an_untrusted_link_changes_nothing() {
    let blob = blob();
    let mut rig = Rig::new(&blob);
    let step = shared_proto::message::CalibrationStep::Neutral;
    rig.send(&HostMessage::Calibrate { request: 1, step });
    let begin = ModelBegin {
        request: 2,
        info: ModelInfo { model_id: 1, recipe: 1, axes: 3, sample_hz: 100, window: 200, labels: Text("x") },
        scaling: ModelBegin::DATA_SHEET_SCALING,
        size: 10,
    };
    let untrusted = [
        HostMessage::ModelBegin(begin),
        HostMessage::ModelChunk { request: 3, offset: 0, data: Bytes(&[1]) },
        HostMessage::ModelCommit { request: 4, crc32: 1 },
        HostMessage::SetMode { request: 5, mode: Mode::Record },
    ];
    for message in &untrusted {
        assert_eq!(rig.board.receive(message, false, 0, &mut rig.line), None);
    }
    let refused = |request| (request, AckResult::NotBonded);
    assert_eq!(
        rig.line.acks(),
        [(1, AckResult::Unsupported), refused(2), refused(3), refused(4), refused(5)]
    );
    assert_eq!(rig.board.light(), Light::Well);
    // A trusted request goes to the store, and a board without a store refuses it.
    rig.line.clear();
    for (i, message) in untrusted[..3].iter().enumerate() {
        let request = rig.send(message).expect("for the store");
        request.refuse(&mut rig.line);
        assert_eq!(rig.line.acks()[i], (2 + i as u16, AckResult::Unsupported));
    }
}

#[test]
fn record_mode_sends_each_sample_once_in_whole_hops() {
    let blob = blob();
    let mut rig = Rig::new(&blob);
    rig.samples(5);
    rig.send(&HostMessage::SetMode { request: 1, mode: Mode::Record });
    assert_eq!((rig.line.acks(), rig.board.light()), (vec![(1, AckResult::Ok)], Light::Recording));
    rig.samples(20);
    let raw = rig.raw();
    assert_eq!(raw.iter().map(|r| r.0).collect::<Vec<_>>(), [5, 13]);
    assert_eq!(raw[0].1[..6], [5, 15, -5, 6, 18, -6]);
    assert!(raw.iter().all(|r| r.1.len() == 24));
    assert!(rig.states().is_empty());
    // After a gap, the unfinished batch is discarded. The next batch contains no gap.
    rig.line.clear();
    rig.number += 3;
    rig.samples(16);
    assert_eq!(rig.raw().iter().map(|r| r.0).collect::<Vec<_>>(), [28, 36]);
    rig.board.gap();
    rig.line.clear();
    rig.samples(8);
    assert_eq!(rig.raw()[0].0, 44);
    // Samples that did not enter the window count as a gap.
    rig.send(&HostMessage::SetMode { request: 2, mode: Mode::Classify });
    rig.line.clear();
    rig.samples(240);
    let full: Vec<_> = rig.states().iter().map(|s| s.2 == 0).collect();
    assert_eq!(full.iter().position(|&full| full), Some(24));
}

#[test]
fn idle_is_silent_but_for_statuses() {
    let blob = blob();
    let mut rig = Rig::new(&blob);
    rig.send(&HostMessage::SetMode { request: 1, mode: Mode::Idle });
    rig.line.clear();
    rig.samples(300);
    rig.board.silence(&mut rig.line);
    assert!(rig.states().is_empty() && rig.raw().is_empty());
    let counted = Status { dropped_samples: 4, bad_frames: 2, ..Status::default() };
    rig.board.status(counted, 3000, &mut rig.line);
    let status = rig.line.statuses()[0];
    assert_eq!((status.uptime_ms, status.dropped_samples, status.bad_frames), (3000, 4, 2));
    assert_eq!(status.mode, Mode::Idle);
}

/// Returns the state of the motor after `ms` milliseconds.
fn motor_after(rig: &mut Rig<'_>, ms: u32) -> u8 {
    rig.board.motor(rig.number * 10 + ms).percent
}

#[test]
fn a_trusted_laptop_is_felt_without_an_answer_and_when_it_falls_silent() {
    let blob = blob();
    let mut rig = Rig::new(&blob);
    let stopped = HostMessage::Feel { signal: Signal::Stopped };
    rig.board.receive(&stopped, false, 0, &mut rig.line);
    assert_eq!(motor_after(&mut rig, 10), 0, "a stranger");
    rig.send(&stopped);
    assert_eq!([10, 599, 600].map(|ms| motor_after(&mut rig, ms)), [100, 100, 0]);
    assert!(rig.line.all_acks().is_empty());
    // Any message from the laptop shows that the link is alive.
    rig.board.receive(&HostMessage::Ping { id: 1 }, true, 900, &mut rig.line);
    assert_eq!([1899, 1900].map(|ms| motor_after(&mut rig, ms)), [0, 100]);
}

#[test]
fn what_a_board_is_made_of_is_said_after_each_hello_and_again_when_its_battery_has_changed() {
    let blob = blob();
    let mut rig = Rig::new(&blob);
    let about = |battery_mv| About {
        sensor: Sensor::Lsm6ds3,
        axes: 6,
        image: Image::Uf2,
        reset: ResetCause::Pin,
        battery_mv,
    };
    let said = |rig: &Rig<'_>| {
        rig.line.all(|m| if let BoardMessage::About(about) = m { Some(about.battery_mv) } else { None })
    };
    rig.board.set_about(about(0));
    rig.board.status(Status::default(), 0, &mut rig.line);
    assert!(said(&rig).is_empty(), "not before it has said who it is");
    rig.samples(8);
    rig.board.status(Status::default(), 1000, &mut rig.line);
    rig.line.clear();
    for (battery_mv, wanted) in [(0, &[][..]), (3700, &[3700]), (3700, &[]), (3690, &[3690])] {
        rig.board.set_about(about(battery_mv));
        rig.board.status(Status::default(), 2000, &mut rig.line);
        assert_eq!(said(&rig), wanted, "{battery_mv}");
        rig.line.clear();
    }
}

#[test]
fn a_sensor_that_falls_silent_is_said_with_the_time_of_its_last_sample() {
    let blob = blob();
    let mut rig = Rig::new(&blob);
    rig.samples(241);
    assert_eq!(rig.states().last().unwrap().2, 0);
    rig.board.set_sensor_ok(false);
    assert_eq!(rig.board.light(), Light::SensorGone);
    rig.board.silence(&mut rig.line);
    rig.board.silence(&mut rig.line);
    let states = rig.states();
    let [.., first, second] = states[..] else { panic!("{states:?}") };
    assert_eq!((first.1, first.2), (2400, health::SENSOR | health::GAP));
    assert_eq!(second.0, first.0 + 1);
}

#[test]
fn measured_values_become_the_counts_that_a_sensor_would_have_given() {
    let blob = blob();
    let model = Model::parse(&blob).unwrap();
    let hand = ValueHand::new(RightHand::<3>::new(model, DecisionConfig::default()).unwrap(), SCALE);
    let mut counts = [0; MAX_AXES];
    for (value, count) in [
        (0.0, 0),
        (1.0, 100),
        (-1.0, -100),
        (0.0149, 1),
        (-0.0151, -2),
        (1e9, 32767),
        (-1e9, -32768),
        (f32::NAN, 0),
    ] {
        assert_eq!(hand.counts(&[value; 3], &mut counts), 3);
        assert_eq!(counts[..3], [count; 3], "{value}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Samples in counts and the same samples in physical units give the same gestures.
    #[test]
    fn counts_and_values_are_the_same_hand(samples in prop::collection::vec(any::<[i16; 3]>(), 400)) {
        let blob = blob();
        let mut counted = hand(&blob);
        let model = Model::parse(&blob).unwrap();
        let mut valued = ValueHand::new(RightHand::<3>::new(model, DecisionConfig::default()).unwrap(), SCALE);
        for (i, sample) in samples.iter().enumerate() {
            let values = sample.map(|count| f32::from(count) * SCALE[0]);
            prop_assert_eq!(counted.push(sample, i as u32), valued.push(&values, i as u32));
        }
        prop_assert_eq!(counted.output(), valued.output());
    }

    /// The board answers any intact message in any mode at most once, and continues to work.
    #[test]
    fn messages_of_any_content_leave_the_board_working(
        payloads in prop::collection::vec(prop::collection::vec(any::<u8>(), 1..40), 0..40),
    ) {
        let blob = blob();
        let mut rig = Rig::new(&blob);
        for payload in &payloads {
            rig.samples(3);
            if let Ok(message) = parse_host(payload) {
                let before = rig.line.all_acks().len();
                rig.send(&message);
                prop_assert!(rig.line.all_acks().len() <= before + 1);
            }
        }
        let mode = HostMessage::SetMode { request: 1, mode: Mode::Classify };
        assert!(frame(&mode).len() <= HOST_FRAME_MAX);
        rig.send(&mode);
        rig.line.clear();
        rig.samples(16);
        prop_assert_eq!(rig.states().len(), 2);
    }
}

/// A hand whose samples are the scores of `idle` and `a`.
struct Scores(RightOutput);

impl Hand for Scores {
    type Sample = [i8; 2];

    fn push(&mut self, sample: &[i8; 2], _: u32) -> bool {
        self.0.scores[..2].copy_from_slice(sample);
        true
    }

    fn gap(&mut self) {}

    fn output(&self) -> &RightOutput {
        &self.0
    }

    fn model(&self) -> ModelInfo<'_> {
        ModelInfo { model_id: 1, recipe: 1, axes: 3, sample_hz: 100, window: 200, labels: Text("idle,a") }
    }

    fn scale(&self) -> Option<[f32; 3]> {
        Some(SCALE)
    }

    fn counts(&self, _: &[i8; 2], _: &mut [i16; MAX_AXES]) -> usize {
        0
    }
}

#[test]
fn the_light_shows_once_that_a_movement_was_nearly_a_gesture() {
    let output = RightOutput {
        window_end_ms: 0,
        full: true,
        replaced: false,
        events: 0,
        is_event: false,
        label: 255,
        confidence: 0,
        event_window_end_ms: 0,
        scores: [-128; MAX_LABELS],
        label_count: 2,
    };
    let mut board = RightBoard::new(identity(), Scores(output));
    board.set_sensor_ok(true);
    let mut line = Line::default();
    let mut hops = |board: &mut RightBoard<Scores>, scores: [i8; 2]| {
        for _ in 0..8 {
            assert!(board.sample(&scores, 0, 0));
            board.send_due(&mut line);
        }
        board.light()
    };
    // The probability of the gesture rises to 0.45 and falls again.
    assert_eq!(hops(&mut board, [127, -128]), Light::Well);
    assert_eq!(hops(&mut board, [12, -13]), Light::Well, "it may still become a gesture");
    assert_eq!(hops(&mut board, [127, -128]), Light::Almost);
    assert_eq!(board.light(), Light::Well, "only once");
    // At 0.35, the movement is far from a gesture.
    assert_eq!(hops(&mut board, [37, -38]), Light::Well);
    assert_eq!(hops(&mut board, [127, -128]), Light::Well);
}

/// Adds samples that are all equal. One count of the rig is 0.01 m/s².
fn hold(rig: &mut Rig<'_>, counts: [i16; 3], samples: u32) {
    for _ in 0..samples {
        if rig.board.sample(&counts, rig.number * 10, rig.number) {
            rig.board.send_due(&mut rig.line);
        }
        rig.number += 1;
    }
}

fn tilts(line: &Line) -> Vec<(u16, [i16; 3])> {
    line.all(|m| match m {
        BoardMessage::Tilt(tilt) => Some((tilt.sequence, tilt.acceleration_mm_s2)),
        _ => None,
    })
}

fn thresholds(request: u16) -> HostMessage<'static> {
    HostMessage::SetThresholds { request, thresholds: TiltThresholds::DEFAULT }
}

#[test]
fn the_tilt_is_sent_after_each_state_once_it_was_asked_for_and_also_after_recording() {
    let blob = blob();
    let mut rig = Rig::new(&blob);
    hold(&mut rig, [0, 0, 981], 16);
    assert_eq!(tilts(&rig.line), [], "nobody asked");
    rig.send(&thresholds(5));
    assert_eq!(rig.line.acks(), [(5, AckResult::Ok)]);
    rig.line.clear();
    // Four samples of each pose: the mean over the hop.
    hold(&mut rig, [-100, 50, 900], 4);
    hold(&mut rig, [-200, 51, 1000], 4);
    hold(&mut rig, [i16::MIN, i16::MAX, 981], 8);
    let sent = tilts(&rig.line);
    assert_eq!(sent, [(2, [-1500, 505, 9500]), (3, [i16::MIN, i16::MAX, 9810])]);
    let order = rig.line.all(|m| Some(matches!(m, BoardMessage::Tilt(_))));
    assert_eq!(order, [false, true, false, true], "each after its state");
    let sequences: Vec<u16> = rig.states().iter().map(|state| state.0).collect();
    assert_eq!(sequences, [2, 3]);

    rig.line.clear();
    rig.send(&HostMessage::SetMode { request: 6, mode: Mode::Record });
    hold(&mut rig, [0, 0, 981], 12);
    assert_eq!(tilts(&rig.line), [], "raw samples only");
    rig.send(&HostMessage::SetMode { request: 7, mode: Mode::Classify });
    hold(&mut rig, [0, 0, 981], 16);
    assert!(!tilts(&rig.line).is_empty() && tilts(&rig.line).iter().all(|(_, a)| *a == [0, 0, 9810]));
}

#[test]
fn a_hop_with_missing_samples_has_no_tilt_and_a_silent_sensor_none_at_all() {
    let blob = blob();
    let mut rig = Rig::new(&blob);
    rig.send(&thresholds(1));
    hold(&mut rig, [0, 0, 981], 5);
    rig.board.gap();
    hold(&mut rig, [100, 0, 981], 8);
    let sent = tilts(&rig.line);
    assert_eq!(sent.len(), 1);
    assert_eq!(sent[0].1, [1000, 0, 9810], "nothing from before the gap");
    rig.line.clear();
    rig.board.silence(&mut rig.line);
    assert_eq!((rig.states().len(), tilts(&rig.line).len()), (1, 0));
}

#[test]
fn an_untrusted_link_gets_no_tilt() {
    let blob = blob();
    let mut rig = Rig::new(&blob);
    rig.board.receive(&thresholds(3), false, 0, &mut rig.line);
    assert_eq!(rig.line.acks(), [(3, AckResult::NotBonded)]);
    hold(&mut rig, [0, 0, 981], 16);
    assert_eq!(tilts(&rig.line), []);
}
