//! Stores the poses (`geometry_msgs/PoseStamped`) of objects to which the arm may move.
//! The age of each pose comes from its time stamp.
//!
//! A pose must be in the frame of the arm's base or of the mobile base, because this program does not look up transforms.
//! If the newest message is unusable, the pose is unknown, even if an earlier message was usable.
//! The pose is also unknown if several publishers use the topic, because they may mean different objects.
//! This module is sans-IO.

use std::collections::BTreeMap;

use super::clocks::DIFFERENCE_MAX_S;
use super::config::Ros2Config;
use host_robot::{DMat3, DQuat, DVec3, Pose, Reading, Root, Sighting};
use host_topics::message::PoseStamped;

/// Maximum distance of a pose in m. No arm can reach this far.
const FAR_M: f64 = 100.0;
/// Publishers that sent a pose within this time are told apart. A publisher that was restarted has a new name.
const WRITERS_MS: u64 = 3000;
/// Maximum number of publishers of one topic that are told apart.
const WRITERS_MAX: usize = 8;
/// Maximum deviation of a quaternion's length from 1.
const UNIT_OFF: f64 = 0.05;

/// The topics and frames that the motions need.
/// They are derived from the motions and the arm, and are not in the configuration file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Watched {
    /// The topics on which poses are published.
    pub topics: Vec<String>,
    /// The root link of the arm's own description.
    pub arm_root: String,
}

/// The names of the frames in which poses are accepted.
#[derive(Clone, Debug)]
struct Names {
    base: String,
    arm: Vec<String>,
}

/// The content of a received message.
#[derive(Clone, Debug)]
struct Told {
    sighting: Result<Sighting, String>,
    stamp_s: f64,
    /// The message's age on arrival. The next field is the time of arrival.
    age_ms: u64,
    at_ms: u64,
}

/// The newest pose of each topic, as described in this module.
#[derive(Clone, Debug)]
pub struct Sightings {
    names: Names,
    told: BTreeMap<String, Option<Told>>,
    /// The publishers of each topic, with the time of their last message in ms.
    writers: BTreeMap<String, BTreeMap<String, u64>>,
    /// The graph's time at the most recent call of [`Self::at`].
    clock_s: f64,
}

impl Sightings {
    /// Creates the state in which no pose has arrived.
    pub fn new(config: &Ros2Config) -> Self {
        let Watched { topics, arm_root } = &config.watched;
        let arm = match config.arm_base_frame.as_str() {
            "" => vec![format!("{}{arm_root}", config.arm_prefix), arm_root.clone()],
            own => vec![own.to_owned()],
        };
        Sightings {
            names: Names { base: config.base_frame.clone(), arm },
            told: topics.iter().map(|topic| (topic.clone(), None)).collect(),
            writers: BTreeMap::new(),
            clock_s: 0.0,
        }
    }

    /// Sets the graph's current time in seconds. If the graph's clock runs faster than ours, it determines the ages.
    pub fn at(&mut self, clock_s: f64) {
        self.clock_s = clock_s;
    }

    /// Processes a newly received pose, with the name of its publisher.
    pub fn see(&mut self, topic: &str, message: &PoseStamped, writer: &str, now_ms: u64) {
        let Some(told) = self.told.get_mut(topic) else { return };
        let writers = self.writers.entry(topic.to_owned()).or_default();
        writers.retain(|_, at_ms| now_ms.saturating_sub(*at_ms) <= WRITERS_MS);
        if writers.len() < WRITERS_MAX || writers.contains_key(writer) {
            writers.insert(writer.to_owned(), now_ms);
        }
        let stamp_s = message.header.stamp.seconds();
        let age_s = self.clock_s - stamp_s;
        let sighting = if stamp_s == 0.0 {
            Err("its stamp is zero, so that its age is not known".to_owned())
        } else if age_s < -DIFFERENCE_MAX_S {
            Err(format!("its stamp is {:.2} s ahead of this machine's clock: set both clocks by NTP", -age_s))
        } else {
            self.names.sighting(message)
        };
        let age_ms = (age_s.max(0.0) * 1000.0).round() as u64;
        *told = Some(Told { sighting, stamp_s, age_ms, at_ms: now_ms });
    }

    /// Returns the newest pose on this topic, with the age of the pose.
    ///
    /// # Errors
    /// Returns the reason why the pose is unknown, with a remedy.
    pub fn get(&self, topic: &str, now_ms: u64) -> Result<Reading<Sighting>, String> {
        let Some(told) = self.told.get(topic) else {
            return Err(format!("{topic} is not read"));
        };
        let Some(told) = told else {
            return Err(format!(
                "no pose has come on {topic} (geometry_msgs/PoseStamped): is its publisher running?"
            ));
        };
        let writers = self.writers.get(topic).into_iter().flatten();
        let writers = writers.filter(|(_, at_ms)| now_ms.saturating_sub(**at_ms) <= WRITERS_MS);
        let writers: Vec<&str> = writers.map(|(name, _)| name.as_str()).collect();
        if writers.len() > 1 {
            return Err(format!(
                "{} publishers send poses on {topic} ({}): end all but one (`ros2 topic info -v {topic}` names them), or give \
                 each object its own topic",
                writers.len(),
                writers.join(", ")
            ));
        }
        let value = told
            .sighting
            .clone()
            .map_err(|why| format!("the newest pose on {topic} cannot be used: {why}"))?;
        // The larger age is used, so a pose never becomes younger when a clock is set back or the computer sleeps.
        let since_ms = told.age_ms.saturating_add(now_ms.saturating_sub(told.at_ms));
        let by_clock_ms = ((self.clock_s - told.stamp_s).max(0.0) * 1000.0).round() as u64;
        Ok(Reading { value, age_ms: since_ms.max(by_clock_ms) })
    }
}

impl Names {
    fn sighting(&self, message: &PoseStamped) -> Result<Sighting, String> {
        let root = self.root(message.header.frame_id.trim_start_matches('/'))?;
        let (at, turn) = (message.pose.position, message.pose.orientation);
        let position_m = DVec3::new(at.x, at.y, at.z);
        if !position_m.is_finite() || position_m.length() > FAR_M {
            return Err(format!("its position is ({}, {}, {}) m", at.x, at.y, at.z));
        }
        let turn = DQuat::from_xyzw(turn.x, turn.y, turn.z, turn.w);
        let off = (turn.length() - 1.0).abs();
        if off.is_nan() || off > UNIT_OFF {
            return Err("its orientation is no unit quaternion".to_owned());
        }
        Ok(Sighting { pose: Pose { position_m, rotation: DMat3::from_quat(turn.normalize()) }, root })
    }

    fn root(&self, frame: &str) -> Result<Root, String> {
        let is_arm = self.arm.iter().any(|name| name == frame);
        match (frame == self.base, is_arm) {
            (true, true) => Err(format!(
                "its frame '{frame}' could be the arm's base or the mobile base: set arm_base_frame or base_frame in [ros2]"
            )),
            (true, false) => Ok(Root::Base),
            (false, true) => Ok(Root::Arm),
            (false, false) => Err(format!(
                "its frame is '{frame}', and only '{}' (the base) and '{}' (the arm) are taken: let its publisher transform \
                 it, or set base_frame and arm_base_frame in [ros2]",
                self.base,
                self.arm.join("' or '")
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_topics::message::{self as ros, Time};

    const CLOCK_S: f64 = 1_790_000_000.0;

    fn sightings() -> Sightings {
        let watched = Watched { topics: vec!["/cup".to_owned()], arm_root: "base_link".to_owned() };
        let mut sightings = Sightings::new(&Ros2Config { watched, ..Ros2Config::default() });
        sightings.at(CLOCK_S);
        sightings
    }

    fn pose(frame: &str, age_s: f64) -> PoseStamped {
        let stamp = Time::at_ns(((CLOCK_S - age_s) * 1e9).round() as u64);
        let header = ros::Header { stamp, frame_id: frame.to_owned() };
        let mut pose = PoseStamped { header, ..PoseStamped::default() };
        pose.pose.position.x = 0.7;
        pose.pose.orientation.w = 1.0;
        pose
    }

    fn told(sightings: &mut Sightings, pose: &PoseStamped) -> Result<Reading<Sighting>, String> {
        sightings.see("/cup", pose, "camera", 1000);
        sightings.get("/cup", 1000)
    }

    #[test]
    fn a_pose_is_as_old_as_its_stamp_says_however_late_or_often_it_comes() {
        let mut sightings = sightings();
        assert!(sightings.get("/cup", 0).unwrap_err().contains("no pose has come"));
        assert!(sightings.get("/other", 0).unwrap_err().contains("is not read"));
        let came = told(&mut sightings, &pose("arm_base_link", 0.2)).unwrap();
        assert_eq!((came.age_ms, came.value.root, came.value.pose.position_m.x), (200, Root::Arm, 0.7));
        sightings.at(CLOCK_S + 1.0);
        sightings.see("/cup", &pose("arm_base_link", 0.2), "camera", 2000);
        assert_eq!(sightings.get("/cup", 2100).unwrap().age_ms, 1300, "the same message again is no newer");
    }

    #[test]
    fn two_publishers_on_one_topic_are_refused_by_name_until_one_has_been_silent_for_a_while() {
        let mut sightings = sightings();
        let here = pose("arm_base_link", 0.0);
        sightings.see("/cup", &here, "camera 1", 1000);
        sightings.see("/cup", &here, "camera 2", 1500);
        for _ in 0..20 {
            sightings.see("/cup", &here, "camera 2", 3900);
            let why = sightings.get("/cup", 3900).unwrap_err();
            assert!(why.contains("2 publishers") && why.contains("camera 1, camera 2"), "{why}");
        }
        assert!(sightings.get("/cup", 4001).is_ok(), "the first one has ended");
        for n in 0..100 {
            sightings.see("/cup", &here, &format!("flood {n}"), 4100);
        }
        assert!(sightings.get("/cup", 4100).unwrap_err().starts_with("8 publishers"), "memory is bounded");
    }

    #[test]
    fn a_clock_that_jumps_makes_no_pose_younger() {
        let mut sightings = sightings();
        sightings.see("/cup", &pose("arm_base_link", 0.1), "camera", 1000);
        sightings.at(CLOCK_S - 3600.0);
        assert_eq!(sightings.get("/cup", 1500).unwrap().age_ms, 600, "set back by an hour");
        sightings.at(CLOCK_S + 3600.0);
        assert_eq!(sightings.get("/cup", 1500).unwrap().age_ms, 3_600_100, "the computer slept for an hour");
        sightings.at(CLOCK_S - 3600.0);
        sightings.see("/cup", &pose("arm_base_link", 0.0), "camera", 2000);
        assert!(sightings.get("/cup", 2000).unwrap_err().contains("3600.00 s ahead"));
    }

    #[test]
    fn other_frames_are_refused_by_name_and_so_is_one_that_could_be_either() {
        let mut sightings = sightings();
        let camera = told(&mut sightings, &pose("camera_optical_frame", 0.0)).unwrap_err();
        assert!(camera.contains("'camera_optical_frame'") && camera.contains("'arm_base_link'"), "{camera}");
        let either = told(&mut sightings, &pose("base_link", 0.0)).unwrap_err();
        assert!(either.contains("'base_link' could be"), "{either}");
        assert!(told(&mut sightings, &pose("", 0.0)).is_err());
        let own = Ros2Config {
            arm_base_frame: "arm".to_owned(),
            watched: Watched { topics: vec!["/cup".to_owned()], arm_root: "base_link".to_owned() },
            ..Ros2Config::default()
        };
        let mut sightings = Sightings::new(&own);
        sightings.at(CLOCK_S);
        assert_eq!(told(&mut sightings, &pose("base_link", 0.0)).unwrap().value.root, Root::Base);
        assert_eq!(told(&mut sightings, &pose("/arm", 0.0)).unwrap().value.root, Root::Arm);
    }

    #[test]
    fn a_pose_without_numbers_hides_the_one_before_it() {
        type Spoil = fn(&mut PoseStamped);
        let spoils: [Spoil; 6] = [
            |pose| pose.pose.position.y = f64::NAN,
            |pose| pose.pose.position.z = f64::INFINITY,
            |pose| pose.pose.position.x = 1e6,
            |pose| pose.pose.orientation.w = f64::NAN,
            |pose| pose.pose.orientation.w = 0.0,
            |pose| pose.header.stamp = Time::default(),
        ];
        for spoil in spoils {
            let mut sightings = sightings();
            assert!(told(&mut sightings, &pose("arm_base_link", 0.0)).is_ok());
            let mut spoilt = pose("arm_base_link", 0.0);
            spoil(&mut spoilt);
            let why = told(&mut sightings, &spoilt).unwrap_err();
            assert!(why.contains("/cup cannot be used"), "{why}");
        }
    }
}
