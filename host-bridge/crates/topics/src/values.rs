//! Converts between ROS 2's values and those of the bridge.

use std::time::{SystemTime, UNIX_EPOCH};

use crate::message::{
    DiagnosticStatus, Header, Odometry, Point, Pose, PoseWithCovariance, Quaternion, Time, Transform, Twist,
    TwistWithCovariance, Vector3,
};
use host_robot::{BaseConfig, DVec3, Picture, base};

/// Interval at which odometry is published.
pub const SPEED_INTERVAL_S: f64 = 0.02;

impl Time {
    /// A wall-clock time.
    pub fn at(time: SystemTime) -> Self {
        let since = time.duration_since(UNIX_EPOCH).unwrap_or_default();
        Time { sec: i32::try_from(since.as_secs()).unwrap_or(i32::MAX), nanosec: since.subsec_nanos() }
    }

    /// Creates a duration from seconds. Negative values become zero.
    pub fn after_s(seconds: f64) -> Self {
        let nanoseconds = (seconds.max(0.0) * 1e9).round() as u64;
        Time::at_ns(nanoseconds)
    }

    /// Creates a time from nanoseconds since 1970.
    pub fn at_ns(nanoseconds: u64) -> Self {
        Time {
            sec: i32::try_from(nanoseconds / 1_000_000_000).unwrap_or(i32::MAX),
            nanosec: (nanoseconds % 1_000_000_000) as u32,
        }
    }

    /// Returns the time in nanoseconds since 1970.
    pub fn nanoseconds(self) -> i64 {
        i64::from(self.sec) * 1_000_000_000 + i64::from(self.nanosec)
    }

    /// In seconds.
    pub fn seconds(self) -> f64 {
        f64::from(self.sec) + f64::from(self.nanosec) * 1e-9
    }
}

impl From<DVec3> for Vector3 {
    fn from(DVec3 { x, y, z }: DVec3) -> Self {
        Vector3 { x, y, z }
    }
}

impl Quaternion {
    /// Returns the rotation to the left about the vertical axis in rad.
    pub fn yaw_rad(&self) -> f64 {
        (2.0 * (self.w * self.z + self.x * self.y)).atan2(1.0 - 2.0 * (self.y * self.y + self.z * self.z))
    }

    /// Creates a rotation to the left about the vertical axis.
    pub fn yaw(angle_rad: f64) -> Self {
        Quaternion { x: 0.0, y: 0.0, z: (0.5 * angle_rad).sin(), w: (0.5 * angle_rad).cos() }
    }
}

impl From<base::Twist> for Twist {
    fn from(twist: base::Twist) -> Self {
        Twist {
            linear: Vector3 { x: twist.linear_m_s, ..Vector3::default() },
            angular: Vector3 { z: twist.angular_rad_s, ..Vector3::default() },
        }
    }
}

/// Expands a covariance to x, y, z and the rotations about these axes. Our entries are placed at `places`.
fn spread<const N: usize>(ours: &[[f64; N]; N], places: [usize; N]) -> [[f64; 6]; 6] {
    let mut all = [[0.0; 6]; 6];
    for (row, values) in ours.iter().enumerate() {
        for (column, value) in values.iter().enumerate() {
            all[places[row]][places[column]] = *value;
        }
    }
    all
}

impl Odometry {
    /// Creates odometry with covariances. The covariance of the speed applies to [`SPEED_INTERVAL_S`].
    pub fn of(robot: &Picture, wheels: &BaseConfig, header: Header, child_frame_id: String) -> Self {
        let odometry = robot.odometry;
        let of_speed = wheels.speed_covariance(robot.wheels_rad_s, SPEED_INTERVAL_S);
        let Transform { translation: Vector3 { x, y, z }, rotation } = Transform::of_base(robot);
        Odometry {
            header,
            child_frame_id,
            pose: PoseWithCovariance {
                pose: Pose { position: Point { x, y, z }, orientation: rotation },
                covariance: spread(&robot.covariance, [0, 1, 5]),
            },
            twist: TwistWithCovariance {
                twist: odometry.twist.into(),
                covariance: spread(&of_speed, [0, 5]),
            },
        }
    }
}

impl Transform {
    /// Returns the transform of the base relative to its start.
    pub fn of_base(robot: &Picture) -> Self {
        let odometry = robot.odometry;
        Transform {
            translation: Vector3 { x: odometry.x_m, y: odometry.y_m, z: 0.0 },
            rotation: Quaternion::yaw(odometry.heading_rad),
        }
    }
}

impl DiagnosticStatus {
    /// All is well.
    pub const OK: u8 = 0;
    /// Something to know.
    pub const WARN: u8 = 1;
    /// Something is wrong.
    pub const ERROR: u8 = 2;
    /// Nothing is heard.
    pub const STALE: u8 = 3;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_round_to_nanoseconds_and_never_go_below_zero() {
        assert_eq!(Time::after_s(1.25), Time { sec: 1, nanosec: 250_000_000 });
        assert_eq!(Time::after_s(0.999_999_999_9), Time { sec: 1, nanosec: 0 });
        assert_eq!(Time::after_s(-1.0), Time::default());
        let wall = UNIX_EPOCH + std::time::Duration::new(1_790_000_000, 7);
        assert_eq!(Time::at(wall), Time { sec: 1_790_000_000, nanosec: 7 });
    }

    #[test]
    fn a_quarter_turn_to_the_left_is_half_the_angle_about_z() {
        let q = Quaternion::yaw(std::f64::consts::FRAC_PI_2);
        assert!((q.z - 0.5_f64.sqrt()).abs() < 1e-12 && (q.w - 0.5_f64.sqrt()).abs() < 1e-12);
    }
}
