//! Inverse kinematics: finds joint angles for a position and an orientation of the flange.
//!
//! The method is damped least squares (Nakamura and Hanafusa 1986).
//! After an unsuccessful step, the damping is increased.
//! The solver restarts from seeded random angles.
//! The budget counts steps and collision checks ([`Budget`]), not time.
//! Equal calls therefore give equal results on any machine.
//! A position beyond the arm's length is refused without a step ([`SerialArm::beyond_reach_m`]).
//! The test `tests/plan_ik.rs` prints the number of steps for solved and for refused positions.

use super::model::SerialArm;
use super::plan::Purse;
use host_robot::Random;
use host_robot::{DVec3, JOINTS, Joints, Pose};

/// The budget of one search, including all restarts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// Steps of the solver.
    pub steps: usize,
    /// Number of solutions that are passed to `accept`, which may check the arm's surroundings.
    pub looks: usize,
}

impl Budget {
    /// This budget takes much less than 0.2 s of one core.
    pub const DEFAULT: Budget = Budget { steps: 3000, looks: 200 };

    /// Limits the steps to those that remain in the purse.
    #[must_use]
    pub fn within(self, purse: &Purse) -> Self {
        Budget { steps: self.steps.min(usize::try_from(purse.left()).unwrap_or(usize::MAX)), ..self }
    }
}

/// Number of steps before a start is abandoned.
const STEPS_PER_START: usize = 40;

/// Maximum error of a solution in m and in rad.
pub const TOLERANCE: f64 = 1e-9;

/// Joint angles that were found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution {
    /// Joint angles within the limits, in rad.
    pub joints_rad: Joints,
    /// The work that the search took.
    pub steps: usize,
}

/// No angles were found.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Unreachable {
    /// The arm is too short.
    #[error(
        "the flange cannot get there: the place is {beyond_mm:.0} mm beyond the arm's reach; choose a nearer one"
    )]
    Beyond {
        /// Minimum distance between the target and the arm's reach.
        beyond_mm: f64,
    },
    /// The search ended without a solution.
    #[error(
        "no joint angles were found that put the flange there (nearest: {position_mm:.1} mm and {angle_mrad:.1} mrad \
         off, {looks} solutions touch something); it may be out of reach, or blocked: choose another place"
    )]
    NotFound {
        /// Distance between the best attempt and the goal.
        position_mm: f64,
        /// The angle between the best attempt's orientation and the goal's.
        angle_mrad: f64,
        /// Number of steps that the search took.
        steps: usize,
        /// Number of solutions that were not accepted.
        looks: usize,
    },
}

type Six = [f64; 6];

/// Finds joint angles within the limits that `accept` permits (for example, without contact).
/// The first attempt starts at `start_rad`, so a solution near it is found first.
///
/// # Errors
/// Returns [`Unreachable`], at the latest when [`Budget::DEFAULT`] is used up.
pub fn solve(
    arm: &SerialArm,
    target: &Pose,
    start_rad: &Joints,
    seed: u64,
    accept: impl FnMut(&Joints) -> bool,
) -> Result<Solution, Unreachable> {
    solve_from(&Purse::of(Budget::DEFAULT.steps as u64), arm, target, start_rad, seed, accept)
}

/// Like [`solve`], but the steps count against the purse. The search ends when the purse is empty.
///
/// # Errors
/// Returns the same errors as [`solve`].
pub fn solve_from(
    purse: &Purse,
    arm: &SerialArm,
    target: &Pose,
    start_rad: &Joints,
    seed: u64,
    accept: impl FnMut(&Joints) -> bool,
) -> Result<Solution, Unreachable> {
    let beyond_m = arm.beyond_reach_m(target);
    if beyond_m > 0.0 {
        return Err(Unreachable::Beyond { beyond_mm: 1000.0 * beyond_m });
    }
    let found = search(arm, target, start_rad, seed, Budget::DEFAULT.within(purse), accept);
    purse.spend(steps(&found));
    found
}

/// What a search took.
pub fn steps(found: &Result<Solution, Unreachable>) -> u64 {
    match found {
        Ok(Solution { steps, .. }) | Err(Unreachable::NotFound { steps, .. }) => *steps as u64,
        Err(Unreachable::Beyond { .. }) => 0,
    }
}

/// Runs only the search, with a custom budget.
///
/// # Errors
/// Returns [`Unreachable::NotFound`] when the budget is used up.
pub fn search(
    arm: &SerialArm,
    target: &Pose,
    start_rad: &Joints,
    seed: u64,
    budget: Budget,
    mut accept: impl FnMut(&Joints) -> bool,
) -> Result<Solution, Unreachable> {
    let mut random = Random::new(seed);
    let (mut steps, mut looks) = (0, 0);
    let mut nearest = (f64::INFINITY, [f64::INFINITY; 6]);
    let mut joints_rad = *start_rad;
    while steps < budget.steps && looks < budget.looks {
        into_limits(arm, &mut joints_rad);
        let mut damping = 1e-3;
        let (mut error, mut poses) = error_at(arm, target, &joints_rad);
        // Counts at least one step, so that a start at a rejected solution is not free.
        steps += 1;
        let until = budget.steps.min(steps + STEPS_PER_START);
        while steps < until && length(&error) >= TOLERANCE {
            steps += 1;
            let mut tried = joints_rad;
            let step = damped(&columns(arm, &poses), error, damping);
            for (joint, step) in tried.iter_mut().zip(step) {
                // Longer steps would leave the range in which the angles are almost linear.
                *joint += step.clamp(-0.5, 0.5);
            }
            into_limits(arm, &mut tried);
            let (tried_error, tried_poses) = error_at(arm, target, &tried);
            if length(&tried_error) < length(&error) {
                (joints_rad, error, poses) = (tried, tried_error, tried_poses);
                damping = (damping * 0.3).max(1e-12);
            } else {
                damping *= 10.0;
                if damping > 1e3 {
                    break;
                }
            }
        }
        if length(&error) < TOLERANCE {
            looks += 1;
            if accept(&joints_rad) {
                return Ok(Solution { joints_rad, steps });
            }
        }
        if length(&error) < nearest.0 {
            nearest = (length(&error), error);
        }
        for (i, joint) in arm.joints.iter().enumerate() {
            let pi = std::f64::consts::PI;
            let (low, high) = joint.limit_rad.unwrap_or((start_rad[i] - pi, start_rad[i] + pi));
            joints_rad[i] = random.between(low, high);
        }
    }
    let [x, y, z, u, v, w] = nearest.1;
    Err(Unreachable::NotFound {
        position_mm: 1000.0 * DVec3::new(x, y, z).length(),
        angle_mrad: 1000.0 * DVec3::new(u, v, w).length(),
        steps,
        looks,
    })
}

fn into_limits(arm: &SerialArm, joints_rad: &mut Joints) {
    for (joint, angle) in arm.joints.iter().zip(joints_rad) {
        if let Some((low, high)) = joint.limit_rad {
            *angle = angle.clamp(low, high);
        }
    }
}

fn length(error: &Six) -> f64 {
    error.iter().map(|e| e * e).sum::<f64>().sqrt()
}

/// Returns the error: the distance in m, the rotation as axis times angle in rad, and the frames.
fn error_at(arm: &SerialArm, target: &Pose, joints_rad: &Joints) -> (Six, [Pose; JOINTS + 1]) {
    let poses = arm.link_poses(joints_rad);
    let here = poses[JOINTS];
    let way = target.position_m - here.position_m;
    // The remaining rotation, in the base frame.
    let rotation = target.rotation * here.rotation.transpose();
    let turn = Pose { rotation, ..Pose::IDENTITY }.quaternion();
    let half_sine = turn.xyz().length();
    // For small rotations, the angle is twice the vector part.
    let scale = if half_sine < 1e-9 { 2.0 } else { 2.0 * half_sine.atan2(turn.w.min(1.0)) / half_sine };
    let turn = scale * turn.xyz();
    ([way.x, way.y, way.z, turn.x, turn.y, turn.z], poses)
}

/// Returns the motion of the flange per unit of each joint, in the base frame: linear speed, then turn rate.
/// `poses` contains the frames of the links and of the flange.
pub(crate) fn columns(arm: &SerialArm, poses: &[Pose; JOINTS + 1]) -> [Six; JOINTS] {
    let tip = poses[JOINTS].position_m;
    let mut columns = [[0.0; 6]; JOINTS];
    for (i, joint) in arm.joints.iter().enumerate() {
        let axis = poses[i].rotation * joint.axis;
        if joint.slides {
            columns[i] = [axis.x, axis.y, axis.z, 0.0, 0.0, 0.0];
            continue;
        }
        let lever = axis.cross(tip - poses[i].position_m);
        columns[i] = [lever.x, lever.y, lever.z, axis.x, axis.y, axis.z];
    }
    columns
}

/// Jᵀ (J Jᵀ + λ I)⁻¹ e
pub(crate) fn damped(columns: &[Six; JOINTS], wanted: Six, damping: f64) -> Joints {
    let mut normal = [[0.0; 6]; 6];
    for (row, line) in normal.iter_mut().enumerate() {
        for (col, value) in line.iter_mut().enumerate() {
            *value = columns.iter().map(|c| c[row] * c[col]).sum();
        }
        line[row] += damping;
    }
    let weights = solve_symmetric(normal, wanted);
    columns.map(|column| (0..6).map(|k| column[k] * weights[k]).sum())
}

/// Solves A x = b for a symmetric, positive definite A (Cholesky).
fn solve_symmetric(mut a: [[f64; 6]; 6], mut b: Six) -> Six {
    for i in 0..6 {
        for j in 0..=i {
            let sum = a[i][j] - (0..j).map(|k| a[i][k] * a[j][k]).sum::<f64>();
            // The damping keeps the diagonal positive, even with rounding errors.
            a[i][j] = if i == j { sum.max(1e-18).sqrt() } else { sum / a[j][j] };
        }
    }
    for i in 0..6 {
        b[i] = (b[i] - (0..i).map(|k| a[i][k] * b[k]).sum::<f64>()) / a[i][i];
    }
    for i in (0..6).rev() {
        b[i] = (b[i] - (i + 1..6).map(|k| a[k][i] * b[k]).sum::<f64>()) / a[i][i];
    }
    b
}
