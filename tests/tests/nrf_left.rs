//! The left hand on a XIAO, without a cable: the image that users flash, with bumble as the laptop.
//!
//! Modelled, and no proof of a radio: when packets pass, as in `nrf_hci.rs`.
#![cfg(feature = "nrf")]

use serde_json::{Value, json};
use shared_proto::message::{
    AckResult, Board, CalibrationStep, FaultKind, Heading, HostMessage, LeftState, Mode, ModelBegin,
    ModelInfo, Text, health,
};
use tests::nrf::left_hand::{acceleration, set_flex};
use tests::nrf::lsm9ds1::Motion;
use tests::nrf::session::RightRig;

const LEFT_SERVICE: &str = "B1A40011-6D61-4E75-A1B2-5C3D9E7F0A33";
/// The one restart is the first start's, which sets up the reset pin.
const STARTED_ONCE: [u32; 1] = [4];
const STRAIGHT: [f64; 2] = [5600.0; 2];
const BENT: [f64; 2] = [4300.0; 2];
/// Readings per g.
const ONE_G: f64 = 819.0;

/// A hand that is level until this time in seconds, and then tilts forward by 30°. Its readings have a little noise.
struct Tilts(f64);

impl Motion for Tilts {
    fn at(&self, seconds: f64) -> [f64; 9] {
        let angle: f64 = if seconds < self.0 { 0.0 } else { std::f64::consts::FRAC_PI_6 };
        let noise = 3.0 * (seconds * 9173.0).sin();
        acceleration([
            4096.0 + ONE_G * angle.sin() + noise,
            4096.0 - noise,
            4096.0 + ONE_G * angle.cos() + noise,
        ])
    }
}

fn joined(motion: Tilts) -> RightRig {
    let mut rig = RightRig::left_air(Box::new(motion));
    set_flex(&mut rig.board, STRAIGHT);
    rig.run_ms(700);
    rig.join(15.0);
    rig
}

fn last(rig: &RightRig) -> LeftState {
    rig.heard.lefts.last().expect("a state").1
}

/// Calibrates a step, and waits for its result, which comes after the step's acknowledgement.
fn calibrate(rig: &mut RightRig, request: u16, step: CalibrationStep) -> AckResult {
    let started = rig.ask(request, &HostMessage::Calibrate { request, step });
    assert_eq!(started.expect("an answer").result, AckResult::Started);
    let before = rig.heard.acks.len();
    rig.run_until_that(5000, |rig| rig.heard.acks.len() > before);
    rig.heard.acks.last().expect("a result").result
}

#[test]
fn it_is_found_as_a_left_hand_and_its_states_and_tilts_come_over_the_air() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = RightRig::left_air(Box::new(Tilts(12.0)));
    set_flex(&mut rig.board, STRAIGHT);
    rig.run_ms(700);
    let heard = rig.get(json!({"do": "scan", "seconds": 1.0}));
    println!("{heard}");
    let boards: Vec<&Value> = heard.as_object().expect("advertisers").values().collect();
    assert_eq!(boards.len(), 1);
    assert_eq!(boards[0]["names"], json!(["bimanual-left"]));
    assert_eq!(boards[0]["services"].to_string().to_uppercase(), format!("[\"{LEFT_SERVICE}\"]"));
    let tap = rig.board.tap("bimanual_left_sample", 0);
    rig.join(15.0);
    assert!(rig.ask(1, &HostMessage::SetMode { request: 1, mode: Mode::Classify }).is_some());
    rig.send(&HostMessage::HelloRequest);
    rig.run_ms(500);
    assert_eq!(rig.heard.kind, Some(Board::LeftXiao));
    let before = rig.heard.lefts.len();
    rig.run_ms(5000);
    let states = &rig.heard.lefts[before..];
    println!("{} states in 5 s, {:?}", states.len(), states[0].1);
    assert!((249..=252).contains(&states.len()), "{} states in 5 s", states.len());
    assert!(states.windows(2).all(|pair| pair[1].1.sequence == pair[0].1.sequence.wrapping_add(1)));
    assert!(states.iter().all(|(_, s)| s.heading == Heading::Neutral && s.pitch_mrad.abs() < 30));
    assert_eq!(last(&rig).health, health::DEFAULT_CALIBRATION);
    let left_ms = 12_500u64.saturating_sub((rig.board.seconds() * 1000.0) as u64);
    rig.run_ms(left_ms);
    let state = last(&rig);
    assert_eq!(state.heading, Heading::Forward, "{state:?}");
    assert!((state.pitch_mrad - 524).abs() < 20, "{state:?}");
    // Every sample of the grid arrives once, whose time is given in whole ms.
    let times: Vec<u32> = rig.board.tapped(tap).iter().map(|call| call.registers[2]).collect();
    for pair in times.windows(2) {
        assert!((9..=11).contains(&(pair[1] - pair[0])), "{} ms, then {}", pair[0], pair[1]);
    }
    let (samples, passed_ms) = (times.len(), times[times.len() - 1] - times[0]);
    assert!(passed_ms.abs_diff(10 * (samples as u32 - 1)) <= 1, "{samples} samples in {passed_ms} ms");
    println!("{samples} samples, each 10 ms after the last; awake {:.2} %", 100.0 * rig.board.awake_share());
    assert!(samples > 800);
    assert_eq!((rig.damaged(), &rig.board.resets[..]), (0, &STARTED_ONCE[..]));
}

#[test]
fn a_calibration_over_the_air_counts_and_is_still_there_after_a_restart() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = joined(Tilts(f64::INFINITY));
    rig.run_ms(500);
    assert_eq!(calibrate(&mut rig, 1, CalibrationStep::Neutral), AckResult::Ok);
    assert_eq!(calibrate(&mut rig, 2, CalibrationStep::Rest), AckResult::Ok);
    set_flex(&mut rig.board, BENT);
    rig.run_ms(100);
    assert_eq!(calibrate(&mut rig, 3, CalibrationStep::Bend), AckResult::Ok);
    set_flex(&mut rig.board, STRAIGHT);
    rig.run_ms(500);
    assert_eq!(last(&rig).health, 0);
    rig.board.soc().nvic.reset_wanted = true;
    rig.run_ms(3000);
    rig.join(15.0);
    rig.run_ms(500);
    assert_eq!(last(&rig).health, 0, "calibrated");
    let bends = last(&rig).index_bends;
    for _ in 0..2 {
        set_flex(&mut rig.board, [BENT[0], STRAIGHT[1]]);
        rig.run_ms(150);
        set_flex(&mut rig.board, STRAIGHT);
        rig.run_ms(400);
    }
    assert_eq!((last(&rig).index_bends.wrapping_sub(bends), last(&rig).middle_bends), (2, 0));
}

#[test]
fn an_accelerometer_that_is_gone_and_an_open_flex_sensor_are_faults_and_end() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = joined(Tilts(f64::INFINITY));
    rig.run_ms(500);
    set_flex(&mut rig.board, [0.0, STRAIGHT[1]]);
    rig.run_ms(150);
    assert_eq!(last(&rig).health & health::FLEX, health::FLEX);
    set_flex(&mut rig.board, STRAIGHT);
    rig.run_ms(600);
    assert_eq!(last(&rig).health, health::DEFAULT_CALIBRATION);
    rig.board.soc().bus.unplugged = true;
    rig.run_ms(2500);
    let state = last(&rig);
    assert_eq!(state.health & health::STUCK, health::STUCK);
    assert_eq!((state.heading, state.pitch_mrad), (Heading::Neutral, 0));
    assert!(
        rig.heard.faults.iter().any(|fault| fault.kind == FaultKind::SensorMissing),
        "{:?}",
        rig.heard.faults
    );
    rig.board.soc().bus.unplugged = false;
    rig.board.soc().bus.sensor.power_cycle();
    rig.run_ms(2500);
    assert_eq!(last(&rig).health, health::DEFAULT_CALIBRATION);
    assert_eq!(rig.board.resets, STARTED_ONCE);
}

#[test]
fn after_a_reset_states_arrive_again_within_2_s() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = joined(Tilts(f64::INFINITY));
    rig.wait_for_parameters();
    let from = rig.board.now();
    rig.board.soc().nvic.reset_wanted = true;
    assert!(rig.run_until_that(1500, |rig| !rig.noticed("lost").is_empty()), "the laptop notices nothing");
    let back_ms = rig.return_ms(from);
    println!("states again {back_ms} ms after the board's reset (modelled)");
    assert!(back_ms < 2000);
}

#[test]
fn it_takes_a_new_image_but_no_model() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = joined(Tilts(f64::INFINITY));
    let result = |rig: &mut RightRig, request, message| rig.ask(request, &message).map(|ack| ack.result);
    let info = ModelInfo { model_id: 1, recipe: 1, axes: 3, sample_hz: 100, window: 200, labels: Text("x") };
    let begin = ModelBegin { request: 1, size: 4, info, scaling: ModelBegin::DATA_SHEET_SCALING };
    assert_eq!(result(&mut rig, 1, HostMessage::ModelBegin(begin)), Some(AckResult::Unsupported));
    let unknown = HostMessage::ImageConfirm { request: 2, crc32: 5 };
    assert_eq!(result(&mut rig, 2, unknown), Some(AckResult::WrongOffset), "there was no update");
    let begin = HostMessage::ImageBegin { request: 3, size: 8, crc32: 5 };
    assert_eq!(result(&mut rig, 3, begin), Some(AckResult::Ok));
    let commit = HostMessage::ModelCommit { request: 4, crc32: 5 };
    assert_eq!(result(&mut rig, 4, commit), Some(AckResult::WrongOffset), "the pieces are missing");
    assert_eq!(rig.board.resets, STARTED_ONCE);
}

#[test]
fn a_laptop_without_keys_learns_and_changes_nothing() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = RightRig::left_air(Box::new(Tilts(f64::INFINITY)));
    set_flex(&mut rig.board, STRAIGHT);
    rig.run_ms(700);
    rig.get(json!({"do": "connect", "interval": 15.0}));
    rig.get(json!({"do": "discover"}));
    let refused =
        rig.want(json!({"do": "write", "uuid": tests::nrf::air_host::IN, "bytes": "00", "response": true}));
    let code = refused.expect_err("a write without keys")["code"].as_u64().expect("an ATT error");
    assert!([5, 8, 15].contains(&code), "{code}");
    rig.run_ms(1000);
    assert!(rig.heard.lefts.is_empty(), "not a state");
}
