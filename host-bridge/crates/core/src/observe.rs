//! How a running session is watched: one tap, to which any number of observers are attached.
//!
//! ```text
//!             received, sent, sampled, operated, turned, happened, state
//! Engine ─► Tap ──────────────────────────────────────────────────────────► Observer …
//!                   in the order in which it happened
//! ```
//!
//! **To observe**, implement [`Observer`] (every method has an empty default) and hand it over before the
//! first step: `session.tap_mut().add(…)` or `live.tap_mut().add(…)`. What never changes (joints, links,
//! boxes, limits) is in [`Setting::of`]; what does is borrowed in [`Now`], and [`Snapshot::of`] makes an owned
//! copy of it that serialises. An observer puts what it finds where its owner can see it: a channel, a
//! shared cell.
//!
//! Observers run inside the session's own loop, and nothing waits for anybody: an observer must not block.
//! One that talks to the world hands over to a thread of its own through something bounded, and drops what
//! does not fit. Nothing comes back this way either: an observer cannot move or stop the robot.
//!
//! `tests/adding.rs` of host-bridge has an observer in eight lines.

use host_robot::shape::Capsule;
use host_robot::{
    ArmState, DMat3, DVec3, Door, JOINTS, Joints, Odometry, Pose, RobotSetting, SceneObject, Twist,
};
use serde::Serialize;

use crate::bridge::{Accepted, Bridge, BridgeEvent, Drops, Nearly, Prompt};
use crate::episodes::{Mark, MarkedBy, Told};
use crate::intent::{Caps, SpeedRules};
use crate::link::LinkCounters;
use crate::safety::{Hand, State};
use shared_words::Heading;

/// Watches a session. See the module for what an observer may do.
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

    /// The robot itself refuses to move from now on (or `None`: does not any more), just before the bridge acts.
    fn refused(&mut self, _time_ms: u64, _reason: Option<&str>) {}

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
    observers: Vec<Box<dyn Observer + Send>>,
}

impl Tap {
    /// Adds an observer, which is shown everything from now on.
    pub fn add(&mut self, observer: Box<dyn Observer + Send>) {
        self.observers.push(observer);
    }

    /// Drops all observers; those that hand things over do so now at the latest.
    pub fn clear(&mut self) {
        self.observers.clear();
    }

    /// Nobody looks.
    pub fn is_idle(&self) -> bool {
        self.observers.is_empty()
    }

    /// Shows something to all observers.
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
    /// A motion that was planned elsewhere is about to begin ([`Door::begin_planned`]).
    Planned,
    /// The robot is about to move on by this much ([`Door::step`]), in ms.
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
    /// End the arm's motion alone.
    EndArm,
    /// Begin to show gestures that are to be learnt.
    Show,
    /// That is over.
    Shown,
    /// Lend the left hand to the arm, or take it back.
    Clutch,
}

/// The state of a session, borrowed.
#[derive(Clone, Copy)]
pub struct Now<'a> {
    /// Time of the session (virtual where it is played).
    pub time_ms: u64,
    /// Links, hands, safety, caps.
    pub bridge: &'a Bridge,
    /// Base and arm, as the robot itself reports them.
    pub robot: &'a dyn Door,
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
    /// The speed that the base is asked for now; zero unless armed.
    pub twist_asked: Twist,
    /// Where the base is, from its wheels, and how fast.
    pub odometry: Odometry,
    /// Age of what the robot reports of its base; `None` = it reports nothing.
    pub base_age_ms: Option<u64>,
    /// Speeds of the left and the right wheel.
    pub wheels_rad_s: [f64; 2],
    /// How far each has turned since the start.
    pub wheels_rad: [f64; 2],
    /// Joint angles and speeds, and the motion under way.
    pub arm: ArmState,
    /// Age of what the robot reports of its arm; `None` = it reports nothing.
    pub arm_age_ms: Option<u64>,
    /// Where the arm should be by now, while it follows a trajectory.
    pub reference_rad: Option<Joints>,
    /// The flange in the arm's base frame.
    pub flange: Pose,
    /// How far the gripper's fingers are apart; `None` = there is none, or it does not say.
    pub opening_m: Option<f64>,
    /// Shapes of what is on the flange, in its frame.
    pub tool: Vec<Capsule>,
    /// Objects of the scene, where they are now.
    pub objects: Vec<SceneObject>,
    /// What holds the base back, if anything does.
    pub held: Option<String>,
    /// The left hand is lent to the arm: it moves the tool while armed, and the base stands still.
    pub jogging: bool,
    /// What keeps the tool from following it, if anything does.
    pub jog_held: Option<String>,
    /// Why the robot itself refuses to move, if it does: its e-stop, a fault, clocks apart.
    pub refusal: Option<String>,
    /// What this session may not do, and why.
    pub restriction: Option<String>,
    /// Ticks in which the guard braked for an obstacle.
    pub guard_stops: u32,
    /// How often the robot had to stop by itself.
    pub robot_timeouts: u32,
    /// What was dropped so far.
    pub drops: Drops,
    /// How old samples were once the robot acted on them.
    pub accepted: Accepted,
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
    /// How its frames were used.
    pub counters: LinkCounters,
    /// Battery of its board in millivolts, if it is known.
    pub battery_mv: Option<u16>,
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
    pub heading: Heading,
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
    /// What is nearly a gesture, or was a moment ago.
    pub nearly: Option<Nearly>,
    /// What its wearer is asked.
    pub prompt: Option<Prompt>,
}

impl Snapshot {
    /// Copies the state.
    pub fn of(now: &Now<'_>) -> Self {
        let Now { time_ms, bridge, robot } = *now;
        let (left, picture) = (bridge.left_state(), robot.picture());
        let link = |hand, health| LinkSnapshot {
            connected: bridge.safety().connected(hand),
            live: bridge.safety().live(hand),
            age_ms: bridge.safety().age_ms(hand, time_ms),
            round_trip_ms: bridge.link(hand).round_trip_ms(),
            counters: bridge.link(hand).counters(),
            battery_mv: bridge.link(hand).battery_mv(),
            health,
        };
        Snapshot {
            time_ms,
            safety: bridge.safety().state(),
            left: LeftSnapshot {
                link: link(Hand::Left, left.health),
                pitch_rad: f64::from(left.pitch_mrad) / 1000.0,
                roll_rad: f64::from(left.roll_mrad) / 1000.0,
                heading: left.heading,
                index_bends: left.index_bends,
                middle_bends: left.middle_bends,
                stop: left.stop,
            },
            right: RightSnapshot {
                link: link(Hand::Right, bridge.right_health()),
                labels: bridge.link(Hand::Right).model().map_or(Vec::new(), |model| model.labels.clone()),
                scores: bridge.scores().to_vec(),
                nearly: bridge.nearly(time_ms),
                prompt: bridge.prompt().cloned(),
            },
            caps: bridge.caps(),
            twist_asked: bridge.twist(),
            odometry: picture.odometry,
            base_age_ms: picture.base_age_ms,
            wheels_rad_s: picture.wheels_rad_s,
            wheels_rad: picture.wheels_rad,
            arm: picture.arm,
            arm_age_ms: picture.arm_age_ms,
            reference_rad: picture.reference_rad,
            flange: picture.flange,
            opening_m: picture.opening_m,
            tool: picture.tool,
            objects: picture.objects,
            held: picture.held,
            jogging: bridge.is_jogging(),
            jog_held: picture.jog_held,
            refusal: bridge.refusal().map(str::to_owned),
            restriction: bridge.restriction().map(str::to_owned),
            guard_stops: picture.guard_stops,
            robot_timeouts: picture.timeouts,
            drops: bridge.drops(),
            accepted: bridge.accepted(),
        }
    }
}

/// What does not change in a session: the robot, its limits, its surroundings, and the speed rules.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Setting {
    /// The robot and what stands around it.
    #[serde(flatten)]
    pub robot: RobotSetting,
    /// How the caps start and change.
    pub speed: SpeedRules,
}

impl Setting {
    /// The setting of a session.
    pub fn of(now: &Now<'_>) -> Self {
        Setting { robot: now.robot.setting(), speed: now.bridge.caps().rules }
    }
}

/// Something that happened in a session.
#[derive(Clone, Debug, PartialEq)]
pub enum SessionEvent {
    /// On the bridge.
    Bridge(BridgeEvent),
    /// A recording is over: its hand falls silent, and the dead-man halts the robot.
    RecordingEnded {
        /// Virtual time.
        time_ms: u64,
        /// Whose.
        hand: Hand,
    },
    /// The operator marked an episode.
    Marked {
        /// When.
        time_ms: u64,
        /// As what.
        mark: Mark,
        /// How.
        by: MarkedBy,
        /// What follows from it.
        told: Told,
    },
    /// The right hand's wearer is told something about the model.
    Wearer {
        /// When.
        time_ms: u64,
        /// What.
        text: String,
    },
    /// The operator's stop threw away the episode that was under way.
    EpisodeStopped {
        /// When.
        time_ms: u64,
        /// Which, from 1.
        number: usize,
    },
}

/// Frames of the arm's joints and its flange (last) in the world, for those who draw it or log transforms.
pub fn link_poses_in_world(now: &Now<'_>, joints_rad: &Joints) -> [Pose; JOINTS + 1] {
    let odometry = now.robot.picture().odometry;
    let base = Pose {
        position_m: DVec3::new(odometry.x_m, odometry.y_m, 0.0),
        rotation: DMat3::from_rotation_z(odometry.heading_rad),
    };
    let foot = base.then(now.robot.mount_m(), DMat3::IDENTITY);
    now.robot.link_poses(joints_rad).map(|link| foot.then(link.position_m, link.rotation))
}
