//! The base: two driven wheels, whose motion is integrated along exact arcs.
//!
//! Axes: x forward, y left, angles counter-clockwise seen from above. The odometry frame is the start pose of the base.
//! Wheels never exceed their maximum speed and acceleration.
//! If a twist requires more, both wheels are slowed by the same factor, so the base stays on its path.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use crate::robot::{BaseState, Wheels};

/// The commanded motion of the base.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Twist {
    /// Forward speed in m/s.
    pub linear_m_s: f64,
    /// Turning speed in rad/s, positive = left.
    pub angular_rad_s: f64,
}

impl Twist {
    /// No motion.
    pub const ZERO: Twist = Twist { linear_m_s: 0.0, angular_rad_s: 0.0 };
}

/// Size and limits of the base.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BaseConfig {
    /// Radius of the driven wheels.
    pub wheel_radius_m: f64,
    /// Distance between the wheels' contact points.
    pub track_m: f64,
    /// Maximum speed of a wheel.
    pub wheel_speed_max_rad_s: f64,
    /// Maximum change of wheel speed per second.
    pub wheel_acceleration_max_rad_s2: f64,
    /// Variance of a wheel's distance per metre, in m²/m, caused by slip and a worn radius.
    pub wheel_variance_m: f64,
}

impl Default for BaseConfig {
    /// Wheels of 10 cm, 40 cm apart, with 1.2 m/s and 1.0 m/s² at the rim.
    /// These values suffice for the highest possible cap (1.0 m/s).
    /// After one metre, the standard deviation of a wheel's distance is 1 cm.
    fn default() -> Self {
        BaseConfig {
            wheel_radius_m: 0.1,
            track_m: 0.4,
            wheel_speed_max_rad_s: 12.0,
            wheel_acceleration_max_rad_s2: 10.0,
            wheel_variance_m: 1e-4,
        }
    }
}

/// Minimum variance of a wheel's speed in m²/s², because sensor fusion cannot use zero.
const SPEED_VARIANCE_MIN: f64 = 1e-6;

impl BaseConfig {
    /// Returns the covariance of linear (m/s) and angular speed (rad/s), averaged over `interval_s`.
    /// The wheel speeds are in rad/s.
    /// The covariance results from the same distance errors of the wheels as the covariance of the pose.
    pub fn speed_covariance(&self, wheels_rad_s: [f64; 2], interval_s: f64) -> [[f64; 2]; 2] {
        let [left, right] = wheels_rad_s.map(|wheel| {
            let rim_m_s = (wheel * self.wheel_radius_m).abs();
            self.wheel_variance_m * rim_m_s / interval_s + SPEED_VARIANCE_MIN
        });
        let both = 0.5 * (right - left) / self.track_m;
        [[0.25 * (left + right), both], [both, (left + right) / (self.track_m * self.track_m)]]
    }

    /// Returns the speeds of the left and right wheel in rad/s for a twist, without limits.
    pub fn wheels_rad_s(&self, twist: Twist) -> [f64; 2] {
        let turn_m_s = twist.angular_rad_s * self.track_m / 2.0;
        [twist.linear_m_s - turn_m_s, twist.linear_m_s + turn_m_s]
            .map(|rim_m_s| rim_m_s / self.wheel_radius_m)
    }
}

/// The position of the base, estimated from its wheels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Odometry {
    /// Distance in front of the start, in m.
    pub x_m: f64,
    /// Distance to the left of the start, in m.
    pub y_m: f64,
    /// Rotation to the left since the start in rad, not wrapped.
    pub heading_rad: f64,
    /// Length of the path, in m.
    pub path_m: f64,
    /// Speed now.
    pub twist: Twist,
}

/// Covariance of x (m), y (m) and heading (rad), in this order.
pub type Covariance = [[f64; 3]; 3];

/// The current state of the base and its commanded motion.
#[derive(Clone, Debug)]
pub struct Base {
    config: BaseConfig,
    target_rad_s: [f64; 2],
    wheels_rad_s: [f64; 2],
    wheels_rad: [f64; 2],
    odometry: Odometry,
    covariance: Covariance,
}

impl Base {
    /// A base at rest.
    pub fn new(config: BaseConfig) -> Self {
        Base {
            config,
            target_rad_s: [0.0; 2],
            wheels_rad_s: [0.0; 2],
            wheels_rad: [0.0; 2],
            odometry: Odometry::default(),
            covariance: [[0.0; 3]; 3],
        }
    }

    /// Creates a base that moves as reported. Missing wheel speeds are derived from the reported twist.
    pub fn at(config: BaseConfig, state: &BaseState) -> Self {
        let wheels = state.wheels.unwrap_or_else(|| Wheels {
            speed_rad_s: config.wheels_rad_s(state.odometry.twist),
            ..Wheels::default()
        });
        Base {
            config,
            target_rad_s: wheels.speed_rad_s,
            wheels_rad_s: wheels.speed_rad_s,
            wheels_rad: wheels.angle_rad,
            odometry: state.odometry,
            covariance: state.covariance,
        }
    }

    /// Returns the complete state of the base.
    pub fn state(&self) -> BaseState {
        let wheels = Wheels { speed_rad_s: self.wheels_rad_s, angle_rad: self.wheels_rad };
        BaseState { odometry: self.odometry, covariance: self.covariance, wheels: Some(wheels) }
    }

    /// Sets the target speed. A twist with NaN or infinity halts the base.
    pub fn drive(&mut self, twist: Twist) {
        if !(twist.linear_m_s.is_finite() && twist.angular_rad_s.is_finite()) {
            self.target_rad_s = [0.0; 2];
            return;
        }
        let wheels = self.config.wheels_rad_s(twist);
        let fastest = wheels[0].abs().max(wheels[1].abs());
        let scale = (self.config.wheel_speed_max_rad_s / fastest).min(1.0);
        self.target_rad_s = wheels.map(|w| w * scale);
    }

    /// Lets `dt_s` seconds pass.
    pub fn step(&mut self, dt_s: f64) {
        let before = self.wheels_rad_s;
        let change = [self.target_rad_s[0] - before[0], self.target_rad_s[1] - before[1]];
        let largest = change[0].abs().max(change[1].abs());
        let allowed = self.config.wheel_acceleration_max_rad_s2 * dt_s;
        if largest <= allowed {
            self.wheels_rad_s = self.target_rad_s;
        } else {
            // Both wheels reach their speeds together, so a halting base stays on its arc.
            for (wheel, change) in self.wheels_rad_s.iter_mut().zip(change) {
                *wheel += change * allowed / largest;
            }
        }
        let mean = [0, 1].map(|i| 0.5 * (before[i] + self.wheels_rad_s[i]));
        let travelled = self.twist_of(mean);
        for (turned, speed) in self.wheels_rad.iter_mut().zip(mean) {
            *turned += speed * dt_s;
        }
        self.grow_covariance(mean.map(|w| w * self.config.wheel_radius_m * dt_s));
        self.odometry.advance(travelled, dt_s);
        self.odometry.twist = self.twist_of(self.wheels_rad_s);
    }

    /// Propagates the wheels' errors through one small step of the path, to first order.
    fn grow_covariance(&mut self, [left_m, right_m]: [f64; 2]) {
        let track_m = self.config.track_m;
        let arc_m = 0.5 * (left_m + right_m);
        let (s, c) = (self.odometry.heading_rad + 0.5 * (right_m - left_m) / track_m).sin_cos();
        // Derivatives of the step's end with respect to its start, and to each wheel's distance.
        let from_start = DMat3::from_cols(DVec3::X, DVec3::Y, DVec3::new(-arc_m * s, arc_m * c, 1.0));
        let sideways = 0.5 * arc_m / track_m;
        let from_left = DVec3::new(0.5 * c + sideways * s, 0.5 * s - sideways * c, -1.0 / track_m);
        let from_right = DVec3::new(0.5 * c - sideways * s, 0.5 * s + sideways * c, 1.0 / track_m);
        let [left, right] = [left_m, right_m].map(|way_m| self.config.wheel_variance_m * way_m.abs());
        let squared = |v: DVec3| DMat3::from_cols(v * v.x, v * v.y, v * v.z);
        let before = DMat3::from_cols_array_2d(&self.covariance);
        let grown = from_start * before * from_start.transpose()
            + squared(from_left) * left
            + squared(from_right) * right;
        self.covariance = grown.to_cols_array_2d();
    }

    fn twist_of(&self, wheels_rad_s: [f64; 2]) -> Twist {
        let [left, right] = wheels_rad_s.map(|w| w * self.config.wheel_radius_m);
        Twist { linear_m_s: 0.5 * (left + right), angular_rad_s: (right - left) / self.config.track_m }
    }

    /// Returns position, path length and speed.
    pub fn odometry(&self) -> Odometry {
        self.odometry
    }

    /// Returns the covariance of the odometry.
    pub fn covariance(&self) -> Covariance {
        self.covariance
    }

    /// Returns the speeds of the left and right wheel in rad/s.
    pub fn wheels_rad_s(&self) -> [f64; 2] {
        self.wheels_rad_s
    }

    /// Returns the total rotation of the left and right wheel since the start, in rad.
    pub fn wheels_rad(&self) -> [f64; 2] {
        self.wheels_rad
    }

    /// Returns the braking time from the current speed.
    pub fn braking_s(&self) -> f64 {
        let fastest = self.wheels_rad_s[0].abs().max(self.wheels_rad_s[1].abs());
        fastest / self.config.wheel_acceleration_max_rad_s2
    }

    /// Size and limits.
    pub fn config(&self) -> &BaseConfig {
        &self.config
    }
}

impl Odometry {
    /// Moves along the arc of a constant twist. The result is exact for any turn.
    pub fn advance(&mut self, twist: Twist, dt_s: f64) {
        let half_turn = 0.5 * twist.angular_rad_s * dt_s;
        let arc_m = twist.linear_m_s * dt_s;
        // The chord is shorter than the arc by the factor sin(α/2)/(α/2).
        // The chord points in the direction of half the turn.
        let chord_m = if half_turn.abs() < 1e-8 { arc_m } else { arc_m * half_turn.sin() / half_turn };
        let direction = self.heading_rad + half_turn;
        self.x_m += chord_m * direction.cos();
        self.y_m += chord_m * direction.sin();
        self.heading_rad += 2.0 * half_turn;
        self.path_m += arc_m.abs();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn a_quarter_circle_ends_a_radius_ahead_and_a_radius_to_the_left() {
        let mut odometry = Odometry::default();
        // The radius is 2 m (1 m/s and 0.5 rad/s). The steps have very different lengths.
        for share in [0.5, 0.25, 0.125, 0.125] {
            odometry.advance(Twist { linear_m_s: 1.0, angular_rad_s: 0.5 }, PI * share);
        }
        assert!((odometry.x_m - 2.0).abs() < 1e-12);
        assert!((odometry.y_m - 2.0).abs() < 1e-12);
        assert!((odometry.heading_rad - FRAC_PI_2).abs() < 1e-12);
        assert!((odometry.path_m - PI).abs() < 1e-12);
    }

    #[test]
    fn too_fast_a_twist_is_slowed_on_the_same_curve() {
        let mut base = Base::new(BaseConfig::default());
        base.drive(Twist { linear_m_s: 2.0, angular_rad_s: 1.0 });
        for _ in 0..1000 {
            base.step(0.005);
        }
        let twist = base.odometry().twist;
        assert!((twist.angular_rad_s / twist.linear_m_s - 0.5).abs() < 1e-12);
        assert!((base.wheels_rad_s()[1] - 12.0).abs() < 1e-12);
    }

    #[test]
    fn halting_keeps_to_the_arc() {
        let mut base = Base::new(BaseConfig::default());
        base.drive(Twist { linear_m_s: 0.5, angular_rad_s: 0.5 });
        for _ in 0..400 {
            base.step(0.005);
        }
        base.drive(Twist::ZERO);
        while base.wheels_rad_s() != [0.0; 2] {
            let twist = base.odometry().twist;
            assert!((twist.linear_m_s - twist.angular_rad_s).abs() < 1e-9);
            base.step(0.005);
        }
    }

    #[test]
    fn a_twist_that_is_no_number_halts() {
        let mut base = Base::new(BaseConfig::default());
        base.drive(Twist { linear_m_s: 0.5, angular_rad_s: 0.0 });
        base.step(1.0);
        base.drive(Twist { linear_m_s: f64::NAN, angular_rad_s: 0.0 });
        base.step(1.0);
        assert_eq!(base.wheels_rad_s(), [0.0; 2]);
    }

    #[test]
    fn a_speeds_covariance_is_that_of_wheels_whose_ways_err_as_the_poses_do() {
        let config = BaseConfig::default();
        // With 0.3 and 0.5 m/s at the rim, the variances of the distances over 20 ms are 6e-7 and 1e-6 m².
        let got = config.speed_covariance([3.0, 5.0], 0.02);
        let (left, right) = (6e-7 / 0.0004 + 1e-6, 1e-6 / 0.0004 + 1e-6);
        let both = (right - left) / 0.8;
        let expected = [[(left + right) / 4.0, both], [both, (left + right) / 0.16]];
        for (got, expected) in got.as_flattened().iter().zip(expected.as_flattened()) {
            assert!((got - expected).abs() < 1e-12, "{got} {expected}");
        }
        // The covariance is the same for forward and backward motion. At rest, it is small but never zero.
        assert_eq!(config.speed_covariance([-3.0, -5.0], 0.02), config.speed_covariance([3.0, 5.0], 0.02));
        assert!(config.speed_covariance([0.0; 2], 0.02)[1][1] > 0.0);
    }

    #[test]
    fn the_covariance_is_that_of_many_runs_with_such_wheels() {
        let config = BaseConfig::default();
        let mut base = Base::new(config);
        // A curve to the left, followed by one to the right.
        let mut ways = Vec::new();
        for (linear_m_s, angular_rad_s) in [(0.5, 0.4), (0.5, -0.6)] {
            base.drive(Twist { linear_m_s, angular_rad_s });
            for _ in 0..400 {
                let before = base.wheels_rad_s();
                base.step(0.01);
                let after = base.wheels_rad_s();
                ways.push([0, 1].map(|i| 0.5 * (before[i] + after[i]) * config.wheel_radius_m * 0.01));
            }
        }
        let mut random = crate::Random::new(8);
        // The sum of twelve uniform numbers is approximately normal with variance 1.
        let mut normal = || (0..12).map(|_| random.between(-0.5, 0.5)).sum::<f64>();
        let runs = 4000;
        let (end, mut seen) = (base.odometry(), [[0.0; 3]; 3]);
        for _ in 0..runs {
            let mut odometry = Odometry::default();
            for way in &ways {
                let [left, right] =
                    way.map(|way_m| way_m + normal() * (config.wheel_variance_m * way_m.abs()).sqrt());
                let (linear_m_s, angular_rad_s) = (0.5 * (left + right), (right - left) / config.track_m);
                odometry.advance(Twist { linear_m_s, angular_rad_s }, 1.0);
            }
            let off =
                [odometry.x_m - end.x_m, odometry.y_m - end.y_m, odometry.heading_rad - end.heading_rad];
            for row in 0..3 {
                for col in 0..3 {
                    seen[row][col] += off[row] * off[col] / f64::from(runs);
                }
            }
        }
        let covariance = base.covariance();
        for row in 0..3 {
            for col in 0..3 {
                let scale = (covariance[row][row] * covariance[col][col]).sqrt();
                let (a, b) = (seen[row][col], covariance[row][col]);
                assert!((a - b).abs() < 0.08 * scale, "{row} {col}: {a} seen, {b} computed");
            }
        }
    }

    proptest! {
        #[test]
        fn wheel_limits_hold(twists in prop::collection::vec((-3.0..3.0_f64, -6.0..6.0_f64), 1..20)) {
            let mut base = Base::new(BaseConfig::default());
            let dt_s = 0.005;
            for (linear_m_s, angular_rad_s) in twists {
                base.drive(Twist { linear_m_s, angular_rad_s });
                for _ in 0..50 {
                    let before = base.wheels_rad_s();
                    base.step(dt_s);
                    for (a, b) in before.into_iter().zip(base.wheels_rad_s()) {
                        prop_assert!(b.abs() <= 12.0 + 1e-9);
                        prop_assert!((b - a).abs() <= 10.0 * dt_s + 1e-9);
                    }
                }
            }
        }
    }
}
