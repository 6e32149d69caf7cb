//! Converts the steps of a motion to a sequence of acts.
//! All acts are planned or refused before anything moves.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use host_robot::shape::Point;
use host_robot::{DVec3, JointLimits, Joints, MotionName, Pose, Robot, Trajectory};

use crate::model::SerialArm;
use crate::motions::{Grasp, GripTable, Step};
use crate::plan::collision::Part;
use crate::plan::{Case, Placement, Purse, Refusal, line};
use crate::scene::Route;
use crate::things::{Things, Touch, in_scene};

use super::seen::Anchor;
use super::{Director, REST_RAD_S, Site, still_moves};

/// Distance by which a hand backs away from an object before it moves freely.
const BACK_OFF_M: f64 = 0.1;
/// Distance by which a standing object is lifted.
const LIFT_M: f64 = 0.05;
/// Fingers are open if their distance exceeds this fraction of their range.
const OPEN_SHARE: f64 = 0.5;

/// One action in the execution of a motion.
#[derive(Clone, Debug)]
pub(super) enum Act {
    /// The arm follows this.
    Follow {
        trajectory: Arc<Trajectory>,
        /// Time at which the arm rests at its home pose before it continues;
        /// 0 if the path does not lead through home.
        home_s: f64,
        touch: Touch,
        /// The object to which the motion is relative.
        anchor: Option<Anchor>,
    },
    /// The gripper moves.
    Grip { opening_m: f64, effort_n: Option<f64>, closes_on: bool, anchor: Option<Anchor> },
    /// Nothing moves.
    Wait { ms: u64 },
}

impl Act {
    /// Returns whether the hand is at an object, so that the base must not move.
    pub(super) fn is_at_work(&self) -> bool {
        match self {
            Act::Follow { touch, anchor, .. } => *touch != Touch::default() || anchor.is_some(),
            Act::Grip { .. } => true,
            Act::Wait { .. } => false,
        }
    }

    /// Returns the object on which this act depends.
    pub(super) fn anchor(&self) -> Option<&Anchor> {
        match self {
            Act::Follow { anchor, .. } | Act::Grip { anchor, .. } => anchor.as_ref(),
            Act::Wait { .. } => None,
        }
    }
}

/// The state of a plan so far.
#[derive(Debug)]
struct Draft {
    acts: VecDeque<Act>,
    from_rad: Joints,
    things: Things,
    placement: Placement,
    /// The planning budget shared by all steps of a motion.
    purse: Purse,
    /// A number that distinguishes plans that are otherwise equal.
    turn: u64,
    /// The object to which the current steps are relative.
    anchor: Option<Anchor>,
}

impl Draft {
    fn case(&self) -> Case<'_> {
        Case { placement: self.placement, things: &self.things, purse: &self.purse }
    }

    fn follow(&mut self, leg: Trajectory, home_s: f64, touch: Touch) {
        self.from_rad = leg.goal_rad();
        // Consecutive legs form one trajectory. The arm rests between them, and no new check is needed.
        // Before each leg to an object, the pose of the object is checked again.
        if let Some(Act::Follow { trajectory, touch: same, anchor: None, .. }) = self.acts.back_mut()
            && *same == touch
            && self.anchor.is_none()
        {
            *trajectory = Arc::new((**trajectory).clone().then(&leg));
            return;
        }
        let anchor = self.anchor.clone();
        self.acts.push_back(Act::Follow { trajectory: Arc::new(leg), home_s, touch, anchor });
    }
}

/// The input of planning: a copy of the current state, so that planning can run on another thread.
#[derive(Debug)]
pub(super) struct Task {
    plot: Plot,
    steps: Vec<Step>,
    /// The object to which each step is relative, if there is one.
    anchors: Vec<Option<Anchor>>,
    draft: Draft,
}

/// The data that does not change during planning.
#[derive(Debug)]
struct Plot {
    site: Site,
    /// The robot's limits; in a scene, the planner has its own limits.
    limits: JointLimits,
    /// Number of earlier runs of the motion, for motions with random poses.
    draw: usize,
}

impl Task {
    /// Returns the placement of the base and the objects on which the plan relies.
    pub(super) fn taken(&self) -> (Placement, Things) {
        (self.draft.placement, self.draft.things.clone())
    }

    /// Sets a flag with which the owner can end planning early, without a plan.
    pub(super) fn ended_by(mut self, ends: Arc<AtomicBool>) -> Self {
        self.draft.purse = self.draft.purse.ended_by(ends);
        self
    }

    /// Returns the acts, or the reason why no safe sequence exists.
    pub(super) fn plan(self) -> Result<VecDeque<Act>, String> {
        let Task { plot, steps, anchors, mut draft } = self;
        for ((i, step), anchor) in steps.iter().enumerate().zip(anchors) {
            let beside = |other: Option<&Step>| matches!(other, Some(Step::Grip { .. }));
            let is_rest = |step: &&Step| matches!(step, Step::Wait { .. });
            let before = beside(steps[..i].iter().rev().find(|step| !is_rest(step)));
            let after = beside(steps[i + 1..].iter().find(|step| !is_rest(step)));
            if matches!(step, Step::To(_) | Step::ToNextOf(_) | Step::Tool { .. }) {
                draft.anchor = anchor;
            }
            let done = plot.take_step(step, &mut draft, (before, after));
            done.map_err(|why| {
                let why = draft.purse.refusal().unwrap_or(why);
                if steps.len() == 1 { why } else { format!("step {}: {why}", i + 1) }
            })?;
        }
        Ok(draft.acts)
    }
}

impl<R: Robot> Director<R> {
    /// Returns the planning task for a motion, based on the current state.
    pub(super) fn task(&mut self, motion: &MotionName) -> Result<Task, String> {
        let steps = self.motions.get(motion.as_str()).map_err(|error| error.to_string())?.steps;
        let grips = steps.iter().any(|step| matches!(step, Step::Grip { .. }));
        let moves = steps.iter().any(|step| !matches!(step, Step::Grip { .. } | Step::Wait { .. }));
        if grips {
            self.robot.can_grip()?;
        }
        let anchors = self.anchors(&steps)?;
        let needs_rest = grips || steps.len() > 1 || anchors.iter().any(Option::is_some);
        let draft = self.draft(moves, needs_rest)?;
        // Each step needs at most one plan.
        self.plans += steps.len() as u64;
        let plot = Plot {
            site: self.site.clone(),
            limits: *self.robot.joint_limits(),
            draw: self.draws.get(motion).copied().unwrap_or_default(),
        };
        Ok(Task { plot, steps, anchors, draft })
    }

    /// Returns the current positions of the arm and all objects.
    fn draft(&self, moves: bool, needs_rest: bool) -> Result<Draft, String> {
        if moves {
            self.robot.can_follow()?;
        }
        let here = self.robot.arm().map(|reading| reading.value);
        let arm = self.site.arm();
        let from_rad = match here {
            Some(here) => {
                if let Some(i) = here.velocity_rad_s.iter().position(|v| v.abs() > REST_RAD_S) {
                    return Err(format!("the arm moves already ({})", arm.joints[i].name));
                }
                self.robot.held_rad().unwrap_or(here.joints_rad)
            }
            // A gripper works without a known pose, but the gripped object is then unknown.
            None if !moves => [0.0; host_robot::JOINTS],
            None => return Err("the arm's angles are not known".to_owned()),
        };
        let mut placement = Placement::default();
        if self.site.planner().is_some() {
            let base = self.known_base().map_err(|why| format!("the arm cannot be planned for: {why}"))?;
            placement = Placement::from(base.odometry);
            if needs_rest && still_moves(base.odometry.twist) {
                return Err("the base still moves; let it rest first".to_owned());
            }
        }
        let mut things = self.things.clone();
        things.opening_m = self.robot.opening_m().map(|opening| opening.value);
        Ok(Draft {
            acts: VecDeque::new(),
            from_rad,
            things,
            placement,
            purse: Purse::default(),
            turn: self.plans,
            anchor: None,
        })
    }
}

/// Returns the reason why the arm cannot start from these angles, if it is beyond its limits.
pub(super) fn can_start(arm: &SerialArm, from_rad: &Joints) -> Result<(), String> {
    arm.check(from_rad).map_err(|error| Refusal::StartBeyondLimit(error).to_string())
}

impl Plot {
    /// Plans one step; `beside` tells whether the gripper moves before this step and after it.
    fn take_step(&self, step: &Step, draft: &mut Draft, beside: (bool, bool)) -> Result<(), String> {
        let goal_rad = match step {
            Step::Wait { ms } => {
                draft.acts.push_back(Act::Wait { ms: *ms });
                return Ok(());
            }
            Step::Grip { to, effort_n } => return self.take_grip(*to, *effort_n, draft),
            Step::To(goal_rad) => *goal_rad,
            Step::ToNextOf(goals_rad) => goals_rad[self.draw % goals_rad.len()],
            Step::Tool { .. } | Step::Move { .. } => {
                let target = self.target(step, draft)?;
                if step.is_straight() {
                    return self.go_straight(&target, draft, beside);
                }
                self.back_off(draft)?;
                self.angles_for(&target, draft)?
            }
        };
        self.back_off(draft)?;
        self.go_freely(&goal_rad, draft)
    }

    /// Returns the flange's goal in the arm's base frame.
    fn target(&self, step: &Step, draft: &Draft) -> Result<Pose, String> {
        let point_m = self.site.shop().tool.point_m();
        let here = self.site.arm().flange_pose(&draft.from_rad);
        Ok(match step {
            Step::Tool { pose, .. } => {
                let frame = draft
                    .anchor
                    .as_ref()
                    .map(|anchor| anchor.on_base(&self.site, &draft.things, draft.placement));
                let frame = frame.transpose()?.unwrap_or(Pose::IDENTITY);
                let pose = frame.then(pose.position_m, pose.rotation);
                let mount_m = self.site.mount_m();
                Pose { position_m: pose.position_m - mount_m - pose.rotation * point_m, ..pose }
            }
            Step::Move { way_m, own, turn, .. } => {
                let way_m = if *own { here.rotation * *way_m } else { *way_m };
                let rotation = here.rotation * *turn;
                // The pose is rotated about the tool's point.
                Pose { position_m: here.at(point_m) + way_m - rotation * point_m, rotation }
            }
            _ => here,
        })
    }

    fn angles_for(&self, target: &Pose, draft: &Draft) -> Result<Joints, String> {
        if let Some(planner) = self.site.planner() {
            return planner
                .place(&draft.from_rad, target, draft.case())
                .map_err(|refusal| refusal.to_string());
        }
        let arm = self.site.arm();
        let found = crate::ik::solve_from(&draft.purse, arm, target, &draft.from_rad, 1, |_| true);
        Ok(found.map_err(|error| error.to_string())?.joints_rad)
    }

    /// Moves to these angles: via the home pose, straight, or along the planned path.
    fn go_freely(&self, goal_rad: &Joints, draft: &mut Draft) -> Result<(), String> {
        let arm = self.site.arm();
        let from_rad = draft.from_rad;
        let goal_rad = arm.unwound(goal_rad, &from_rad);
        let (leg, home_s) = match self.site.planner() {
            None if self.is_straight_clear(&goal_rad, draft)? => {
                (Trajectory::through(&[from_rad, goal_rad], &[], &self.limits), 0.0)
            }
            None => {
                let home_rad = arm.unwound(&arm.home_rad, &from_rad);
                let goal_rad = arm.unwound(&goal_rad, &home_rad);
                let limits = &self.limits;
                let home = Trajectory::through(&[from_rad, home_rad], &[], limits);
                let onward = Trajectory::through(&[home_rad, goal_rad], &[], limits);
                let home_s = home.duration_s();
                (home.then(&onward), home_s)
            }
            Some(planner) => {
                draft.turn += 1;
                let plan = planner
                    .plan_best(&from_rad, &goal_rad, draft.case(), draft.turn)
                    .map_err(|refusal| refusal.to_string())?;
                (plan.trajectory, plan.home_s.unwrap_or(0.0))
            }
        };
        draft.follow(leg, home_s, Touch::default());
        Ok(())
    }

    /// Returns whether the arm may move straight to these angles without a scene.
    /// If not, the arm moves via home, which users know from the paper's motions.
    fn is_straight_clear(&self, goal_rad: &Joints, draft: &Draft) -> Result<bool, String> {
        can_start(self.site.arm(), &draft.from_rad)?;
        let world = self.site.world();
        let arm = &world.scene().arm;
        let around = world.around_with(draft.placement, &draft.things).paid_from(&draft.purse);
        Ok(arm.route == Route::Direct && around.way_is_clear(&draft.from_rad, goal_rad, arm.margin_m))
    }

    /// Moves the flange in a straight line.
    /// Next to a gripper step, the hand may touch the object and its support.
    fn go_straight(
        &self,
        target: &Pose,
        draft: &mut Draft,
        (before, after): (bool, bool),
    ) -> Result<(), String> {
        let Some(planner) = self.site.planner() else {
            let arm = self.site.arm();
            let path_rad =
                line::along(arm, &draft.from_rad, target, &draft.purse).map_err(|error| error.to_string())?;
            let corners = path_rad.len().saturating_sub(2);
            let leg = Trajectory::through(&path_rad, &vec![false; corners], &self.limits);
            draft.follow(leg, 0.0, Touch::default());
            return Ok(());
        };
        let shop = self.site.shop();
        let here = self.site.flange(draft.placement, &draft.from_rad);
        let mut touch = Touch::default();
        if before || self.is_at_something(draft).is_some() {
            touch = shop.touching(&draft.things, &here);
        }
        if after {
            let there = in_scene(draft.placement, self.site.mount_m(), target);
            touch = both(touch, shop.touching(&draft.things, &there));
        }
        let things = Things { touch: touch.clone(), ..draft.things.clone() };
        let leg = planner
            .straight(&draft.from_rad, target, Case { things: &things, ..draft.case() })
            .map_err(|refusal| refusal.to_string())?;
        draft.follow(leg, 0.0, touch);
        Ok(())
    }

    /// Backs away from an object, or lifts the held object, before the hand moves freely.
    fn back_off(&self, draft: &mut Draft) -> Result<(), String> {
        let Some(part) = self.is_at_something(draft) else { return Ok(()) };
        let here = self.site.arm().flange_pose(&draft.from_rad);
        let way_m: Point = match part {
            Part::Held => LIFT_M * DVec3::Z,
            _ => -BACK_OFF_M * here.rotation.z_axis,
        };
        let target = Pose { position_m: here.position_m + way_m, ..here };
        self.go_straight(&target, draft, (true, false))
            .map_err(|why| format!("the hand cannot get away from what it is at: {why}"))
    }

    /// Returns a part of the hand that is too close to an object or its support for the start of a motion.
    fn is_at_something(&self, draft: &Draft) -> Option<Part> {
        let planner = self.site.planner()?;
        let world = planner.world();
        let near_m = |things: &Things| {
            let around = world.around_with(draft.placement, things).paid_from(&draft.purse);
            let nearest = around.arm_clearance(&draft.from_rad);
            (nearest.distance_m < world.scene().arm.margin_m).then_some(nearest.parts.0)
        };
        let part = near_m(&draft.things)?;
        let here = self.site.flange(draft.placement, &draft.from_rad);
        let touch = self.site.shop().touching(&draft.things, &here);
        // This exception applies only if the close object is the object that the hand grips.
        let without = near_m(&Things { touch, ..draft.things.clone() });
        without.is_none().then_some(part)
    }

    fn take_grip(&self, to: GripTable, effort_n: Option<f64>, draft: &mut Draft) -> Result<(), String> {
        let shop = self.site.shop();
        let widest_m = shop.tool.hand().map_or(1.0, |hand| hand.widest_m);
        // If the finger distance is unknown, the gripper closes, so that nothing falls.
        let is_open = draft.things.held().is_none()
            && draft.things.opening_m.is_none_or(|apart_m| apart_m >= OPEN_SHARE * widest_m);
        let opening_m = match to {
            GripTable::Width(width_m) if width_m > widest_m => {
                return Err(format!("the gripper opens {widest_m} m at most, not {width_m}"));
            }
            GripTable::Width(width_m) => width_m,
            GripTable::Word(Grasp::Open) => widest_m,
            GripTable::Word(Grasp::Close) => 0.0,
            GripTable::Word(Grasp::Toggle) => {
                if is_open {
                    0.0
                } else {
                    widest_m
                }
            }
        };
        let closes_on = opening_m == 0.0;
        let flange = self.site.flange(draft.placement, &draft.from_rad);
        if let Some(planner) = self.site.planner() {
            // The fingers need free space at both ends of their range.
            for width_m in [draft.things.opening_m, Some(opening_m)] {
                let touch = shop.touching(&draft.things, &flange);
                let things = Things { opening_m: width_m, touch, ..draft.things.clone() };
                let around = planner.world().around_with(draft.placement, &things).paid_from(&draft.purse);
                let nearest = around.arm_clearance(&draft.from_rad);
                if nearest.distance_m <= 0.0 {
                    let [one, two] =
                        [nearest.parts.0, nearest.parts.1].map(|part| planner.world().name(part));
                    return Err(format!("the gripper has no room to move: {one} would touch {two}"));
                }
            }
        }
        let before_m = draft.things.opening_m;
        let _ = shop.gripped(&mut draft.things, &flange, opening_m);
        // A robot without a reported finger distance may not report it afterwards either.
        draft.things.opening_m = draft.things.opening_m.filter(|_| before_m.is_some());
        // After a gripper movement, the object's position is not checked again.
        let anchor = draft.anchor.take();
        draft.acts.push_back(Act::Grip { opening_m, effort_n, closes_on, anchor });
        Ok(())
    }
}

fn both(one: Touch, two: Touch) -> Touch {
    let boxes = one.boxes.into_iter().chain(two.boxes).collect();
    Touch { object: two.object.or(one.object), boxes, floor: one.floor || two.floor }
}
