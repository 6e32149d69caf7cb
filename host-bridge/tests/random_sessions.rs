//! Runs random sessions of both hands through real frames and the bridge, in virtual time.
//! For any input and any failure of the links, no limit may be exceeded and no value may be NaN.
//! Each stop must bring the robot to rest within the time that the limits allow.
//!
//! `BIMANUAL_FULL=1` runs ten thousand sessions.

mod support;

use host_bridge::arm::gen3::paper_limits;
use host_bridge::base::BaseConfig;
use host_bridge::bridge::EventKind;
use host_bridge::robot::JOINTS;
use host_bridge::robot::Random;
use host_bridge::safety::{Hand, State};
use shared_proto::message::Heading;

use support::{Rig, Virtual as _};

const HEADINGS: [Heading; 6] =
    [Heading::Neutral, Heading::Between, Heading::Forward, Heading::Backward, Heading::Left, Heading::Right];

/// Statistics of all sessions.
#[derive(Default, Debug)]
struct Seen {
    stops: u32,
    motions: u32,
    braking_ms: u64,
    path_m: f64,
}

/// Checks the robot from one millisecond to the next.
struct Watch {
    joints_rad: [f64; JOINTS],
    velocity_rad_s: [f64; JOINTS],
    wheels_rad_s: [f64; 2],
    /// Time from which no motion may start, and the maximum braking time after it.
    halted: Option<(u64, f64)>,
}

impl Watch {
    fn new(rig: &Rig) -> Self {
        let arm = rig.robot.arm();
        Watch {
            joints_rad: arm.joints_rad,
            velocity_rad_s: arm.velocity_rad_s,
            wheels_rad_s: rig.robot.wheels_rad_s(),
            halted: None,
        }
    }

    fn look(&mut self, rig: &Rig, seen: &mut Seen) {
        let (limits, base, dt_s) = (paper_limits(), BaseConfig::default(), 0.001);
        let (arm, wheels, odometry) = (rig.robot.arm(), rig.robot.wheels_rad_s(), rig.robot.odometry());
        for i in 0..JOINTS {
            let (v, a) = (limits.velocity_rad_s[i], limits.acceleration_rad_s2[i]);
            assert!(arm.joints_rad[i].is_finite());
            assert!(arm.velocity_rad_s[i].abs() <= v * (1.0 + 1e-9));
            assert!((arm.velocity_rad_s[i] - self.velocity_rad_s[i]).abs() <= a * dt_s + 1e-9);
            assert!((arm.joints_rad[i] - self.joints_rad[i]).abs() <= v * dt_s + 1e-9);
        }
        for (now, before) in wheels.into_iter().zip(self.wheels_rad_s) {
            assert!(now.abs() <= base.wheel_speed_max_rad_s + 1e-9);
            assert!((now - before).abs() <= base.wheel_acceleration_max_rad_s2 * dt_s + 1e-9);
        }
        assert!(
            [odometry.x_m, odometry.y_m, odometry.heading_rad, odometry.path_m].iter().all(|v| v.is_finite())
        );

        if rig.state() == State::Armed {
            self.halted = None;
        } else {
            let (since_ms, allowed_s) = *self.halted.get_or_insert_with(|| {
                seen.stops += 1;
                let wheel = wheels[0].abs().max(wheels[1].abs()) / base.wheel_acceleration_max_rad_s2;
                let slowest =
                    (0..JOINTS).map(|i| arm.velocity_rad_s[i].abs() / limits.acceleration_rad_s2[i]);
                (rig.now_ms, slowest.fold(wheel, f64::max))
            });
            let since_ms = rig.now_ms - since_ms;
            if rig.robot.at_rest() {
                // After braking, the robot stays at rest, because no motion may start while it is not armed.
                self.halted = Some((rig.now_ms - since_ms, 0.0));
            } else {
                assert!(since_ms as f64 <= allowed_s * 1000.0 + 2.0, "{since_ms} ms, {allowed_s} s allowed");
                seen.braking_ms = seen.braking_ms.max(since_ms);
            }
        }
        *self = Watch {
            joints_rad: arm.joints_rad,
            velocity_rad_s: arm.velocity_rad_s,
            wheels_rad_s: wheels,
            halted: self.halted,
        };
    }
}

fn session(seed: u64, seen: &mut Seen) {
    let mut random = Random::new(seed);
    let mut rig = Rig::with(&[Hand::Left, Hand::Right]);
    let mut watch = Watch::new(&rig);
    let mut run = |rig: &mut Rig, ms: usize| {
        for _ in 0..ms {
            rig.run(1);
            watch.look(rig, seen);
        }
    };
    run(&mut rig, 200);
    for _ in 0..12 {
        match random.below(10) {
            0..=3 => rig.left.heading = HEADINGS[random.below(6)],
            4..=5 => {
                rig.right.events = rig.right.events.wrapping_add(1);
                rig.right.label = random.below(7) as u8;
                rig.right.top = if random.below(4) == 0 { rig.right.label } else { 0 };
                rig.right.event_window_end_ms = rig.board_time_ms().wrapping_sub(random.below(400) as u32);
            }
            6 => {
                rig.left.index_bends = rig.left.index_bends.wrapping_add(random.below(6) as u8);
                rig.left.middle_bends = rig.left.middle_bends.wrapping_add(random.below(3) as u8);
            }
            7 => {
                // Both fingers are bent, then the hand returns to neutral, and a gesture releases the stop.
                rig.left.stop = true;
                run(&mut rig, 20 + random.below(200));
                rig.left.stop = false;
                if random.below(4) != 0 {
                    rig.left.heading = Heading::Neutral;
                    rig.right.top = 0;
                    run(&mut rig, 1100);
                    rig.right.events = rig.right.events.wrapping_add(1);
                    rig.right.label = 1;
                    rig.right.event_window_end_ms = rig.board_time_ms();
                }
            }
            8 => {
                // A hand falls silent, a hand resumes, or bytes are damaged.
                let hand = Hand::BOTH[random.below(2)];
                rig.talking[hand] = !rig.talking[hand];
                let noise: Vec<u8> = (0..random.below(40)).map(|_| random.bits() as u8).collect();
                rig.send(hand, &noise);
            }
            _ => {
                if random.below(3) == 0 {
                    let (bridge, robot, now_ms) = (&mut rig.bridge, &mut rig.robot, rig.now_ms);
                    bridge.stop_key(now_ms, robot);
                } else {
                    rig.talking = [true; 2].into();
                    rig.left.heading = Heading::Neutral;
                    rig.right.top = 0;
                }
            }
        }
        run(&mut rig, random.below(900));
    }
    let started = |event: &&EventKind| matches!(event, EventKind::MotionEnded { .. });
    seen.motions += rig.events.iter().filter(started).count() as u32;
    seen.path_m += rig.robot.odometry().path_m;
}

#[test]
fn whatever_two_hands_do_limits_hold_and_stops_end_at_rest() {
    let sessions = if std::env::var_os("BIMANUAL_FULL").is_some() { 10_000 } else { 300 };
    let mut seen = Seen::default();
    for seed in 0..sessions {
        session(seed, &mut seen);
    }
    println!("{sessions} sessions: {seen:?}");
    // The sessions did move the robot.
    assert!(seen.stops > sessions as u32 && seen.motions > 20 && seen.path_m > sessions as f64 * 0.1);
    assert!(seen.braking_ms > 100);
}
