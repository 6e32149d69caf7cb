//! Creates all messages from the data that observers receive.

use serde::Serialize;

use super::Topic;
use super::cdr::encode;
use crate::bimanual::{self as own, Intent};
use crate::message::{self as ros, Header, Time};
use host_core::bridge::Bridge;
use host_core::bridge::{BridgeEvent, EventKind};
use host_core::describe;
use host_core::observe::SessionEvent;
use host_core::observe::{Now, OperatorKey, Sample, Turn};
use host_core::safety::Hand;
use host_robot::{DQuat, DVec3, Door, Picture, Pose, RobotSetting};

/// Frame of the base's odometry.
pub const ODOM: &str = "odom";
/// Frame of the base, on the floor between its wheels.
pub const BASE: &str = "base_link";
/// Prefix of the arm's link names, which distinguishes the arm's `base_link` from the base's.
pub const ARM_PREFIX: &str = "arm_";

/// Names of the frames, chosen to match the robot's own description.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frames {
    /// Frame of the base's odometry.
    pub odom: String,
    /// Frame of the base, on the floor between its wheels.
    pub base: String,
    /// Of the arm's foot.
    pub arm_root: String,
    /// Prefix of the arm's link names.
    pub arm_prefix: String,
}

impl Frames {
    /// The names used in files and in Foxglove.
    pub fn plain(setting: &RobotSetting) -> Self {
        Frames {
            odom: ODOM.to_owned(),
            base: BASE.to_owned(),
            arm_root: format!("{ARM_PREFIX}{}", setting.arm_root),
            arm_prefix: ARM_PREFIX.to_owned(),
        }
    }

    /// A link of the arm.
    pub fn link(&self, name: &str) -> String {
        format!("{}{name}", self.arm_prefix)
    }
}

/// Returns three groups of transforms.
/// They are the base in the world, the arm's base on it, and the arm's links with the flange.
pub fn transforms(
    robot: &dyn Door,
    picture: &Picture,
    model: &RobotSetting,
    frames: &Frames,
    stamp: Time,
) -> ros::TfMessage {
    let links = robot.link_poses(&picture.arm.joints_rad);
    let joints = model.joints.len().min(links.len() - 1);
    let put = |parent: &str, child: String, transform| ros::TransformStamped {
        header: Header { stamp, frame_id: parent.to_owned() },
        child_frame_id: child,
        transform,
    };
    let on_foot =
        |pose: &Pose| ros::Transform { translation: pose.position_m.into(), rotation: quaternion(pose) };
    let foot = ros::Transform { translation: model.mount_m.into(), rotation: ros::Quaternion::yaw(0.0) };
    let mut transforms = vec![
        put(&frames.odom, frames.base.clone(), ros::Transform::of_base(picture)),
        put(&frames.base, frames.arm_root.clone(), foot),
    ];
    for (joint, pose) in model.joints.iter().zip(&links[..joints]) {
        transforms.push(put(&frames.arm_root, frames.link(&joint.link), on_foot(pose)));
    }
    let flange = on_foot(&links[links.len() - 1]);
    transforms.push(put(&frames.arm_root, frames.link(&model.flange_link), flange));
    ros::TfMessage { transforms }
}

/// A message that is ready to be written or sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Where.
    pub topic: Topic,
    /// Time on the session's clock.
    pub time_ms: u64,
    /// What, in CDR.
    pub data: Vec<u8>,
}

/// Time of day at which the session's clock was zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Origin {
    /// Since 1970.
    pub nanoseconds: u64,
}

impl Entry {
    fn new(topic: Topic, time_ms: u64, message: &impl Serialize) -> Self {
        Entry { topic, time_ms, data: encode(message) }
    }
}

impl Origin {
    /// The time of day.
    pub fn at(self, time_ms: u64) -> u64 {
        self.nanoseconds.saturating_add(time_ms.saturating_mul(1_000_000))
    }

    fn stamp(self, time_ms: u64) -> Time {
        Time::at_ns(self.at(time_ms))
    }

    fn header(self, time_ms: u64, frame: &str) -> Header {
        Header { stamp: self.stamp(time_ms), frame_id: frame.to_owned() }
    }

    /// Bytes of a link.
    pub fn bytes(self, time_ms: u64, hand: Hand, received: bool, data: &[u8]) -> Entry {
        let topic = match (hand, received) {
            (Hand::Left, true) => Topic::LeftReceived,
            (Hand::Left, false) => Topic::LeftSent,
            (Hand::Right, true) => Topic::RightReceived,
            (Hand::Right, false) => Topic::RightSent,
        };
        Entry::new(topic, time_ms, &own::Bytes { stamp: self.stamp(time_ms), time_ms, data: data.to_vec() })
    }

    /// A key.
    pub fn operated(self, time_ms: u64, key: OperatorKey) -> Entry {
        let key = match key {
            OperatorKey::Stop => 0,
            OperatorKey::Release => 1,
            OperatorKey::EndArm => 2,
            OperatorKey::Show => 3,
            OperatorKey::Shown => 4,
            OperatorKey::Clutch => 5,
        };
        Entry::new(Topic::Operated, time_ms, &own::Operated { stamp: self.stamp(time_ms), time_ms, key })
    }

    /// Reports that the robot itself refuses to move, or (with `None`) that the refusal has ended.
    pub fn refused(self, time_ms: u64, reason: Option<&str>) -> Entry {
        let reason = reason.unwrap_or_default().to_owned();
        Entry::new(Topic::Refused, time_ms, &own::Refused { stamp: self.stamp(time_ms), time_ms, reason })
    }

    /// Reports steps, the last of which ended at `time_ms`.
    pub fn turns(self, time_ms: u64, turns: &[Turn]) -> Entry {
        let turn = |turn: &Turn| match turn {
            Turn::Decided(ms) => own::Turn { kind: 0, ms: *ms },
            Turn::Moved(ms) => own::Turn { kind: 1, ms: *ms },
            Turn::Planned => own::Turn { kind: 2, ms: 0 },
        };
        Entry::new(Topic::Turns, time_ms, &own::Turns { turns: turns.iter().map(turn).collect() })
    }

    /// Reports a sample in the units of recordings and of ROS.
    pub fn sample(self, time_ms: u64, sample: &Sample<'_>) -> Vec<Entry> {
        match *sample {
            Sample::Left { counts, bends_permille } => {
                let header = self.header(time_ms, "left_hand");
                vec![Entry::new(
                    Topic::LeftSample,
                    time_ms,
                    &own::LeftSample { header, counts, bends_permille },
                )]
            }
            Sample::Right { values } => {
                let header = self.header(time_ms, "right_hand");
                let three = |from: usize, factor: f64| -> Option<DVec3> {
                    let found = values.get(from..from + 3)?;
                    Some(DVec3::from([0, 1, 2].map(|i| f64::from(found[i]))) * factor)
                };
                // In ROS, the value -1 in the first element means that the data is missing.
                let mut unknown = [0.0; 9];
                unknown[0] = -1.0;
                let raw = own::RightSample { header: header.clone(), values: values.to_vec() };
                let mut entries = vec![Entry::new(Topic::RightSample, time_ms, &raw)];
                if let Some(acceleration) = three(0, 1.0) {
                    let turning = three(3, std::f64::consts::PI / 180.0);
                    let imu = ros::Imu {
                        header: header.clone(),
                        orientation: ros::Quaternion { w: 1.0, ..ros::Quaternion::default() },
                        orientation_covariance: unknown,
                        angular_velocity: turning.unwrap_or_default().into(),
                        angular_velocity_covariance: if turning.is_some() { [0.0; 9] } else { unknown },
                        linear_acceleration: acceleration.into(),
                        linear_acceleration_covariance: [0.0; 9],
                    };
                    entries.push(Entry::new(Topic::Imu, time_ms, &imu));
                }
                if let Some(field) = three(6, 1e-6) {
                    let magnetic =
                        ros::MagneticField { header, magnetic_field: field.into(), ..Default::default() };
                    entries.push(Entry::new(Topic::Magnetic, time_ms, &magnetic));
                }
                entries
            }
        }
    }

    /// Reports an event on all topics that it belongs to.
    pub fn event(self, event: &SessionEvent) -> Vec<Entry> {
        let time_ms = describe::time_ms(event);
        let text = describe::text(event);
        let mut entries = Vec::new();
        let mut warning = false;
        if let SessionEvent::Bridge(bridge_event) = event {
            let BridgeEvent { kind, .. } = bridge_event;
            let (header, json) =
                (self.header(time_ms, ""), serde_json::to_string(bridge_event).unwrap_or_default());
            let event = own::Event { header: header.clone(), time_ms, text: text.clone(), json };
            entries.push(Entry::new(Topic::Events, time_ms, &event));
            if let Some(intent) = intent(kind, &header) {
                entries.push(Entry::new(Topic::Intents, time_ms, &intent));
            }
            let stop = match kind {
                EventKind::Halt { reason } => Some((true, plain(reason))),
                EventKind::Released => Some((false, String::new())),
                _ => None,
            };
            if let Some((halted, reason)) = stop {
                entries.push(Entry::new(Topic::Stops, time_ms, &own::Stop { header, halted, reason }));
            }
            warning = matches!(
                kind,
                EventKind::Halt { .. }
                    | EventKind::BoardFault { .. }
                    | EventKind::HandUnusable { .. }
                    | EventKind::MotionRefused { .. }
            );
        }
        if let SessionEvent::Marked { mark, by, .. } = event {
            let (mark, by) = (mark.name().to_owned(), by.name().to_owned());
            let marked =
                own::Mark { header: self.header(time_ms, ""), time_ms, mark, by, text: text.clone() };
            entries.push(Entry::new(Topic::Marks, time_ms, &marked));
        }
        let log = ros::Log {
            stamp: self.stamp(time_ms),
            level: if warning { 30 } else { 20 },
            name: "bimanual".to_owned(),
            msg: text,
            ..ros::Log::default()
        };
        entries.push(Entry::new(Topic::Log, time_ms, &log));
        entries
    }

    /// What the hands say.
    pub fn hands(self, now: &Now<'_>) -> Entry {
        let bridge = now.bridge;
        let (left, caps) = (bridge.left_state(), bridge.caps());
        let hands = own::Hands {
            header: self.header(now.time_ms, ""),
            safety: safety(bridge),
            pitch_rad: f64::from(left.pitch_mrad) / 1000.0,
            roll_rad: f64::from(left.roll_mrad) / 1000.0,
            heading: left.heading.name().to_owned(),
            both_fingers: left.stop,
            labels: bridge.link(Hand::Right).model().map_or(Vec::new(), |model| model.labels.clone()),
            scores: bridge.scores().to_vec(),
            cap_m_s: caps.linear_m_s,
            cap_rad_s: caps.angular_rad_s,
        };
        Entry::new(Topic::Hands, now.time_ms, &hands)
    }

    /// Reports the commanded speed of the base.
    pub fn twist(self, now: &Now<'_>) -> Entry {
        let twist =
            ros::TwistStamped { header: self.header(now.time_ms, BASE), twist: now.bridge.twist().into() };
        Entry::new(Topic::Twist, now.time_ms, &twist)
    }

    /// Arm joints, then the wheels.
    pub fn joints(self, now: &Now<'_>) -> Entry {
        let (picture, model) = (now.robot.picture(), now.robot.setting());
        let arm = &picture.arm;
        let joints = model.joints.len().min(arm.joints_rad.len());
        let names = model.joints[..joints].iter().map(|joint| joint.name.as_str());
        let state = ros::JointState {
            header: self.header(now.time_ms, ""),
            name: names.chain(["left_wheel", "right_wheel"]).map(str::to_owned).collect(),
            position: [&arm.joints_rad[..joints], &picture.wheels_rad].concat(),
            velocity: [&arm.velocity_rad_s[..joints], &picture.wheels_rad_s].concat(),
            effort: Vec::new(),
        };
        Entry::new(Topic::Joints, now.time_ms, &state)
    }

    /// Reports the position of the base and its covariance.
    pub fn odometry(self, now: &Now<'_>) -> Entry {
        let (header, base) = (self.header(now.time_ms, ODOM), now.robot.setting().base);
        let odometry = ros::Odometry::of(&now.robot.picture(), &base, header, BASE.to_owned());
        Entry::new(Topic::Odometry, now.time_ms, &odometry)
    }

    /// Reports three groups of transforms.
    /// They are the base in the world, the arm's base on it, and the arm's links with the flange.
    pub fn transforms(self, now: &Now<'_>) -> Entry {
        let (picture, model) = (now.robot.picture(), now.robot.setting());
        let message =
            transforms(now.robot, &picture, &model, &Frames::plain(&model), self.stamp(now.time_ms));
        Entry::new(Topic::Transforms, now.time_ms, &message)
    }

    /// Reports the number of missing messages.
    pub fn lost(self, time_ms: u64, messages: u64) -> Entry {
        Entry::new(Topic::Lost, time_ms, &own::Lost { header: self.header(time_ms, ""), messages })
    }
}

/// Reports an event that a hand caused.
fn intent(kind: &EventKind, header: &Header) -> Option<Intent> {
    let header = header.clone();
    let (hand, confidence, age_ms, [linear_m_s, angular_rad_s], name, outcome) = match kind {
        EventKind::Heading { hand, heading, twist, age_ms, .. } => {
            let speed = [twist.linear_m_s, twist.angular_rad_s];
            (*hand, 1.0, *age_ms, speed, heading.name(), "drive".to_owned())
        }
        EventKind::Caps { cap, .. } => (Hand::Left, 1.0, 0, [*cap, *cap], "cap", "cap".to_owned()),
        EventKind::Gesture { label, confidence, age_ms, outcome, .. } => {
            (Hand::Right, *confidence, *age_ms, [0.0; 2], label.as_str(), plain(outcome))
        }
        _ => return None,
    };
    let (hand, name) = (hand.to_string(), name.to_owned());
    Some(Intent { header, hand, name, outcome, confidence, age_ms, linear_m_s, angular_rad_s })
}

/// Returns the state of the dead-man, together with any other reason that restricts the robot.
fn safety(bridge: &Bridge) -> String {
    let mut text = plain(&bridge.safety().state());
    if bridge.is_jogging() {
        text += "; jogging";
    }
    for why in [bridge.refusal(), bridge.restriction()].into_iter().flatten() {
        text += &format!("; {why}");
    }
    text
}

/// Formats a value as in the JSON summary, but without quotes around texts.
fn plain(value: &impl serde::Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(text)) => text,
        Ok(other) => other.to_string(),
        Err(_) => String::new(),
    }
}

fn quaternion(pose: &Pose) -> ros::Quaternion {
    let DQuat { x, y, z, w } = pose.quaternion();
    ros::Quaternion { x, y, z, w }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_the_time_of_day() {
        let origin = Origin { nanoseconds: 1_700_000_000_900_000_000 };
        let entry = origin.operated(250, OperatorKey::Release);
        let stamp = Time { sec: 1_700_000_001, nanosec: 150_000_000 };
        let expected = own::Operated { stamp, time_ms: 250, key: 1 };
        assert_eq!(crate::cdr::decode(&entry.data), Some(expected));
    }
}
