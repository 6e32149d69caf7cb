//! Where a running session shows itself: one tap that any number of observers hang on.
//!
//! ```text
//! Session (demo, replay) ─┐          received, sent, sampled, operated, turned, happened, state
//!                         ├─► Tap ──────────────────────────────────────────────────────► Observer …
//! Live (run) ─────────────┘                  in the order in which it happened
//! ```
//!
//! **To observe**, implement [`Observer`] (every method has an empty default) and hand it over before the
//! first step: `session.tap_mut().add(…)` or `live.tap_mut().add(…)`. What never changes (joints, links,
//! boxes, limits) is in [`Setting::of`]; what does is borrowed in [`Now`], and [`Snapshot::of`] makes an owned
//! copy of it that serialises. Whatever an observer finds out it puts where its owner can see it: a channel, a
//! shared cell.
//!
//! Observers run inside the session's own loop, and nothing waits for anybody: an observer must not block.
//! One that talks to the world hands over to a thread of its own through something bounded, and drops what
//! does not fit. Nothing comes back this way either: an observer cannot move or stop the robot.
//!
//! ```
//! use std::{cell::Cell, rc::Rc};
//! use host_bridge::{config::{Config, Place}, live::Live, keyboard::HandKey};
//! use host_bridge::{observe::{Now, Observer}, robot::Robot as _};
//! use shared_proto::message::Heading;
//!
//! struct Fastest(Rc<Cell<f64>>);
//! impl Observer for Fastest {
//!     fn state(&mut self, now: &Now<'_>) {
//!         self.0.set(self.0.get().max(now.robot.odometry().twist.linear_m_s));
//!     }
//! }
//!
//! let fastest = Rc::new(Cell::new(0.0));
//! let mut live = Live::new(&Config::default(), Place::Keyboard, Place::Nobody, 0);
//! live.tap_mut().add(Box::new(Fastest(fastest.clone())));
//! for now_ms in 1..2000 {
//!     if now_ms == 1000 {
//!         live.press(HandKey::Arrow(Heading::Forward), now_ms);
//!     }
//!     live.step(now_ms, [true; 2]);
//! }
//! assert!(fastest.get() > 0.4);
//! ```

use serde::Serialize;

use crate::arm::gen3::JOINTS;
use crate::arm::model::SerialArm;
use crate::arm::profile::JointLimits;
use crate::arm::sequencer::ArmState;
use crate::arm::{Joints, Pose};
use crate::base::{BaseConfig, Odometry, Twist};
use crate::bridge::{Bridge, Drops, HeadingName};
use crate::intent::{Caps, SpeedRules};
use crate::link::LinkCounters;
use crate::plan::shape::{Capsule, Point, UprightBox};
use crate::robot::Robot as _;
use crate::safety::{Hand, State};
use crate::session::SessionEvent;
use crate::sim::Simulator;

/// Looks on. See the module for what an observer may do.
pub trait Observer {
    /// Bytes of a hand's board, just before the bridge handles them, sliced as they came.
    fn received(&mut self, _time_ms: u64, _hand: Hand, _bytes: &[u8]) {}

    /// A frame on its way to a hand's board.
    fn sent(&mut self, _time_ms: u64, _hand: Hand, _frame: &[u8]) {}

    /// A reading of a hand's sensors, as its board has it. Only played recordings show theirs: a real board
    /// keeps its readings and sends what it makes of them.
    fn sampled(&mut self, _time_ms: u64, _sample: &Sample<'_>) {}

    /// The operator pressed a key (or a button) of the bridge, just before it acts.
    fn operated(&mut self, _time_ms: u64, _key: OperatorKey) {}

    /// The session goes on, between what comes in: with this, the bytes and the keys, anybody can do all of it
    /// again, in the same order.
    fn turned(&mut self, _turn: Turn) {}

    /// Something happened.
    fn happened(&mut self, _event: &SessionEvent) {}

    /// How things stand after a step: each millisecond of a played session, each turn of a live one.
    fn state(&mut self, _now: &Now<'_>) {}
}

/// Observers of one session.
#[derive(Default)]
pub struct Tap {
    observers: Vec<Box<dyn Observer>>,
}

impl Tap {
    /// One more observer, shown everything from now on.
    pub fn add(&mut self, observer: Box<dyn Observer>) {
        self.observers.push(observer);
    }

    /// Lets all observers go; those that hand things over do so now at the latest.
    pub fn clear(&mut self) {
        self.observers.clear();
    }

    /// Nobody looks.
    pub fn is_idle(&self) -> bool {
        self.observers.is_empty()
    }

    /// Shows something to all.
    pub(crate) fn show(&mut self, show: impl Fn(&mut dyn Observer)) {
        for observer in &mut self.observers {
            show(observer.as_mut());
        }
    }
}

/// How a session goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// The bridge is about to let this time come ([`Bridge::step`]), in ms.
    Decided(u64),
    /// The robot is about to move on by so much ([`Simulator::step`]), in ms.
    Moved(u64),
}

/// One reading of a hand's sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sample<'a> {
    /// The left hand's converter.
    Left {
        /// 10-bit conversions: x, y, z, index, middle.
        counts: [u16; 5],
        /// Index and middle finger: 0 = straight, 1000 = bent as far as in the calibration.
        bends_permille: [i16; 2],
    },
    /// The right hand's IMU, brought to 100 Hz.
    Right {
        /// Accelerometer in m/s², then (6 values) gyroscope in deg/s, then (9) magnetometer in µT.
        values: &'a [f32],
    },
}

/// What an operator can press.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum OperatorKey {
    /// Stop the robot.
    Stop,
    /// Release the stop (pressed and confirmed).
    Release,
}

/// The state of a session, borrowed.
#[derive(Clone, Copy)]
pub struct Now<'a> {
    /// Time of the session (virtual where it is played).
    pub time_ms: u64,
    /// Links, hands, safety, caps.
    pub bridge: &'a Bridge,
    /// Base and arm.
    pub robot: &'a Simulator,
}

/// The state of a session, owned: everything that changes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Snapshot {
    /// Time of the session (virtual where it is played).
    pub time_ms: u64,
    /// What the safety machine lets through; `stopped` until the operator's stop is released.
    pub safety: State,
    /// Base and tilt.
    pub left: LeftSnapshot,
    /// Gestures.
    pub right: RightSnapshot,
    /// Caps on the base's speed.
    pub caps: Caps,
    /// What the base is asked for now; zero unless armed.
    pub twist_asked: Twist,
    /// Where the base is, from its wheels, and how fast.
    pub odometry: Odometry,
    /// Speeds of the left and the right wheel.
    pub wheels_rad_s: [f64; 2],
    /// How far each has turned since the start.
    pub wheels_rad: [f64; 2],
    /// Joint angles and speeds, and the motion under way.
    pub arm: ArmState,
    /// The flange in the arm's base frame.
    pub flange: Pose,
    /// Ticks in which something braked for what was in the way.
    pub guard_stops: u32,
    /// How often the robot had to stop by itself.
    pub robot_timeouts: u32,
    /// What was dropped so far.
    pub drops: Drops,
}

/// One hand's link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LinkSnapshot {
    /// The hand has said hello.
    pub connected: bool,
    /// Connected, fresh and fit to act on.
    pub live: bool,
    /// Age of its newest valid sample.
    pub age_ms: Option<u64>,
    /// How long the newest answered ping took, there and back.
    pub round_trip_ms: Option<u64>,
    /// What became of its frames.
    pub counters: LinkCounters,
    /// Bits of [`shared_proto::message::health`] in its newest state.
    pub health: u8,
}

/// What the left hand says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LeftSnapshot {
    /// Its link.
    pub link: LinkSnapshot,
    /// Tilt about the lateral axis, positive = forward.
    pub pitch_rad: f64,
    /// Tilt about the forward axis, positive = left.
    pub roll_rad: f64,
    /// What the tilt means, whether or not it acts.
    pub heading: HeadingName,
    /// Bends of the index finger since the board's start, wrapping.
    pub index_bends: u8,
    /// Bends of the middle finger since the board's start, wrapping.
    pub middle_bends: u8,
    /// Both fingers are held.
    pub stop: bool,
}

/// What the right hand says.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RightSnapshot {
    /// Its link.
    pub link: LinkSnapshot,
    /// Names of its model's outputs.
    pub labels: Vec<String>,
    /// Newest probability of each, 0 to 1; empty before the first window is full.
    pub scores: Vec<f32>,
}

impl Snapshot {
    /// Copies the state.
    pub fn of(now: &Now<'_>) -> Self {
        let Now { time_ms, bridge, robot } = *now;
        let (left, arm) = (bridge.left_state(), robot.arm());
        let link = |hand, health| LinkSnapshot {
            connected: bridge.safety().connected(hand),
            live: bridge.safety().live(hand),
            age_ms: bridge.safety().age_ms(hand, time_ms),
            round_trip_ms: bridge.link(hand).round_trip_ms(),
            counters: bridge.link(hand).counters(),
            health,
        };
        Snapshot {
            time_ms,
            safety: bridge.safety().state(),
            left: LeftSnapshot {
                link: link(Hand::Left, left.health),
                pitch_rad: f64::from(left.pitch_mrad) / 1000.0,
                roll_rad: f64::from(left.roll_mrad) / 1000.0,
                heading: left.heading.into(),
                index_bends: left.index_bends,
                middle_bends: left.middle_bends,
                stop: left.stop,
            },
            right: RightSnapshot {
                link: link(Hand::Right, bridge.right_health()),
                labels: bridge.link(Hand::Right).model().map_or(Vec::new(), |model| model.labels.clone()),
                scores: bridge.scores().to_vec(),
            },
            caps: bridge.caps(),
            twist_asked: bridge.twist(),
            odometry: robot.odometry(),
            wheels_rad_s: robot.wheels_rad_s(),
            wheels_rad: robot.wheels_rad(),
            flange: robot.arm_model().flange_pose(&arm.joints_rad),
            arm,
            guard_stops: robot.guard_stops(),
            robot_timeouts: robot.timeouts(),
            drops: bridge.drops(),
        }
    }
}

/// What does not change in a session: the robot, its limits, its surroundings. Frames: the world is where the
/// base started, x forward, y left, z up from the floor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Setting {
    /// The scene's title; empty where there is none.
    pub scene: String,
    /// What stands around.
    pub boxes: Vec<SceneBox>,
    /// Wheels and limits of the base.
    pub base: BaseConfig,
    /// The base's body, as seen from the point on the floor between its wheels.
    pub body: UprightBox,
    /// The arm's foot, as seen from the same point.
    pub mount_m: Point,
    /// Of the arm.
    pub arm_name: String,
    /// From the foot on.
    pub joints: Vec<JointSetting>,
    /// The flange in the last joint's frame.
    pub flange_m: Point,
    /// How the flange is turned against the last joint.
    pub flange_rotation: [[f64; 3]; 3],
    /// Shapes of the arm's foot, in the arm's base frame.
    pub foot: Vec<Capsule>,
    /// How the caps start and change.
    pub speed: SpeedRules,
}

/// A box of the scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SceneBox {
    /// From the scene file.
    pub name: String,
    /// Where.
    #[serde(flatten)]
    pub shape: UprightBox,
}

/// One joint and the link that it turns: frames as in [`crate::arm::model::ArmJoint`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointSetting {
    /// As in the robot's own description.
    pub name: String,
    /// Where the joint sits in its parent's frame.
    pub origin_m: Point,
    /// How its frame is turned against its parent's.
    pub origin_rotation: [[f64; 3]; 3],
    /// Axis in its own frame.
    pub axis: Point,
    /// Least and greatest angle; `None` = turns without end.
    pub limit_rad: Option<(f64, f64)>,
    /// Fastest turn that motions use.
    pub velocity_max_rad_s: f64,
    /// Largest acceleration that motions use.
    pub acceleration_max_rad_s2: f64,
    /// The link, in the joint's frame.
    pub shapes: Vec<Capsule>,
}

impl Setting {
    /// The setting of a session.
    pub fn of(now: &Now<'_>) -> Self {
        let (arm, scene) = (now.robot.arm_model(), now.robot.scene());
        let shape = |b: &crate::scene::NamedBox| UprightBox {
            center_m: b.center_m,
            half_m: b.size_m.map(|size| 0.5 * size),
            yaw_rad: b.yaw_rad,
        };
        Setting {
            scene: scene.title.clone(),
            boxes: scene.boxes.iter().map(|b| SceneBox { name: b.name.clone(), shape: shape(b) }).collect(),
            base: *now.robot.base_config(),
            body: scene.base.body(),
            mount_m: scene.base.mount_m,
            arm_name: arm.name.clone(),
            joints: joints(arm, now.robot.arm_limits()),
            flange_m: arm.flange_m,
            flange_rotation: arm.flange_rotation,
            foot: arm.foot.clone(),
            speed: now.bridge.caps().rules,
        }
    }
}

fn joints(arm: &SerialArm, limits: &JointLimits) -> Vec<JointSetting> {
    let setting = |i: usize| {
        let joint = &arm.joints[i];
        JointSetting {
            name: joint.name.clone(),
            origin_m: joint.origin_m,
            origin_rotation: joint.origin_rotation,
            axis: joint.axis,
            limit_rad: joint.limit_rad,
            velocity_max_rad_s: limits.velocity_rad_s[i],
            acceleration_max_rad_s2: limits.acceleration_rad_s2[i],
            shapes: joint.shapes.clone(),
        }
    };
    (0..arm.joints.len().min(JOINTS)).map(setting).collect()
}

/// Frames of the arm's joints and its flange (last) in the world, for those who draw it or log transforms.
pub fn link_poses_in_world(now: &Now<'_>, joints_rad: &Joints) -> [Pose; JOINTS + 1] {
    let odometry = now.robot.odometry();
    let (s, c) = odometry.heading_rad.sin_cos();
    let base = Pose {
        position_m: [odometry.x_m, odometry.y_m, 0.0],
        rotation: [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]],
    };
    let foot = base.then(now.robot.scene().base.mount_m, Pose::IDENTITY.rotation);
    now.robot.arm_model().link_poses(joints_rad).map(|link| foot.then(link.position_m, link.rotation))
}
