//! Tests the path from voltages at the pins of the emulated Nano to the wheels of the simulated base.
#![cfg(feature = "avr")]

use std::cell::RefCell;
use std::rc::Rc;

use fastrand::Rng;
use shared_proto::message::CalibrationStep;
use tests::avr::image;
use tests::avr::nano::{CYCLES_PER_MS, Nano, PinInput};
use tests::avr::session::{BLANK, LeftRig};
use tests::avr::street::Street;
use tests::avr::wearer::{Sensors, Wearer, normal};
use tests::is_full;

/// Returns pin voltages of a nominal hand that tilts forward in a single step at a given clock cycle.
fn stepping(at: Rc<RefCell<(u64, f64)>>) -> impl FnMut(u8, u64) -> PinInput {
    let mut rng = Rng::with_seed(5);
    move |pin, cycle| {
        let (step, angle) = *at.borrow();
        let angle = if cycle >= step { angle } else { 0.0 };
        let g = match pin {
            0 => angle.sin(),
            1 => 0.0,
            2 => angle.cos(),
            _ => return PinInput::Millivolts(3300.0 * 22.0 / 32.0 + 1.6 * normal(&mut rng)),
        };
        PinInput::Millivolts(1650.0 + 330.0 * g + 1.8 * normal(&mut rng))
    }
}

#[test]
fn a_voltage_step_that_stays_turns_the_wheels_within_150_ms() {
    let phases = if is_full() { 50 } else { 10 };
    println!("from the voltage step to the first wheel speed, {phases} phases of the sample clock each");
    println!("{:>8}{:>12}{:>12}{:>10}", "tilt", "median ms", "worst ms", "limit");
    for degrees in [20.0_f64, 30.0, 45.0] {
        let step = Rc::new(RefCell::new((u64::MAX, degrees.to_radians())));
        let nano = Nano::new(&image::path(), &BLANK, Box::new(stepping(Rc::clone(&step))));
        let mut street = Street::new(nano);
        street.run_ms(500);
        let mut latencies = Vec::new();
        for phase in 0..phases {
            // The steps are spread evenly over the 10 ms sample period. Each step starts at rest in neutral.
            let at = (street.now_ms() / 10 + 5) * 10 * CYCLES_PER_MS + phase * 10 * CYCLES_PER_MS / phases;
            step.borrow_mut().0 = at;
            while !street.moves() {
                street.step();
                assert!(street.now_ms() < at / CYCLES_PER_MS + 400, "no motion after {degrees}°");
            }
            latencies.push(street.now_ms() as f64 - at as f64 / CYCLES_PER_MS as f64);
            step.borrow_mut().0 = u64::MAX;
            // The pause is long enough that the next step does not count as shaking.
            street.run_ms(1500);
            while street.moves() {
                street.step();
            }
        }
        latencies.sort_by(f64::total_cmp);
        let (median, worst) = (latencies[latencies.len() / 2], latencies[latencies.len() - 1]);
        println!("{degrees:>7}°{median:>12.1}{worst:>12.1}{:>10}", 150);
        println!(
            "paper: time from a tilt to {degrees:.0}° until the wheels react, median and maximum | not stated | {median:.0} and {worst:.0} ms"
        );
        // A tilt counts only if it persists, so that movements of a walking or shaken hand are not commands.
        assert!(worst <= 150.0, "{degrees}°: {worst:.1} ms");
    }
}

/// Replays the 10 s from the paper: hold, eight index bends to 1.00 m/s, steady, seven middle bends, hold.
#[test]
fn the_papers_speed_modulation_comes_out_of_the_emulated_board() {
    let (wearer, hand) = Wearer::new(Sensors::nominal(), (0.0, 0.0), None, Rng::with_seed(6));
    let mut session = LeftRig::new(&image::path(), &BLANK, Box::new(wearer));
    session.run_ms(300.0);
    for (step, depth) in
        [(CalibrationStep::Neutral, 0.0), (CalibrationStep::Rest, 0.0), (CalibrationStep::Bend, 1.0)]
    {
        let now_s = session.now_ms() / 1000.0;
        (0..2).for_each(|finger| hand.borrow_mut().bend(finger, depth, now_s, 0.1));
        session.run_ms(200.0);
        assert_eq!(session.calibrate(step), shared_proto::message::AckResult::Ok);
    }
    let now_s = session.now_ms() / 1000.0;
    (0..2).for_each(|finger| hand.borrow_mut().bend(finger, 0.0, now_s, 0.1));
    session.run_ms(500.0);

    let mut street = Street::new(session.nano);
    street.run_ms(1500);
    let start_ms = street.now_ms();
    let at = |ms: u64| (start_ms + ms) as f64 / 1000.0;
    // Columns: start and end in ms, action, values in the paper, final cap.
    let phases = [
        (0, 1000, "hold (neutral)", 0.00, 0.0, None, 0),
        (1000, 5200, "eight index bends", 1.00, 1.0, Some(0), 8),
        (5200, 6200, "steady", 1.00, 1.0, None, 0),
        (6200, 9000, "seven middle bends", 0.50, 0.9_f64.powi(7), Some(1), 7),
        (9000, 10_000, "hold (neutral)", 0.00, 0.0, None, 0),
    ];
    println!("{:>10}  {:<20}{:>8}{:>8}{:>10}{:>8}", "s", "phase", "paper", "cap", "commanded", "base");
    for (from, to, what, paper, expected, finger, bends) in phases {
        if from == 1000 {
            hand.borrow_mut().tilt(30f64.to_radians(), 0.0, at(from), 0.15);
        }
        if from == 9000 {
            hand.borrow_mut().tilt(0.0, 0.0, at(from), 0.15);
        }
        let step_ms = (to - from) / (bends + 1).max(1);
        let run_to = |street: &mut Street, ms: u64| {
            while street.now_ms() < ms {
                street.step();
                if (street.now_ms() - start_ms).is_multiple_of(50) {
                    let second = (street.now_ms() - start_ms) as f64 / 1000.0;
                    let cap = street.bridge.caps().linear_m_s;
                    let commanded = street.bridge.twist().linear_m_s;
                    println!("figure: speed | {second:.2} | {cap:.3} | {commanded:.3}");
                }
            }
        };
        for bend in 0..bends {
            run_to(&mut street, start_ms + from + step_ms * (bend + 1) - 100);
            let now_s = street.now_ms() as f64 / 1000.0;
            hand.borrow_mut().bend(finger.expect("a finger bends"), 0.9, now_s, 0.08);
            let unbent = street.now_ms() + 150;
            run_to(&mut street, unbent);
            let now_s = street.now_ms() as f64 / 1000.0;
            hand.borrow_mut().bend(finger.expect("a finger bends"), 0.0, now_s, 0.08);
        }
        run_to(&mut street, start_ms + to);
        let cap = street.bridge.caps().linear_m_s;
        let commanded = street.bridge.twist().linear_m_s;
        let base = host_bridge::robot::Door::picture(&street.robot).odometry.twist.linear_m_s;
        let span = format!("{:.1}–{:.1}", from as f64 / 1000.0, to as f64 / 1000.0);
        println!("{span:>10}  {what:<20}{paper:>8.2}{cap:>8.3}{commanded:>10.3}{base:>8.3}");
        println!("paper: speed profile, {span} s, {what} | {paper:.2} m/s | {commanded:.3} m/s");
        assert!((commanded - expected).abs() <= 0.01, "{what}: commanded {commanded:.3}, not {expected:.3}");
    }
}
