//! Tests faults of the emulated Nano: none of them may move the robot, hang the board or destroy a calibration.
#![cfg(feature = "avr")]

use std::cell::RefCell;
use std::rc::Rc;

use fastrand::Rng;
use shared_proto::message::{
    AckResult, CalibrationStep, FaultKind, Heading, HostMessage, LeftState, Mode, TiltThresholds, health,
};
use tests::avr::image;
use tests::avr::nano::EEPROM_BYTES;
use tests::avr::session::{BLANK, LeftRig, Seen};
use tests::avr::street::Street;
use tests::avr::wearer::{Fault, Hand, Sensors, Wearer};
use tests::is_full;

const FORWARD_RAD: f64 = 0.52;

fn powered(eeprom: &[u8; EEPROM_BYTES], seed: u64) -> (LeftRig, Rc<RefCell<Hand>>) {
    let (wearer, hand) = Wearer::new(Sensors::nominal(), (0.0, 0.0), None, Rng::with_seed(seed));
    (LeftRig::new(&image::path(), eeprom, Box::new(wearer)), hand)
}

fn now_s(session: &LeftRig) -> f64 {
    session.now_ms() / 1000.0
}

fn last(states: &[(f64, LeftState)]) -> LeftState {
    states.last().expect("the board sends states").1
}

const FAULTS: [(&str, Fault, u8); 19] = [
    ("x open", Fault::Open(0), health::SENSOR),
    ("y open", Fault::Open(1), health::SENSOR),
    ("z open", Fault::Open(2), health::SENSOR),
    ("index open", Fault::Open(3), health::FLEX),
    ("middle open", Fault::Open(4), health::FLEX),
    ("x to ground", Fault::Shorted(0, 0.0), health::SENSOR),
    ("y to ground", Fault::Shorted(1, 0.0), health::SENSOR),
    ("z to ground", Fault::Shorted(2, 0.0), health::SENSOR),
    ("index to ground", Fault::Shorted(3, 0.0), health::FLEX),
    ("middle to ground", Fault::Shorted(4, 0.0), health::FLEX),
    ("x to 3.3 V", Fault::Shorted(0, 3300.0), health::SENSOR),
    ("y to 3.3 V", Fault::Shorted(1, 3300.0), health::SENSOR),
    ("z to 3.3 V", Fault::Shorted(2, 3300.0), health::SENSOR),
    ("index to 3.3 V", Fault::Shorted(3, 3300.0), health::FLEX),
    ("middle to 5 V", Fault::Shorted(4, 5000.0), health::FLEX),
    ("gravity 0", Fault::Gravity(0.0), health::GRAVITY),
    ("gravity 0.3 g", Fault::Gravity(0.3), health::GRAVITY),
    ("gravity 2 g", Fault::Gravity(2.0), health::GRAVITY),
    ("converter stuck", Fault::Stuck, health::STUCK),
];

#[test]
fn each_sensor_fault_halts_the_hand_until_neutral() {
    println!("{:<18}{:>14}{:>12}", "fault", "flag after ms", "commands");
    for (name, fault, bit) in FAULTS {
        for tilted in [false, true] {
            // Each fault gets a new board, because a line fault that returns soon remains active.
            let (mut session, hand) = powered(&BLANK, 7);
            session.run_ms(300.0);
            let angle = if tilted { FORWARD_RAD } else { 0.0 };
            hand.borrow_mut().tilt(angle, 0.0, now_s(&session), 0.1);
            let before = last(&session.states(400.0));
            assert_eq!(before.heading, if tilted { Heading::Forward } else { Heading::Neutral }, "{name}");
            assert_eq!(before.health & !health::DEFAULT_CALIBRATION, 0, "{name}");
            // The fault starts between two ticks of the sample clock.
            session.run_ms(3.7);
            let start_ms = session.now_ms();
            hand.borrow_mut().fault = Some(fault);
            let states = session.states(2500.0);
            let flagged = states.iter().position(|(_, s)| s.health & bit != 0);
            let flagged = flagged.unwrap_or_else(|| panic!("{name} is not noticed"));
            let after_ms = states[flagged].0 - start_ms;
            let limit_ms = match bit {
                health::GRAVITY => 250.0,
                health::STUCK => 1050.0,
                _ => 50.0,
            };
            assert!(after_ms <= limit_ms, "{name}: noticed after {after_ms:.0} ms");
            let commands = states[flagged..].iter().filter(|(_, s)| s.heading.is_command()).count();
            assert_eq!(commands, 0, "{name}");
            // The old heading may remain until the fault flag is set, but no other command may appear.
            let strange =
                states[..flagged].iter().find(|(_, s)| s.heading.is_command() && s.heading != before.heading);
            assert_eq!(strange, None, "{name}");
            if tilted {
                println!("{name:<18}{after_ms:>14.0}{commands:>12}");
            }
            let counted = last(&states);
            assert_eq!(
                (counted.index_bends, counted.middle_bends, counted.stop),
                (before.index_bends, before.middle_bends, false),
                "{name}"
            );
            // The fault is repaired while the hand is tilted forward. No command may appear until the hand has been neutral.
            hand.borrow_mut().fault = None;
            hand.borrow_mut().tilt(FORWARD_RAD, 0.0, now_s(&session), 0.01);
            let states = session.states(1500.0);
            assert!(states.iter().all(|(_, s)| !s.heading.is_command()), "{name}: moves without neutral");
            assert_eq!(last(&states).health & !health::DEFAULT_CALIBRATION, 0, "{name} goes away");
            assert_eq!(session.nano.resets(), 0);
        }
    }
}

#[test]
fn a_fault_stops_the_simulated_base() {
    let (session, hand) = powered(&BLANK, 8);
    let mut street = Street::new(session.nano);
    street.run_ms(600);
    let at = |street: &Street| street.now_ms() as f64 / 1000.0;
    hand.borrow_mut().tilt(FORWARD_RAD, 0.0, at(&street), 0.1);
    street.run_ms(800);
    assert!(street.moves(), "the base drives forward");
    hand.borrow_mut().fault = Some(Fault::Open(0));
    street.run_ms(1500);
    assert!(!street.moves(), "and stops with a broken wire");
    hand.borrow_mut().fault = None;
    street.run_ms(2000);
    assert!(!street.moves(), "and stays until the hand was neutral");
    hand.borrow_mut().tilt(0.0, 0.0, at(&street), 0.1);
    street.run_ms(500);
    hand.borrow_mut().tilt(FORWARD_RAD, 0.0, at(&street), 0.1);
    street.run_ms(500);
    assert!(street.moves(), "and drives again afterwards");
}

#[test]
fn a_converter_that_hangs_is_restarted() {
    const ADCSRA: usize = 0x7A;
    let (mut session, _hand) = powered(&BLANK, 9);
    session.run_ms(1500.0);
    // The converter switches off in the middle of a sample.
    for _ in 0..100 {
        session.nano.run_ms(0.1);
        session.nano.poke(ADCSRA, 0);
    }
    let mut errors = 0;
    for (_, seen) in session.run_ms(3000.0) {
        if let Seen::Status(status) = seen {
            errors = status.sensor_errors;
        }
    }
    assert_eq!(errors, 1, "one restart of the converter");
    assert_eq!(last(&session.states(100.0)).heading, Heading::Neutral);
}

/// Sends 10 minutes of random bytes at the full speed of the line (10 s in the short run).
#[test]
fn random_bytes_on_the_line_disturb_nothing() {
    let seconds = if is_full() { 600 } else { 10 };
    let (mut session, hand) = powered(&BLANK, 10);
    session.run_ms(500.0);
    let mut rng = Rng::with_seed(11);
    let (mut states, mut last_status, mut changes) = (0u32, None, 0u32);
    let mut tilted = false;
    for second in 0..seconds {
        // The number of bytes is the capacity of the emulated line.
        // Zeros are delimiters, so there are many short frames.
        let mut noise: Vec<u8> = (0..10_650).map(|_| if rng.u8(..) < 20 { 0 } else { rng.u8(..) }).collect();
        // Some frames are damaged copies of valid frames.
        let mut frame = [0; 64];
        let request = HostMessage::Calibrate { request: 1, step: CalibrationStep::Reset };
        let frame = shared_proto::frame::encode_host(&request, &mut frame).unwrap();
        let at = rng.usize(..noise.len() - frame.len());
        noise[at..at + frame.len()].copy_from_slice(frame);
        noise[at + rng.usize(1..frame.len() - 1)] ^= 1 << rng.u8(..8);
        session.nano.send(&noise);
        if second % 5 == 4 {
            tilted = !tilted;
            let angle = if tilted { FORWARD_RAD } else { 0.0 };
            hand.borrow_mut().tilt(angle, 0.0, now_s(&session), 0.1);
            let wanted = if tilted { Heading::Forward } else { Heading::Neutral };
            changes += u32::from(last(&session.states(300.0)).heading == wanted);
            session.run_ms(700.0);
        } else {
            for (_, seen) in session.run_ms(1000.0) {
                match seen {
                    Seen::Left(state) => {
                        states += 1;
                        assert_eq!(state.heading.is_command(), tilted, "second {second}");
                    }
                    Seen::Status(status) => last_status = Some(status),
                    Seen::Ack(ack) => panic!("noise was taken for a request: {ack:?}"),
                    _ => {}
                }
            }
        }
    }
    let status = last_status.expect("a status per second");
    println!(
        "{seconds} s of noise: {states} states, {} damaged frames counted, {} dropped samples, load {} ‰",
        status.bad_frames, status.dropped_samples, status.load_permille
    );
    assert!(status.bad_frames > 1000);
    assert_eq!(status.dropped_samples, 0, "the sampling never waits for the line");
    assert_eq!(changes, seconds / 5, "the hand is followed all the time");
    assert_eq!(session.nano.resets(), 0);
}

#[test]
fn requests_are_answered() {
    let (mut session, _hand) = powered(&BLANK, 12);
    let start = session.run_ms(300.0);
    assert!(matches!(&start[0].1, Seen::Hello(_, firmware) if firmware == "0.1.0"), "{:?}", start[0]);
    let thresholds = |start_mrad| TiltThresholds { neutral_mrad: 87, end_mrad: 209, start_mrad };
    let unsound = HostMessage::SetThresholds { request: 4, thresholds: thresholds(200) };
    for (request, message, result) in [
        (2, HostMessage::SetMode { request: 2, mode: Mode::Record }, AckResult::Ok),
        (3, HostMessage::SetThresholds { request: 3, thresholds: thresholds(300) }, AckResult::Ok),
        (4, unsound, AckResult::OutOfRange),
        (5, HostMessage::SetMode { request: 5, mode: Mode::Idle }, AckResult::Ok),
    ] {
        session.send(&message);
        let heard = session.run_ms(60.0);
        let answer = heard.iter().find_map(|(_, s)| if let Seen::Ack(a) = s { Some(*a) } else { None });
        assert_eq!(answer.map(|a| (a.request, a.result)), Some((request, result)));
    }
    assert!(session.states(500.0).is_empty(), "idle: status only");
    session.send(&HostMessage::SetMode { request: 6, mode: Mode::Record });
    let heard = session.run_ms(1000.0);
    let times: Vec<u32> = heard
        .iter()
        .filter_map(|(_, s)| if let Seen::Raw(raw) = s { Some(raw.board_time_ms) } else { None })
        .collect();
    assert!((95..=100).contains(&times.len()), "each sample: {}", times.len());
    assert!(times.windows(2).all(|pair| pair[1] - pair[0] == 10), "none missing: {times:?}");
    session.send(&HostMessage::SetMode { request: 7, mode: Mode::Classify });
    session.send(&HostMessage::Ping { id: 77 });
    session.send(&HostMessage::HelloRequest);
    let heard = session.run_ms(1100.0);
    assert!(heard.iter().any(|(_, s)| *s == Seen::Pong(77)));
    assert!(heard.iter().any(|(_, s)| matches!(s, Seen::Hello(..))));
    assert!(heard.iter().any(|(_, s)| matches!(s, Seen::Status(_))));
    let states = session.states(2000.0);
    assert!((100..=104).contains(&states.len()), "50 per second: {}", states.len());
    assert!(states.windows(2).all(|w| w[1].1.sequence == w[0].1.sequence.wrapping_add(1)));
}

#[test]
fn under_an_old_bootloader_a_hanging_program_starts_again_without_a_reset_and_says_so() {
    const TIMSK1: usize = 0x6F;
    let (mut session, hand) = powered(&BLANK, 13);
    session.nano.pretend_old_bootloader();
    hand.borrow_mut().tilt(FORWARD_RAD, 0.0, 0.5, 0.1);
    let start = session.run_ms(1000.0);
    let boot = |heard: &[(f64, Seen)]| {
        heard.iter().find_map(|(_, s)| if let Seen::Hello(id, _) = s { Some(*id) } else { None })
    };
    // The sample clock stops, so no interrupt wakes the program.
    session.nano.poke(TIMSK1, 0);
    let heard = session.run_ms(1500.0);
    let watchdog = |heard: &[(f64, Seen)]| {
        heard.iter().any(|(_, s)| matches!(s, Seen::Fault(f) if f.kind == FaultKind::Watchdog))
    };
    assert!(watchdog(&heard), "the restart is reported");
    assert_ne!(boot(&heard), boot(&start), "with a new boot id");
    assert!(boot(&heard).is_some());
    assert_eq!(session.nano.resets(), 0, "no reset: an old bootloader is never entered");
    let restarted = heard.iter().position(|(_, s)| matches!(s, Seen::Hello(..))).unwrap();
    let moved = heard[restarted..].iter().any(|(_, s)| matches!(s, Seen::Left(l) if l.heading.is_command()));
    assert!(!moved, "the hand is still tilted: neutral comes first");
}

#[test]
fn a_program_that_hangs_is_reset_and_says_so_whatever_bootloader_hides_the_reason() {
    const TIMSK1: usize = 0x6F;
    for optiboot in [false, true] {
        let (mut session, hand) = powered(&BLANK, 27);
        if optiboot {
            session.nano.pretend_optiboot();
        }
        hand.borrow_mut().tilt(FORWARD_RAD, 0.0, 0.5, 0.1);
        let start = session.run_ms(1000.0);
        let boot = |heard: &[(f64, Seen)]| {
            heard.iter().find_map(|(_, s)| if let Seen::Hello(id, _) = s { Some(*id) } else { None })
        };
        let watchdog = |heard: &[(f64, Seen)]| {
            heard.iter().any(|(_, s)| matches!(s, Seen::Fault(f) if f.kind == FaultKind::Watchdog))
        };
        assert!(!watchdog(&start));
        // The sample clock stops, so no interrupt wakes the program.
        session.nano.poke(TIMSK1, 0);
        let heard = session.run_ms(2000.0);
        assert_eq!(session.nano.resets(), 1, "optiboot {optiboot}");
        assert!(watchdog(&heard), "optiboot {optiboot}: the restart is reported");
        assert!(boot(&heard).is_some() && boot(&heard) != boot(&start), "with a new boot id");
        // A press of the reset button, or a laptop that opens the port, is not a fault.
        session.nano.reset();
        let heard = session.run_ms(1000.0);
        assert!(boot(&heard).is_some() && !watchdog(&heard), "optiboot {optiboot}: {heard:?}");
    }
}

#[test]
fn between_samples_the_processor_sleeps_for_real() {
    let (mut session, _hand) = powered(&BLANK, 28);
    session.run_ms(1000.0);
    assert!(session.nano.may_sleep(), "SMCR.SE: without it SLEEP does nothing");
    let (asleep, now) = (session.nano.asleep(), session.nano.cycle());
    let heard = session.run_ms(5000.0);
    let awake = 1.0 - (session.nano.asleep() - asleep) as f64 / (session.nano.cycle() - now) as f64;
    let status = heard.iter().rev().find_map(|(_, s)| if let Seen::Status(s) = s { Some(*s) } else { None });
    let said = f64::from(status.expect("a status per second").load_permille) / 1000.0;
    println!("awake {:.1} % of the time; the board says {:.1} %", awake * 100.0, said * 100.0);
    assert!((0.05..0.8).contains(&awake), "{awake}");
    assert!((said - awake).abs() < 0.05, "the board says {said}, it was {awake}");
}

#[test]
fn a_program_that_restarts_for_ever_does_not_wear_out_the_eeprom() {
    for optiboot in [false, true] {
        let (mut session, _hand) = powered(&BLANK, 29);
        if optiboot {
            session.nano.pretend_optiboot();
        }
        session.run_ms(500.0);
        let before = session.nano.eeprom_write_count();
        let mut ids = Vec::new();
        for _ in 0..12 {
            session.nano.jump(image::stop_program());
            for (_, seen) in session.run_ms(900.0) {
                if let Seen::Hello(id, _) = seen {
                    ids.push(id);
                }
            }
        }
        println!(
            "{} restarts, {} bytes of EEPROM written",
            session.nano.resets(),
            session.nano.eeprom_write_count() - before
        );
        assert!(session.nano.resets() >= 12 && ids.len() >= 12);
        assert_eq!(session.nano.eeprom_write_count(), before, "optiboot {optiboot}");
        let count = ids.len();
        ids.sort_unstable();
        ids.dedup();
        assert_eq!(ids.len(), count, "each start has an id of its own");
    }
}

#[test]
fn nothing_is_kept_at_address_0_of_the_eeprom() {
    let (mut session, hand) = powered(&BLANK, 30);
    session.run_ms(300.0);
    for pose in [0.05, NEW_POSE, OLD_POSE] {
        assert_eq!(calibrate_at(&mut session, &hand, pose), AckResult::Ok);
    }
    // A supply dip may write the byte at the controller's reset address.
    let lowest = session.nano.eeprom_writes().iter().map(|write| write.address).min();
    assert_eq!(lowest, Some(0x20));
}

#[test]
fn a_program_that_hangs_with_interrupts_off_is_reset_and_says_so() {
    let (mut session, _hand) = powered(&BLANK, 14);
    session.run_ms(1000.0);
    // The program enters an endless loop with interrupts disabled, as at the end of a C program.
    session.nano.jump(image::stop_program());
    let heard = session.run_ms(2000.0);
    // The interrupt remains pending, so the second time-out of the watchdog resets the board.
    assert_eq!(session.nano.resets(), 1, "the watchdog resets");
    assert!(heard.iter().any(|(_, s)| matches!(s, Seen::Fault(f) if f.kind == FaultKind::Watchdog)));
    assert!(heard.iter().any(|(_, s)| matches!(s, Seen::Left(_))), "and the board lives again");
}

/// Under the old bootloader, a program that hangs with interrupts disabled is not reset.
/// The board is silent, the robot is at rest, and a reset helps.
#[test]
fn under_an_old_bootloader_a_program_that_hangs_with_interrupts_off_is_silent_until_the_port_is_opened() {
    let (mut session, hand) = powered(&BLANK, 26);
    session.nano.pretend_old_bootloader();
    let mut street = Street::new(session.nano);
    street.run_ms(600);
    hand.borrow_mut().tilt(FORWARD_RAD, 0.0, street.now_ms() as f64 / 1000.0, 0.1);
    street.run_ms(800);
    assert!(street.moves());
    street.nano.jump(image::stop_program());
    street.run_ms(1500);
    assert!(!street.moves(), "silence stops the robot");
    assert_eq!(street.nano.resets(), 0, "and no reset leads into the trap");
    street.nano.reset();
    street.run_ms(1000);
    assert!(!street.moves(), "a new start needs neutral");
    hand.borrow_mut().tilt(0.0, 0.0, street.now_ms() as f64 / 1000.0, 0.1);
    street.run_ms(600);
    hand.borrow_mut().tilt(FORWARD_RAD, 0.0, street.now_ms() as f64 / 1000.0, 0.1);
    street.run_ms(600);
    assert!(street.moves(), "and then the hand drives again");
}

#[test]
fn no_reference_but_aref_is_ever_selected() {
    let (mut session, _hand) = powered(&BLANK, 15);
    session.run_ms(2000.0);
    // `run_ms` panics if the converter's reference is wrong, so this run checks the reference.
    assert_eq!(session.nano.peek(0x7C) >> 6, 0);
    assert!(session.nano.conversions() > 8000, "45 conversions per sample, 100 samples per second");
}

#[test]
#[should_panic(expected = "any reference but AREF")]
fn the_watch_on_the_reference_sees_a_wrong_one() {
    let (mut session, _hand) = powered(&BLANK, 16);
    session.run_ms(500.0);
    session.nano.execute_sts(0x7C, 0x40);
    session.run_ms(100.0);
}

/// The pose of the calibration before the power cut, and the pose of the calibration after it.
const OLD_POSE: f64 = 0.0;
const NEW_POSE: f64 = 0.12;

/// Calibrates neutral at `pose`, in radians forward.
fn calibrate_at(session: &mut LeftRig, hand: &Rc<RefCell<Hand>>, pose: f64) -> AckResult {
    hand.borrow_mut().tilt(pose, 0.0, now_s(session), 0.0);
    session.run_ms(100.0);
    session.calibrate(CalibrationStep::Neutral)
}

/// Returns the pitch and health that a board with this EEPROM reports for a hand in this pose.
fn pitch_after_power_on(eeprom: &[u8; EEPROM_BYTES], pose: f64) -> (f64, u8, bool) {
    let (mut session, hand) = powered(eeprom, 17);
    hand.borrow_mut().tilt(pose, 0.0, 0.0, 0.0);
    let heard = session.run_ms(150.0);
    let damaged =
        heard.iter().any(|(_, s)| matches!(s, Seen::Fault(f) if f.kind == FaultKind::CalibrationDamaged));
    let state = last(&session.states(100.0));
    (f64::from(state.pitch_mrad) / 1000.0, state.health, damaged)
}

#[test]
fn a_power_cut_at_any_byte_keeps_a_good_calibration() {
    // Creates boards with a good calibration, once in each of the two slots.
    let (mut session, hand) = powered(&BLANK, 18);
    session.run_ms(300.0);
    assert_eq!(calibrate_at(&mut session, &hand, 0.05), AckResult::Ok);
    let one = session.nano.eeprom();
    assert_eq!(calibrate_at(&mut session, &hand, OLD_POSE), AckResult::Ok);
    let two = session.nano.eeprom();
    let mut rng = Rng::with_seed(19);
    let (mut cuts, mut kept_old, mut have_new) = (0, 0, 0);
    for (before, old_pose) in [(one, 0.05), (two, OLD_POSE)] {
        // Records every byte that the board writes for the next calibration.
        let (mut session, hand) = powered(&before, 20);
        session.run_ms(300.0);
        let counted = session.nano.eeprom_write_count();
        assert_eq!(calibrate_at(&mut session, &hand, NEW_POSE), AckResult::Ok);
        let writes = session.nano.eeprom_writes()[counted..].to_vec();
        assert!(writes.len() >= 6, "a record was written: {writes:?}");
        let mut eeprom = before;
        // The board had already written its start counter.
        for write in &session.nano.eeprom_writes()[..counted] {
            eeprom[write.address as usize] = write.new;
        }
        for (i, write) in writes.iter().enumerate() {
            let place = write.address as usize;
            assert_eq!(eeprom[place], write.old);
            // The power fails before this byte or during its write, when the cell may contain any value.
            for in_flight in [write.old, 0xFF, rng.u8(..)] {
                eeprom[place] = in_flight;
                let (pitch, health, _) = pitch_after_power_on(&eeprom, 0.0);
                let error = |pose: f64| (pitch + pose).abs();
                assert_eq!(health & health::DEFAULT_CALIBRATION, 0, "byte {i} of {}: lost", writes.len());
                let is_last = i + 1 == writes.len() && in_flight == write.new;
                assert!(error(old_pose) < 0.02 || (is_last && error(NEW_POSE) < 0.02), "byte {i}: {pitch}");
                cuts += 1;
                kept_old += u32::from(error(old_pose) < 0.02);
            }
            eeprom[place] = write.new;
        }
        // After the last byte, the new calibration is valid.
        let (pitch, health, _) = pitch_after_power_on(&eeprom, 0.0);
        assert_eq!(health & health::DEFAULT_CALIBRATION, 0);
        assert!((pitch + NEW_POSE).abs() < 0.02, "{pitch}");
        cuts += 1;
        have_new += 1;
    }
    println!("{cuts} power cuts: old calibration after {kept_old}, new one after {have_new}, none lost");
}

#[test]
fn a_damaged_record_falls_back_to_defaults_and_is_reported() {
    let (mut session, hand) = powered(&BLANK, 21);
    session.run_ms(300.0);
    assert_eq!(calibrate_at(&mut session, &hand, NEW_POSE), AckResult::Ok);
    let good = session.nano.eeprom();
    let (pitch, health, damaged) = pitch_after_power_on(&good, NEW_POSE);
    assert!(pitch.abs() < 0.02 && health == 0 && !damaged, "{pitch} {health}");
    for place in 0x20..0x34 {
        let mut bad = good;
        bad[place] ^= 0x10;
        let (pitch, health, damaged) = pitch_after_power_on(&bad, 0.0);
        assert_eq!(health, health::DEFAULT_CALIBRATION, "byte {place}");
        assert!(damaged, "byte {place} is reported");
        assert!(pitch.abs() < 0.02, "defaults: {pitch}");
    }
    // A board without any calibration reports no damage.
    let (_, health, damaged) = pitch_after_power_on(&BLANK, 0.0);
    assert!(health == health::DEFAULT_CALIBRATION && !damaged);
}

#[test]
fn reset_forgets_the_calibration() {
    let (mut session, hand) = powered(&BLANK, 22);
    session.run_ms(300.0);
    assert_eq!(calibrate_at(&mut session, &hand, NEW_POSE), AckResult::Ok);
    assert_eq!(calibrate_at(&mut session, &hand, NEW_POSE), AckResult::Ok);
    assert_eq!(session.calibrate(CalibrationStep::Reset), AckResult::Ok);
    let (_, health, damaged) = pitch_after_power_on(&session.nano.eeprom(), 0.0);
    assert!(health == health::DEFAULT_CALIBRATION && !damaged);
}

#[test]
fn an_unsteady_hand_keeps_its_old_calibration() {
    let (mut session, hand) = powered(&BLANK, 23);
    session.run_ms(300.0);
    hand.borrow_mut().tilt(0.4, 0.0, now_s(&session), 1.0);
    assert_eq!(session.calibrate(CalibrationStep::Neutral), AckResult::Unsteady);
    hand.borrow_mut().tilt(0.0, 0.0, now_s(&session), 0.1);
    let state = last(&session.states(500.0));
    assert_eq!((state.heading, state.health), (Heading::Neutral, health::DEFAULT_CALIBRATION));
}

#[test]
fn the_pin_at_power_on_calibrates_by_the_light() {
    let (mut session, hand) = powered(&BLANK, 24);
    session.nano.hold_calibration_pin(true);
    hand.borrow_mut().tilt(NEW_POSE, 0.0, 0.0, 0.0);
    let mut blinks = 0;
    let mut was_on = false;
    for _ in 0..300 {
        session.run_ms(10.0);
        blinks += u32::from(session.nano.light() && !was_on);
        was_on = session.nano.light();
    }
    assert!((2..=4).contains(&blinks), "slow blink while the hand gets ready: {blinks}");
    session.run_ms(1500.0);
    for finger in 0..2 {
        hand.borrow_mut().bend(finger, 1.0, now_s(&session), 0.2);
    }
    let heard = session.states(4500.0);
    assert!(heard.iter().all(|(_, s)| !s.heading.is_command() && s.index_bends == 0 && s.middle_bends == 0));
    assert!(!session.nano.light(), "done");
    let (pitch, health, _) = pitch_after_power_on(&session.nano.eeprom(), NEW_POSE);
    assert!(pitch.abs() < 0.02 && health == 0, "{pitch} {health}");
}

#[test]
fn each_power_on_has_its_own_boot_id() {
    let mut eeprom = BLANK;
    let mut seen = Vec::new();
    for _ in 0..5 {
        let (mut session, _hand) = powered(&eeprom, 25);
        let heard = session.run_ms(100.0);
        let id = heard.iter().find_map(|(_, s)| if let Seen::Hello(id, _) = s { Some(*id) } else { None });
        let id = id.expect("a hello at start");
        assert!(!seen.contains(&id), "{seen:?} {id}");
        seen.push(id);
        eeprom = session.nano.eeprom();
    }
}

#[test]
fn the_image_fits() {
    let (flash, ram) = image::size();
    let (unused, stack) = tests::avr::trials::stack();
    println!("{:<32}{:>8}{:>10}", "bytes", "here", "allowed");
    println!("{:<32}{flash:>8}{:>10}", "flash", 24 * 1024);
    println!("{:<32}{ram:>8}", "static RAM");
    println!("{:<32}{stack:>8}", "deepest stack");
    println!("{:<32}{:>8}{:>10}", "static RAM + deepest stack", ram + stack as u64, 1536);
    assert!(flash <= 24 * 1024);
    assert!(ram + stack as u64 <= 1536);
    assert!(unused > 0 && image::static_end() == 0x100 + ram as usize);
}
