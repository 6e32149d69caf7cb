//! Every message, made from what observers are shown.

use super::Topic;
use super::cdr::Writer;
use crate::arm::Pose;
use crate::bridge::{BridgeEvent, EventKind};
use crate::describe;
use crate::observe::{Now, OperatorKey, Sample, Turn};
use crate::robot::Robot as _;
use crate::safety::Hand;
use crate::session::SessionEvent;

/// Frame in which the base's way is told.
pub const ODOM: &str = "odom";
/// Frame of the base, on the floor between its wheels.
pub const BASE: &str = "base_link";
/// Frame of the arm's foot.
pub const ARM: &str = "arm_base";

/// A message, ready to be written or sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Where.
    pub topic: Topic,
    /// When, on the session's clock.
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

impl Origin {
    /// The time of day.
    pub fn at(self, time_ms: u64) -> u64 {
        self.nanoseconds.saturating_add(time_ms.saturating_mul(1_000_000))
    }

    fn stamp(self, writer: &mut Writer, time_ms: u64) {
        let at = self.at(time_ms);
        let seconds = i32::try_from(at / 1_000_000_000).unwrap_or(i32::MAX);
        writer.i32(seconds).u32((at % 1_000_000_000) as u32);
    }

    fn header(self, writer: &mut Writer, time_ms: u64, frame: &str) {
        self.stamp(writer, time_ms);
        writer.string(frame);
    }

    fn with_header(self, time_ms: u64, frame: &str) -> Writer {
        let mut writer = Writer::new();
        self.header(&mut writer, time_ms, frame);
        writer
    }

    /// Bytes of a link.
    pub fn bytes(self, time_ms: u64, hand: Hand, received: bool, bytes: &[u8]) -> Entry {
        let topic = match (hand, received) {
            (Hand::Left, true) => Topic::LeftReceived,
            (Hand::Left, false) => Topic::LeftSent,
            (Hand::Right, true) => Topic::RightReceived,
            (Hand::Right, false) => Topic::RightSent,
        };
        let mut writer = Writer::new();
        self.stamp(&mut writer, time_ms);
        Entry { topic, time_ms, data: writer.u64(time_ms).blob(bytes).take() }
    }

    /// A key.
    pub fn operated(self, time_ms: u64, key: OperatorKey) -> Entry {
        let mut writer = Writer::new();
        self.stamp(&mut writer, time_ms);
        let data = writer.u64(time_ms).u8(u8::from(key == OperatorKey::Release)).take();
        Entry { topic: Topic::Operated, time_ms, data }
    }

    /// Steps, of which the last one ended at `time_ms`.
    pub fn turns(self, time_ms: u64, turns: &[Turn]) -> Entry {
        let mut writer = Writer::new();
        writer.count(turns.len());
        for turn in turns {
            match turn {
                Turn::Decided(ms) => writer.u8(0).u64(*ms),
                Turn::Moved(ms) => writer.u8(1).u64(*ms),
            };
        }
        Entry { topic: Topic::Turns, time_ms, data: writer.take() }
    }

    /// A reading: as the recording has it, and as ROS wants it.
    pub fn sample(self, time_ms: u64, sample: &Sample<'_>) -> Vec<Entry> {
        let entry = |topic, mut writer: Writer| Entry { topic, time_ms, data: writer.take() };
        match sample {
            Sample::Left { counts, bends_permille } => {
                let mut writer = self.with_header(time_ms, "left_hand");
                counts.iter().for_each(|count| {
                    writer.u16(*count);
                });
                bends_permille.iter().for_each(|bend| {
                    writer.i16(*bend);
                });
                vec![entry(Topic::LeftSample, writer)]
            }
            Sample::Right { values } => {
                let mut raw = self.with_header(time_ms, "right_hand");
                raw.count(values.len());
                values.iter().for_each(|value| {
                    raw.f32(*value);
                });
                let three = |from: usize, factor: f64| -> Option<[f64; 3]> {
                    let found = values.get(from..from + 3)?;
                    Some([0, 1, 2].map(|i| f64::from(found[i]) * factor))
                };
                // A first element of -1 is ROS's way to say that there is no such reading.
                let mut unknown = [0.0; 9];
                unknown[0] = -1.0;
                let known = [0.0; 9];
                let mut entries = vec![entry(Topic::RightSample, raw)];
                if let Some(acceleration) = three(0, 1.0) {
                    let mut imu = self.with_header(time_ms, "right_hand");
                    imu.f64s(&[0.0, 0.0, 0.0, 1.0]).f64s(&unknown);
                    let turning = three(3, std::f64::consts::PI / 180.0);
                    imu.f64s(&turning.unwrap_or_default());
                    imu.f64s(if turning.is_some() { &known } else { &unknown });
                    imu.f64s(&acceleration).f64s(&known);
                    entries.push(entry(Topic::Imu, imu));
                }
                if let Some(field) = three(6, 1e-6) {
                    let mut magnetic = self.with_header(time_ms, "right_hand");
                    magnetic.f64s(&field).f64s(&known);
                    entries.push(entry(Topic::Magnetic, magnetic));
                }
                entries
            }
        }
    }

    /// An event, on all topics that it is for.
    pub fn event(self, event: &SessionEvent) -> Vec<Entry> {
        let time_ms = describe::time_ms(event);
        let text = describe::text(event);
        let mut entries = Vec::new();
        let mut push =
            |topic, writer: &mut Writer| entries.push(Entry { topic, time_ms, data: writer.take() });
        let mut warning = false;
        if let SessionEvent::Bridge(bridge_event) = event {
            let BridgeEvent { kind, .. } = bridge_event;
            let json = serde_json::to_string(bridge_event).unwrap_or_default();
            push(Topic::Events, self.with_header(time_ms, "").u64(time_ms).string(&text).string(&json));
            if let Some(intent) = Intent::of(kind) {
                let mut writer = self.with_header(time_ms, "");
                writer.string(intent.hand).string(&intent.name).string(&intent.outcome);
                writer.f32(intent.confidence).u64(intent.age_ms).f64s(&intent.speed);
                push(Topic::Intents, &mut writer);
            }
            let stop = match kind {
                EventKind::Halt { reason } => Some((1, plain(reason))),
                EventKind::Released => Some((0, String::new())),
                _ => None,
            };
            if let Some((halted, reason)) = stop {
                push(Topic::Stops, self.with_header(time_ms, "").u8(halted).string(&reason));
            }
            warning = matches!(
                kind,
                EventKind::Halt { .. }
                    | EventKind::BoardFault { .. }
                    | EventKind::HandUnusable { .. }
                    | EventKind::MotionRefused { .. }
            );
        }
        let mut log = Writer::new();
        self.stamp(&mut log, time_ms);
        log.u8(if warning { 30 } else { 20 }).string("bimanual").string(&text).string("").string("").u32(0);
        push(Topic::Log, &mut log);
        entries
    }

    /// What the hands say.
    pub fn hands(self, now: &Now<'_>) -> Entry {
        let bridge = now.bridge;
        let left = bridge.left_state();
        let mut writer = self.with_header(now.time_ms, "");
        writer.string(&plain(&bridge.safety().state()));
        writer.f64(f64::from(left.pitch_mrad) / 1000.0).f64(f64::from(left.roll_mrad) / 1000.0);
        writer.string(describe::heading_name(left.heading.into())).u8(u8::from(left.stop));
        let labels = bridge.link(Hand::Right).model().map_or(&[][..], |model| &model.labels);
        writer.count(labels.len());
        for label in labels {
            writer.string(label);
        }
        writer.count(bridge.scores().len());
        for score in bridge.scores() {
            writer.f32(*score);
        }
        let caps = bridge.caps();
        writer.f64(caps.linear_m_s).f64(caps.angular_rad_s);
        Entry { topic: Topic::Hands, time_ms: now.time_ms, data: writer.take() }
    }

    /// What the base is asked for.
    pub fn twist(self, now: &Now<'_>) -> Entry {
        let twist = now.bridge.twist();
        let mut writer = self.with_header(now.time_ms, BASE);
        writer.f64s(&[twist.linear_m_s, 0.0, 0.0]).f64s(&[0.0, 0.0, twist.angular_rad_s]);
        Entry { topic: Topic::Twist, time_ms: now.time_ms, data: writer.take() }
    }

    /// Arm joints, then the wheels.
    pub fn joints(self, now: &Now<'_>) -> Entry {
        let (arm, model) = (now.robot.arm(), now.robot.arm_model());
        let joints = model.joints.len().min(arm.joints_rad.len());
        let mut writer = self.with_header(now.time_ms, "");
        writer.count(joints + 2);
        for joint in &model.joints[..joints] {
            writer.string(&joint.name);
        }
        writer.string("left_wheel").string("right_wheel");
        writer.count(joints + 2).f64s(&arm.joints_rad[..joints]).f64s(&now.robot.wheels_rad());
        writer.count(joints + 2).f64s(&arm.velocity_rad_s[..joints]).f64s(&now.robot.wheels_rad_s());
        writer.count(0);
        Entry { topic: Topic::Joints, time_ms: now.time_ms, data: writer.take() }
    }

    /// Where the base is, and how sure that is.
    pub fn odometry(self, now: &Now<'_>) -> Entry {
        let odometry = now.robot.odometry();
        let mut writer = self.with_header(now.time_ms, ODOM);
        writer.string(BASE);
        writer.f64s(&[odometry.x_m, odometry.y_m, 0.0]).f64s(&about_z(odometry.heading_rad));
        // Rows and columns: x, y, z and the turns about them; of ours, 0, 1 and 5.
        let mut covariance = [0.0; 36];
        let ours = [0, 1, 5];
        for (row, values) in now.robot.covariance().iter().enumerate() {
            for (column, value) in values.iter().enumerate() {
                covariance[6 * ours[row] + ours[column]] = *value;
            }
        }
        writer.f64s(&covariance);
        let twist = odometry.twist;
        writer.f64s(&[twist.linear_m_s, 0.0, 0.0, 0.0, 0.0, twist.angular_rad_s]).f64s(&[0.0; 36]);
        Entry { topic: Topic::Odometry, time_ms: now.time_ms, data: writer.take() }
    }

    /// Base in the world, foot on the base, links and flange on the foot.
    pub fn transforms(self, now: &Now<'_>) -> Entry {
        let (odometry, model) = (now.robot.odometry(), now.robot.arm_model());
        let links = model.link_poses(&now.robot.arm().joints_rad);
        let joints = model.joints.len().min(links.len() - 1);
        let mut writer = Writer::new();
        writer.count(3 + joints);
        let mut put = |parent: &str, child: &str, at_m: [f64; 3], turned_xyzw: [f64; 4]| {
            self.header(&mut writer, now.time_ms, parent);
            writer.string(child).f64s(&at_m).f64s(&turned_xyzw);
        };
        put(ODOM, BASE, [odometry.x_m, odometry.y_m, 0.0], about_z(odometry.heading_rad));
        put(BASE, ARM, now.robot.scene().base.mount_m, about_z(0.0));
        for (joint, pose) in model.joints.iter().zip(&links[..joints]) {
            put(ARM, &format!("{}_link", joint.name), pose.position_m, quaternion_xyzw(pose));
        }
        let flange = &links[links.len() - 1];
        put(ARM, "flange", flange.position_m, quaternion_xyzw(flange));
        Entry { topic: Topic::Transforms, time_ms: now.time_ms, data: writer.take() }
    }

    /// So many messages are missing.
    pub fn lost(self, time_ms: u64, messages: u64) -> Entry {
        Entry { topic: Topic::Lost, time_ms, data: self.with_header(time_ms, "").u64(messages).take() }
    }
}

/// An event that a hand asked for.
struct Intent {
    hand: &'static str,
    name: String,
    outcome: String,
    confidence: f32,
    age_ms: u64,
    /// Forward and turning, where it is about speed.
    speed: [f64; 2],
}

impl Intent {
    fn of(kind: &EventKind) -> Option<Self> {
        match kind {
            EventKind::Heading { heading, twist, age_ms, .. } => Some(Intent {
                hand: "left",
                name: describe::heading_name(*heading).to_owned(),
                outcome: "drive".to_owned(),
                confidence: 1.0,
                age_ms: *age_ms,
                speed: [twist.linear_m_s, twist.angular_rad_s],
            }),
            EventKind::Caps { cap, .. } => Some(Intent {
                hand: "left",
                name: "cap".to_owned(),
                outcome: "cap".to_owned(),
                confidence: 1.0,
                age_ms: 0,
                speed: [*cap, *cap],
            }),
            EventKind::Gesture { label, confidence, age_ms, outcome, .. } => Some(Intent {
                hand: "right",
                name: label.clone(),
                outcome: plain(outcome),
                confidence: *confidence,
                age_ms: *age_ms,
                speed: [0.0; 2],
            }),
            _ => None,
        }
    }
}

/// As in the JSON summary; texts without their quotes.
fn plain(value: &impl serde::Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(text)) => text,
        Ok(other) => other.to_string(),
        Err(_) => String::new(),
    }
}

fn about_z(angle_rad: f64) -> [f64; 4] {
    let (s, c) = (0.5 * angle_rad).sin_cos();
    [0.0, 0.0, s, c]
}

/// By the largest component, so that no division is by something small.
fn quaternion_xyzw(pose: &Pose) -> [f64; 4] {
    let r = &pose.rotation;
    let trace = r[0][0] + r[1][1] + r[2][2];
    // Four times the square of w, x, y, z.
    let squares =
        [1.0 + trace, 1.0 + 2.0 * r[0][0] - trace, 1.0 + 2.0 * r[1][1] - trace, 1.0 + 2.0 * r[2][2] - trace];
    let largest = (1..4).fold(0, |best, k| if squares[k] > squares[best] { k } else { best });
    let twice = squares[largest].max(0.0).sqrt();
    let share = 0.5 / twice;
    let (a, b, c) = (r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]);
    let (d, e, f) = (r[0][1] + r[1][0], r[0][2] + r[2][0], r[1][2] + r[2][1]);
    match largest {
        0 => [a * share, b * share, c * share, 0.5 * twice],
        1 => [0.5 * twice, d * share, e * share, a * share],
        2 => [d * share, 0.5 * twice, f * share, b * share],
        _ => [e * share, f * share, 0.5 * twice, c * share],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quaternions_turn_as_their_matrices_do() {
        let (s, c) = 0.7_f64.sin_cos();
        let turned = |rotation| quaternion_xyzw(&Pose { position_m: [0.0; 3], rotation });
        let half = 0.35_f64.sin_cos();
        for (rotation, expected) in [
            ([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.0, 0.0, 0.0, 1.0]),
            ([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], [0.0, 0.0, half.0, half.1]),
            ([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]], [half.0, 0.0, 0.0, half.1]),
            ([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]], [0.0, half.0, 0.0, half.1]),
            // Half a turn about each axis.
            ([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]], [1.0, 0.0, 0.0, 0.0]),
            ([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]], [0.0, 1.0, 0.0, 0.0]),
            ([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]], [0.0, 0.0, 1.0, 0.0]),
        ] {
            for (got, expected) in turned(rotation).iter().zip(expected) {
                assert!((got - expected).abs() < 1e-12, "{rotation:?}");
            }
        }
    }

    #[test]
    fn stamps_are_the_time_of_day() {
        let origin = Origin { nanoseconds: 1_700_000_000_900_000_000 };
        let entry = origin.operated(250, OperatorKey::Release);
        let mut reader = super::super::cdr::Reader::new(&entry.data).unwrap();
        assert_eq!((reader.i32(), reader.u32()), (Some(1_700_000_001), Some(150_000_000)));
        assert_eq!((reader.u64(), reader.u8()), (Some(250), Some(1)));
    }
}
