//! Goals that move: where the thing is that a step goes to, and whether it is still there.
//!
//! All places are looked up when the motion is asked for, and the whole motion is planned to them. It does not begin if a
//! pose is too old, or if the thing or the base has moved since. Until the gripper has moved, each part of the motion begins
//! only if thing and base are still there. A pose may then be older, because the hand often hides what it reaches for.

use host_robot::{MotionName, Pose, Reading, Robot, Root};

use crate::frame::Frame;
use crate::motions::Step;
use crate::plan::Placement;
use crate::things::{ObjectPose, Things, on_base};

use super::{Director, Site, still_moves};

/// A thing that is this far from where it was seen, in m, has moved,
const MOVED_M: f64 = 0.01;
/// or that has turned by this much, in rad. Cameras report smaller changes all the time.
const TURNED_RAD: f64 = 0.1;
/// A base that reports no odometry counts as moving for this long after its last command.
const BLIND_MS: u64 = 2000;

/// The place of a thing, as the motion was planned to it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Seen {
    topic: String,
    age_max_ms: u64,
    /// In the frame of the base.
    on_base: Pose,
    /// Time of the measurement.
    taken_ms: u64,
}

/// What a step is about; until the gripper moves, the steps after it are, too.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Anchor {
    /// An object of the scene, with its number.
    Object(usize),
    /// A thing on a topic.
    Topic(Seen),
}

impl Anchor {
    /// Returns the frame's pose relative to the point between the wheels.
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
    /// Looks up the frame of each step.
    pub(super) fn anchors(&self, steps: &[Step]) -> Result<Vec<Option<Anchor>>, String> {
        let anchor = |(i, step): (usize, &Step)| {
            let Step::Tool { frame: Some(frame), .. } = step else { return Ok(None) };
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

    /// Returns whether a pose has come on each topic that this motion needs, however old it is.
    pub fn has_seen(&self, motion: &MotionName) -> bool {
        let steps = self.motions.get(motion.as_str()).map(|motion| motion.steps).unwrap_or_default();
        steps.iter().all(|step| match step {
            Step::Tool { frame: Some(Frame::Topic { name, .. }), .. } => self.robot.sighting(name).is_ok(),
            _ => true,
        })
    }

    /// Returns where this topic's thing is, if that was measured lately enough and the base has not moved since.
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

    /// Checks that the thing is still where the motion was planned to. With `begins`, its pose must also be recent.
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
        let off_m = (now.position_m - seen.on_base.position_m).length();
        let turn = (now.rotation.transpose() * seen.on_base.rotation).to_cols_array_2d();
        let cosine = 0.5 * (turn[0][0] + turn[1][1] + turn[2][2] - 1.0);
        let turned_rad = cosine.clamp(-1.0, 1.0).acos();
        if off_m <= MOVED_M && turned_rad <= TURNED_RAD {
            return Ok(());
        }
        Err(format!(
            "what {} shows has moved by {off_m:.3} m and {turned_rad:.2} rad since the motion was planned; ask for the \
             motion again",
            seen.topic
        ))
    }

    /// Notes when the base moved last.
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
