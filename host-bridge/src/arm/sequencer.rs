//! Runs one arm motion at a time: home first, then to the pose, or as planned. Time comes in as steps.

use std::sync::Arc;

use serde::Serialize;

use super::gen3::{HOME, Joints};
use super::motions::ArmMotion;
use super::profile::{JointLimits, Motion};
use crate::plan::{Plan, Refusal, Trajectory};

/// Which part of a motion is under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Leg {
    /// On the way to the home pose.
    ToHome,
    /// On the way to the motion's own pose.
    ToGoal,
    /// Stopping where it is; the motion is given up.
    Halting,
}

/// The arm as it is now.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ArmState {
    /// In rad.
    pub joints_rad: Joints,
    /// In rad/s.
    pub velocity_rad_s: Joints,
    /// What runs, and how far it is; `None` = at rest.
    pub running: Option<(ArmMotion, Leg)>,
}

impl ArmState {
    /// No joint moves.
    pub fn at_rest(&self) -> bool {
        self.velocity_rad_s.iter().all(|v| *v == 0.0)
    }
}

/// How a motion ended.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ArmReport {
    /// Which motion.
    pub motion: ArmMotion,
    /// The pose was reached; otherwise the motion was halted.
    pub reached: bool,
    /// Where the arm rests now, in rad.
    pub joints_rad: Joints,
}

/// A motion is under way; a new one is not accepted, and not queued.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the arm is busy with {0}")]
pub struct Busy(pub ArmMotion);

/// Why a motion does not start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotStarted {
    /// Another one runs.
    #[error(transparent)]
    Busy(#[from] Busy),
    /// No safe way there.
    #[error(transparent)]
    Refused(#[from] Refusal),
}

#[derive(Clone, Debug)]
struct Running {
    motion: ArmMotion,
    trajectory: Arc<Trajectory>,
    /// When it rests at home on its way; 0 = it does not.
    home_s: f64,
    halting: bool,
    elapsed_s: f64,
}

impl Running {
    fn leg(&self) -> Leg {
        if self.halting {
            Leg::Halting
        } else if self.elapsed_s < self.home_s {
            Leg::ToHome
        } else {
            Leg::ToGoal
        }
    }
}

/// The arm's motion in time.
#[derive(Clone, Debug)]
pub struct Sequencer {
    limits: JointLimits,
    here: Motion,
    running: Option<Running>,
    random_draws: usize,
    report: Option<ArmReport>,
}

impl Sequencer {
    /// An arm at rest.
    pub fn new(joints_rad: Joints, limits: JointLimits) -> Self {
        Sequencer { limits, here: Motion::at_rest(joints_rad), running: None, random_draws: 0, report: None }
    }

    /// Where the motion would end if it were started now.
    pub fn goal(&self, motion: ArmMotion) -> Joints {
        motion.goal(self.random_draws)
    }

    /// Starts a motion from rest: straight home, then straight to its pose.
    ///
    /// # Errors
    /// [`Busy`] while another motion runs or halts.
    pub fn start(&mut self, motion: ArmMotion) -> Result<(), Busy> {
        let home = Trajectory::through(&[self.here.joints_rad, HOME], &[], &self.limits);
        let onward = Trajectory::through(&[HOME, self.goal(motion)], &[], &self.limits);
        let home_s = home.duration_s();
        self.run(motion, home.then(&onward), home_s)
    }

    /// Starts a motion from rest as planned.
    ///
    /// # Errors
    /// [`Busy`] while another motion runs or halts.
    pub fn start_planned(&mut self, motion: ArmMotion, plan: Plan) -> Result<(), Busy> {
        self.run(motion, plan.trajectory, plan.home_s.unwrap_or(0.0))
    }

    fn run(&mut self, motion: ArmMotion, trajectory: Trajectory, home_s: f64) -> Result<(), Busy> {
        if let Some(running) = &self.running {
            return Err(Busy(running.motion));
        }
        if motion == ArmMotion::RandomTop {
            self.random_draws += 1;
        }
        let trajectory = Arc::new(trajectory);
        self.running = Some(Running { motion, trajectory, home_s, halting: false, elapsed_s: 0.0 });
        Ok(())
    }

    /// Gives the running motion up and brakes as fast as the limits allow, straight on.
    pub fn halt(&mut self) {
        if let Some(running) = &mut self.running
            && !running.halting
        {
            running.trajectory = Arc::new(Trajectory::braking(self.here, &self.limits));
            running.elapsed_s = 0.0;
            running.halting = true;
        }
    }

    /// Lets `dt_s` seconds pass.
    pub fn step(&mut self, dt_s: f64) {
        let Some(running) = &mut self.running else { return };
        running.elapsed_s += dt_s;
        self.here = running.trajectory.motion(running.elapsed_s);
        if running.elapsed_s >= running.trajectory.duration_s() {
            let (motion, reached) = (running.motion, !running.halting);
            self.report = Some(ArmReport { motion, reached, joints_rad: self.here.joints_rad });
            self.running = None;
        }
    }

    /// Limits that it keeps.
    pub fn limits(&self) -> &JointLimits {
        &self.limits
    }

    /// How it moves now.
    pub fn motion(&self) -> Motion {
        self.here
    }

    /// The arm as it is now.
    pub fn state(&self) -> ArmState {
        ArmState {
            joints_rad: self.here.joints_rad,
            velocity_rad_s: self.here.velocity_rad_s,
            running: self.running.as_ref().map(|r| (r.motion, r.leg())),
        }
    }

    /// How the last motion ended; once per motion.
    pub fn take_report(&mut self) -> Option<ArmReport> {
        self.report.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::motions::READY;

    const DT_S: f64 = 0.005;

    fn run_to_rest(arm: &mut Sequencer) -> f64 {
        let mut time_s = 0.0;
        while arm.state().running.is_some() {
            arm.step(DT_S);
            time_s += DT_S;
            assert!(time_s < 60.0);
        }
        time_s
    }

    #[test]
    fn a_motion_passes_through_home_and_ends_at_its_pose() {
        let mut arm = Sequencer::new(READY, JointLimits::paper());
        arm.start(ArmMotion::Place).unwrap();
        let mut nearest_home = f64::INFINITY;
        while arm.state().running.is_some() {
            arm.step(DT_S);
            let joints = arm.state().joints_rad;
            let far = joints.into_iter().zip(HOME).map(|(a, b)| (a - b).abs());
            nearest_home = nearest_home.min(far.fold(0.0, f64::max));
        }
        assert!(nearest_home < 1e-4, "{nearest_home}");
        let goal = ArmMotion::Place.goal(0);
        let report = arm.take_report().unwrap();
        assert_eq!(report, ArmReport { motion: ArmMotion::Place, reached: true, joints_rad: goal });
        assert_eq!(arm.take_report(), None);
    }

    #[test]
    fn a_second_motion_is_refused_while_one_runs_and_while_it_halts() {
        let mut arm = Sequencer::new(HOME, JointLimits::paper());
        arm.start(ArmMotion::PickUp).unwrap();
        arm.step(2.0);
        assert_eq!(arm.start(ArmMotion::Place), Err(Busy(ArmMotion::PickUp)));
        arm.halt();
        arm.step(DT_S);
        assert_eq!(arm.start(ArmMotion::Place), Err(Busy(ArmMotion::PickUp)));
        assert!(run_to_rest(&mut arm) < 0.35, "braking takes at most v/a = 0.325 s");
        assert!(!arm.take_report().unwrap().reached);
        arm.start(ArmMotion::Place).unwrap();
    }

    #[test]
    fn halting_twice_or_at_rest_changes_nothing() {
        let mut arm = Sequencer::new(HOME, JointLimits::paper());
        arm.halt();
        assert_eq!(arm.state().running, None);
        arm.start(ArmMotion::PickUp).unwrap();
        arm.step(3.0);
        arm.halt();
        arm.step(0.1);
        let before = arm.state();
        arm.halt();
        assert_eq!(arm.state(), before);
    }

    #[test]
    fn circles_lead_to_one_pose_after_the_other() {
        let mut arm = Sequencer::new(HOME, JointLimits::paper());
        let mut poses = Vec::new();
        for _ in 0..2 {
            arm.start(ArmMotion::RandomTop).unwrap();
            run_to_rest(&mut arm);
            poses.push(arm.state().joints_rad);
        }
        assert_eq!(poses, [ArmMotion::RandomTop.goal(0), ArmMotion::RandomTop.goal(1)]);
    }
}
