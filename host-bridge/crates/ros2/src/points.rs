//! Converts a complete trajectory to the form of a `joint_trajectory_controller`.

use host_robot::Trajectory;
use host_topics::message::{Header, JointTrajectory, JointTrajectoryPoint, Time};

/// Maximum time between two points. Further points mark the instants at which the acceleration changes.
const GRID_S: f64 = 0.25;
/// Controllers require strictly increasing times.
const LEAST_STEP_S: f64 = 0.001;

/// Creates the message with these points, for the joints that the arm has.
pub fn message(header: Header, names: &[String], mut points: Vec<JointTrajectoryPoint>) -> JointTrajectory {
    for point in &mut points {
        point.positions.truncate(names.len());
        point.velocities.truncate(names.len());
    }
    JointTrajectory { header, joint_names: names.to_vec(), points }
}

/// Converts a trajectory to points in time. Cubic interpolation between these points gives the same motion.
pub fn points(trajectory: &Trajectory) -> Vec<JointTrajectoryPoint> {
    let end_s = trajectory.duration_s();
    let mut times_s = trajectory.knots_s();
    times_s.extend((1..).map(|k| f64::from(k) * GRID_S).take_while(|t| *t < end_s));
    times_s.sort_by(f64::total_cmp);
    let mut kept: Vec<f64> = Vec::new();
    for time_s in times_s {
        let last_s = kept.last().copied().unwrap_or(0.0);
        if time_s - last_s >= LEAST_STEP_S && end_s - time_s >= LEAST_STEP_S {
            kept.push(time_s);
        }
    }
    kept.push(end_s.max(LEAST_STEP_S));
    let point = |time_s: f64| {
        let motion = trajectory.motion(time_s);
        JointTrajectoryPoint {
            positions: motion.joints_rad.to_vec(),
            velocities: motion.velocity_rad_s.to_vec(),
            time_from_start: Time::after_s(time_s),
            ..JointTrajectoryPoint::default()
        }
    };
    kept.into_iter().map(point).collect()
}
