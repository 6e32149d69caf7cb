//! Publishes data other than commands: the operator's stop, diagnostics, and the simulator if it is the robot.
//! Needs the feature `ros2`.

use std::sync::{MutexGuard, PoisonError};

use super::config::Ros2Config;
use super::description::urdf;
use super::node::Shared;
use super::transport::Voice;
use host_robot::{Door, RobotSetting};
use host_topics::message as ros;
use host_topics::messages::{Frames, transforms};

/// Repetition interval of the operator's stop.
const STOPPED_INTERVAL_MS: u64 = 250;
/// Publication interval of the simulator's state.
const SIM_INTERVAL_MS: u64 = 20;

/// The simulator's data for publishing.
#[derive(Clone, Debug)]
pub struct Simulator {
    /// Data of the simulator that does not change.
    pub setting: RobotSetting,
    /// Names of its frames.
    pub frames: Frames,
    /// Its description.
    pub urdf: String,
}

impl Simulator {
    /// Creates a simulator as configured.
    ///
    /// # Errors
    /// Fails if two frames would have the same name.
    pub fn new(config: &Ros2Config, setting: &RobotSetting) -> Result<Self, String> {
        let frames = config.frames(setting)?;
        Ok(Simulator { setting: setting.clone(), urdf: urdf(setting, &frames, config), frames })
    }
}

/// Publishes diagnostics, and the simulator if it is the robot.
pub struct RosPublisher {
    config: Ros2Config,
    published: Shared,
    /// The outlet for the simulator's state.
    simulator: Option<Simulator>,
    sim_published_ms: u64,
    /// The last published operator's stop, and its time.
    said_stopped: Option<(bool, u64)>,
}

impl RosPublisher {
    /// Creates a publisher for this node that has not published anything.
    pub(super) fn new(config: &Ros2Config, published: Shared, simulator: Option<Simulator>) -> Self {
        let config = config.clone();
        RosPublisher { config, published, simulator, sim_published_ms: 0, said_stopped: None }
    }

    /// Publishes the operator's stop: immediately on a change, otherwise four times per second.
    pub fn say_stopped(&mut self, stopped: bool, now_ms: u64) {
        let said = self.said_stopped.is_some_and(|(last, at_ms)| {
            last == stopped && now_ms.saturating_sub(at_ms) < STOPPED_INTERVAL_MS
        });
        if !said && let Some(published) = &mut *lock(&self.published) {
            self.said_stopped = Some((stopped, now_ms));
            // A message that cannot be sent is soon sent again.
            let _ = published.say_stopped(stopped);
        }
    }

    /// Publishes the state of the hands.
    pub fn diagnose(&mut self, message: ros::DiagnosticArray) {
        if let Some(published) = &mut *lock(&self.published) {
            published.diagnose(message);
        }
    }

    /// Publishes the simulator's state, if requested and due.
    pub fn publish_sim(&mut self, robot: &dyn Door, now_ms: u64, stamp: ros::Time) {
        let mut published = lock(&self.published);
        let voice = published.as_mut().filter(|voice| voice.has_simulator());
        let (Some(voice), Some(described)) = (voice, &self.simulator) else { return };
        if now_ms.saturating_sub(self.sim_published_ms) < SIM_INTERVAL_MS {
            return;
        }
        voice.describe(&described.urdf);
        self.sim_published_ms = now_ms;
        let (picture, Simulator { setting, frames, .. }) = (robot.picture(), described);
        let header = |frame: &str| ros::Header { stamp, frame_id: frame.to_owned() };
        let arm = &picture.arm;
        let joint_state = ros::JointState {
            header: header(""),
            name: self.config.joint_names.clone(),
            position: arm.joints_rad[..self.config.joint_names.len()].to_vec(),
            velocity: arm.velocity_rad_s[..self.config.joint_names.len()].to_vec(),
            effort: Vec::new(),
        };
        let odom = ros::Odometry::of(&picture, &setting.base, header(&frames.odom), frames.base.clone());
        voice.simulate(joint_state, odom, transforms(robot, &picture, setting, frames, stamp));
    }
}

/// A publisher that panicked leaves its data intact.
pub(super) fn lock(published: &Shared) -> MutexGuard<'_, Option<Box<dyn Voice>>> {
    published.lock().unwrap_or_else(PoisonError::into_inner)
}
