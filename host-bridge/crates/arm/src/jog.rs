//! The arithmetic of jogging.
//! This module converts the tool's speed to joint speeds, and computes how joints change their speed.
//! The director describes the purpose of jogging and its checks.
//!
//! The method is damped least squares (Nakamura and Hanafusa 1986).
//! Near a singularity, the joints slow down instead of racing.
//! A joint near its limit moves no faster than the speed from which it can still stop,
//! and the other joints compensate for the difference.
//! If a joint would still be too fast, all joints are slowed by the same factor.
//! The tool therefore stays on its line.

use host_robot::{DMat3, DVec3, JOINTS, JointLimits, Joints, Motion};

use crate::ik::{columns, damped};
use crate::model::SerialArm;

/// Damping in m and in rad. It is far below the values of an arm in a normal pose, and far above rounding errors.
const DAMPING: f64 = 0.03;
/// Rate at which a drifted orientation is corrected, in 1/s.
const BACK_PER_S: f64 = 1.0;
/// Joints keep this far from their limits.
const LIMIT_MARGIN_RAD: f64 = 0.01;
/// To stop before its limit, a joint needs at most this fraction of its acceleration.
/// The rest is reserved for the motion of the other joints.
const STOP_SHARE: f64 = 0.4;
/// The tool does not move if it would move at less than this fraction of the requested speed.
const SHARE_MIN: f64 = 0.3;

/// Motion of the flange per unit of one joint: linear speed, then turn rate.
type Column = [f64; 6];

/// The reason why the tool does not move as requested.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Stuck {
    /// A joint is at its limit, or close to it.
    #[error("{joint} is at its limit; tilt the other way")]
    AtLimit {
        /// Which.
        joint: String,
    },
    /// The arm is stretched or folded so far that its joints can move the tool only in other directions.
    #[error("the arm cannot move its tool that way from here (it is stretched or folded); tilt another way")]
    Singular,
}

/// Returns joint speeds that move the tool at `tool_m_s` and keep (or restore) its orientation `hold`.
///
/// # Errors
/// Returns [`Stuck`] if the tool would not move in the requested direction.
pub fn joint_speeds(
    arm: &SerialArm,
    joints_rad: &Joints,
    tool_m_s: DVec3,
    hold: &DMat3,
    limits: &JointLimits,
) -> Result<Joints, Stuck> {
    let poses = arm.link_poses(joints_rad);
    let columns = columns(arm, &poses);
    let drift = turn(&(*hold * poses[JOINTS].rotation.transpose())) * BACK_PER_S;
    // An arm with too few joints for an orientation controls only the position.
    let asks_turn = arm.joints.len() >= 6;
    let columns = if asks_turn { columns } else { columns.map(|[x, y, z, ..]| [x, y, z, 0.0, 0.0, 0.0]) };
    let drift = if asks_turn { drift } else { DVec3::ZERO };
    let wanted = [tool_m_s.x, tool_m_s.y, tool_m_s.z, drift.x, drift.y, drift.z];
    let over =
        |speeds: &Joints| (0..JOINTS).map(|i| speeds[i].abs() / limits.velocity_rad_s[i]).fold(1.0, f64::max);
    // The speed is the maximum for all joints, before any joint is slowed near its limit.
    let slower = 1.0 / over(&damped(&columns, wanted, DAMPING * DAMPING));
    let (wanted, tool_m_s) = (wanted.map(|speed| speed * slower), tool_m_s * slower);

    let mut fixed: [Option<f64>; JOINTS] = [None; JOINTS];
    let mut speeds = [0.0; JOINTS];
    for _ in 0..=arm.joints.len() {
        let left: Column = std::array::from_fn(|row| {
            wanted[row]
                - (0..JOINTS).map(|i| fixed[i].map_or(0.0, |speed| columns[i][row] * speed)).sum::<f64>()
        });
        let free: [Column; JOINTS] =
            std::array::from_fn(|i| if fixed[i].is_some() { [0.0; 6] } else { columns[i] });
        let solved = damped(&free, left, DAMPING * DAMPING);
        speeds = std::array::from_fn(|i| fixed[i].unwrap_or(solved[i]));
        let beyond = |i: &usize| {
            let (low, high) = allowed(arm, *i, joints_rad[*i], limits);
            (speeds[*i] - speeds[*i].clamp(low, high)).abs()
        };
        let free = (0..arm.joints.len()).filter(|&i| fixed[i].is_none());
        let worst = free.max_by(|a, b| beyond(a).total_cmp(&beyond(b))).filter(|i| beyond(i) > 1e-12);
        let Some(i) = worst else { break };
        let (low, high) = allowed(arm, i, joints_rad[i], limits);
        fixed[i] = Some(speeds[i].clamp(low, high));
    }
    let moved: DVec3 = (0..JOINTS).map(|i| speeds[i] * DVec3::from_slice(&columns[i])).sum();
    if moved.dot(tool_m_s) < SHARE_MIN * tool_m_s.length_squared() {
        let stopped = fixed.iter().position(Option::is_some);
        return Err(match stopped {
            Some(i) => Stuck::AtLimit { joint: arm.joints[i].name.clone() },
            None => Stuck::Singular,
        });
    }
    let fastest = over(&speeds);
    Ok(speeds.map(|speed| speed / fastest))
}

/// Returns the acceleration that brings the joints to these speeds, within `for_s` if the limits allow it.
/// All joints change in proportion, so the tool's speed stays between its old and its requested value.
pub fn acceleration(from: &Motion, speeds_rad_s: &Joints, for_s: f64, limits: &JointLimits) -> Joints {
    let change: Joints = std::array::from_fn(|i| speeds_rad_s[i] - from.velocity_rad_s[i]);
    let share = |of: &Joints, most: &Joints| {
        let ratio = |i: usize| if of[i] == 0.0 { 1.0 } else { most[i] / of[i].abs() };
        (0..JOINTS).map(ratio).fold(1.0, f64::min)
    };
    let most = limits.acceleration_rad_s2.map(|a| a * for_s);
    let wanted = change.map(|change| change / for_s);
    let wanted = wanted.map(|a| a * share(&change, &most));
    if !limits.jerk_rad_s3.iter().all(|jerk| jerk.is_finite()) {
        return wanted;
    }
    // The acceleration must be small enough that it can return to zero before the joint reaches its target speed.
    let back: Joints = std::array::from_fn(|i| 0.7 * (2.0 * limits.jerk_rad_s3[i] * change[i].abs()).sqrt());
    let wanted = wanted.map(|a| a * share(&wanted, &back));
    let step: Joints = std::array::from_fn(|i| wanted[i] - from.acceleration_rad_s2[i]);
    let part = share(&step, &limits.jerk_rad_s3.map(|jerk| jerk * for_s));
    std::array::from_fn(|i| from.acceleration_rad_s2[i] + part * step[i])
}

/// Returns the slowest and the fastest speed from which a joint can stop before its limits.
fn allowed(arm: &SerialArm, i: usize, angle_rad: f64, limits: &JointLimits) -> (f64, f64) {
    let Some((low, high)) = arm.joints[i].limit_rad else { return (f64::NEG_INFINITY, f64::INFINITY) };
    let stops = |room_rad: f64| {
        (2.0 * STOP_SHARE * limits.acceleration_rad_s2[i] * (room_rad - LIMIT_MARGIN_RAD).max(0.0)).sqrt()
    };
    (-stops(angle_rad - low), stops(high - angle_rad))
}

/// Returns a small rotation as axis times angle; for a larger rotation, the sine replaces the angle.
fn turn(rotation: &DMat3) -> DVec3 {
    let [x, y, z] = [rotation.x_axis, rotation.y_axis, rotation.z_axis];
    0.5 * DVec3::new(y.z - z.y, z.x - x.z, x.y - y.x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gen3::{HOME, paper_limits};

    fn tool_m_s(arm: &SerialArm, joints_rad: &Joints, speeds: &Joints) -> DVec3 {
        let after = std::array::from_fn(|i| joints_rad[i] + 1e-4 * speeds[i]);
        (arm.flange_pose(&after).position_m - arm.flange_pose(joints_rad).position_m) / 1e-4
    }

    #[test]
    fn the_tool_moves_as_asked_and_keeps_its_orientation() {
        let arm = SerialArm::gen3();
        let hold = arm.flange_pose(&HOME).rotation;
        for way in [DVec3::X, -DVec3::X, DVec3::Y, DVec3::Z, DVec3::new(1.0, -1.0, 0.5).normalize()] {
            let asked = 0.03 * way;
            let speeds = joint_speeds(&arm, &HOME, asked, &hold, &paper_limits()).unwrap();
            let moved = tool_m_s(&arm, &HOME, &speeds);
            // Damping costs a few percent.
            assert!((moved - asked).length() < 0.08 * 0.03, "{way}: {moved}");
            let after: Joints = std::array::from_fn(|i| HOME[i] + speeds[i]);
            let turned = turn(&(arm.flange_pose(&after).rotation * hold.transpose())).length();
            assert!(turned < 0.02, "{way}: turned by {turned} rad in a second");
        }
    }

    #[test]
    fn too_fast_is_slowed_on_the_same_line_and_no_joint_exceeds_its_speed() {
        let arm = SerialArm::gen3();
        let (hold, limits) = (arm.flange_pose(&HOME).rotation, paper_limits());
        let asked = DVec3::new(1.0, 0.4, 0.0);
        let speeds = joint_speeds(&arm, &HOME, asked, &hold, &limits).unwrap();
        let fastest = (0..JOINTS).map(|i| speeds[i].abs() / limits.velocity_rad_s[i]).fold(0.0, f64::max);
        assert!((fastest - 1.0).abs() < 1e-9, "{fastest}");
        let moved = tool_m_s(&arm, &HOME, &speeds);
        assert!(moved.normalize().dot(asked.normalize()) > 0.995, "{moved}");
    }

    #[test]
    fn a_stretched_arm_is_not_stretched_further_and_says_so() {
        let arm = SerialArm::gen3();
        // Straight up.
        let joints = [0.0; JOINTS];
        let hold = arm.flange_pose(&joints).rotation;
        let up = joint_speeds(&arm, &joints, 0.05 * DVec3::Z, &hold, &paper_limits());
        assert_eq!(up, Err(Stuck::Singular));
    }

    #[test]
    fn a_joint_at_its_limit_stays_there_while_others_move_the_tool_or_the_reason_names_it() {
        let arm = SerialArm::gen3();
        let limits = paper_limits();
        let mut random = host_robot::Random::new(4);
        let (mut moved, mut stuck) = (0, 0);
        for _ in 0..500 {
            let mut joints: Joints = std::array::from_fn(|_| random.between(-2.0, 2.0));
            joints[3] = arm.joints[3].limit_rad.unwrap().0 + 0.005;
            let hold = arm.flange_pose(&joints).rotation;
            let way = DVec3::from_array(std::array::from_fn(|_| random.between(-0.05, 0.05)));
            match joint_speeds(&arm, &joints, way, &hold, &limits) {
                Ok(speeds) => {
                    assert!(speeds[3] >= 0.0, "{speeds:?}");
                    moved += 1;
                }
                Err(Stuck::AtLimit { joint }) => {
                    assert!(!joint.is_empty());
                    stuck += 1;
                }
                Err(Stuck::Singular) => {}
            }
        }
        assert!(moved > 100 && stuck > 0, "{moved} {stuck}");
    }

    #[test]
    fn speeds_change_within_the_limits_of_acceleration_and_jerk_all_joints_alike() {
        let goal: Joints = std::array::from_fn(|i| 0.02 * (i as f64 - 3.0));
        for limits in [paper_limits(), paper_limits().with_jerk(4.3)] {
            let mut here = Motion::at_rest(HOME);
            for _ in 0..200 {
                let next = acceleration(&here, &goal, 0.02, &limits);
                for (i, next) in next.iter().enumerate() {
                    assert!(next.abs() <= limits.acceleration_rad_s2[i] * (1.0 + 1e-9));
                    let step = (next - here.acceleration_rad_s2[i]).abs();
                    assert!(step <= limits.jerk_rad_s3[i] * 0.02 * (1.0 + 1e-9));
                    // A constant jerk leads from one acceleration to the other, unless the jerk is unlimited.
                    let mean = if limits.jerk_rad_s3[i].is_finite() {
                        0.5 * (next + here.acceleration_rad_s2[i])
                    } else {
                        *next
                    };
                    here.velocity_rad_s[i] += 0.02 * mean;
                }
                here.acceleration_rad_s2 = next;
            }
            for (reached, goal) in here.velocity_rad_s.iter().zip(goal) {
                assert!((reached - goal).abs() < 1e-3, "{reached} {goal}");
            }
        }
    }
}
