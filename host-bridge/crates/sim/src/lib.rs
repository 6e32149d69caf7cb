//! The simulated robot, in steps of a millisecond:
//! a base with differential drive, an arm, and an optional gripper.

use std::sync::Arc;

use host_robot::{
    Base, BaseConfig, BaseState, End, Following, Grip, GripEnd, JointLimits, Joints, Motion, Odometry,
    Reading, Robot, Trajectory, Twist,
};

/// Length of one step.
pub const STEP_MS: u64 = 1;

/// After this long without a command, the robot stops by itself.
pub const COMMAND_TIMEOUT_MS: u64 = 500;

/// Figures of the simulated robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimConfig {
    /// Size and limits of the base.
    pub base: BaseConfig,
    /// Initial position of the arm, in rad.
    pub arm_start_rad: Joints,
    /// Scaled limits of the arm.
    pub arm_limits: JointLimits,
}

/// The arm, which follows one trajectory at a time without errors.
#[derive(Clone, Debug)]
struct Arm {
    here: Motion,
    following: Option<(Arc<Trajectory>, f64)>,
    halting: bool,
    end: Option<End>,
}

/// Speed of the simulated fingers in m/s.
const GRIP_SPEED_M_S: f64 = 0.06;

/// Two fingers.
#[derive(Clone, Debug)]
struct Gripper {
    opening_m: f64,
    widest_m: f64,
    asked: Option<Grip>,
    end: Option<GripEnd>,
}

/// A robot in virtual time.
#[derive(Clone, Debug)]
pub struct Simulator {
    base: Base,
    arm: Arm,
    gripper: Option<Gripper>,
    arm_limits: JointLimits,
    now_ms: u64,
    last_command_ms: u64,
    timeouts: u32,
    timed_out: bool,
}

impl Simulator {
    /// Creates a robot at rest at time 0.
    pub fn new(config: SimConfig) -> Self {
        Simulator {
            base: Base::new(config.base),
            arm: Arm {
                here: Motion::at_rest(config.arm_start_rad),
                following: None,
                halting: false,
                end: None,
            },
            gripper: None,
            arm_limits: config.arm_limits,
            now_ms: 0,
            last_command_ms: 0,
            timeouts: 0,
            timed_out: false,
        }
    }

    /// Sets the robot's clock to `now_ms`.
    #[must_use]
    pub fn starting_at(self, now_ms: u64) -> Self {
        Simulator { now_ms, last_command_ms: now_ms, ..self }
    }

    /// Adds a gripper, which is open.
    #[must_use]
    pub fn with_gripper(self, widest_m: f64) -> Self {
        let gripper = Gripper { opening_m: widest_m, widest_m, asked: None, end: None };
        Simulator { gripper: Some(gripper), ..self }
    }

    /// Returns whether no wheel and no joint moves.
    pub fn at_rest(&self) -> bool {
        self.base.wheels_rad_s() == [0.0; 2] && self.arm.here.velocity_rad_s.iter().all(|v| *v == 0.0)
    }

    /// Returns the speeds of the left and right wheel in rad/s.
    pub fn wheels_rad_s(&self) -> [f64; 2] {
        self.base.wheels_rad_s()
    }

    /// Returns position and speed of the base.
    pub fn odometry(&self) -> Odometry {
        self.base.odometry()
    }

    /// How the arm moves.
    pub fn motion(&self) -> Motion {
        self.arm.here
    }

    fn heard(&mut self) {
        self.last_command_ms = self.now_ms;
        self.timed_out = false;
    }
}

impl Arm {
    fn step(&mut self, dt_s: f64) {
        let Some((trajectory, elapsed_s)) = &mut self.following else { return };
        *elapsed_s += dt_s;
        self.here = trajectory.motion(*elapsed_s);
        if *elapsed_s >= trajectory.duration_s() {
            self.end = Some(if self.halting { End::Halted } else { End::Reached });
            self.following = None;
            self.halting = false;
        }
    }

    /// Abandons the trajectory and brakes in a straight line as fast as the limits allow.
    fn halt(&mut self, limits: &JointLimits) {
        if self.following.is_some() && !self.halting {
            self.following = Some((Arc::new(Trajectory::braking(self.here, limits)), 0.0));
            self.halting = true;
        }
    }
}

impl Gripper {
    fn step(&mut self, dt_s: f64) {
        let Some(asked) = self.asked else { return };
        let wanted_m = asked.opening_m.clamp(0.0, self.widest_m);
        let way_m = wanted_m - self.opening_m;
        let mut next_m = self.opening_m + way_m.clamp(-GRIP_SPEED_M_S * dt_s, GRIP_SPEED_M_S * dt_s);
        let mut end = (next_m == wanted_m).then_some(GripEnd::Reached);
        // Fingers can close on an object only from outside.
        if let Some(between_m) =
            asked.between_m.filter(|m| (next_m..=self.opening_m).contains(m) && way_m < 0.0)
        {
            next_m = between_m;
            end = Some(GripEnd::Stalled);
        }
        self.opening_m = next_m;
        if end.is_some() {
            self.finish(end);
        }
    }

    fn finish(&mut self, end: Option<GripEnd>) {
        if self.asked.take().is_some() {
            self.end = end;
        }
    }
}

impl Robot for Simulator {
    fn step(&mut self, now_ms: u64) {
        let dt_s = STEP_MS as f64 / 1000.0;
        while self.now_ms + STEP_MS <= now_ms {
            self.now_ms += STEP_MS;
            if self.now_ms - self.last_command_ms > COMMAND_TIMEOUT_MS && !self.timed_out {
                self.timed_out = true;
                self.timeouts += u32::from(!self.at_rest());
                self.base.drive(Twist::ZERO);
                self.arm.halt(&self.arm_limits);
                self.halt_gripper();
            }
            if self.timed_out && self.at_rest() && self.arm.following.is_none() {
                // Nothing moves until the next command. The rest of a long pause is therefore a single step.
                self.now_ms += (now_ms - self.now_ms) / STEP_MS * STEP_MS;
            }
            self.base.step(dt_s);
            self.arm.step(dt_s);
            if let Some(gripper) = &mut self.gripper {
                gripper.step(dt_s);
            }
        }
    }

    fn arm(&self) -> Option<Reading<Motion>> {
        Some(Reading { value: self.arm.here, age_ms: 0 })
    }

    fn base(&self) -> Option<Reading<BaseState>> {
        Some(Reading { value: self.base.state(), age_ms: 0 })
    }

    fn joint_limits(&self) -> &JointLimits {
        &self.arm_limits
    }

    fn base_limits(&self) -> &BaseConfig {
        self.base.config()
    }

    fn drive(&mut self, twist: Twist) {
        self.heard();
        self.base.drive(twist);
    }

    fn can_follow(&self) -> Result<(), String> {
        Ok(())
    }

    fn follow(&mut self, trajectory: Arc<Trajectory>) -> Result<(), String> {
        self.heard();
        self.arm.following = Some((trajectory, 0.0));
        self.arm.halting = false;
        Ok(())
    }

    fn ahead_ms(&self) -> Result<u64, String> {
        Ok(0)
    }

    fn follow_on(&mut self, trajectory: Arc<Trajectory>, from_s: f64) -> Result<(), String> {
        match &mut self.arm.following {
            Some((followed, elapsed_s)) if !self.arm.halting && *elapsed_s <= from_s => {
                *followed = trajectory;
                Ok(())
            }
            _ => Err("there is no motion that could be continued from there".to_owned()),
        }
    }

    fn following(&self) -> Following {
        match self.arm.following {
            None => Following::Idle,
            Some(_) if self.arm.halting => Following::Halting,
            Some((_, elapsed_s)) => Following::Moving { elapsed_s },
        }
    }

    fn take_end(&mut self) -> Option<End> {
        self.arm.end.take()
    }

    fn halt_arm(&mut self) {
        self.arm.halt(&self.arm_limits);
    }

    fn halt(&mut self) {
        self.heard();
        self.base.drive(Twist::ZERO);
        self.arm.halt(&self.arm_limits);
        self.halt_gripper();
    }

    fn opening_m(&self) -> Option<Reading<f64>> {
        Some(Reading { value: self.gripper.as_ref()?.opening_m, age_ms: 0 })
    }

    fn can_grip(&self) -> Result<(), String> {
        match &self.gripper {
            Some(_) => Ok(()),
            None => {
                Err("the simulated arm has no gripper; give its scene one: [[tool]] with name = \"2f-85\""
                    .to_owned())
            }
        }
    }

    fn grip(&mut self, grip: Grip) -> Result<(), String> {
        self.can_grip()?;
        self.heard();
        if let Some(gripper) = &mut self.gripper {
            gripper.end = None;
            gripper.asked = Some(grip);
        }
        Ok(())
    }

    fn take_grip_end(&mut self) -> Option<GripEnd> {
        self.gripper.as_mut()?.end.take()
    }

    fn halt_gripper(&mut self) {
        if let Some(gripper) = &mut self.gripper {
            gripper.finish(Some(GripEnd::Halted));
        }
    }

    fn timeouts(&self) -> u32 {
        self.timeouts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_robot::JOINTS;

    const START_RAD: Joints = [0.1; JOINTS];
    const GOAL_RAD: Joints = [1.0; JOINTS];

    fn robot() -> Simulator {
        let arm_limits = JointLimits {
            velocity_rad_s: [0.14; JOINTS],
            acceleration_rad_s2: [0.43; JOINTS],
            jerk_rad_s3: [f64::INFINITY; JOINTS],
        };
        Simulator::new(SimConfig { base: BaseConfig::default(), arm_start_rad: START_RAD, arm_limits })
    }

    fn to_goal(robot: &Simulator) -> Arc<Trajectory> {
        Arc::new(Trajectory::through(&[START_RAD, GOAL_RAD], &[], robot.joint_limits()))
    }

    /// Advances the time, and repeats the command every 20 ms as the bridge does.
    fn run(robot: &mut Simulator, ms: u64, twist: Option<Twist>) {
        for _ in 0..ms {
            if let Some(twist) = twist.filter(|_| robot.now_ms.is_multiple_of(20)) {
                robot.drive(twist);
            }
            robot.step(robot.now_ms + 1);
        }
    }

    #[test]
    fn without_commands_base_and_arm_come_to_rest_by_themselves() {
        let mut robot = robot();
        robot.follow(to_goal(&robot)).unwrap();
        run(&mut robot, 2000, Some(Twist { linear_m_s: 1.0, angular_rad_s: 0.0 }));
        assert!(!robot.at_rest());
        // After 0.5 s of silence, the base takes 1 s to brake from 1 m/s at 1 m/s².
        run(&mut robot, 480, None);
        assert!((robot.odometry().twist.linear_m_s - 1.0).abs() < 1e-9);
        run(&mut robot, 1030, None);
        assert!(robot.at_rest());
        assert_eq!(robot.timeouts(), 1);
        assert_eq!(robot.take_end(), Some(End::Halted));
        run(&mut robot, 10_000, None);
        assert!(robot.at_rest());
    }

    #[test]
    fn a_halted_trajectory_is_not_taken_up_again_and_halting_twice_changes_nothing() {
        let mut robot = robot();
        robot.follow(to_goal(&robot)).unwrap();
        run(&mut robot, 1000, Some(Twist::ZERO));
        robot.halt();
        run(&mut robot, 100, Some(Twist::ZERO));
        let before = robot.motion();
        robot.halt();
        assert_eq!((robot.motion(), robot.following()), (before, Following::Halting));
        run(&mut robot, 300, Some(Twist::ZERO));
        assert_eq!(robot.following(), Following::Idle, "braking takes at most v/a = 0.326 s");
        let rested = robot.motion();
        run(&mut robot, 3000, Some(Twist::ZERO));
        assert_eq!(robot.motion(), rested);
    }

    fn grip(opening_m: f64, between_m: Option<f64>) -> Grip {
        Grip { opening_m, effort_n: None, between_m }
    }

    fn opening_m(robot: &Simulator) -> f64 {
        robot.opening_m().unwrap().value
    }

    #[test]
    fn fingers_close_on_what_is_between_them_and_a_stop_leaves_them_where_they_are() {
        let mut robot = robot().with_gripper(0.085);
        robot.grip(grip(0.0, Some(0.06))).unwrap();
        // 25 mm at 60 mm/s.
        run(&mut robot, 400, Some(Twist::ZERO));
        assert_eq!(robot.take_grip_end(), None);
        run(&mut robot, 30, Some(Twist::ZERO));
        assert_eq!((robot.take_grip_end(), opening_m(&robot)), (Some(GripEnd::Stalled), 0.06));
        robot.grip(grip(0.085, None)).unwrap();
        run(&mut robot, 100, Some(Twist::ZERO));
        robot.halt();
        let halted_m = opening_m(&robot);
        assert!((halted_m - 0.066).abs() < 1e-9, "{halted_m}");
        assert_eq!(robot.take_grip_end(), Some(GripEnd::Halted));
        run(&mut robot, 1000, Some(Twist::ZERO));
        assert_eq!(opening_m(&robot), halted_m);
    }

    #[test]
    fn fingers_with_nothing_between_them_close_and_silence_halts_them() {
        let mut robot = robot().with_gripper(0.085);
        robot.grip(grip(0.0, None)).unwrap();
        run(&mut robot, 1500, Some(Twist::ZERO));
        assert_eq!((robot.take_grip_end(), opening_m(&robot)), (Some(GripEnd::Reached), 0.0));
        robot.grip(grip(0.085, None)).unwrap();
        run(&mut robot, 1000, None);
        assert_eq!(robot.take_grip_end(), Some(GripEnd::Halted));
        assert!(opening_m(&robot) < 0.04);
    }

    #[test]
    fn without_a_gripper_a_grip_is_refused_with_what_to_do() {
        let mut robot = robot();
        assert!(robot.grip(grip(0.0, None)).unwrap_err().contains("[[tool]]"));
    }

    #[test]
    fn a_trajectory_ends_at_its_goal_once() {
        let mut robot = robot();
        robot.follow(to_goal(&robot)).unwrap();
        run(&mut robot, 10_000, Some(Twist::ZERO));
        assert_eq!(robot.motion(), Motion::at_rest(GOAL_RAD));
        assert_eq!(robot.take_end(), Some(End::Reached));
        assert_eq!(robot.take_end(), None);
    }
}
