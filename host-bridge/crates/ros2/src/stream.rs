//! Sends a trajectory in short pieces, which gives the arm a third stop.
//! Each piece contains the next quarter second of the plan, followed by braking on the planned path.
//! If the laptop dies, the cable is cut or the program freezes, the arm therefore comes to rest.
//!
//! ```text
//! plan      ────────────────────────────────────────────────►
//! piece 1   ▪────────╲__                ▪ a point in the past
//! piece 2        ▪────────╲__           ╲__ braking on the path, at the plan's acceleration and jerk
//! piece 3             ▪────────╲__      every 100 ms
//! ```
//!
//! This method relies on rules of Jazzy's joint_trajectory_controller.
//! Their source files are `joint_trajectory_controller.cpp` and `trajectory.cpp`.
//! A message on the topic replaces the running one. A zero stamp means "now" and would cause a jump or a blend.
//! With a stamp, the controller samples the trajectory at its own time,
//! exactly between a past point and the next one.
//! The last point is held. All pieces of a motion therefore have the same stamp in the robot's clock.

use std::collections::VecDeque;

use super::points;
use host_robot::{JointLimits, Joints, Motion, Trajectory, brake};
use host_topics::message::{Header, JointTrajectory, JointTrajectoryPoint, Time};

/// Duration of the plan in each piece, from now on.
pub const HORIZON_MS: u64 = 250;
/// Interval at which pieces are sent.
pub const RENEW_MS: u64 = 100;
/// A piece starts this long before the time at which it is sent.
const PAST_S: f64 = 0.02;
/// Time between sending the first piece and its motion. Its timeline begins earlier by the same time.
const LEAD_S: f64 = 0.05;
const HOLD_S: f64 = 0.5;
/// Time between sending a stop and its effect.
const STOP_LEAD_S: f64 = 0.01;
/// Minimum time between the decision to change a motion and the change. By then, the piece has arrived.
pub const AHEAD_MS: u64 = 30;
/// Longest time between two points of a piece.
const GRID_S: f64 = 0.05;
/// Points of braking.
const BRAKE_GRID_S: f64 = 0.02;
/// Controllers want increasing times.
const STEP_MIN_S: f64 = 0.001;

/// An estimate of the robot's clock from the stamps of its reports.
/// The estimate is never ahead of the robot's own clock.
#[derive(Clone, Debug, Default)]
pub struct RobotClock {
    /// Time of arrival in ms, and the difference between the stamp and our clock in ns.
    seen: VecDeque<(u64, i64)>,
}

impl RobotClock {
    /// Messages within this time are considered. The message with the shortest delay is the most accurate.
    const WINDOW_MS: u64 = 2000;

    /// Processes a stamp. A zero stamp is ignored.
    pub fn see(&mut self, stamp: Time, now_ms: u64) {
        if stamp == Time::default() {
            return;
        }
        let ahead_ns = stamp.nanoseconds() - now_ms as i64 * 1_000_000;
        self.seen.retain(|(at_ms, _)| now_ms.saturating_sub(*at_ms) < RobotClock::WINDOW_MS);
        self.seen.push_back((now_ms, ahead_ns));
        if self.seen.len() > 1024 {
            self.seen.pop_front();
        }
    }

    /// Returns the robot's time in ns at `now_ms`, or `None` without stamps.
    pub fn at_ns(&self, now_ms: u64) -> Option<i64> {
        let ahead_ns = self.seen.iter().map(|(_, ahead_ns)| *ahead_ns).max()?;
        Some(now_ms as i64 * 1_000_000 + ahead_ns)
    }
}

/// A trajectory that is being sent.
#[derive(Clone, Debug)]
pub struct Stream {
    /// Robot time at the trajectory's start.
    start_ns: i64,
    /// The last piece: its time of sending, and the time at which it begins to brake.
    sent: Option<(u64, f64)>,
    /// For an abandoned trajectory, the start and the end of braking.
    braking: Option<(f64, f64)>,
}

impl Stream {
    /// Creates a stream that begins shortly after `robot_ns`.
    pub fn new(robot_ns: i64) -> Self {
        Stream { start_ns: robot_ns + (LEAD_S * 1e9) as i64, sent: None, braking: None }
    }

    /// Time since the trajectory's start on the robot's clock in s; negative before the start.
    pub fn elapsed_s(&self, robot_ns: i64) -> f64 {
        (robot_ns - self.start_ns) as f64 / 1e9
    }

    /// Returns the expected position of the arm.
    pub fn reference(&self, trajectory: &Trajectory, limits: &JointLimits, robot_ns: i64) -> Motion {
        let elapsed_s = self.elapsed_s(robot_ns).max(0.0);
        match self.braking {
            Some((from_s, _)) if elapsed_s > from_s => {
                let instants = brake::along(trajectory, from_s, limits);
                let passed_s = elapsed_s - from_s;
                let k = instants.partition_point(|instant| instant.time_s <= passed_s).saturating_sub(1);
                instants[k].motion
            }
            _ => trajectory.motion(elapsed_s),
        }
    }

    /// Returns whether the trajectory was abandoned and the arm rests.
    pub fn has_braked(&self, robot_ns: i64) -> bool {
        self.braking.is_some_and(|(_, until_s)| self.elapsed_s(robot_ns) > until_s)
    }

    /// Returns the next piece if it is due. `Err` means that the arm has already begun to brake.
    pub fn renew(
        &mut self,
        trajectory: &Trajectory,
        limits: &JointLimits,
        now_ms: u64,
        robot_ns: i64,
    ) -> Result<Option<Vec<JointTrajectoryPoint>>, Late> {
        let elapsed_s = self.elapsed_s(robot_ns);
        if let Some((sent_ms, brakes_from_s)) = self.sent {
            if now_ms.saturating_sub(sent_ms) < RENEW_MS || self.braking.is_some() {
                return Ok(None);
            }
            // The new piece must arrive while the old one still follows the plan.
            if elapsed_s + STOP_LEAD_S >= brakes_from_s && brakes_from_s < trajectory.duration_s() {
                self.give_up(trajectory, limits, brakes_from_s);
                return Err(Late);
            }
        }
        Ok(Some(self.piece(trajectory, limits, now_ms, elapsed_s)))
    }

    /// Returns the next piece of a motion that changes from `change_s` on.
    /// `Err` means that the robot could already be there; the pieces that were sent remain valid.
    pub fn go_on(
        &mut self,
        [before, trajectory]: [&Trajectory; 2],
        change_s: f64,
        limits: &JointLimits,
        now_ms: u64,
        robot_ns: i64,
    ) -> Result<Vec<JointTrajectoryPoint>, Late> {
        let elapsed_s = self.elapsed_s(robot_ns);
        // The piece that the robot has must still describe the unchanged motion.
        let is_too_late =
            self.sent.is_some_and(|(_, until_s)| change_s > until_s && until_s < before.duration_s());
        if self.braking.is_some() || is_too_late || elapsed_s + STOP_LEAD_S > change_s {
            return Err(Late);
        }
        Ok(self.piece(trajectory, limits, now_ms, elapsed_s))
    }

    /// A piece that follows the trajectory for [`HORIZON_MS`] from now on.
    fn piece(
        &mut self,
        trajectory: &Trajectory,
        limits: &JointLimits,
        now_ms: u64,
        elapsed_s: f64,
    ) -> Vec<JointTrajectoryPoint> {
        let from_s = (elapsed_s.max(0.0) + HORIZON_MS as f64 / 1000.0).min(trajectory.duration_s());
        self.sent = Some((now_ms, from_s));
        self.points(trajectory, limits, elapsed_s, from_s)
    }

    /// A piece that brakes now.
    pub fn halt(
        &mut self,
        trajectory: &Trajectory,
        limits: &JointLimits,
        robot_ns: i64,
    ) -> Vec<JointTrajectoryPoint> {
        let elapsed_s = self.elapsed_s(robot_ns);
        let from_s = (elapsed_s + STOP_LEAD_S).clamp(0.0, trajectory.duration_s());
        self.give_up(trajectory, limits, from_s);
        self.points(trajectory, limits, elapsed_s, from_s)
    }

    fn give_up(&mut self, trajectory: &Trajectory, limits: &JointLimits, from_s: f64) {
        let takes_s = brake::along(trajectory, from_s, limits).last().map_or(0.0, |end| end.time_s);
        self.braking = Some((from_s, from_s + takes_s));
    }

    /// Returns the plan up to `from_s`, followed by braking. Times are relative to the stamp.
    fn points(
        &self,
        trajectory: &Trajectory,
        limits: &JointLimits,
        elapsed_s: f64,
        from_s: f64,
    ) -> Vec<JointTrajectoryPoint> {
        let first_s = (elapsed_s - PAST_S).max(-HOLD_S);
        let mut times_s = vec![first_s];
        times_s
            .extend(trajectory.knots_s().into_iter().filter(|knot_s| *knot_s > first_s && *knot_s < from_s));
        times_s.extend((1..).map(|k| first_s + f64::from(k) * GRID_S).take_while(|time_s| *time_s < from_s));
        if first_s < 0.0 && from_s > 0.0 {
            times_s.push(0.0);
        }
        times_s.sort_by(f64::total_cmp);
        let mut points: Vec<(f64, Motion)> = Vec::new();
        for time_s in times_s {
            let far = points.last().is_none_or(|(last_s, _)| time_s - last_s >= STEP_MIN_S);
            if far && from_s - time_s >= STEP_MIN_S {
                points.push((time_s, trajectory.motion(time_s.max(0.0))));
            }
        }
        let instants = brake::along(trajectory, from_s, limits);
        let (mut next_s, last) = (0.0, instants.len() - 1);
        for (k, instant) in instants.iter().enumerate() {
            // The last regular point is not too close to the end.
            let room = instants[last].time_s - instant.time_s >= STEP_MIN_S;
            if k == last || (instant.time_s >= next_s && room) {
                points.push((from_s + instant.time_s, instant.motion));
                next_s = instant.time_s + BRAKE_GRID_S;
            }
        }
        let point = |(time_s, motion): (f64, Motion)| JointTrajectoryPoint {
            positions: motion.joints_rad.to_vec(),
            velocities: motion.velocity_rad_s.to_vec(),
            time_from_start: Time::after_s(HOLD_S + time_s),
            ..JointTrajectoryPoint::default()
        };
        points.into_iter().map(point).collect()
    }

    /// Creates the message with these points.
    pub fn message(&self, joint_names: &[String], points: Vec<JointTrajectoryPoint>) -> JointTrajectory {
        let stamp_ns = (self.start_ns - (HOLD_S * 1e9) as i64).max(1);
        let header = Header { stamp: Time::at_ns(stamp_ns as u64), ..Header::default() };
        points::message(header, joint_names, points)
    }
}

/// The next piece would arrive after the arm has begun to brake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Late;

/// Returns the largest difference of a joint. Complete turns of continuous joints are ignored.
pub fn off_rad(here_rad: &Joints, there_rad: &Joints) -> f64 {
    use std::f64::consts::TAU;
    let off = here_rad.iter().zip(there_rad).map(|(a, b)| {
        let off = (a - b).rem_euclid(TAU);
        off.min(TAU - off)
    });
    off.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_robot::{JOINTS, joints};

    const FROM: Joints = joints([0.0, 0.26, 3.0, -2.27, 0.0, 0.96, 1.57]);

    fn limits() -> JointLimits {
        JointLimits {
            velocity_rad_s: [0.13963; JOINTS],
            acceleration_rad_s2: [0.43; JOINTS],
            jerk_rad_s3: [f64::INFINITY; JOINTS],
        }
    }

    fn trajectory() -> Trajectory {
        let mut to = FROM;
        to[1] += 0.75;
        to[3] += 0.55;
        Trajectory::through(&[FROM, to], &[], &limits())
    }

    /// A controller with Jazzy's rules. It samples the last message with cubics at its own time.
    /// The controller holds the last point.
    struct Controller {
        message: Option<JointTrajectory>,
    }

    impl Controller {
        fn at(&self, robot_ns: i64) -> Option<(f64, f64)> {
            let message = self.message.as_ref()?;
            assert_ne!(message.header.stamp, Time::default(), "never 'now'");
            let time_s = (robot_ns - message.header.stamp.nanoseconds()) as f64 / 1e9;
            let points = &message.points;
            assert!(points[0].time_from_start.seconds() <= time_s, "a point in the past");
            let k = points.partition_point(|point| point.time_from_start.seconds() <= time_s);
            let (p, v) = (points[k - 1].positions[1], points[k - 1].velocities[1]);
            let Some(next) = points.get(k) else { return Some((p, 0.0)) };
            let (t0, t1) = (points[k - 1].time_from_start.seconds(), next.time_from_start.seconds());
            let (h, q, w) = (t1 - t0, next.positions[1], next.velocities[1]);
            let s = (time_s - t0) / h;
            let position = p * (1.0 + 2.0 * s) * (1.0 - s).powi(2)
                + v * h * s * (1.0 - s).powi(2)
                + q * s * s * (3.0 - 2.0 * s)
                + w * h * s * s * (s - 1.0);
            Some((position, v + (w - v) * s))
        }
    }

    const BOOT_NS: i64 = 1_700_000_000_000_000_000;

    /// Runs for `ms`, with pieces until `dead_ms`. Returns positions of joint 2, one per millisecond.
    fn run(ms: u64, dead_ms: u64, halt_ms: Option<u64>) -> Vec<f64> {
        let trajectory = trajectory();
        let names: Vec<String> = (1..=7).map(|i| format!("joint_{i}")).collect();
        let mut stream = Stream::new(BOOT_NS);
        let mut controller = Controller { message: None };
        let mut seen = Vec::new();
        for now_ms in 0..ms {
            let robot_ns = BOOT_NS + now_ms as i64 * 1_000_000;
            if halt_ms == Some(now_ms) {
                let points = stream.halt(&trajectory, &limits(), robot_ns);
                controller.message = Some(stream.message(&names, points));
            } else if now_ms < dead_ms
                && halt_ms.is_none_or(|at| now_ms < at)
                && let Ok(Some(points)) = stream.renew(&trajectory, &limits(), now_ms, robot_ns)
            {
                controller.message = Some(stream.message(&names, points));
            }
            seen.push(controller.at(robot_ns).unwrap().0);
        }
        seen
    }

    #[test]
    fn pieces_add_up_to_the_plan() {
        let seen = run(8000, u64::MAX, None);
        let trajectory = trajectory();
        for (ms, position) in seen.iter().enumerate() {
            let planned = trajectory.motion((ms as f64 / 1000.0 - LEAD_S).max(0.0)).joints_rad[1];
            assert!((position - planned).abs() < 1e-6, "{ms} ms: {position} {planned}");
        }
    }

    #[test]
    fn a_dead_program_is_an_arm_at_rest_within_a_quarter_second_and_its_braking_time_without_a_jump() {
        let braking_ms = (brake::longest_s(&limits()) * 1000.0) as u64;
        let mut worst_ms = 0;
        for dead_ms in (100..5000).step_by(173) {
            let seen = run(8000, dead_ms, None);
            let rest_ms =
                seen.windows(2).rposition(|two| (two[1] - two[0]).abs() > 1e-9).unwrap_or(0) as u64 + 1;
            worst_ms = worst_ms.max(rest_ms.saturating_sub(dead_ms));
            assert!(rest_ms <= dead_ms + HORIZON_MS + braking_ms + 20, "{dead_ms}: {rest_ms}");
            for three in seen.windows(3) {
                let acceleration = (three[2] - 2.0 * three[1] + three[0]) * 1e6;
                assert!(acceleration.abs() < 0.43 * 1.1, "{acceleration}");
            }
        }
        println!("worst: {worst_ms} ms; braking {braking_ms} ms");
    }

    #[test]
    fn a_stop_brakes_at_once_on_the_path() {
        for halt_ms in (200..5000).step_by(333) {
            let seen = run(8000, u64::MAX, Some(halt_ms));
            let rest_ms =
                seen.windows(2).rposition(|two| (two[1] - two[0]).abs() > 1e-9).unwrap_or(0) as u64 + 1;
            assert!(rest_ms <= halt_ms + 325 + 20, "{halt_ms}: {rest_ms}");
            for three in seen.windows(3) {
                assert!(((three[2] - 2.0 * three[1] + three[0]) * 1e6).abs() < 0.43 * 1.1);
            }
        }
    }

    #[test]
    fn a_piece_that_would_come_after_the_arm_began_to_brake_is_not_sent() {
        let trajectory = trajectory();
        let mut stream = Stream::new(BOOT_NS);
        let at = |ms: i64| BOOT_NS + ms * 1_000_000;
        assert!(stream.renew(&trajectory, &limits(), 0, at(0)).unwrap().is_some());
        assert_eq!(stream.renew(&trajectory, &limits(), 50, at(50)), Ok(None));
        assert!(stream.renew(&trajectory, &limits(), 150, at(150)).unwrap().is_some());
        assert_eq!(stream.renew(&trajectory, &limits(), 600, at(600)), Err(Late));
        assert!(!stream.has_braked(at(600)) && stream.has_braked(at(1200)));
    }

    #[test]
    fn the_robots_clock_is_never_taken_to_be_ahead_of_what_it_is() {
        let mut clock = RobotClock::default();
        assert_eq!(clock.at_ns(0), None);
        clock.see(Time::default(), 5);
        assert_eq!(clock.at_ns(5), None);
        // The robot's clock shows 1 s at our 0 ms, and messages take 3 to 40 ms.
        for (sent_ms, delay_ms) in [(100, 40), (200, 3), (300, 17)] {
            clock.see(Time::at_ns(1_000_000_000 + sent_ms * 1_000_000), sent_ms + delay_ms);
        }
        assert_eq!(clock.at_ns(400), Some(1_000_000_000 + 397 * 1_000_000));
    }
}
