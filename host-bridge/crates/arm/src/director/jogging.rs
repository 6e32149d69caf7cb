//! A hand moves the tool in pieces of a few hundredths of a second. The arm brakes to rest after each piece.
//!
//! ```text
//! plan    ──────────╲__          what the robot has: it always ends at rest
//! piece 1     ▪──╲__             begins on the plan, a little ahead of now; then brakes
//! piece 2        ▪──╲__
//! ```
//!
//! A piece is accepted only if the piece and the braking after it keep every limit and touch nothing.
//! If no piece is accepted, the plan remains, and the arm comes to rest.
//! An arm that was allowed to move can therefore always stop, whatever the hand does next.
//! A silent hand needs no decision.

use std::sync::Arc;

use host_robot::{
    Base, BaseState, DMat3, DVec3, JointLimits, Motion, Odometry, Report, Robot, Trajectory, Twist,
};

use crate::jog::{acceleration, joint_speeds};
use crate::plan::guard::{Guard, Moving, TICK_MS};

use super::carry::{Running, SILENCE_MS};
use super::sequence::can_start;
use super::{Director, REST_RAD_S, Site, still_moves};

/// Length of a piece.
const PIECE_MS: u64 = 20;
const PIECE_S: f64 = PIECE_MS as f64 / 1000.0;
/// This much of the past plan is kept, because the arm is also compared with earlier parts of its plan.
const KEEP_S: f64 = 1.0;
/// Fractions of the requested speed, tried one after the other.
const SHARES: [f64; 3] = [1.0, 0.5, 0.2];
/// Minimum interval between messages about an obstacle to the tool; the state always shows the obstacle.
const NOTES_MS: u64 = 1000;

/// The motion that a hand requests of the tool.
#[derive(Clone, Debug, Default)]
pub(super) struct Jog {
    wanted_m_s: DVec3,
    /// Time of the last request.
    asked_ms: u64,
    /// A rejected piece is not tried again before this time.
    due_ms: u64,
    /// The reason for a standstill is not reported again before this time.
    tell_ms: u64,
    /// The tool's orientation when the tool began to move.
    hold: DMat3,
    /// The tool moves until this time in the plan, and then brakes.
    until_s: f64,
    /// The tool was stopped; the hand must be neutral before the tool moves again.
    pub(super) needs_neutral: bool,
    /// The reason why the tool does not move.
    pub(super) held: Option<String>,
}

impl<R: Robot> Director<R> {
    pub(super) fn want_jog(&mut self, tool_m_s: DVec3) {
        self.jog.asked_ms = self.now_ms;
        self.jog.wanted_m_s = if tool_m_s.is_finite() { tool_m_s } else { DVec3::ZERO };
        if self.jog.wanted_m_s == DVec3::ZERO {
            (self.jog.needs_neutral, self.jog.held) = (false, None);
        }
    }

    /// Continues in the direction that the hand requests, if the hand requests a direction.
    pub(super) fn jog_on(&mut self) {
        if self.now_ms.saturating_sub(self.jog.asked_ms) > SILENCE_MS {
            // Further motion needs a new request.
            self.jog.wanted_m_s = DVec3::ZERO;
        }
        if self.jog.wanted_m_s == DVec3::ZERO || self.jog.needs_neutral || self.now_ms < self.jog.due_ms {
            return;
        }
        let done = match &self.running {
            None if self.planning.is_some() => return,
            None => self.begin_jog(),
            Some(running) if running.jogs && !running.halted => self.go_on_jogging(),
            Some(_) => return,
        };
        match done {
            Ok(true) => self.jog.held = None,
            Ok(false) => {}
            Err(why) => {
                self.jog.due_ms = self.now_ms + TICK_MS;
                // At a limit, pieces are accepted and rejected alternately.
                if self.jog.held.is_none() && self.now_ms >= self.jog.tell_ms {
                    self.jog.tell_ms = self.now_ms + NOTES_MS;
                    self.reports.push(Report::Note(format!("the tool is held: {why}")));
                }
                self.jog.held = Some(why);
            }
        }
    }

    /// Whether a piece was taken.
    fn begin_jog(&mut self) -> Result<bool, String> {
        self.robot.can_follow()?;
        let ahead_s = self.robot.ahead_ms()? as f64 / 1000.0;
        let here = self.robot.arm().ok_or("the arm's angles are not known")?.value;
        if here.velocity_rad_s.iter().any(|speed| speed.abs() > REST_RAD_S) {
            // The arm will rest in a moment.
            return Ok(false);
        }
        let from_rad = self.robot.held_rad().unwrap_or(here.joints_rad);
        can_start(self.site.arm(), &from_rad)?;
        self.jog.hold = self.site.arm().flange_pose(&from_rad).rotation;
        let (plan, until_s) = self.extended(&Trajectory::at_rest(from_rad), 0.0, ahead_s + PIECE_S)?;
        let plan = Arc::new(plan);
        self.robot.follow(Arc::clone(&plan))?;
        self.jog.until_s = until_s;
        self.running = Some(Running::jogging(plan, self.now_ms));
        self.guard_due_ms = 0;
        Ok(true)
    }

    /// Whether a piece was taken.
    fn go_on_jogging(&mut self) -> Result<bool, String> {
        let ahead_s = self.robot.ahead_ms()? as f64 / 1000.0;
        let Some((plan, elapsed_s)) = self.along() else { return Ok(false) };
        let (earliest_s, enough_s) = (elapsed_s + ahead_s, elapsed_s + ahead_s + PIECE_S);
        if self.jog.until_s >= enough_s {
            return Ok(false);
        }
        let from_s = self.jog.until_s.max(earliest_s);
        let (plan, until_s) = self.extended(&Arc::clone(plan), from_s, enough_s)?;
        let plan = Arc::new(plan);
        if self.robot.follow_on(Arc::clone(&plan), from_s).is_err() {
            // The piece would come too late; the robot continues its plan and brakes.
            return Ok(false);
        }
        self.jog.until_s = until_s;
        if let Some(running) = &mut self.running {
            running.replace(plan);
        }
        Ok(true)
    }

    /// Returns the plan with pieces from `from_s` on, at least until `enough_s`.
    /// Also returns the time at which the pieces end, which is earlier if no more pieces are allowed.
    fn extended(&self, plan: &Trajectory, from_s: f64, enough_s: f64) -> Result<(Trajectory, f64), String> {
        let (mut plan, mut at_s) = (plan.clone(), from_s);
        while at_s < enough_s {
            match self.piece(&plan, at_s) {
                Ok(next) => plan = next,
                Err(why) if at_s == from_s => return Err(why),
                Err(_) => break,
            }
            at_s += PIECE_S;
        }
        Ok((plan, at_s))
    }

    /// Returns the plan with one more piece, if a further piece is allowed.
    fn piece(&self, plan: &Trajectory, at_s: f64) -> Result<Trajectory, String> {
        let (arm, limits) = (self.site.arm(), self.joint_limits());
        let from = plan.motion(at_s);
        let mut refused = Err(String::new());
        for share in SHARES {
            let wanted =
                joint_speeds(arm, &from.joints_rad, share * self.jog.wanted_m_s, &self.jog.hold, limits)
                    .map_err(|stuck| stuck.to_string())?;
            let change = acceleration(&from, &wanted, PIECE_S, limits);
            let next = plan.continued(at_s, &change, PIECE_S, limits, KEEP_S);
            let allowed = self.keeps_limits(&next, at_s, limits).and_then(|()| self.keeps_clear(&next, at_s));
            match allowed {
                Ok(()) => return Ok(next),
                Err(why) => refused = Err(why),
            }
        }
        refused
    }

    /// Speeds and angles, up to rest.
    fn keeps_limits(&self, next: &Trajectory, at_s: f64, limits: &JointLimits) -> Result<(), String> {
        let arm = self.site.arm();
        let fastest = next.fastest_rad_s(at_s, next.duration_s());
        let too_fast = |i: &usize| fastest[*i] > limits.velocity_rad_s[*i] * (1.0 + 1e-9);
        if let Some(i) = (0..arm.joints.len()).find(too_fast) {
            return Err(format!("{} would be too fast", arm.joints[i].name));
        }
        let steps = ((next.duration_s() - at_s) / PIECE_S).ceil() as usize;
        (0..=4 * steps)
            .map(|k| next.motion(at_s + 0.25 * PIECE_S * k as f64))
            .chain([Motion::at_rest(next.goal_rad())])
            .try_for_each(|motion| arm.check(&motion.joints_rad))
            .map_err(|error| error.to_string())
    }

    /// Checks the same conditions as the guard.
    /// The arm must touch nothing, neither during the piece nor during the braking after it.
    /// The base stands still. Without a scene, the arm can still touch the robot itself.
    fn keeps_clear(&self, next: &Trajectory, at_s: f64) -> Result<(), String> {
        let base = match &self.site {
            Site::Scene(_) => {
                self.known_base().map_err(|why| format!("what is around is not known: {why}"))?
            }
            // The base's position does not matter to the arm here.
            Site::Bare(_) => BaseState::default(),
        };
        if still_moves(base.odometry.twist) {
            return Err("the base still moves".to_owned());
        }
        let guard = Guard { world: self.site.world(), limits: self.joint_limits(), things: &self.things };
        let odometry = Odometry { twist: Twist::ZERO, ..base.odometry };
        let model = Base::at(*self.robot.base_limits(), &BaseState { odometry, ..base });
        let at = |time_s: f64| Moving { odometry, ..Moving::now(&model, next.motion(time_s)) };
        let instants: Vec<Moving> = (1..=PIECE_MS).map(|ms| at(at_s + ms as f64 / 1000.0)).collect();
        if guard.allows(&at(at_s), &instants) {
            return Ok(());
        }
        Err(guard.nearest(&odometry, &next.motion(at_s + PIECE_S)))
    }
}
