//! Tests that bends change the arm's speed while the arm moves: on its path, within its limits and without a jump.
//! The setting `arm` in `[speed]` permits it.
//! All tests run in virtual time, with both hands.

mod support;

use host_bridge::arm::gen3::paper_limits;
use host_bridge::bridge::{EventKind, GestureOutcome};
use host_bridge::config::Config;
use host_bridge::robot::{JOINTS, Joints};
use host_bridge::safety::{Hand, State};
use shared_proto::message::Heading;
use support::{Rig, Virtual as _, pose};

/// Labels of the rig's right hand.
const UP_DOWN: u8 = 1;
const TO_FRO: u8 = 2;

/// Checks the arm from one millisecond to the next.
struct Watch {
    joints_rad: Joints,
    velocity_rad_s: Joints,
}

impl Watch {
    fn new(rig: &Rig) -> Self {
        let arm = rig.robot.arm();
        Watch { joints_rad: arm.joints_rad, velocity_rad_s: arm.velocity_rad_s }
    }

    fn run(&mut self, rig: &mut Rig, ms: u64) {
        for _ in 0..ms {
            rig.run(1);
            let (limits, now, dt_s) = (paper_limits(), Watch::new(rig), 0.001);
            for i in 0..JOINTS {
                let (v, a) = (limits.velocity_rad_s[i], limits.acceleration_rad_s2[i]);
                assert!(now.velocity_rad_s[i].abs() <= v * (1.0 + 1e-9));
                assert!((now.velocity_rad_s[i] - self.velocity_rad_s[i]).abs() <= a * dt_s + 1e-9);
                assert!((now.joints_rad[i] - self.joints_rad[i]).abs() <= v * dt_s + 1e-9);
            }
            *self = now;
        }
    }

    /// Runs until the arm rests, and returns the time that this takes.
    fn finish(&mut self, rig: &mut Rig) -> u64 {
        let from_ms = rig.now_ms;
        while rig.robot.arm().running.is_some() {
            self.run(rig, 1);
            assert!(rig.now_ms - from_ms < 200_000);
        }
        rig.now_ms - from_ms
    }

    fn fastest_rad_s(&self) -> f64 {
        self.velocity_rad_s.iter().fold(0.0, |most, speed| most.max(speed.abs()))
    }
}

/// The right hand draws a gesture, and the arm starts.
fn gesture(watch: &mut Watch, rig: &mut Rig, label: u8) {
    rig.right.events = rig.right.events.wrapping_add(1);
    rig.right.label = label;
    rig.right.event_window_end_ms = rig.board_time_ms();
    while rig.robot.arm().running.is_none() {
        watch.run(rig, 1);
    }
}

/// Both hands, neutral and armed, with this configuration.
fn wearer(config: &str) -> Rig {
    let config = Config::parse(config).unwrap();
    let mut rig = Rig::empty();
    rig.bridge = config.bridge(config.motion_map());
    rig.connect(Hand::Left, 1);
    rig.connect(Hand::Right, 1);
    rig.run(200);
    assert_eq!(rig.state(), State::Armed);
    rig
}

/// An arm at its home pose.
fn at_home() -> (Rig, Watch) {
    let mut rig = wearer("[speed]\narm = true\n");
    let mut watch = Watch::new(&rig);
    gesture(&mut watch, &mut rig, UP_DOWN);
    watch.finish(&mut rig);
    assert_eq!(rig.robot.arm().joints_rad, pose("home"));
    (rig, watch)
}

#[test]
fn bends_slow_a_moving_arm_down_and_bring_it_back_to_its_planned_speed_while_the_base_drives_as_ever() {
    let (mut rig, mut watch) = at_home();
    rig.left.heading = Heading::Forward;
    gesture(&mut watch, &mut rig, TO_FRO);
    watch.run(&mut rig, 1500);
    let full_rad_s = watch.fastest_rad_s();
    rig.left.middle_bends += 2;
    watch.run(&mut rig, 300);
    assert!(
        (watch.fastest_rad_s() - 0.81 * full_rad_s).abs() < 1e-9,
        "{} {full_rad_s}",
        watch.fastest_rad_s()
    );
    assert!((rig.bridge.caps().linear_m_s - 0.81 * 0.5).abs() < 1e-9, "the cap changes as ever");
    assert!((rig.speed_m_s() - 0.81 * 0.5).abs() < 1e-9);
    // More bends than the planned speed permits.
    rig.left.index_bends += 3;
    watch.run(&mut rig, 500);
    assert!((watch.fastest_rad_s() - full_rad_s).abs() < 1e-9);
    rig.left.middle_bends += 3;
    watch.run(&mut rig, 300);
    assert!((watch.fastest_rad_s() - 0.729 * full_rad_s).abs() < 1e-9);
    watch.finish(&mut rig);
    assert_eq!(rig.robot.arm().joints_rad, pose("pick-up"));
    let notes = rig.events.iter().filter_map(|event| match event {
        EventKind::Robot { text } => Some(text.as_str()),
        _ => None,
    });
    let notes: Vec<&str> = notes.collect();
    assert_eq!(
        notes,
        ["81", "100", "73"].map(|share| format!("the arm moves at {share} % of its planned speed")),
    );
}

#[test]
fn the_pace_remains_for_the_next_motion_until_a_stop_and_bends_of_a_resting_arm_leave_it_alone() {
    let (mut rig, mut watch) = at_home();
    rig.left.middle_bends += 2;
    watch.run(&mut rig, 200);
    gesture(&mut watch, &mut rig, TO_FRO);
    let planned_ms = watch.finish(&mut rig);
    // The paper's 5.7 s from home; the first half of the motion, from home to home, takes no time.
    assert!((5690..=5720).contains(&planned_ms), "bends of a resting arm change the cap alone: {planned_ms}");

    gesture(&mut watch, &mut rig, UP_DOWN);
    watch.run(&mut rig, 1000);
    for _ in 0..3 {
        rig.left.middle_bends += 2;
        watch.run(&mut rig, 200);
    }
    watch.finish(&mut rig);
    gesture(&mut watch, &mut rig, TO_FRO);
    let slow_ms = watch.finish(&mut rig);
    let share = 0.9_f64.powi(6);
    assert!((slow_ms as f64 * share - planned_ms as f64).abs() < 20.0, "{slow_ms} {planned_ms}");

    rig.stop();
    rig.right.top = 0;
    watch.run(&mut rig, 1500);
    rig.gesture(UP_DOWN);
    assert!(rig.take_outcomes().contains(&GestureOutcome::Released));
    watch = Watch::new(&rig);
    gesture(&mut watch, &mut rig, UP_DOWN);
    let back_ms = watch.finish(&mut rig);
    assert!((back_ms as f64 - planned_ms as f64).abs() < 20.0, "{back_ms} {planned_ms}");
}

#[test]
fn without_the_setting_bends_change_the_cap_alone_as_in_the_paper() {
    let mut rig = wearer("");
    let mut watch = Watch::new(&rig);
    gesture(&mut watch, &mut rig, TO_FRO);
    watch.run(&mut rig, 1500);
    let full_rad_s = watch.fastest_rad_s();
    rig.left.middle_bends += 2;
    watch.run(&mut rig, 300);
    assert_eq!(watch.fastest_rad_s(), full_rad_s);
    assert!((rig.bridge.caps().linear_m_s - 0.81 * 0.5).abs() < 1e-9);
}

#[test]
fn a_stop_while_the_pace_changes_brakes_within_the_planned_braking_time() {
    for after_ms in [1, 15, 40, 120, 400] {
        let (mut rig, mut watch) = at_home();
        gesture(&mut watch, &mut rig, TO_FRO);
        watch.run(&mut rig, 1500);
        rig.left.middle_bends += 3;
        watch.run(&mut rig, after_ms);
        let (bridge, robot, now_ms) = (&mut rig.bridge, &mut rig.robot, rig.now_ms);
        bridge.stop_key(now_ms, robot);
        let took_ms = watch.finish(&mut rig);
        // Full speed takes v/a = 0.326 s.
        assert!(took_ms <= 328, "{after_ms}: {took_ms}");
        let there = rig.robot.arm().joints_rad;
        watch.run(&mut rig, 2000);
        assert_eq!(rig.robot.arm().joints_rad, there);
    }
}
