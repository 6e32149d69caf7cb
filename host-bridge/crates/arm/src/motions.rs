//! Arm motions and named poses, as data: the paper's six, and those of scenes and configurations.
//!
//! ```toml
//! [[motion]]
//! name = "fetch"
//! steps = [
//!     { to = "above the cup" },                  # or to_next_of = ["left shelf", "right shelf"]
//!     { joints_rad = [0.0, 0.9, 3.14, -1.7, 0.0, 0.4, 1.57] },
//!     { position_m = [0.6, 0.1, 0.7], quaternion_wxyz = [0, 1, 0, 0], straight = true },
//!     { gripper = "close", effort_n = 40 },      # or "open", "toggle", or a width in m
//!     { wait_s = 0.5 },
//!     { move_m = [0, 0, 0.1] },                  # along the robot's axes; move_tool_m along the tool's own
//!     { turn_rad = [0, 0, 1.57] },               # about the tool's own axes, also together with a move
//! ]
//!
//! [[pose]]
//! name = "above the cup"
//! joints_rad = [0.0, 0.9, 3.14, -1.7, 0.0, 0.4, 1.57]
//! ```
//!
//! The origin of the tool's positions is on the floor between the wheels: x forward, y left, z up.
//! By default, moves and turns are straight lines, and positions are reached freely; `straight` changes this.
//! The straight steps directly before and after a gripper step may touch the object and its support.
//!
//! A pose is also a motion: `--map wave="above the cup"`.
//! A later pose replaces an earlier pose with the same name.
//! A pose with the name of a motion replaces that motion's steps.

use host_robot::shape::Point;
use host_robot::{DMat3, DQuat, Joints, MotionName, Pose};
use serde::{Deserialize, Serialize};

use crate::frame::Frame;
use crate::model::SerialArm;

/// The paper's motions and the Gen3's poses for them.
const PAPER: &str = include_str!("../motions/paper.toml");

/// A motion as written in a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionTable {
    /// Name for `--map` and for users.
    pub name: String,
    /// The steps in sequence, between which the arm rests.
    pub steps: Vec<StepTable>,
}

/// One step of a motion with a single action.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepTable {
    /// Moves to this pose.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to: Option<String>,
    /// Moves to the next of these poses each time the motion runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_next_of: Option<Vec<String>>,
    /// Moves to these angles.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joints_rad: Option<Vec<f64>>,
    /// Moves the tool's point to this position.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_m: Option<Point>,
    /// Orientation of the tool, with z pointing out of the arm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quaternion_wxyz: Option<[f64; 4]>,
    /// Moves the tool by this much along the robot's axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub move_m: Option<Point>,
    /// Moves the tool by this much along its own axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub move_tool_m: Option<Point>,
    /// Turns the tool about its own axes; the length of the vector is the angle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turn_rad: Option<Point>,
    /// Whether the tool moves in a straight line.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub straight: Option<bool>,
    /// Opens or closes the gripper.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gripper: Option<GripTable>,
    /// The maximum force of the gripper.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub effort_n: Option<f64>,
    /// The name of a scene object or of a topic with a pose. The place is relative to it; see [`crate::frame`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<String>,
    /// Maximum age of the pose on a topic when the motion begins.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub age_max_s: Option<f64>,
    /// The arm rests for this time in s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wait_s: Option<f64>,
}

/// The command for a gripper.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum GripTable {
    /// `"open"`, `"close"`, `"toggle"`.
    Word(Grasp),
    /// To this width in m.
    Width(f64),
}

/// Commands for a gripper without a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Grasp {
    /// Opens the gripper completely.
    Open,
    /// Closes until an object is held or the gripper is fully closed.
    Close,
    /// Opens a closed gripper, and closes an open gripper.
    Toggle,
}

/// Names of motions that every robot with a gripper has.
const GRASPS: [(&str, Grasp); 3] =
    [("open-gripper", Grasp::Open), ("close-gripper", Grasp::Close), ("toggle-gripper", Grasp::Toggle)];

/// Returns whether this name denotes a motion that every robot with a gripper has.
pub fn is_grasp(name: &str) -> bool {
    GRASPS.iter().any(|(known, _)| *known == name)
}

/// Maximum number of steps. The limit exists because all steps are planned before the motion starts.
const STEPS_MAX: usize = 32;
/// Maximum duration of a waiting step.
const WAIT_MAX_S: f64 = 60.0;
/// Maximum length of a relative move.
const MOVE_MAX_M: f64 = 2.0;

/// A pose given by its joint angles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseTable {
    /// Name for steps and for `--map`.
    pub name: String,
    /// One angle per joint of the arm, in rad.
    pub joints_rad: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PaperFile {
    motion: Vec<MotionTable>,
    pose: Vec<PoseTable>,
}

/// A motion or pose cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MotionError {
    /// No motion or pose has that name.
    #[error(
        "'{name}' is neither a motion nor a pose of {arm}; choose one of: {known}, or add [[motion]] or [[pose]]"
    )]
    Unknown {
        /// The name that was requested.
        name: String,
        /// The arm's name.
        arm: String,
        /// What there is.
        known: String,
    },
    /// A step names a pose that does not exist.
    #[error("motion '{motion}': {arm} has no pose '{pose}'; add [[pose]] name = \"{pose}\"")]
    NoPose {
        /// Which motion.
        motion: String,
        /// The pose that is missing.
        pose: String,
        /// The arm's name.
        arm: String,
    },
    /// A step is empty, contains two actions at once, or has invalid values.
    #[error("motion '{motion}', step {step}: {reason}")]
    Step {
        /// Which motion.
        motion: String,
        /// Which step, from 1.
        step: usize,
        /// The problem, and the valid values.
        reason: String,
    },
    /// A motion without a step.
    #[error("motion '{0}' has no step; give it one, such as {{ to = \"home\" }}")]
    Empty(String),
    /// The name is taken.
    #[error("motion '{0}' is there twice; give each its own name")]
    Twice(String),
    /// The name almost equals a bundled pose's name, but would not replace that pose.
    #[error("pose '{name}' replaces nothing; '{meant}' would: name it so, or quite otherwise")]
    Slip {
        /// As given.
        name: String,
        /// What there is.
        meant: String,
    },
    /// A pose does not fit the arm.
    #[error("pose '{name}': {reason}")]
    Pose {
        /// Which pose.
        name: String,
        /// The problem and a remedy.
        reason: String,
    },
}

/// Where a step leads.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// The step always leads here, in rad.
    To(Joints),
    /// The next of these poses each time, in rad; never empty.
    ToNextOf(Vec<Joints>),
    /// A position of the tool's point, relative to an object or to the point on the floor between the wheels.
    Tool {
        /// Place and orientation.
        pose: Pose,
        /// The object to which the position is relative, if there is one.
        frame: Option<Frame>,
        /// In a straight line.
        straight: bool,
    },
    /// A move of the tool relative to its current pose.
    Move {
        /// So far,
        way_m: Point,
        /// Whether the move is along the tool's own axes instead of the robot's.
        own: bool,
        /// A rotation about the tool's own axes.
        turn: DMat3,
        /// in a straight line.
        straight: bool,
    },
    /// Opens or closes the gripper.
    Grip {
        /// How.
        to: GripTable,
        /// The largest force.
        effort_n: Option<f64>,
    },
    /// Waits for this long without motion.
    Wait {
        /// Time.
        ms: u64,
    },
}

impl Step {
    /// Returns whether the step is a straight line of the tool.
    pub fn is_straight(&self) -> bool {
        matches!(self, Step::Tool { straight: true, .. } | Step::Move { straight: true, .. })
    }
}

/// A motion, ready to run.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Its name.
    pub name: MotionName,
    /// At least one.
    pub steps: Vec<Step>,
}

/// All motions of an arm.
#[derive(Clone, Debug, PartialEq)]
pub struct Motions {
    arm: String,
    motions: Vec<Motion>,
    poses: Vec<(String, Joints)>,
}

/// Parses the angles of a pose for this arm.
///
/// # Errors
/// Fails if the number of angles differs from the arm's joints, or an angle is beyond the limits.
pub fn joints_of(arm: &SerialArm, name: &str, angles: &[f64]) -> Result<Joints, MotionError> {
    let bad = |reason| MotionError::Pose { name: name.to_owned(), reason };
    let count = arm.joints.len();
    if angles.len() != count {
        return Err(bad(format!("joints_rad has {} angles, {} has {count} joints", angles.len(), arm.name)));
    }
    let mut joints_rad = Joints::default();
    joints_rad[..count].copy_from_slice(angles);
    arm.check(&joints_rad).map_err(|error| bad(error.to_string()))?;
    Ok(joints_rad)
}

/// Returns a name in a form without the differences that typing errors cause.
fn plain(name: &str) -> String {
    name.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect()
}

impl Motions {
    /// The paper's motions on the Gen3.
    pub fn paper() -> Self {
        // A test (`the_papers_motions_read`) checks this bundled file.
        Motions::new(&SerialArm::gen3(), &[], &[], &[]).unwrap_or_else(|error| panic!("{error}"))
    }

    /// Creates the motions of an arm.
    /// `solved` are poses as joint angles (of a scene); `poses` and `motions` are from a configuration.
    /// The bundled poses are for the Gen3 only.
    ///
    /// # Errors
    /// [`MotionError`] names the invalid entry.
    pub fn new(
        arm: &SerialArm,
        solved: &[(String, Joints)],
        poses: &[PoseTable],
        motions: &[MotionTable],
    ) -> Result<Self, MotionError> {
        let paper: PaperFile = toml::from_str(PAPER).unwrap_or_else(|error| panic!("paper.toml: {error}"));
        let mut all = Motions { arm: arm.name.clone(), motions: Vec::new(), poses: Vec::new() };
        all.set_pose("home", arm.home_rad);
        let bundled = if arm.is_gen3() { &paper.pose[..] } else { &[] };
        for pose in bundled.iter().chain(poses) {
            all.set_pose(&pose.name, joints_of(arm, &pose.name, &pose.joints_rad)?);
        }
        for (name, joints_rad) in solved {
            all.set_pose(name, *joints_rad);
        }
        for name in solved.iter().map(|(name, _)| name).chain(poses.iter().map(|pose| &pose.name)) {
            let paper =
                || paper.motion.iter().map(|motion| &motion.name).chain(paper.pose.iter().map(|p| &p.name));
            let slip = paper().find(|known| **known != *name && plain(known) == plain(name));
            if let Some(meant) = slip.filter(|_| !motions.iter().any(|own| own.name == *name)) {
                return Err(MotionError::Slip { name: name.clone(), meant: meant.clone() });
            }
        }
        let given = |name: &str| {
            solved.iter().any(|(known, _)| known == name) || poses.iter().any(|pose| pose.name == name)
        };
        for table in &paper.motion {
            let replaced = motions.iter().any(|own| own.name == table.name) || given(&table.name);
            let fits = table.steps.iter().flat_map(StepTable::poses).all(|pose| all.pose(pose).is_some());
            if !replaced && fits {
                let motion = all.read(arm, table)?;
                all.motions.push(motion);
            }
        }
        for (i, table) in motions.iter().enumerate() {
            if motions[..i].iter().any(|other| other.name == table.name) {
                return Err(MotionError::Twice(table.name.clone()));
            }
            let motion = all.read(arm, table)?;
            all.motions.push(motion);
        }
        Ok(all)
    }

    fn set_pose(&mut self, name: &str, joints_rad: Joints) {
        self.poses.retain(|(known, _)| known != name);
        self.poses.push((name.to_owned(), joints_rad));
    }

    fn read(&self, arm: &SerialArm, table: &MotionTable) -> Result<Motion, MotionError> {
        if table.steps.is_empty() {
            return Err(MotionError::Empty(table.name.clone()));
        }
        if table.steps.len() > STEPS_MAX {
            let reason = format!("a motion has at most {STEPS_MAX} steps");
            return Err(MotionError::Step { motion: table.name.clone(), step: STEPS_MAX + 1, reason });
        }
        let read = |(i, step): (usize, &StepTable)| {
            let bad = |reason: String| MotionError::Step { motion: table.name.clone(), step: i + 1, reason };
            if let Some(pose) = step.poses().find(|pose| self.pose(pose).is_none()) {
                let (motion, pose, arm) = (table.name.clone(), pose.clone(), self.arm.clone());
                return Err(MotionError::NoPose { motion, pose, arm });
            }
            self.step(arm, step).map_err(bad)
        };
        let steps = table.steps.iter().enumerate().map(read).collect::<Result<_, _>>()?;
        Ok(Motion { name: table.name.as_str().into(), steps })
    }

    /// Converts a step, whose named poses exist.
    fn step(&self, arm: &SerialArm, table: &StepTable) -> Result<Step, String> {
        const KINDS: &str = "each step is one of to, to_next_of, joints_rad, position_m with quaternion_wxyz, \
                             move_m or move_tool_m (with or without turn_rad), turn_rad, gripper, wait_s";
        let moves = table.move_m.is_some() || table.move_tool_m.is_some() || table.turn_rad.is_some();
        let place = table.position_m.is_some() || table.quaternion_wxyz.is_some();
        let kinds = [
            table.to.is_some(),
            table.to_next_of.is_some(),
            table.joints_rad.is_some(),
            place,
            moves,
            table.gripper.is_some(),
            table.wait_s.is_some(),
        ];
        if kinds.iter().filter(|kind| **kind).count() != 1 {
            return Err(KINDS.to_owned());
        }
        if table.straight.is_some() && !(place || moves) {
            return Err("straight belongs to position_m, move_m, move_tool_m or turn_rad".to_owned());
        }
        if (table.frame.is_some() && !place) || (table.age_max_s.is_some() && table.frame.is_none()) {
            return Err("frame belongs to position_m, and age_max_s to a frame that is a topic".to_owned());
        }
        if table.effort_n.is_some() && table.gripper.is_none() {
            return Err("effort_n belongs to gripper".to_owned());
        }
        let pose = |name: &String| self.pose(name).ok_or_else(|| format!("there is no pose '{name}'"));
        if let Some(name) = &table.to {
            return Ok(Step::To(pose(name)?));
        }
        if let Some(names) = &table.to_next_of {
            if names.is_empty() {
                return Err("to_next_of names no pose".to_owned());
            }
            return Ok(Step::ToNextOf(names.iter().map(pose).collect::<Result<_, _>>()?));
        }
        if let Some(angles) = &table.joints_rad {
            return Ok(Step::To(joints_of(arm, "of the step", angles).map_err(|error| error.to_string())?));
        }
        if let Some(to) = table.gripper {
            if matches!(to, GripTable::Width(m) if !(0.0..=1.0).contains(&m)) {
                return Err(
                    "gripper is \"open\", \"close\", \"toggle\", or a width in m from 0 to 1".to_owned()
                );
            }
            if table.effort_n.is_some_and(|n| !(n.is_finite() && n > 0.0)) {
                return Err("effort_n is a force in N, above 0".to_owned());
            }
            return Ok(Step::Grip { to, effort_n: table.effort_n });
        }
        if let Some(wait_s) = table.wait_s {
            if !(0.0..=WAIT_MAX_S).contains(&wait_s) {
                return Err(format!("wait_s = {wait_s}: lies between 0 and {WAIT_MAX_S} s"));
            }
            return Ok(Step::Wait { ms: (wait_s * 1000.0) as u64 });
        }
        if place {
            let (Some(position_m), Some([w, x, y, z])) = (table.position_m, table.quaternion_wxyz) else {
                return Err("a place of the tool needs position_m together with quaternion_wxyz".to_owned());
            };
            let turn = DQuat::from_xyzw(x, y, z, w);
            if !(turn.length().is_finite() && turn.length() > 0.5 && position_m.is_finite()) {
                return Err("position_m or quaternion_wxyz is no place".to_owned());
            }
            let pose = Pose { position_m, rotation: DMat3::from_quat(turn.normalize()) };
            let frame = table.frame.as_ref().map(|name| Frame::read(name, table.age_max_s)).transpose()?;
            return Ok(Step::Tool { pose, frame, straight: table.straight.unwrap_or(false) });
        }
        let (own, way_m) = match (table.move_m, table.move_tool_m) {
            (Some(_), Some(_)) => return Err(KINDS.to_owned()),
            (Some(way_m), None) => (false, way_m),
            (None, Some(way_m)) => (true, way_m),
            (None, None) => (true, Point::ZERO),
        };
        let turn = table.turn_rad.unwrap_or(Point::ZERO);
        let still = way_m == Point::ZERO && turn == Point::ZERO;
        let short = |vector: Point, most: f64| vector.is_finite() && vector.length() <= most;
        if !short(way_m, MOVE_MAX_M) || !short(turn, std::f64::consts::PI) || still {
            return Err(format!(
                "a move is at most {MOVE_MAX_M} m long, a turn at most 3.14 rad, and one of them is not zero"
            ));
        }
        let turn = DMat3::from_quat(DQuat::from_scaled_axis(turn));
        Ok(Step::Move { way_m, own, turn, straight: table.straight.unwrap_or(true) })
    }

    /// Returns the list of motions, which does not include the poses.
    pub(crate) fn all(&self) -> &[Motion] {
        &self.motions
    }

    /// Every pose, in rad.
    pub fn poses(&self) -> &[(String, Joints)] {
        &self.poses
    }

    /// Returns the pose with this name, in rad.
    pub fn pose(&self, name: &str) -> Option<Joints> {
        self.poses.iter().find(|(known, _)| known == name).map(|(_, joints_rad)| *joints_rad)
    }

    /// Returns the motion with this name, or a single step to the pose with this name.
    ///
    /// # Errors
    /// [`MotionError::Unknown`] lists all names.
    pub fn get(&self, name: &str) -> Result<Motion, MotionError> {
        if let Some(motion) = self.motions.iter().find(|motion| motion.name == *name) {
            return Ok(motion.clone());
        }
        if let Some((_, grasp)) = GRASPS.iter().find(|(known, _)| *known == name)
            && self.pose(name).is_none()
        {
            let steps = vec![Step::Grip { to: GripTable::Word(*grasp), effort_n: None }];
            return Ok(Motion { name: name.into(), steps });
        }
        let pose =
            self.pose(name).map(|joints_rad| Motion { name: name.into(), steps: vec![Step::To(joints_rad)] });
        pose.ok_or_else(|| MotionError::Unknown {
            name: name.to_owned(),
            arm: self.arm.clone(),
            known: self.names().join(", "),
        })
    }

    /// Returns all motions, and all poses that are not the only step of a motion with the same name.
    pub fn names(&self) -> Vec<&str> {
        let motions = self.motions.iter().map(|motion| motion.name.as_str());
        let poses = self.poses.iter().map(|(name, _)| name.as_str());
        let alone = poses.filter(|name| !self.motions.iter().any(|motion| motion.name == *name));
        motions.chain(alone).collect()
    }
}

impl StepTable {
    fn poses(&self) -> impl Iterator<Item = &String> {
        self.to.iter().chain(self.to_next_of.iter().flatten())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion(name: &str, to: &str) -> MotionTable {
        MotionTable {
            name: name.to_owned(),
            steps: vec![StepTable { to: Some(to.to_owned()), ..StepTable::default() }],
        }
    }

    #[test]
    fn the_papers_motions_read() {
        let motions = Motions::paper();
        let papers = ["home", "pick-up", "place", "place-top-right", "place-bottom-right", "random-top"];
        assert_eq!(motions.names()[..6], papers);
        assert!(
            matches!(&motions.get("random-top").unwrap().steps[..], [Step::ToNextOf(tops)] if tops.len() == 8)
        );
    }

    #[test]
    fn a_pose_is_a_motion_of_its_own() {
        let motions = Motions::paper();
        let ready = motions.pose("ready").unwrap();
        assert_eq!(motions.get("ready").unwrap().steps, [Step::To(ready)]);
    }

    #[test]
    fn an_unknown_name_is_refused_with_all_that_there_is() {
        let error = Motions::paper().get("wave").unwrap_err().to_string();
        assert!(error.contains("'wave'") && error.contains("pick-up") && error.contains("Kinova"), "{error}");
    }

    #[test]
    fn a_motion_of_ones_own_has_steps_and_may_replace_one_of_the_papers() {
        let own =
            MotionTable { steps: vec![motion("", "pick-up").steps[0].clone(); 2], ..motion("place", "x") };
        let motions = Motions::new(&SerialArm::gen3(), &[], &[], &[own]).unwrap();
        assert_eq!(motions.get("place").unwrap().steps.len(), 2);
    }

    #[test]
    fn a_pose_of_the_scene_replaces_the_papers_and_a_motion_that_draws() {
        let here = ("random-top".to_owned(), crate::gen3::HOME);
        let motions = Motions::new(&SerialArm::gen3(), &[here], &[], &[]).unwrap();
        assert_eq!(motions.get("random-top").unwrap().steps, [Step::To(crate::gen3::HOME)]);
    }

    #[test]
    fn steps_poses_and_names_that_do_not_fit_are_refused_by_name() {
        let gen3 = SerialArm::gen3();
        let new = |poses: &[PoseTable], motions: &[MotionTable]| {
            Motions::new(&gen3, &[], poses, motions).unwrap_err()
        };
        assert!(new(&[], &[motion("wave", "nowhere")]).to_string().contains("no pose 'nowhere'"));
        assert!(new(&[], &[motion("wave", "home"), motion("wave", "home")]).to_string().contains("twice"));
        assert!(
            new(&[], &[MotionTable { steps: vec![], ..motion("wave", "home") }]).to_string().contains("wave")
        );
        let few = PoseTable { name: "few".to_owned(), joints_rad: vec![0.0; 6] };
        let text = new(&[few], &[]).to_string();
        assert!(text.contains("6 angles") && text.contains("7 joints"), "{text}");
        let slip = PoseTable { name: "Pickup".to_owned(), joints_rad: crate::gen3::HOME[..7].to_vec() };
        assert!(new(&[slip], &[]).to_string().contains("'pick-up' would"));
        let far = PoseTable { name: "far".to_owned(), joints_rad: vec![3.0; 7] };
        assert!(new(&[far], &[]).to_string().contains("joint_2"));
    }

    fn read(steps: &str) -> Result<Vec<Step>, MotionError> {
        let table: MotionTable = toml::from_str(&format!("name = \"own\"\nsteps = [{steps}]")).unwrap();
        Ok(Motions::new(&SerialArm::gen3(), &[], &[], &[table])?.get("own").unwrap().steps)
    }

    #[test]
    fn steps_of_every_kind_are_read() {
        let steps = read(
            r#"{ to = "home" }, { joints_rad = [0, 1, 3, -1, 0, 0, 1] }, { gripper = "close", effort_n = 40 },
               { position_m = [0.6, 0, 0.7], quaternion_wxyz = [0, 1, 0, 0], straight = true }, { wait_s = 0.25 },
               { move_m = [0, 0, 0.1] }, { move_tool_m = [0, 0, -0.1], straight = false }, { gripper = 0.04 },
               { turn_rad = [0, 0, 1.5] }"#,
        )
        .unwrap();
        assert_eq!(steps.len(), 9);
        assert_eq!(steps.iter().filter(|step| step.is_straight()).count(), 3);
        assert_eq!(steps[2], Step::Grip { to: GripTable::Word(Grasp::Close), effort_n: Some(40.0) });
        assert_eq!(steps[4], Step::Wait { ms: 250 });
        assert_eq!(steps[7], Step::Grip { to: GripTable::Width(0.04), effort_n: None });
    }

    #[test]
    fn steps_that_make_no_sense_are_refused_with_their_number() {
        for (steps, told) in [
            ("{ }", "step 1: each step is one of"),
            ("{ to = \"home\" }, { to = \"home\", wait_s = 1 }", "step 2: each step is one of"),
            ("{ position_m = [1, 0, 0] }", "together with quaternion_wxyz"),
            ("{ wait_s = 1e9 }", "wait_s = 1000000000"),
            ("{ move_m = [0, 0, 9] }", "at most 2 m"),
            ("{ move_m = [0, 0, 0] }", "not zero"),
            ("{ gripper = 7 }", "a width in m"),
            ("{ gripper = \"open\", effort_n = -1 }", "effort_n"),
            ("{ to = \"home\", straight = true }", "straight belongs to"),
            ("{ joints_rad = [1, 2] }", "2 angles"),
        ] {
            let error = read(steps).unwrap_err().to_string();
            assert!(error.contains(told) && error.contains("'own'"), "{error}");
        }
    }

    #[test]
    fn a_gripper_opens_and_closes_by_name_without_a_table() {
        let steps = Motions::paper().get("toggle-gripper").unwrap().steps;
        assert_eq!(steps, [Step::Grip { to: GripTable::Word(Grasp::Toggle), effort_n: None }]);
    }

    #[test]
    fn another_arm_has_only_the_poses_that_it_is_given() {
        let mut other = SerialArm::gen3();
        other.name = "another arm".to_owned();
        let motions = Motions::new(&other, &[], &[], &[]).unwrap();
        assert_eq!(motions.names(), ["home"]);
        assert!(motions.get("pick-up").unwrap_err().to_string().contains("another arm"));
    }
}
