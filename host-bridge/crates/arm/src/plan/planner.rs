//! Plans motions from one pose to another: straight if that is clear, otherwise around obstacles or via home.
//! If no path is found, the planner refuses the motion with a reason.

use crate::ik;
use crate::model::{JointError, SerialArm};
use crate::motions::{MotionError, joints_of};
use crate::plan::collision::{Clearance, Placement, Surroundings, World};
use crate::plan::line;
use crate::plan::polish::Polish;
use crate::plan::purse::Purse;
use crate::plan::rrt::{Search, connect, shorten};
use crate::scene::{Goal, Route, Scene};
use crate::things::Things;
use host_robot::{JOINTS, JointLimits, Joints, Pose, Random, Trajectory};

/// Maximum number of checks in one search.
const CHECKS_MAX: u64 = 30_000;

/// Maximum number of plans that are compared for one motion.
const TRIES_MAX: u64 = 12;

/// After this number of checks, a motion's plan is not improved any more.
/// The planner counts checks instead of measuring time. This many checks take less than 60 ms on one core.
pub const COMPARING_CHECKS_MAX: u64 = 18_000;

/// This many of these checks are kept for moving the corners of the best plan.
const POLISHING_CHECKS_MAX: u64 = 9_000;

/// The corners of so many plans are moved; most checks are for the best of them.
const POLISHED: usize = 3;

/// This many of the checks for the corners are kept for the final check of the rounded corners.
const ROUNDING_CHECKS_MAX: u64 = 2_000;

/// A motion that takes at most this many times the least time of any motion is not improved any more.
const GOOD: f64 = 1.005;

/// Interval at which cut corners are checked for the path of braking.
const BRAKING_INTERVAL_S: f64 = 0.05;

/// A path with more corners stops at all of them or at none.
const CHOICE_CORNERS_MAX: usize = 4;

/// How a path was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// All joints straight to the goal.
    Straight,
    /// Around something.
    Around,
    /// Through the home pose.
    ViaHome,
}

/// A motion that is safe if the scene matches reality.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The motion in time.
    pub trajectory: Trajectory,
    /// Corners of the path in rad, including both ends.
    pub path_rad: Vec<Joints>,
    /// How it was found.
    pub kind: Kind,
    /// Time at which the motion passes the home pose, if it goes there first.
    pub home_s: Option<f64>,
    /// Number of complete checks of a configuration.
    pub checks: u64,
}

/// Why the arm does not move.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The goal is not a valid configuration of this arm.
    #[error("the goal cannot be reached: {0}; choose another pose")]
    GoalBeyondLimit(JointError),
    /// The arm would touch something at the goal.
    #[error(
        "the goal is not safe: {one} would come within {distance_mm:.0} mm of {two}; move {two} or choose another pose"
    )]
    GoalBlocked {
        /// One part.
        one: String,
        /// The other.
        two: String,
        /// Distance between the two bodies at the goal; negative if they overlap.
        distance_mm: f64,
    },
    /// The arm touches something now, or is beyond a limit.
    #[error("the arm cannot start: {one} touches {two}; free it by hand")]
    StartBlocked {
        /// One part.
        one: String,
        /// The other.
        two: String,
    },
    /// The arm's own angles make no sense.
    #[error("the arm cannot start: {0}; bring it back within its limits")]
    StartBeyondLimit(JointError),
    /// No joint angles reach this pose of the flange.
    #[error("{0}")]
    Unreachable(#[from] ik::Unreachable),
    /// The straight line cannot be followed to its end.
    #[error("{0}")]
    Line(#[from] line::Ends),
    /// An obstacle is on the straight line.
    #[error("the straight line is not clear: {one} would come within {distance_mm:.0} mm of {two}")]
    LineBlocked {
        /// One part.
        one: String,
        /// The other.
        two: String,
        /// Distance between the two bodies; negative if they overlap.
        distance_mm: f64,
    },
    /// Nothing was found.
    #[error("no safe way was found in {checks} checks, via home neither; go home first or clear the way")]
    NoWay {
        /// What was spent.
        checks: u64,
    },
}

/// The surroundings and the budget of a motion.
#[derive(Clone, Copy, Debug)]
pub struct Case<'a> {
    /// Where the base stands.
    pub placement: Placement,
    /// Tool and objects.
    pub things: &'a Things,
    /// Checks that are left.
    pub purse: &'a Purse,
}

/// A pose of the scene file cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(transparent)]
pub struct BadPose(#[from] pub MotionError);

/// Plans motions in one world.
#[derive(Clone, Debug)]
pub struct Planner {
    world: World,
    limits: JointLimits,
    goals: Vec<(String, Joints)>,
    /// Maximum number of checks in one search. A test makes searches fail with it.
    search_checks_max: u64,
}

impl Planner {
    /// Creates a planner. Route, scaling, margin, seed and poses are from the scene.
    /// A pose with the name `home` replaces the arm's own home pose.
    ///
    /// # Errors
    /// Fails if a pose is beyond the joints' limits, or a position has no safe joint angles.
    pub fn new(mut arm: SerialArm, scene: Scene) -> Result<Self, BadPose> {
        // A home pose must be known before the world is created, and must not need inverse kinematics.
        for (name, goal) in scene.goals() {
            if let ("home", Goal::Joints(angles)) = (name, goal) {
                arm.home_rad = joints_of(&arm, name, &angles).map_err(BadPose)?;
            }
        }
        let limits = scene.limits(&arm);
        let mut planner = Planner {
            world: World::new(arm, scene),
            limits,
            goals: Vec::new(),
            search_checks_max: CHECKS_MAX,
        };
        planner.goals = planner.solve_goals()?;
        Ok(planner)
    }

    fn solve_goals(&self) -> Result<Vec<(String, Joints)>, BadPose> {
        let (arm, scene) = (self.world.arm(), self.world.scene());
        let around = self.world.around(Placement::default());
        // This margin is twice the required margin, so that plans can reach the pose.
        let safe = |joints: &Joints| around.is_clear(joints, 2.0 * scene.arm.margin_m);
        let solve = |(name, goal): (&str, Goal)| {
            let bad = |reason: String| BadPose(MotionError::Pose { name: name.to_owned(), reason });
            let joints_rad = match goal {
                Goal::Joints(angles) => joints_of(arm, name, &angles).map_err(BadPose)?,
                Goal::Flange(pose) => {
                    ik::solve(arm, &pose, &arm.home_rad, scene.arm.seed, safe)
                        .map_err(|error| bad(error.to_string()))?
                        .joints_rad
                }
            };
            Ok((name.to_owned(), joints_rad))
        };
        scene.goals().into_iter().map(solve).collect()
    }

    /// Returns the poses of the scene file as joint angles.
    pub fn goals(&self) -> &[(String, Joints)] {
        &self.goals
    }

    /// The pose of that name.
    pub fn goal(&self, name: &str) -> Option<Joints> {
        self.goals.iter().find(|(known, _)| known == name).map(|(_, joints_rad)| *joints_rad)
    }

    /// Robot and scene.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Scaled limits of the joints.
    pub fn limits(&self) -> &JointLimits {
        &self.limits
    }

    /// Plans from rest to rest, with the base at `placement` and everything else as in the scene.
    /// `turn` distinguishes otherwise equal plans: equal turns give equal plans.
    ///
    /// # Errors
    /// Fails with a [`Refusal`]. Nothing moves in this case.
    pub fn plan(
        &self,
        from_rad: &Joints,
        to_rad: &Joints,
        placement: Placement,
        turn: u64,
    ) -> Result<Plan, Refusal> {
        let case = Case { placement, things: self.world.start(), purse: &Purse::default() };
        self.plan_among(from_rad, to_rad, case, turn)
    }

    fn around<'a>(&'a self, case: Case<'a>) -> Surroundings<'a> {
        self.world.around_with(case.placement, case.things).paid_from(case.purse)
    }

    /// Returns joint angles within the limits that reach this pose without contact,
    /// as close as possible to the current angles.
    ///
    /// # Errors
    /// [`Refusal::Unreachable`].
    pub fn place(&self, from_rad: &Joints, target: &Pose, case: Case<'_>) -> Result<Joints, Refusal> {
        let (arm, scene) = (self.world.arm(), self.world.scene());
        let around = self.around(case);
        let safe = |joints: &Joints| around.is_clear(joints, scene.arm.margin_m);
        Ok(ik::solve_from(case.purse, arm, target, from_rad, scene.arm.seed, safe)?.joints_rad)
    }

    /// Plans a straight line of the flange without a detour.
    ///
    /// # Errors
    /// Fails with a [`Refusal`]. Nothing moves in this case.
    pub fn straight(&self, from_rad: &Joints, target: &Pose, case: Case<'_>) -> Result<Trajectory, Refusal> {
        let path_rad = line::along(self.world.arm(), from_rad, target, case.purse)?;
        let around = self.around(case);
        let margin_m = self.start_margin_m(&around, from_rad)?;
        for two in path_rad.windows(2) {
            if !around.way_is_clear(&two[0], &two[1], margin_m) {
                let Clearance { distance_m, parts: (one, two) } = around.arm_clearance(&two[1]);
                let [one, two] = [one, two].map(|part| self.world.name(part).to_owned());
                return Err(Refusal::LineBlocked { one, two, distance_mm: distance_m * 1000.0 });
            }
        }
        let corners = path_rad.len().saturating_sub(2);
        let motion = Trajectory::through(&path_rad, &vec![false; corners], &self.limits);
        if self.corners_are_clear(&around, &motion, margin_m) {
            return Ok(motion);
        }
        Ok(Trajectory::through(&path_rad, &vec![true; corners], &self.limits))
    }

    /// Returns the distance to keep from now on.
    /// An arm that was stopped near an obstacle may leave, but not come closer.
    fn start_margin_m(&self, around: &Surroundings<'_>, from_rad: &Joints) -> Result<f64, Refusal> {
        self.world.arm().check(from_rad).map_err(Refusal::StartBeyondLimit)?;
        let Clearance { distance_m, parts: (one, two) } = around.arm_clearance(from_rad);
        if distance_m <= 0.0 {
            let [one, two] = [one, two].map(|part| self.world.name(part).to_owned());
            return Err(Refusal::StartBlocked { one, two });
        }
        Ok(self.world.scene().arm.margin_m.min(0.8 * distance_m))
    }

    /// Like [`Planner::plan`], with the current tool and objects.
    ///
    /// # Errors
    /// Fails with a [`Refusal`]. Nothing moves in this case.
    pub fn plan_among(
        &self,
        from_rad: &Joints,
        to_rad: &Joints,
        case: Case<'_>,
        turn: u64,
    ) -> Result<Plan, Refusal> {
        let around = &self.around(case);
        let arm = self.world.arm();
        let to_rad = &arm.unwound(to_rad, from_rad);
        arm.check(to_rad).map_err(Refusal::GoalBeyondLimit)?;
        arm.check(from_rad).map_err(Refusal::StartBeyondLimit)?;
        let name = |part| self.world.name(part).to_owned();

        let Clearance { distance_m, parts: (one, two) } = around.arm_clearance(to_rad);
        if distance_m < self.world.scene().arm.margin_m {
            let (one, two, distance_mm) = (name(one), name(two), distance_m * 1000.0);
            return Err(Refusal::GoalBlocked { one, two, distance_mm });
        }
        let margin_m = self.start_margin_m(around, from_rad)?;
        let search = Search { margin_m, checks_max: self.search_checks_max, seed: self.seed(turn) };

        let home_rad = arm.unwound(&arm.home_rad, from_rad);
        let via_home = || -> Option<Plan> {
            if !around.is_clear(&home_rad, margin_m) {
                return None;
            }
            let (there, _) = self.leg(around, from_rad, &home_rad, &search)?;
            let (onward, _) = self.leg(around, &home_rad, &arm.unwound(to_rad, &home_rad), &search)?;
            let home_s = Some(there.trajectory.duration_s());
            let mut path_rad = there.path_rad;
            path_rad.extend(&onward.path_rad[1..]);
            let trajectory = there.trajectory.then(&onward.trajectory);
            Some(Plan { trajectory, path_rad, kind: Kind::ViaHome, home_s, checks: 0 })
        };
        let direct = || -> Option<Plan> { Some(self.leg(around, from_rad, to_rad, &search)?.0) };
        let found = match self.world.scene().arm.route {
            Route::ViaHome => via_home(),
            Route::Direct => direct().or_else(via_home),
        };
        let checks = around.checks();
        match found {
            Some(plan) => Ok(Plan { checks, ..plan }),
            None => Err(Refusal::NoWay { checks }),
        }
    }

    /// Returns the quickest of several plans with different seeds, with corners that are moved to save time.
    /// As many plans are compared as fit into a motion's first [`COMPARING_CHECKS_MAX`] checks,
    /// less those that are kept for the corners.
    ///
    /// # Errors
    /// Returns the error of [`Planner::plan_among`] for the first plan.
    pub fn plan_best(
        &self,
        from_rad: &Joints,
        to_rad: &Joints,
        case: Case<'_>,
        turn: u64,
    ) -> Result<Plan, Refusal> {
        let first = self.plan_among(from_rad, to_rad, case, turn)?;
        // No plan is quicker than a straight one.
        if first.kind == Kind::Straight {
            return Ok(first);
        }
        let good_s = GOOD * self.least_s(from_rad, to_rad);
        let mut dearest = first.checks;
        let mut plans = vec![first];
        for k in 1..TRIES_MAX {
            let left = (COMPARING_CHECKS_MAX - POLISHING_CHECKS_MAX).saturating_sub(case.purse.spent());
            if left < dearest {
                break;
            }
            let purse = case.purse.apart(left);
            let other = self.plan_among(from_rad, to_rad, Case { purse: &purse, ..case }, turn ^ (k << 32));
            case.purse.spend(purse.spent());
            dearest = dearest.max(purse.spent());
            plans.extend(other);
            if plans.last().is_some_and(|plan| plan.trajectory.duration_s() <= good_s) {
                break;
            }
        }
        plans.sort_by(|a, b| a.trajectory.duration_s().total_cmp(&b.trajectory.duration_s()));
        let polished = self.polished(&plans, good_s, case, turn);
        let best = plans.swap_remove(0);
        let is_quicker = |other: &Plan| {
            best.kind != Kind::Straight && other.trajectory.duration_s() < best.trajectory.duration_s()
        };
        Ok(polished.filter(is_quicker).unwrap_or(best))
    }

    /// Moves the corners of the quickest of these plans to save time.
    fn polished(&self, plans: &[Plan], good_s: f64, case: Case<'_>, turn: u64) -> Option<Plan> {
        let purse = case.purse.apart(COMPARING_CHECKS_MAX.saturating_sub(case.purse.spent()));
        let around = self.around(Case { purse: &purse, ..case });
        let direct = || plans.iter().filter(|plan| plan.kind == Kind::Around);
        let margin_m = self.start_margin_m(&around, &direct().next()?.path_rad[0]).ok()?;
        let polish = |plan: &Plan| {
            let seed = self.seed(turn);
            let path_rad = plan.path_rad.clone();
            Polish::new(&around, path_rad, &self.limits, margin_m, seed, CHOICE_CORNERS_MAX)
        };
        let mut tried: Vec<Polish<'_>> = direct().take(POLISHED).map(polish).collect();
        // After half of the checks, only the best path remains.
        let left = || purse.left().saturating_sub(ROUNDING_CHECKS_MAX);
        let each = left() / (2 * POLISHED as u64);
        for polish in &mut tried {
            polish.improve(each, good_s);
        }
        tried.sort_by(|a, b| a.time_s().total_cmp(&b.time_s()));
        if let Some(best) = tried.first_mut() {
            best.improve(left(), good_s);
        }
        // A path on which the arm would have to stop may be slower than the next one.
        let mut best: Option<(Trajectory, Vec<Joints>)> = None;
        for path in tried {
            let least_s = best.as_ref().map_or(f64::INFINITY, |(motion, _)| motion.duration_s());
            if path.time_s() < least_s {
                let path_rad = path.into_path_rad();
                let motion = self.quickest(&around, &path_rad, margin_m);
                if motion.duration_s() < least_s {
                    best = Some((motion, path_rad));
                }
            }
        }
        case.purse.spend(purse.spent());
        let (trajectory, path_rad) = best?;
        Some(Plan { trajectory, path_rad, kind: Kind::Around, home_s: None, checks: purse.spent() })
    }

    /// Returns the time in s that the slowest joint needs if it moves alone. No motion takes less, whatever its path.
    pub fn least_s(&self, from_rad: &Joints, to_rad: &Joints) -> f64 {
        let to_rad = self.world.arm().unwound(to_rad, from_rad);
        let alone_s = |i: usize| {
            let mut moved_rad = *from_rad;
            moved_rad[i] = to_rad[i];
            Trajectory::through(&[*from_rad, moved_rad], &[], &self.limits).duration_s()
        };
        (0..JOINTS).map(alone_s).fold(0.0, f64::max)
    }

    /// Equal turns have equal seeds.
    fn seed(&self, turn: u64) -> u64 {
        Random::new(self.world.scene().arm.seed ^ turn.wrapping_mul(0x9E37_79B9)).bits()
    }

    /// Returns a path from rest to rest, straight or around obstacles.
    fn leg(
        &self,
        around: &Surroundings<'_>,
        from_rad: &Joints,
        to_rad: &Joints,
        search: &Search,
    ) -> Option<(Plan, Kind)> {
        let (path_rad, kind) = if around.way_is_clear(from_rad, to_rad, search.margin_m) {
            (vec![*from_rad, *to_rad], Kind::Straight)
        } else {
            let path = connect(around, from_rad, to_rad, search)?;
            (shorten(around, path, search), Kind::Around)
        };
        let trajectory = self.quickest(around, &path_rad, search.margin_m);
        Some((Plan { trajectory, path_rad, kind, home_s: None, checks: 0 }, kind))
    }

    /// Returns the quickest motion on a clear path whose cut corners are also clear,
    /// including all braking there.
    fn quickest(&self, around: &Surroundings<'_>, path_rad: &[Joints], margin_m: f64) -> Trajectory {
        let corners = path_rad.len().saturating_sub(2);
        let choices: Vec<Vec<bool>> = if corners <= CHOICE_CORNERS_MAX {
            (0..1 << corners).map(|bits| (0..corners).map(|k| bits >> k & 1 == 1).collect()).collect()
        } else {
            vec![vec![false; corners], vec![true; corners]]
        };
        let mut motions: Vec<Trajectory> =
            choices.iter().map(|stops| Trajectory::through(path_rad, stops, &self.limits)).collect();
        motions.sort_by(|a, b| a.duration_s().total_cmp(&b.duration_s()));
        let clear = motions.into_iter().find(|motion| self.corners_are_clear(around, motion, margin_m));
        // With a stop at every corner, the motion stays on the path, which is clear.
        clear.unwrap_or_else(|| Trajectory::through(path_rad, &vec![true; corners], &self.limits))
    }

    fn corners_are_clear(&self, around: &Surroundings<'_>, motion: &Trajectory, margin_m: f64) -> bool {
        motion.corners_s().into_iter().all(|(start_s, end_s)| {
            let steps = ((end_s - start_s) / BRAKING_INTERVAL_S).ceil().max(1.0) as usize;
            let at = |k: usize| motion.motion(start_s + (end_s - start_s) * k as f64 / steps as f64);
            (0..=steps).all(|k| {
                let here = at(k);
                let onward = at((k + 1).min(steps)).joints_rad;
                let braking = Trajectory::braking(here, &self.limits);
                let mut from = here.joints_rad;
                around.way_is_clear(&from, &onward, margin_m)
                    && braking.knots_s().into_iter().all(|knot_s| {
                        let way = (from, braking.motion(knot_s).joints_rad);
                        from = way.1;
                        self.world.arm().check(&way.1).is_ok()
                            && around.way_is_clear(&way.0, &way.1, margin_m)
                    })
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gen3::HOME;

    /// A post stands before the arm. On both sides of it, the arm reaches out further than to the post.
    const POST: &str = "[[box]]\nname = \"post\"\ncenter_m = [0.8, 0.0, 0.65]\nsize_m = [0.06, 0.06, 1.3]";

    fn beside_the_post() -> (Joints, Joints) {
        let at = |turn_rad: f64| host_robot::joints([turn_rad, 1.1, HOME[2], -0.9, 0.0, -0.4, HOME[6]]);
        (at(-0.5), at(0.5))
    }

    #[test]
    fn where_no_direct_way_is_found_the_arm_goes_by_way_of_home() {
        let mut planner = Planner::new(SerialArm::gen3(), Scene::parse(POST).unwrap()).unwrap();
        let (from, to) = beside_the_post();
        let plan = |planner: &Planner| planner.plan(&from, &to, Placement::default(), 1).unwrap();
        assert_eq!(plan(&planner).kind, Kind::Around);
        // A search without checks finds nothing, so only straight ways remain.
        planner.search_checks_max = 0;
        let plan = plan(&planner);
        assert_eq!(plan.kind, Kind::ViaHome);
        assert_eq!(plan.path_rad, [from, HOME, to]);
        let home_s = plan.home_s.unwrap();
        let at_home = plan.trajectory.motion(home_s);
        assert_eq!((at_home.joints_rad, at_home.velocity_rad_s), (HOME, [0.0; JOINTS]));
        assert!(home_s < plan.trajectory.duration_s());
        let around = planner.world().around(Placement::default());
        for k in 0..=200 {
            let now = plan.trajectory.motion(plan.trajectory.duration_s() * f64::from(k) / 200.0);
            assert!(around.arm_clearance(&now.joints_rad).distance_m >= 0.005);
        }
        // Its corner is home, and stays there.
        let purse = Purse::default();
        let case = Case { placement: Placement::default(), things: planner.world().start(), purse: &purse };
        assert_eq!(planner.plan_best(&from, &to, case, 1).unwrap().path_rad, [from, HOME, to]);
    }

    #[test]
    fn where_home_is_blocked_too_the_motion_is_refused() {
        let blocked = format!(
            "{POST}\n[[box]]\nname = \"crate\"\ncenter_m = [0.55, 0.0, 0.9]\nsize_m = [0.1, 0.1, 0.1]"
        );
        let mut planner = Planner::new(SerialArm::gen3(), Scene::parse(&blocked).unwrap()).unwrap();
        let (from, to) = beside_the_post();
        planner.search_checks_max = 0;
        let refusal = planner.plan(&from, &to, Placement::default(), 1).unwrap_err();
        assert!(matches!(refusal, Refusal::NoWay { .. }), "{refusal}");
    }
}
