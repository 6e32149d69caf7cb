//! The initial conditions of a session. They are complete, so that the same session can be started again.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use host_arm::Director;
use host_arm::model::SerialArm;
use host_arm::plan::Planner;
use host_arm::scene::Scene;
use host_core::bridge::Bridge;
use host_core::intent::MotionMap;
use host_sim::Simulator;

use crate::config::{Config, HandInput};
use crate::robots::Stage;

/// The initial conditions of a session, see the module documentation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Setup {
    /// A one-line title for the user.
    pub title: String,
    /// The configuration: limits, times, base, arm and motions.
    pub config: Config,
    /// `LABEL=MOTION` mappings in the given order. They are applied after those of `config`.
    pub maps: Vec<String>,
    /// The robot's surroundings.
    pub scene: Option<SceneText>,
    /// Time of day at which the session's clock was zero, in nanoseconds since 1970.
    pub origin_ns: u64,
    /// Whether an external robot was driven, whose motion cannot be recomputed.
    pub robot_elsewhere: bool,
    /// Whether motions were planned outside the control thread. If so, they begin at the times in the file.
    pub plans_aside: bool,
    /// Description of the task, for training robots.
    pub task: Option<String>,
}

/// A scene with all files to which it refers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SceneText {
    /// The path of the scene file.
    pub file: PathBuf,
    /// The scene.
    pub toml: String,
    /// The scene's arm, if it is not the Gen3.
    pub urdf: Option<String>,
}

/// The reason why a session cannot be started from a file.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// A file cannot be read.
    #[error("{file}: {source}")]
    Read {
        /// Path of the file.
        file: PathBuf,
        /// Reason of the system.
        source: std::io::Error,
    },
    /// The scene cannot be used.
    #[error("{file}: {problem}")]
    Scene {
        /// Path of the scene file.
        file: PathBuf,
        /// The problem and a remedy.
        problem: String,
    },
    /// The file's metadata have another version or are damaged.
    #[error("the session's settings cannot be read: {0}; it was written by another version of this program")]
    Metadata(String),
}

impl SceneText {
    /// Reads a scene file and its arm.
    ///
    /// # Errors
    /// Returns [`SetupError`] if a file is missing or the scene is invalid.
    pub fn read(file: &Path) -> Result<Self, SetupError> {
        let text = |file: &Path| {
            std::fs::read_to_string(file).map_err(|source| SetupError::Read { file: file.to_owned(), source })
        };
        let toml = text(file)?;
        let scene = Scene::parse(&toml)
            .map_err(|error| SetupError::Scene { file: file.to_owned(), problem: error.to_string() })?;
        let urdf = scene.arm.urdf.as_ref().map(|urdf| {
            let read = urdf_text(urdf, file, &scene);
            read.map_err(|problem| SetupError::Scene { file: urdf.clone(), problem })
        });
        let urdf = urdf.transpose()?;
        Ok(SceneText { file: file.to_owned(), toml, urdf })
    }

    /// Creates a planner for the scene.
    ///
    /// # Errors
    /// [`SetupError::Scene`].
    pub fn planner(&self) -> Result<Planner, SetupError> {
        let bad = |problem: String| SetupError::Scene { file: self.file.clone(), problem };
        let scene = Scene::parse(&self.toml).map_err(|error| bad(error.to_string()))?;
        let arm = match &self.urdf {
            None => SerialArm::gen3(),
            Some(urdf) => arm(urdf, &scene).map_err(bad)?,
        };
        Planner::new(arm, scene).map_err(|error| bad(error.to_string()))
    }
}

/// The description contains capsules instead of meshes, so a session needs no other file.
#[cfg(feature = "urdf")]
fn urdf_text(urdf: &Path, file: &Path, scene: &Scene) -> Result<String, String> {
    Ok(crate::arm_file::read(urdf, file, &scene.arm)?.text)
}

#[cfg(not(feature = "urdf"))]
fn urdf_text(_urdf: &Path, _file: &Path, _scene: &Scene) -> Result<String, String> {
    Err("this program reads no URDF; build it with `--features urdf`".to_owned())
}

#[cfg(feature = "urdf")]
fn arm(urdf: &str, scene: &Scene) -> Result<SerialArm, String> {
    let missing = host_arm::urdf::Missing::of(&scene.arm);
    host_arm::urdf::parse(urdf, &missing).map_err(|error| error.to_string())
}

#[cfg(not(feature = "urdf"))]
fn arm(_urdf: &str, _scene: &Scene) -> Result<SerialArm, String> {
    Err("this program reads no URDF; build it with `--features urdf`".to_owned())
}

impl Setup {
    /// Returns the motions of all labels.
    ///
    /// # Errors
    /// Returns [`SetupError::Metadata`] for an invalid mapping.
    pub fn motion_map(&self) -> Result<MotionMap, SetupError> {
        let mut map = self.config.motion_map();
        for mapping in &self.maps {
            map.assign(mapping).map_err(|error| SetupError::Metadata(error.to_string()))?;
        }
        Ok(map)
    }

    /// Returns a bridge that waits for its hands.
    ///
    /// # Errors
    /// Fails for the same reasons as [`Setup::motion_map`].
    pub fn bridge(&self) -> Result<Bridge, SetupError> {
        let bridge = self.config.bridge(self.motion_map()?);
        let inputs = self.config.inputs();
        let boards = inputs.iter().filter(|(_, input)| **input == HandInput::Board);
        Ok(boards.fold(bridge, |bridge, (hand, _)| bridge.awaiting(hand)))
    }

    /// Returns the surroundings and the motions of the arm.
    ///
    /// # Errors
    /// [`SetupError::Scene`].
    pub fn stage(&self) -> Result<Stage, SetupError> {
        let planner = self.scene.as_ref().map(SceneText::planner).transpose()?;
        let file = || self.scene.as_ref().map(|scene| scene.file.clone()).unwrap_or_default();
        Stage::new(&self.config, planner)
            .map_err(|error| SetupError::Scene { file: file(), problem: error.to_string() })
    }

    /// Returns the simulated robot at rest, behind its door.
    ///
    /// # Errors
    /// [`SetupError::Scene`].
    pub fn robot(&self) -> Result<Director<Simulator>, SetupError> {
        let robot = self.stage()?.simulated(&self.config);
        Ok(if self.plans_aside { robot.planning_held() } else { robot })
    }

    /// Returns the setup as metadata of the file.
    pub fn to_metadata(&self) -> BTreeMap<String, String> {
        let mut metadata = BTreeMap::from([
            ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("title".to_owned(), self.title.clone()),
            ("config".to_owned(), self.config.to_toml()),
            ("maps".to_owned(), serde_json::to_string(&self.maps).unwrap_or_default()),
            ("origin_ns".to_owned(), self.origin_ns.to_string()),
            ("robot".to_owned(), if self.robot_elsewhere { "elsewhere" } else { "simulated" }.to_owned()),
        ]);
        if let Some(scene) = &self.scene {
            metadata.insert("scene".to_owned(), serde_json::to_string(scene).unwrap_or_default());
        }
        if self.plans_aside {
            metadata.insert("planning".to_owned(), "aside".to_owned());
        }
        if let Some(task) = &self.task {
            metadata.insert("task".to_owned(), task.clone());
        }
        metadata
    }

    /// Reads the setup from a file's metadata.
    ///
    /// # Errors
    /// [`SetupError::Metadata`].
    pub fn from_metadata(metadata: &BTreeMap<String, String>) -> Result<Self, SetupError> {
        let bad = |what: String| SetupError::Metadata(what);
        let text = |key: &str| {
            metadata.get(key).map(String::as_str).ok_or_else(|| bad(format!("there is no '{key}'")))
        };
        let scene = metadata.get("scene").map(|scene| serde_json::from_str(scene)).transpose();
        Ok(Setup {
            title: text("title")?.to_owned(),
            config: Config::parse(text("config")?).map_err(|error| bad(error.to_string()))?,
            maps: serde_json::from_str(text("maps")?).map_err(|error| bad(error.to_string()))?,
            scene: scene.map_err(|error| bad(error.to_string()))?,
            origin_ns: text("origin_ns")?.parse().map_err(|_| bad("origin_ns is no number".to_owned()))?,
            robot_elsewhere: metadata.get("robot").is_some_and(|robot| robot == "elsewhere"),
            plans_aside: metadata.get("planning").is_some_and(|planning| planning == "aside"),
            task: metadata.get("task").cloned(),
        })
    }
}
