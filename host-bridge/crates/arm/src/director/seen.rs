//! Moving goals: finds the object that a step goes to, and checks that the object is still there.
//!
//! The poses of all objects are looked up when a motion is requested, and the entire motion is planned with these poses.
//! The motion does not begin if a pose is too old, or if the object or the base has moved since the measurement.
//! Before the first gripper movement, each part of the motion begins only if neither object nor base has moved.
//! For these later checks, a pose may be older, because the arm often hides the object from the camera.

use host_robot::{MotionName, Pose, Reading, Robot, Root};

use crate::frame::Frame;
use crate::motions::Step;
use crate::plan::Placement;
use crate::things::{ObjectPose, Things, on_base};

use super::{Director, Site, still_moves};

/// An object that is more than this distance (in m) from its planned position has moved.
const MOVED_M: f64 = 0.01;
/// An object that has turned by more than this angle (in rad) has moved. Cameras constantly report smaller changes.
const TURNED_RAD: f64 = 0.1;
/// A base without odometry is assumed to move for this time after its last command.
const BLIND_MS: u64 = 2000;

/// The pose of an object on a topic, as used in the plan.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Seen {
    topic: String,
    age_max_ms: u64,
    /// The object's pose in the frame of the base.
    on_base: Pose,
    /// Time of the measurement.
    taken_ms: u64,
}

/// The object to which a step is relative. Until the gripper moves, later steps also depend on it.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Anchor {
    /// An object with this index in the scene.
    Object(usize),
    /// An object whose pose is published on a topic.
    Topic(Seen),
}

impl Anchor {
    /// Returns the object's pose relative to the point between the wheels.
    pub(super) fn on_base(&self, site: &Site, things: &Things, placement: Placement) -> Result<Pose, String> {
        match self {
            Anchor::Topic(seen) => Ok(seen.on_base),
            Anchor::Object(i) => match things.poses.get(*i) {
                Some(ObjectPose::Stands(at)) => Ok(on_base(placement, at)),
                _ => Err(format!("the gripper holds {} itself", site.shop().objects[*i].name)),
            },
        }
    }
}

impl<R: Robot> Director<R> {
    /// Looks up the object of each step.
    pub(super) fn anchors(&self, steps: &[Step]) -> Result<Vec<Option<Anchor>>, String> {
        let anchor = |(i, step): (usize, &Step)| {
            let Some(frame) = step.frame() else { return Ok(None) };
            let found = match frame {
                Frame::Object(name) => {
                    let objects = self.site.shop().objects;
                    let found = objects.iter().position(|object| object.name == *name);
                    found.map(Anchor::Object).ok_or_else(|| format!("there is no object '{name}'"))
                }
                Frame::Topic { name, age_max_ms } => self.look(name, *age_max_ms).map(Anchor::Topic),
            };
            let told = |why: String| if steps.len() == 1 { why } else { format!("step {}: {why}", i + 1) };
            found.map(Some).map_err(told)
        };
        steps.iter().enumerate().map(anchor).collect()
    }

    /// Returns whether all poses that this motion needs have arrived: the pose of the base in a scene, and a pose on every topic.
    /// The age of a topic's pose does not matter.
    pub fn has_seen(&self, motion: &MotionName) -> bool {
        if self.site.planner().is_some() && self.known_base().is_err() {
            return false;
        }
        let steps = self.motions.get(motion.as_str()).map(|motion| motion.steps).unwrap_or_default();
        steps.iter().all(|step| match step.frame() {
            Some(Frame::Topic { name, .. }) => self.robot.sighting(name).is_ok(),
            _ => true,
        })
    }

    /// Returns the pose of this topic's object.
    /// Fails if the pose is too old, or if the base has moved since the measurement.
    fn look(&self, topic: &str, age_max_ms: u64) -> Result<Seen, String> {
        let Reading { value, age_ms } = self.robot.sighting(topic)?;
        if age_ms > age_max_ms {
            return Err(format!(
                "the newest pose on {topic} is {:.2} s old, and may be {:.2} s: is its publisher running, and does it see \
                 the thing?",
                age_ms as f64 / 1000.0,
                age_max_ms as f64 / 1000.0
            ));
        }
        let taken_ms = self.now_ms.saturating_sub(age_ms);
        if self.base_has_moved_since(taken_ms) {
            return Err(format!("the base has moved since the pose on {topic} was measured; let it rest"));
        }
        let on_base = match value.root {
            Root::Base => value.pose,
            Root::Arm => Pose { position_m: value.pose.position_m + self.site.mount_m(), ..value.pose },
        };
        Ok(Seen { topic: topic.to_owned(), age_max_ms, on_base, taken_ms })
    }

    /// Checks that the object is still where the plan expects it. With `begins`, the pose must also be recent.
    pub(super) fn is_still_there(&self, anchor: &Anchor, begins: bool) -> Result<(), String> {
        let Anchor::Topic(seen) = anchor else { return Ok(()) };
        if self.base_has_moved_since(seen.taken_ms) {
            return Err(format!(
                "the base has moved since the pose on {} was measured; let it rest, and ask for the motion again",
                seen.topic
            ));
        }
        let age_max_ms = if begins { seen.age_max_ms } else { u64::MAX };
        let now = self.look(&seen.topic, age_max_ms)?.on_base;
        let off_m = now.position_m.distance(seen.on_base.position_m);
        let turned_rad = now.quaternion().angle_between(seen.on_base.quaternion());
        if off_m <= MOVED_M && turned_rad <= TURNED_RAD {
            return Ok(());
        }
        Err(format!(
            "what {} shows has moved by {off_m:.3} m and {turned_rad:.2} rad since the motion was planned; ask for the \
             motion again",
            seen.topic
        ))
    }

    /// Stores the time at which the base last moved.
    pub(super) fn watch_base(&mut self) {
        let is_driven = self.allowed != host_robot::Twist::ZERO;
        let moves = self.robot.base().is_some_and(|base| still_moves(base.value.odometry.twist));
        if is_driven || moves {
            self.base_moved_ms = Some(self.now_ms);
        }
    }

    fn base_has_moved_since(&self, taken_ms: u64) -> bool {
        let blind_ms = if self.robot.base().is_some() { 0 } else { BLIND_MS };
        self.base_moved_ms.is_some_and(|moved_ms| moved_ms.saturating_add(blind_ms) >= taken_ms)
    }
}
