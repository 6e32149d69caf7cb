//! Arm motions and named poses, as data: bundled for the paper's six, more from scenes and configurations.
//!
//! ```toml
//! [[motion]]
//! name = "fetch"
//! steps = [{ to = "above the cup" }, { to_next_of = ["left shelf", "right shelf"] }]
//!
//! [[pose]]
//! name = "above the cup"
//! joints_rad = [0.0, 0.9, 3.14, -1.7, 0.0, 0.4, 1.57]
//! ```
//!
//! A pose is also a motion of its own: `--map wave="above the cup"`. A later pose replaces an earlier one of the same
//! name; one named like a motion replaces that motion's steps.

use host_robot::{Joints, MotionName};
use serde::{Deserialize, Serialize};

use crate::model::SerialArm;

/// The paper's motions and the Gen3's poses for them.
const PAPER: &str = include_str!("../motions/paper.toml");

/// A motion as written in a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionTable {
    /// For `--map` and for people.
    pub name: String,
    /// One after the other, resting in between.
    pub steps: Vec<StepTable>,
}

/// One step of a motion: exactly one of its fields.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepTable {
    /// Moves to this pose.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to: Option<String>,
    /// Moves to the next of these poses each time the motion runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_next_of: Option<Vec<String>>,
}

/// A pose given by its joint angles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseTable {
    /// For steps and for `--map`.
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
    /// Nothing has that name.
    #[error(
        "'{name}' is neither a motion nor a pose of {arm}; choose one of: {known}, or add [[motion]] or [[pose]]"
    )]
    Unknown {
        /// What was asked for.
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
    /// A step asks for nothing, or for two things at once.
    #[error(
        "motion '{0}': each step is one of {{ to = \"pose\" }} and {{ to_next_of = [\"pose\", …] }}, and there is at least one"
    )]
    Step(String),
    /// The name is taken.
    #[error("motion '{0}' is there twice; give each its own name")]
    Twice(String),
    /// A pose does not fit the arm.
    #[error("pose '{name}': {reason}")]
    Pose {
        /// Which pose.
        name: String,
        /// Why, and what to do.
        reason: String,
    },
}

/// Where a step leads.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Always here, in rad.
    To(Joints),
    /// To the next of these each time, in rad; never empty.
    ToNextOf(Vec<Joints>),
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

/// Reads the angles of a pose of this arm.
///
/// # Errors
/// Their number is not that of the arm's joints, or one is beyond its limits.
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

impl Motions {
    /// The paper's motions on the Gen3.
    pub fn paper() -> Self {
        // Our own file: `the_papers_motions_read` holds it.
        Motions::new(&SerialArm::gen3(), &[], &[], &[]).unwrap_or_else(|error| panic!("{error}"))
    }

    /// What an arm can be asked to do. `solved` are poses as joint angles (of a scene), `poses` and `motions` tables
    /// of a configuration. The bundled poses are the Gen3's: another arm has only those that it is given.
    ///
    /// # Errors
    /// [`MotionError`] names what does not fit.
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
        let given = |name: &str| {
            solved.iter().any(|(known, _)| known == name) || poses.iter().any(|pose| pose.name == name)
        };
        for table in &paper.motion {
            let replaced = motions.iter().any(|own| own.name == table.name) || given(&table.name);
            let fits = table.steps.iter().flat_map(StepTable::poses).all(|pose| all.pose(pose).is_some());
            if !replaced && fits {
                let motion = all.read(table)?;
                all.motions.push(motion);
            }
        }
        for (i, table) in motions.iter().enumerate() {
            if motions[..i].iter().any(|other| other.name == table.name) {
                return Err(MotionError::Twice(table.name.clone()));
            }
            let motion = all.read(table)?;
            all.motions.push(motion);
        }
        Ok(all)
    }

    fn set_pose(&mut self, name: &str, joints_rad: Joints) {
        self.poses.retain(|(known, _)| known != name);
        self.poses.push((name.to_owned(), joints_rad));
    }

    fn read(&self, table: &MotionTable) -> Result<Motion, MotionError> {
        let pose = |name: &String| {
            self.pose(name).ok_or_else(|| MotionError::NoPose {
                motion: table.name.clone(),
                pose: name.clone(),
                arm: self.arm.clone(),
            })
        };
        let step = |step: &StepTable| match (&step.to, &step.to_next_of) {
            (Some(name), None) => Ok(Step::To(pose(name)?)),
            (None, Some(names)) if !names.is_empty() => {
                Ok(Step::ToNextOf(names.iter().map(pose).collect::<Result<_, _>>()?))
            }
            _ => Err(MotionError::Step(table.name.clone())),
        };
        let steps: Vec<Step> = table.steps.iter().map(step).collect::<Result<_, _>>()?;
        if steps.is_empty() {
            return Err(MotionError::Step(table.name.clone()));
        }
        Ok(Motion { name: table.name.as_str().into(), steps })
    }

    /// Every pose, in rad.
    pub fn poses(&self) -> &[(String, Joints)] {
        &self.poses
    }

    /// The pose of that name, in rad.
    pub fn pose(&self, name: &str) -> Option<Joints> {
        self.poses.iter().find(|(known, _)| known == name).map(|(_, joints_rad)| *joints_rad)
    }

    /// The motion of that name, or the one step to the pose of that name.
    ///
    /// # Errors
    /// [`MotionError::Unknown`] lists what there is.
    pub fn get(&self, name: &str) -> Result<Motion, MotionError> {
        if let Some(motion) = self.motions.iter().find(|motion| motion.name == *name) {
            return Ok(motion.clone());
        }
        let pose =
            self.pose(name).map(|joints_rad| Motion { name: name.into(), steps: vec![Step::To(joints_rad)] });
        pose.ok_or_else(|| MotionError::Unknown {
            name: name.to_owned(),
            arm: self.arm.clone(),
            known: self.names().join(", "),
        })
    }

    /// Every motion, then every pose that is no step of a motion of its own name.
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
            steps: vec![StepTable { to: Some(to.to_owned()), to_next_of: None }],
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
        let far = PoseTable { name: "far".to_owned(), joints_rad: vec![3.0; 7] };
        assert!(new(&[far], &[]).to_string().contains("joint_2"));
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
