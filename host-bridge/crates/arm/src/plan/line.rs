//! Straight lines of the flange, as a sequence of joint angles that are each close to the previous ones.

use host_robot::{DMat3, DQuat, Joints, Pose};

use crate::ik::{self, Budget};
use crate::model::SerialArm;
use crate::plan::purse::Purse;

/// Distance between two points of the line.
/// Between them, the error of the line is a fraction of a millimetre.
const STEP_M: f64 = 0.02;
const STEP_RAD: f64 = 0.08;
/// Maximum rotation of a joint between two points. Beyond this angle, the arm would flip.
const JUMP_RAD: f64 = 0.35;
const STEPS: usize = 80;

/// The line cannot be followed to its end.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the straight line ends after {after_mm:.0} of {of_mm:.0} mm: the arm is at a limit or stretched out there; start \
     elsewhere, or go freely (straight = false)"
)]
pub struct Ends {
    after_mm: f64,
    of_mm: f64,
}

/// Returns the angles on the straight line from the arm's position to a pose of its flange,
/// including both ends.
/// The solver's steps count against the purse's budget.
///
/// # Errors
/// Returns the distance that can be reached, or the distance for which checks remain.
pub fn along(arm: &SerialArm, from_rad: &Joints, target: &Pose, purse: &Purse) -> Result<Vec<Joints>, Ends> {
    let start = arm.flange_pose(from_rad);
    let way_m = start.position_m.distance(target.position_m);
    let (from, to) = (DQuat::from_mat3(&start.rotation), DQuat::from_mat3(&target.rotation));
    let steps = (way_m / STEP_M).max(from.angle_between(to) / STEP_RAD).ceil().max(1.0) as u32;
    let mut path_rad = vec![*from_rad];
    for k in 1..=steps {
        let share = f64::from(k) / f64::from(steps);
        let pose = Pose {
            position_m: start.position_m.lerp(target.position_m, share),
            rotation: DMat3::from_quat(from.slerp(to, share)),
        };
        let last = path_rad[path_rad.len() - 1];
        let near = |joints: &Joints| joints.iter().zip(&last).all(|(a, b)| (a - b).abs() <= JUMP_RAD);
        let budget = Budget { steps: STEPS, looks: 1 }.within(purse);
        let found = ik::search(arm, &pose, &last, u64::from(k), budget, near);
        purse.spend(ik::steps(&found));
        let after_mm = 1000.0 * way_m * f64::from(k - 1) / f64::from(steps);
        path_rad.push(found.map_err(|_| Ends { after_mm, of_mm: 1000.0 * way_m })?.joints_rad);
    }
    Ok(path_rad)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gen3::HOME;
    use host_robot::DVec3;

    #[test]
    fn the_flange_keeps_to_the_line_and_its_orientation() {
        let arm = SerialArm::gen3();
        let start = arm.flange_pose(&HOME);
        let target = Pose { position_m: start.position_m + DVec3::new(0.05, 0.1, -0.15), ..start };
        let path = along(&arm, &HOME, &target, &Purse::default()).unwrap();
        let line = (target.position_m - start.position_m).normalize();
        for two in path.windows(2) {
            for k in 0..=10 {
                let between = crate::plan::collision::between(&two[0], &two[1], f64::from(k) / 10.0);
                let here = arm.flange_pose(&between);
                let off = here.position_m - start.position_m;
                assert!((off - off.dot(line) * line).length() < 0.0005);
                assert!(here.rotation.abs_diff_eq(start.rotation, 0.003));
            }
        }
        let last = arm.flange_pose(&path[path.len() - 1]);
        assert!(last.position_m.abs_diff_eq(target.position_m, 1e-8));
    }

    #[test]
    fn a_line_beyond_the_arms_reach_says_how_far_it_goes() {
        let arm = SerialArm::gen3();
        let start = arm.flange_pose(&HOME);
        let target = Pose { position_m: start.position_m + DVec3::new(1.0, 0.0, 0.0), ..start };
        let error = along(&arm, &HOME, &target, &Purse::default()).unwrap_err();
        assert!((200.0..700.0).contains(&error.after_mm), "{error}");
        assert!(error.to_string().contains("of 1000 mm"), "{error}");
    }
}
