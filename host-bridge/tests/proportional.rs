//! Tests driving with a speed that is proportional to the tilt.
//! The rules for silence, neutral, stops and the guard are the same as for four headings. The base also drives arcs.
//!
//! The board's code evaluates the tilt at 100 Hz, and states are sent at 50 Hz.

mod support;

use host_bridge::arm::model::SerialArm;
use host_bridge::base::Twist;
use host_bridge::config::Config;
use host_bridge::plan::{Placement, Planner};
use host_bridge::robot::{Door as _, Random};
use host_bridge::safety::{Hand, State};
use host_bridge::scene::Scene;
use shared_dsp::left::tilt::{Tilt, TiltDetector};
use shared_proto::message::{Heading, TiltThresholds};
use support::{Rig, Virtual as _, moving};

/// Braking from 0.5 m/s at 1 m/s² takes 0.5 s. The remaining time is a margin for the frame in transit.
const REST_MS: u64 = 520;

/// Caps at the start of a session, in m/s and rad/s.
const CAP: f64 = 0.5;

struct Wearer {
    rig: Rig,
    detector: TiltDetector,
}

impl Wearer {
    /// Creates a wearer whose hand is neutral and armed.
    fn new(drive: &str) -> Self {
        let config = Config::parse(&format!("[drive]\nproportional = true\n{drive}")).unwrap();
        let mut rig = Rig::empty();
        rig.bridge = config.bridge(config.motion_map());
        rig.connect(Hand::Left, 1);
        let mut wearer = Wearer { rig, detector: TiltDetector::new(TiltThresholds::DEFAULT) };
        wearer.hold(0, 0, 300);
        assert_eq!(wearer.rig.state(), State::Armed);
        wearer
    }

    /// Keeps this tilt, in milliradians, for a duration in ms.
    fn hold(&mut self, pitch_mrad: i16, roll_mrad: i16, ms: u64) {
        for _ in 0..ms / 10 {
            let heading = self.detector.step(Tilt { pitch_mrad, roll_mrad });
            let left = &mut self.rig.left;
            (left.pitch_mrad, left.roll_mrad, left.heading) = (pitch_mrad, roll_mrad, heading);
            self.rig.run(10);
        }
    }

    fn twist(&self) -> Twist {
        self.rig.robot.odometry().twist
    }
}

/// Returns the fraction of the cap by the default rules, which apply between 140 and 698 mrad.
fn share(mrad: i16) -> f64 {
    f64::from(mrad - 140) / 558.0
}

#[test]
fn the_base_drives_a_figure_of_eight_by_tilts_alone() {
    let (pitch_mrad, roll_mrad) = (524, 419);
    let radius_m = share(pitch_mrad) / share(roll_mrad);
    let mut wearer = Wearer::new("");
    let mut path = vec![wearer.rig.robot.odometry()];
    let from_ms = wearer.rig.now_ms;
    // The base turns once to the left and then once to the right, as seen by the wearer.
    for (roll_mrad, until_rad) in [(roll_mrad, std::f64::consts::TAU), (-roll_mrad, 0.0)] {
        let has_turned = |heading_rad: f64| (heading_rad - until_rad) * f64::from(roll_mrad) >= 0.0;
        while !has_turned(path[path.len() - 1].heading_rad) {
            wearer.hold(pitch_mrad, roll_mrad, 20);
            let now = wearer.rig.robot.odometry();
            assert!(now.twist.linear_m_s <= CAP && now.twist.angular_rad_s.abs() <= CAP, "{now:?}");
            path.push(now);
            assert!(path.len() < 5000, "{now:?}");
        }
    }
    wearer.hold(0, 0, 1000);
    let end = wearer.rig.robot.odometry();
    // Each point must be on one of two circles that touch each other at the start.
    // The tolerance covers the time to reach full speed and to change direction.
    let off = |x: f64, y: f64, side: f64| (x.hypot(y - side * radius_m) - radius_m).abs();
    let worst_m =
        path.iter().map(|o| off(o.x_m, o.y_m, 1.0).min(off(o.x_m, o.y_m, -1.0))).fold(0.0, f64::max);
    let (left_m, right_m) =
        path.iter().fold((0.0, 0.0), |(l, r): (f64, f64), o| (l.max(o.y_m), r.min(o.y_m)));
    let took_s = (wearer.rig.now_ms - from_ms) as f64 / 1000.0;
    println!(
        "circles of {radius_m:.2} m, {left_m:.2} m to the left and {right_m:.2} m to the right in {took_s:.1} s; {worst_m:.3} m \
         off them at most, ends {:.3} m from where it began",
        end.x_m.hypot(end.y_m)
    );
    assert!(worst_m < 0.15 && end.x_m.hypot(end.y_m) < 0.4);
    assert!((left_m - 2.0 * radius_m).abs() < 0.15 && (right_m + 2.0 * radius_m).abs() < 0.3);
    assert!(wearer.rig.robot.at_rest());
}

#[test]
fn speed_follows_the_tilt_within_dead_zone_caps_and_limits_and_bends_change_the_caps() {
    let mut wearer = Wearer::new("");
    for pitch_mrad in [300, 450, 698, 1200] {
        wearer.hold(pitch_mrad, 100, 1500);
        let expected = Twist { linear_m_s: CAP * share(pitch_mrad).min(1.0), angular_rad_s: 0.0 };
        let twist = wearer.twist();
        assert!((twist.linear_m_s - expected.linear_m_s).abs() < 1e-9, "{pitch_mrad}: {twist:?}");
        assert_eq!(twist.angular_rad_s, 0.0, "a roll within the dead zone");
    }
    wearer.rig.left.index_bends += 1;
    wearer.hold(1200, 0, 1500);
    assert!((wearer.twist().linear_m_s - 1.1 * CAP).abs() < 1e-9);
    let mut slow = Wearer::new("gain = 2.0\nlinear_most = 0.3\nangular_most = 0.2\n");
    slow.hold(-600, -400, 1500);
    let twist = slow.twist();
    assert!((twist.linear_m_s + 0.3 * CAP).abs() < 1e-9 && (twist.angular_rad_s + 0.2 * CAP).abs() < 1e-9);
}

#[test]
fn below_the_boards_end_of_a_command_nothing_drives_and_neutral_is_needed_after_a_stop_or_silence() {
    let mut wearer = Wearer::new("");
    wearer.hold(500, 300, 1500);
    assert!(wearer.twist().linear_m_s > 0.2);
    // At 11° the board ends the command, although the tilt exceeds the dead zone.
    wearer.hold(192, 0, 40);
    assert_eq!((wearer.rig.left.heading, wearer.rig.bridge.twist()), (Heading::Between, Twist::ZERO));
    wearer.hold(192, 0, REST_MS);
    assert!(wearer.rig.robot.at_rest());

    type Fault = fn(&mut Wearer);
    let faults: [(&str, Fault, Fault); 3] = [
        ("silence", |w| w.rig.talking.left = false, |w| w.rig.talking.left = true),
        ("doubt", |w| w.rig.left.health = 1, |w| w.rig.left.health = 0),
        ("no answers", |w| w.rig.answering.left = false, |w| w.rig.answering.left = true),
    ];
    for (what, begins, ends) in faults {
        let mut wearer = Wearer::new("");
        wearer.hold(500, -400, 1500);
        begins(&mut wearer);
        wearer.hold(500, -400, 500 + 20 + REST_MS);
        assert!(wearer.rig.robot.at_rest(), "{what}");
        assert_eq!(wearer.rig.bridge.twist(), Twist::ZERO, "{what}");
        ends(&mut wearer);
        wearer.rig.take_moved();
        wearer.hold(500, -400, 3000);
        assert!(!wearer.rig.take_moved(), "{what}: it drives before neutral");
        wearer.hold(0, 0, 1000);
        wearer.hold(500, -400, 1000);
        assert!(wearer.rig.take_moved(), "{what}");
    }
}

#[test]
fn hands_at_random_touch_nothing_in_a_scene() {
    let walls = "[[box]]\nname = \"wall\"\ncenter_m = [1.5, 0.0, 0.25]\nsize_m = [0.2, 4.0, 0.5]\n\
                 [[box]]\nname = \"crate\"\ncenter_m = [-0.8, 0.9, 0.3]\nsize_m = [0.5, 0.5, 0.6]\n";
    let planner = Planner::new(SerialArm::gen3(), Scene::parse(walls).unwrap()).unwrap();
    let seeds = if std::env::var_os("BIMANUAL_FULL").is_some() { 20 } else { 2 };
    let (mut nearest_m, mut path_m, mut stops) = (f64::INFINITY, 0.0, 0);
    for seed in 0..seeds {
        let mut wearer = Wearer::new("gain = 3.0\n");
        wearer.rig.robot = moving::in_scene(planner.clone());
        let ahead_ms = wearer.rig.now_ms;
        wearer.rig.robot.pass(ahead_ms);
        let mut random = Random::new(seed);
        for _ in 0..60 {
            let (pitch, roll) = (random.between(-900.0, 900.0) as i16, random.between(-900.0, 900.0) as i16);
            for _ in 0..random.below(20) {
                wearer.hold(pitch, roll, 50);
                let odometry = wearer.rig.robot.odometry();
                let around = planner.world().around(Placement::from(odometry));
                nearest_m = nearest_m.min(around.base_clearance().distance_m);
            }
        }
        path_m += wearer.rig.robot.odometry().path_m;
        stops += wearer.rig.robot.picture().guard_stops;
    }
    println!(
        "{path_m:.1} m driven, {stops} ticks held back, {:.1} mm from the nearest box",
        1000.0 * nearest_m
    );
    assert!(nearest_m > 0.001 && path_m > 10.0 && stops > 0);
}
