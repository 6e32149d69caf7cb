//! Runs one arm motion at a time: home first, then to the pose. Time comes in as steps.

use serde::Serialize;

use super::gen3::{HOME, JOINTS, Joints};
use super::motions::ArmMotion;
use super::profile::{JointLimits, JointMove, Sample};

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

#[derive(Clone, Copy, Debug)]
struct Running {
    motion: ArmMotion,
    goal_rad: Joints,
    leg: Leg,
    plan: JointMove,
    elapsed_s: f64,
}

/// The arm's motion in time.
#[derive(Clone, Debug)]
pub struct Sequencer {
    limits: JointLimits,
    here: Sample,
    running: Option<Running>,
    random_draws: usize,
    report: Option<ArmReport>,
}

impl Sequencer {
    /// An arm at rest.
    pub fn new(joints_rad: Joints, limits: JointLimits) -> Self {
        Sequencer {
            limits,
            here: Sample { joints_rad, velocity_rad_s: [0.0; JOINTS] },
            running: None,
            random_draws: 0,
            report: None,
        }
    }

    /// Starts a motion from rest.
    ///
    /// # Errors
    /// [`Busy`] while another motion runs or halts.
    pub fn start(&mut self, motion: ArmMotion) -> Result<(), Busy> {
        if let Some(running) = &self.running {
            return Err(Busy(running.motion));
        }
        let goal_rad = motion.goal(self.random_draws);
        if motion == ArmMotion::RandomTop {
            self.random_draws += 1;
        }
        let plan = JointMove::new(self.here.joints_rad, HOME, &self.limits);
        self.running = Some(Running { motion, goal_rad, leg: Leg::ToHome, plan, elapsed_s: 0.0 });
        Ok(())
    }

    /// Gives the running motion up and brakes within the limits, along the path.
    pub fn halt(&mut self) {
        if let Some(running) = &mut self.running
            && running.leg != Leg::Halting
        {
            running.plan = running.plan.halted_at(running.elapsed_s);
            running.elapsed_s = 0.0;
            running.leg = Leg::Halting;
        }
    }

    /// Lets `dt_s` seconds pass.
    pub fn step(&mut self, dt_s: f64) {
        let Some(running) = &mut self.running else { return };
        running.elapsed_s += dt_s;
        // A leg may end within the step; what is left of the step belongs to the next leg.
        while running.elapsed_s >= running.plan.duration_s() {
            match running.leg {
                Leg::ToHome => {
                    running.elapsed_s -= running.plan.duration_s();
                    running.leg = Leg::ToGoal;
                    running.plan = JointMove::new(HOME, running.goal_rad, &self.limits);
                }
                Leg::ToGoal | Leg::Halting => {
                    let joints_rad = running.plan.sample(running.elapsed_s).joints_rad;
                    let reached = running.leg == Leg::ToGoal;
                    self.report = Some(ArmReport { motion: running.motion, reached, joints_rad });
                    self.here = Sample { joints_rad, velocity_rad_s: [0.0; JOINTS] };
                    self.running = None;
                    return;
                }
            }
        }
        self.here = running.plan.sample(running.elapsed_s);
    }

    /// The arm as it is now.
    pub fn state(&self) -> ArmState {
        ArmState {
            joints_rad: self.here.joints_rad,
            velocity_rad_s: self.here.velocity_rad_s,
            running: self.running.map(|r| (r.motion, r.leg)),
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
