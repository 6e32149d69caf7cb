//! Tests both hands together: the emulated images of both boards, one bridge and one simulated robot.
#![cfg(all(feature = "avr", feature = "nrf"))]

use std::cell::RefCell;
use std::rc::Rc;

use fastrand::Rng;
use host_bridge::bridge::{BridgeEvent, EventKind, GestureOutcome};
use host_bridge::config::Config;
use host_bridge::demo::Demo;
use host_bridge::robot::Door as _;
use host_bridge::robots::Stage;
use host_bridge::safety::{HaltReason, Hand as Which};
use host_bridge::script::Script;
use models::synth::{Motion, Segment, Wearer as RightWearer, session};
use shared_dsp::left::calibration::Calibration;
use tests::avr::image;
use tests::avr::nano::{CYCLES_PER_MS, Nano, PinInput, Voltages as _};
use tests::avr::recorded::{Recorded, calibrated};
use tests::avr::session::BLANK;
use tests::avr::wearer::{Hand, SUPPLY_MV, Sensors, Wearer};
use tests::is_full;
use tests::nrf::left_hand::{Recorded as LeftRecorded, acceleration};
use tests::nrf::lsm9ds1::{Motion as Moves, Replay, Still};
use tests::nrf::recordings::rows;
use tests::two_hands::{Cable, Disturbance, Flex, Left, Right, TwoHands, Wire, start_both_on_air};

/// Returns a board without calibration and the nominal left hand that controls it.
fn left_hand(seed: u64) -> (Nano, Rc<RefCell<Hand>>) {
    let (wearer, hand) = Wearer::new(Sensors::nominal(), (0.0, 0.0), None, Rng::with_seed(seed));
    (Nano::new(&image::path(), &BLANK, Box::new(wearer)), hand)
}

const FORWARD_RAD: f64 = 0.5;

/// Plays the bundled session on both boards, and compares the results with the session's expected values.
/// In the short run, one link plays the complete session, and the others play only the first gestures.
fn play_demo(link: Cable) {
    let whole = is_full() || link == Cable::Uart;
    let Demo { left, right, script } = Demo::bundled();
    let seconds = if whole { left.samples.len() as u64 / 100 } else { 36 };
    let mut nano = calibrated(&script.calibration);
    let samples: Vec<[u16; 5]> =
        left.samples.iter().map(|(_, counts)| counts.as_array().map(|sum| sum / 8)).collect();
    nano.set_voltages(Box::new(Recorded::new(samples, nano.cycle())));
    let motion = |start| Replay { rows: rows(&right), interval: 0.01, start };
    let mut desk = TwoHands::new(Some(Left::new(nano)), Some(Right::start(link, motion)));
    desk.run_ms(seconds * 1000);
    compare_with_script(&mut desk, &script, whole, &format!("{link:?}"));
    let (left, right) = (desk.left.as_ref().unwrap(), desk.right.as_mut().unwrap());
    assert_eq!(left.nano.resets(), 0);
    if link != Cable::Ble {
        assert_eq!(right.board.soc().nvic.vector_table, 0x10000, "the image has moved the table to its own");
    }
}

/// Compares what has happened on the desk with what the script of a session expects.
fn compare_with_script(desk: &mut TwoHands, script: &Script, whole: bool, links: &str) {
    let expect = &script.expect;
    let (mut gestures, mut poses, mut halts, mut releases) = (vec![], vec![], vec![], 0);
    let mut together = 0;
    for event in &desk.log {
        match &event.kind {
            EventKind::Gesture { label, .. } => gestures.push(label.clone()),
            EventKind::MotionEnded { motion, reached: true } => poses.push(motion.as_str().to_owned()),
            EventKind::Halt { reason } => halts.push(*reason),
            EventKind::Released => releases += 1,
            EventKind::Heading { .. } => together += 1,
            _ => {}
        }
    }
    let here = desk.robot.picture().odometry;
    let cap = desk.bridge.caps().linear_m_s;
    let place = &expect.base;
    println!("{:<12}{:<76}in virtual time over {links}", "", "as scripted");
    println!("{:<12}{:<76}{}", "gestures", expect.gestures.join(" "), gestures.join(" "));
    println!("{:<12}{:<76}{}", "arm poses", expect.poses.join(" "), poses.join(" "));
    let (scripted, got) = (
        format!("x {:.3} m, y {:.3} m, {:.3} rad", place.x_m, place.y_m, place.heading_rad),
        format!("x {:.3} m, y {:.3} m, {:.3} rad", here.x_m, here.y_m, here.heading_rad),
    );
    println!("{:<12}{:<76}{}", "base", scripted, got);
    println!("{:<12}{:<76}{cap:.4}, {} commands, path {:.2} m", "cap", expect.cap, together, here.path_m);
    if whole {
        assert_eq!(gestures, expect.gestures);
        assert_eq!(poses, expect.poses);
        assert_eq!(halts, vec![HaltReason::OperatorStop; expect.stops as usize]);
        assert_eq!(releases, expect.stops);
        assert!((cap - expect.cap).abs() <= 0.001);
        assert!((here.x_m - place.x_m).hypot(here.y_m - place.y_m) <= place.within_m, "{here:?}");
        assert!((here.heading_rad - place.heading_rad).abs() <= place.within_rad, "{here:?}");
    } else {
        assert!(gestures.len() >= 3 && expect.gestures.starts_with(&gestures), "{gestures:?}");
        assert!(poses.len() >= 2 && expect.poses.starts_with(&poses), "{poses:?}");
        assert!(here.path_m > 1.0 && together > 0, "{here:?}");
    }
    assert_eq!(desk.robot.picture().timeouts, 0);
    for hand in [Which::Left, Which::Right] {
        let counters = desk.bridge.link(hand).counters();
        // The port was opened in the middle of a frame.
        assert!(counters.damaged <= 1 && counters.lost == 0, "{hand}: {counters:?}");
    }
}

#[test]
fn the_bundled_session_on_both_emulated_boards_over_uart_comes_to_what_its_script_says() {
    play_demo(Cable::Uart);
}

#[test]
fn the_bundled_session_on_both_emulated_boards_over_usb_comes_to_what_its_script_says() {
    play_demo(Cable::Usb);
}

#[test]
fn the_bundled_session_on_both_emulated_boards_over_bluetooth_comes_to_what_its_script_says() {
    play_demo(Cable::Ble);
}

/// Both hands over Bluetooth: the left one on a XIAO, whose sensors give the same readings as the left hand's Nano had.
#[test]
fn the_bundled_session_with_both_hands_over_bumbles_link_comes_to_what_its_script_says() {
    if !tests::has_linked_image() {
        return;
    }
    let Demo { left, right, script } = Demo::bundled();
    let whole = is_full();
    let seconds = if whole { left.samples.len() as u64 / 100 } else { 36 };
    let samples: Vec<_> = left.samples.iter().map(|(_, counts)| *counts).collect();
    let wear_left = |start| {
        let recorded = LeftRecorded::new(samples, start);
        let motion = recorded.motion();
        (motion, Box::new(move |seconds| recorded.flex(seconds)) as Flex)
    };
    let wear_right = |start| Replay { rows: rows(&right), interval: 0.01, start };
    let mut desk = TwoHands::on_air(start_both_on_air(&script.calibration.into(), wear_left, wear_right));
    let mut to_arm_ms = Vec::new();
    let (mut seen, mut deciding) = (0, None);
    while desk.now_ms() < seconds * 1000 {
        desk.step();
        let right = desk.right.as_ref().unwrap();
        for event in &desk.log[seen..] {
            if let EventKind::Gesture { outcome: GestureOutcome::Started(_), window_end_board_ms, .. } =
                &event.kind
            {
                deciding = Some(sampled_at(right, *window_end_board_ms));
            }
        }
        seen = desk.log.len();
        if desk.arm_moves()
            && let Some(sample) = deciding.take()
        {
            to_arm_ms.push(passed_ms(right.cycle_at(desk.now_ms()) - sample));
        }
    }
    compare_with_script(&mut desk, &script, whole, "Bluetooth, both hands");
    // This laptop has no keyboard.
    for hand in [Which::Left, Which::Right] {
        let is_named = |event: &BridgeEvent| matches!(&event.kind, EventKind::Pairing { hand: of, text } if *of == hand && text.contains("just works"));
        assert!(desk.log.iter().any(is_named), "{hand} hand: paired by \"just works\"");
    }
    to_arm_ms.sort_by(f64::total_cmp);
    println!(
        "{} motions from rest, from the sample that decides to the arm: median {:.1}, worst {:.1} ms at 15 ms (modelled)",
        to_arm_ms.len(),
        median(&to_arm_ms),
        to_arm_ms.last().unwrap()
    );
    assert!(*to_arm_ms.last().unwrap() <= 50.0);
    for board in [&mut desk.left_air.as_mut().unwrap().board, &mut desk.right.as_mut().unwrap().board] {
        assert_eq!(board.resets, [4], "the one restart is the first start's");
    }
}

/// A left hand out of reach, and then the right one: the robot halts, and moves again only after neutral.
#[test]
fn either_hand_out_of_reach_over_bumbles_link_stops_base_and_arm() {
    if !tests::has_linked_image() {
        return;
    }
    let (wearer, hand) = Wearer::new(Sensors::nominal(), (0.0, 0.0), None, Rng::with_seed(34));
    let pins = Rc::new(RefCell::new(wearer));
    let left = |_: f64| {
        let flex = {
            let pins = Rc::clone(&pins);
            move |seconds: f64| [3, 4].map(|pin| pin_reading(&pins, pin, seconds))
        };
        (WornLeft(Rc::clone(&pins)), Box::new(flex) as Flex)
    };
    let desk = TwoHands::on_air(start_both_on_air(&Calibration::DEFAULT, left, strokes(2)));
    let mut steered = Steered { desk, hand };

    steered.both_move();
    steered.desk.left_air.as_mut().unwrap().board.controller().in_range = false;
    say("left hand (bumble) out of reach", steered.halts(Which::Left));
    // The silence is shorter than the supervision timeout, so the link survives.
    steered.desk.run_ms(100);
    steered.desk.left_air.as_mut().unwrap().board.controller().in_range = true;
    steered.needs_neutral("left hand (bumble) back");

    steered.both_move();
    steered.desk.right.as_mut().unwrap().board.controller().in_range = false;
    say("right hand (bumble) out of reach", steered.halts(Which::Right));
}

/// The reading that a left hand's Nano would have at this pin.
fn pin_reading(pins: &RefCell<Wearer>, pin: u8, seconds: f64) -> f64 {
    let cycle = (seconds * 1000.0 * CYCLES_PER_MS as f64) as u64;
    match pins.borrow_mut().at(pin, cycle) {
        PinInput::Millivolts(mv) => mv / SUPPLY_MV * 8192.0,
        other => panic!("{other:?} at pin {pin}"),
    }
}

/// A simulated left hand, worn with a XIAO.
struct WornLeft(Rc<RefCell<Wearer>>);

impl Moves for WornLeft {
    fn at(&self, seconds: f64) -> [f64; 9] {
        acceleration([0, 1, 2].map(|pin| pin_reading(&self.0, pin, seconds)))
    }
}

/// Cycle at which the right board's sensor measured the last sample of a window, which ends at this time of its clock.
fn sampled_at(right: &Right, window_end_board_ms: u32) -> u64 {
    let number = (f64::from(window_end_board_ms) / 10.0).round() as u64;
    right.board.clock_start() + tests::nrf::time::cycle_of_tick(number * 32_768 / 100)
}

/// Converts cycles since a sample's grid time to ms since it was measured, which is earlier (sensor/src/grid.rs).
fn passed_ms(cycles: u64) -> f64 {
    cycles as f64 / tests::nrf::time::ms(1) as f64 + 1100.0 / 238.0
}

fn median(sorted: &[f64]) -> f64 {
    sorted[sorted.len() / 2]
}

#[test]
fn the_arm_moves_within_50_ms_of_the_sample_that_decides() {
    from_sample_to_arm(Cable::Uart, if is_full() { 40 } else { 2 });
}

/// The times of the packets are modelled at an interval of 15 ms, which is the longest that the board requests.
#[test]
fn over_bumbles_link_at_15_ms_the_arm_moves_within_50_ms_of_the_sample_that_decides() {
    if !tests::has_linked_image_and_time() {
        return;
    }
    from_sample_to_arm(Cable::Air, if is_full() { 10 } else { 1 });
}

/// Simulated wearers perform gestures one after another. No model was trained with their data.
/// Each gesture starts the arm of a robot at rest.
fn from_sample_to_arm(link: Cable, wearers: u32) {
    const REST_S: f64 = 2.0;
    const GESTURE_S: f64 = 3.0;
    let (mut to_arm_ms, mut to_event_s, mut others) = (Vec::new(), Vec::new(), Vec::new());
    for index in 1..=wearers {
        let mut script = vec![Segment::new(Motion::IDLE, 1.0 + REST_S)];
        for gesture in Motion::GESTURES {
            script.push(Segment::new(gesture, GESTURE_S));
            script.push(Segment::new(Motion::IDLE, REST_S));
        }
        let wearer = RightWearer::evaluation(11, index);
        let recording = session(&wearer, 0, &script);
        let mut start_s = 0.0;
        // Each wearer gets a different phase of hop and millisecond, and a different sensor clock.
        let mut right = Right::start(link, |zero_s| {
            start_s = zero_s + 0.080 * f64::from(index) / f64::from(wearers) + 0.0003;
            Replay { rows: rows(&recording), interval: 0.01, start: start_s }
        });
        right.board.soc().bus.sensor.set_clock_ratio([0.97, 1.0, 1.03][index as usize % 3]);
        let mut desk = TwoHands::new(None, Some(right));
        let (mut seen, mut deciding) = (0, None);
        let seconds = 1.0 + REST_S + 6.0 * (GESTURE_S + REST_S);
        while (desk.now_ms() as f64) < seconds * 1000.0 {
            desk.step();
            let now_ms = desk.now_ms();
            let right = desk.right.as_ref().unwrap();
            for event in &desk.log[seen..] {
                let EventKind::Gesture { label, outcome, window_end_board_ms, .. } = &event.kind else {
                    continue;
                };
                let board_s = right.cycle_at(event.time_ms) as f64 / tests::nrf::time::HZ as f64;
                let since_s = board_s - start_s - 1.0 - REST_S;
                let gesture = (since_s / (GESTURE_S + REST_S)).floor();
                let onset_to_event_s = since_s - gesture * (GESTURE_S + REST_S);
                let meant = Motion::GESTURES.get(gesture as usize).map_or("idle", |g| g.label());
                if label == meant {
                    to_event_s.push(onset_to_event_s);
                } else {
                    others.push(format!("{}: {label} for {meant}", wearer.name));
                }
                if matches!(outcome, GestureOutcome::Started(_)) {
                    deciding = Some(sampled_at(right, *window_end_board_ms));
                }
            }
            seen = desk.log.len();
            if let Some(sample) = deciding
                && desk.arm_moves()
            {
                to_arm_ms.push(passed_ms(right.cycle_at(now_ms) - sample));
                deciding = None;
                // The next gesture gets a new robot at rest.
                desk.robot = Stage::bare().simulated(&Config::default());
            }
        }
    }
    let mut waiting_s = to_event_s.clone();
    to_arm_ms.sort_by(f64::total_cmp);
    waiting_s.sort_by(f64::total_cmp);
    println!(
        "{} gestures of {wearers} wearers over {link:?}, {} named otherwise {others:?}",
        to_arm_ms.len(),
        others.len()
    );
    println!("{:<58}{:>10}{:>10}{:>8}", "", "median", "worst", "limit");
    println!(
        "{:<58}{:>7.1} ms{:>7.1} ms{:>8}",
        "last sample of the deciding hop to first joint velocity",
        median(&to_arm_ms),
        to_arm_ms.last().unwrap(),
        "50 ms"
    );
    println!(
        "{:<58}{:>8.2} s{:>8.2} s{:>8}",
        "onset of the gesture to its event",
        median(&waiting_s),
        waiting_s.last().unwrap(),
        "none"
    );
    assert!(to_arm_ms.len() >= 5 * wearers as usize, "{} gestures", to_arm_ms.len());
    assert!(*to_arm_ms.last().unwrap() <= 50.0);
}

/// The right hand performs to-fro strokes for 3 s in every 10 s, starting at 4 s.
fn strokes(count: usize) -> impl FnOnce(f64) -> Replay {
    let mut script = vec![Segment::new(Motion::IDLE, 4.0)];
    for _ in 0..count {
        script.push(Segment::new(Motion::ToFro, 3.0));
        script.push(Segment::new(Motion::IDLE, 7.0));
    }
    let rows = rows(&session(&RightWearer::demo(2), 0, &script));
    move |start| Replay { rows, interval: 0.01, start }
}

/// Creates a desk on which the test controls the left hand.
struct Steered {
    desk: TwoHands,
    hand: Rc<RefCell<Hand>>,
}

impl Steered {
    fn new(link: Cable, count: usize) -> Self {
        let (mut nano, hand) = left_hand(31);
        nano.run_ms(600.0);
        let right = Right::start(link, strokes(count));
        Self { desk: TwoHands::new(Some(Left::new(nano)), Some(right)), hand }
    }

    fn tilt(&mut self, pitch_rad: f64) {
        self.hand.borrow_mut().tilt(pitch_rad, 0.0, self.desk.left_seconds(), 0.1);
    }

    /// Drives forward until a stroke has also started the arm.
    fn both_move(&mut self) {
        self.tilt(0.0);
        self.desk.run_until("armed", 8000, TwoHands::is_armed);
        // The tilt begins half a second before the next stroke.
        let strokes_before = (self.desk.now_ms() + 500).saturating_sub(4000).div_ceil(10_000);
        self.desk.run_ms(3500 + 10_000 * strokes_before - self.desk.now_ms());
        self.tilt(FORWARD_RAD);
        self.desk.run_until("the arm", 4000, TwoHands::arm_moves);
        self.desk.run_ms(300);
        assert!(self.desk.base_moves() && self.desk.arm_moves(), "both move");
    }

    /// Checks that the robot halts because of this hand's silence, and returns the time when it came to rest.
    fn halts(&mut self, hand: Which) -> (u64, u64) {
        let halted_ms = self.desk.run_until("a halt", 260, |d| !d.is_armed());
        let rests = |d: &TwoHands| !d.base_moves() && !d.arm_moves();
        let rested_ms = halted_ms + self.desk.run_until("rest", 1500, rests);
        let halt = self.desk.log.iter().rev().find_map(|event| match event.kind {
            EventKind::Halt { reason } => Some(reason),
            _ => None,
        });
        assert_eq!(halt, Some(HaltReason::Silence(hand)));
        (halted_ms, rested_ms)
    }

    /// Checks that nothing moves while the left hand remains tilted, and that the robot moves again after neutral.
    fn needs_neutral(&mut self, what: &str) {
        for _ in 0..3500 {
            self.desk.step();
            assert!(!self.desk.base_moves() && !self.desk.arm_moves(), "{what}: moves without neutral");
        }
        self.tilt(0.0);
        self.desk.run_until("armed again", 1000, TwoHands::is_armed);
        self.desk.run_ms(300);
        self.tilt(FORWARD_RAD);
        self.desk.run_until("the base drives again", 300, TwoHands::base_moves);
        self.tilt(0.0);
        self.desk.run_until("the base stops again", 1500, |d| !d.base_moves());
    }
}

fn say(what: &str, (halted_ms, rested_ms): (u64, u64)) {
    println!("{what:<36} halt after {halted_ms:>3} ms, at rest after {rested_ms:>4} ms, then needs neutral");
}

#[test]
fn a_cable_pulled_in_mid_drive_stops_base_and_arm_and_put_back_it_needs_neutral() {
    let mut steered = Steered::new(Cable::Uart, 6);

    steered.both_move();
    steered.desk.left.as_mut().unwrap().cable = false;
    say("left cable pulled", steered.halts(Which::Left));
    steered.desk.run_ms(500);
    steered.desk.left.as_mut().unwrap().cable = true;
    steered.needs_neutral("left cable put back");

    steered.both_move();
    let Some(right) = &mut steered.desk.right else { unreachable!() };
    right.wire = Wire::Uart(false);
    say("right cable (UART) pulled", steered.halts(Which::Right));
    steered.desk.run_ms(500);
    steered.desk.right.as_mut().unwrap().wire = Wire::Uart(true);
    steered.needs_neutral("right cable (UART) put back");

    // The left cable also powers the board. After the reconnection, the board restarts while the hand is still tilted.
    steered.both_move();
    steered.desk.left.as_mut().unwrap().cable = false;
    say("left board without power", steered.halts(Which::Left));
    steered.desk.run_ms(500);
    let (wearer, hand) = Wearer::new(Sensors::nominal(), (0.0, 0.0), None, Rng::with_seed(32));
    hand.borrow_mut().tilt(FORWARD_RAD, 0.0, 0.0, 0.0);
    let now_ms = steered.desk.now_ms();
    steered.desk.left.as_mut().unwrap().power_again(now_ms, Box::new(wearer));
    steered.hand = hand;
    steered.needs_neutral("left board with power again");
}

#[test]
fn a_usb_cable_pulled_and_a_touch_at_1200_baud_stop_the_robot() {
    let mut steered = Steered::new(Cable::Usb, 4);

    steered.both_move();
    let pull = |right: &mut Right| {
        let Wire::Usb(host) = &mut right.wire else { unreachable!() };
        host.unplug(&mut right.board);
    };
    pull(steered.desk.right.as_mut().unwrap());
    say("right cable (USB) pulled", steered.halts(Which::Right));
    steered.desk.run_ms(500);
    let right = steered.desk.right.as_mut().unwrap();
    let Wire::Usb(host) = &mut right.wire else { unreachable!() };
    host.plug_in(&mut right.board);
    steered.needs_neutral("right cable (USB) put back");

    steered.both_move();
    let right = steered.desk.right.as_mut().unwrap();
    let Wire::Usb(host) = &mut right.wire else { unreachable!() };
    host.touch();
    // The watchdog resets the board within its two seconds.
    steered.desk.run_until("the bootloader", 2200, |d| d.right.as_ref().unwrap().board.in_bootloader);
    say("right board touched at 1200 baud", steered.halts(Which::Right));
}

/// The noise of a cable. Of the bytes from a board, `damaged` parts per thousand are damaged.
/// The cable adds bytes in `disturbed` parts per thousand of all milliseconds.
/// The lines to the boards are always half full of noise.
fn noise(damaged: u32, disturbed: u32, mut rng: Rng) -> Disturbance {
    Box::new(move |_, bytes| {
        for byte in bytes.iter_mut() {
            if rng.u32(..1000) < damaged {
                *byte ^= 1 << rng.u8(..8);
            }
        }
        if rng.u32(..1000) < disturbed {
            let at = rng.usize(..=bytes.len());
            bytes.splice(at..at, (0..rng.usize(1..9)).map(|_| rng.u8(..)).collect::<Vec<_>>());
        }
        (0..6).map(|_| if rng.u8(..) < 20 { 0 } else { rng.u8(..) }).collect()
    })
}

#[test]
fn random_bytes_on_both_links_move_nothing_that_the_hands_do_not() {
    // A damaged frame at an unfavourable moment stops driving for a second, so some driving remains in eight seconds.
    let seconds = if is_full() { 60 } else { 8 };
    let (mut nano, hand) = left_hand(33);
    nano.run_ms(600.0);
    let right = Right::start(Cable::Uart, |_| Still);
    let mut desk = TwoHands::new(Some(Left::new(nano)), Some(right));
    desk.run_until("armed", 5000, TwoHands::is_armed);
    let tilt = |desk: &TwoHands, pitch_rad| {
        hand.borrow_mut().tilt(pitch_rad, 0.0, desk.left_seconds(), 0.1);
    };
    let mut paths_m = Vec::new();
    for (damaged, disturbed) in [(1, 8), (12, 200)] {
        desk.disturbance = Some(noise(damaged, disturbed, Rng::with_seed(u64::from(damaged))));
        let before_m = desk.robot.picture().odometry.path_m;
        for second in 0..seconds {
            let tilted = second % 2 == 1;
            tilt(&desk, if tilted { FORWARD_RAD } else { 0.0 });
            for ms in 0..1000 {
                desk.step();
                let twist = desk.bridge.twist();
                // The base drives forward or halts.
                // After the hand returns to neutral, the last command may persist for 300 ms.
                assert!(twist.linear_m_s >= 0.0 && twist.angular_rad_s == 0.0, "{twist:?}");
                assert!(tilted || ms < 300 || twist.linear_m_s == 0.0, "{twist:?} at neutral");
                assert!(!desk.arm_moves());
            }
        }
        paths_m.push(desk.robot.picture().odometry.path_m - before_m);
    }
    desk.disturbance = None;
    let damaged = [Which::Left, Which::Right].map(|hand| desk.bridge.link(hand).counters().damaged);
    println!(
        "{} s of noise on both links: {damaged:?} damaged frames counted, forward by {:.2} m with a bad cable and by \
         {:.2} m with a hopeless one",
        2 * seconds,
        paths_m[0],
        paths_m[1]
    );
    assert!(damaged.iter().all(|&count| u64::from(count) >= seconds));
    assert!(paths_m[0] > 0.1, "a bad cable does not keep the hand from driving");
    let here = desk.robot.picture().odometry;
    assert!(here.y_m.abs() < 1e-9 && here.heading_rad.abs() < 1e-9, "{here:?}");
    assert_eq!(desk.left.as_ref().unwrap().nano.resets(), 0);
    assert!(desk.right.as_ref().unwrap().board.resets.iter().all(|&reason| reason == 4));
    tilt(&desk, 0.0);
    desk.run_until("armed after the noise", 3000, TwoHands::is_armed);
    desk.run_ms(500);
    tilt(&desk, FORWARD_RAD);
    desk.run_until("the base follows the hand again", 400, TwoHands::base_moves);
}
