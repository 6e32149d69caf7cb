//! Observation of a running session: any number of observers are attached to one tap.
//!
//! ```text
//!             received, sent, sampled, operated, turned, happened, state
//! Engine ─► Tap ──────────────────────────────────────────────────────────► Observer …
//! in the order of occurrence
//! ```
//!
//! **To observe** a session, implement [`Observer`], whose methods have empty defaults.
//! Attach it before the first step with `session.tap_mut().add(…)` or `live.tap_mut().add(…)`.
//! [`Setting::of`] contains constant data such as joints, links, boxes and limits.
//! Changing data is borrowed in [`Now`], and [`Snapshot::of`] creates an owned copy that can be serialised.
//! An observer passes results to its owner, for example through a channel or a shared cell.
//!
//! Observers run inside the session's loop, so they must not block.
//! An observer with slow outputs passes data through a bounded channel to a separate thread.
//! The observer drops data that does not fit.
//! Observers return nothing, so they cannot move or stop the robot.
//!
//! `tests/adding.rs` of host-bridge contains an observer of eight lines.

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

/// Observes a session. The module documentation lists the rules.
pub trait Observer {
    /// Called with bytes from a hand's board, in the portions in which they arrive.
    /// The call comes just before the bridge processes the bytes.
    fn received(&mut self, _time_ms: u64, _hand: Hand, _bytes: &[u8]) {}

    /// Called with a frame that is sent to a hand's board.
    fn sent(&mut self, _time_ms: u64, _hand: Hand, _frame: &[u8]) {}

    /// Called with a sample of a hand's sensors.
    /// Only played recordings provide samples, because real boards do not send them.
    fn sampled(&mut self, _time_ms: u64, _sample: &Sample<'_>) {}

    /// Called just before the bridge processes an operator's key or button.
    fn operated(&mut self, _time_ms: u64, _key: OperatorKey) {}

    /// Called just before the bridge learns that the robot refuses to move.
    /// When the refusal ends, the reason is `None`.
    fn refused(&mut self, _time_ms: u64, _reason: Option<&str>) {}

    /// Called when the session advances between inputs.
    /// Together with the bytes and keys, these calls are sufficient to replay the session in the same order.
    fn turned(&mut self, _turn: Turn) {}

    /// Called for each event of the session.
    fn happened(&mut self, _event: &SessionEvent) {}

    /// Called with the state after each step.
    /// The steps are every millisecond in a played session, and every turn in a live session.
    fn state(&mut self, _now: &Now<'_>) {}
}

/// The observers of one session.
#[derive(Default)]
pub struct Tap {
    observers: Vec<Box<dyn Observer + Send>>,
}

impl Tap {
    /// Adds an observer, which receives everything from now on.
    pub fn add(&mut self, observer: Box<dyn Observer + Send>) {
        self.observers.push(observer);
    }

    /// Removes all observers. They must pass on any remaining data now.
    pub fn clear(&mut self) {
        self.observers.clear();
    }

    /// Returns whether there are no observers.
    pub fn is_idle(&self) -> bool {
        self.observers.is_empty()
    }

    /// Calls all observers.
    pub(crate) fn show(&mut self, show: impl Fn(&mut dyn Observer)) {
        for observer in &mut self.observers {
            show(observer.as_mut());
        }
    }
}

/// A step of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// The bridge is about to advance to this time ([`Bridge::step`]), in ms.
    Decided(u64),
    /// A motion that was planned elsewhere is about to begin ([`Door::begin_planned`]).
    Planned,
    /// The robot is about to move on by this much ([`Door::step`]), in ms.
    Moved(u64),
}

/// One sample of a hand's sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sample<'a> {
    /// The left hand's converter.
    Left {
        /// 10-bit conversions: x, y, z, index, middle.
        counts: [u16; 5],
        /// Bends of index and middle finger: 0 = straight, 1000 = bent as in the calibration.
        bends_permille: [i16; 2],
    },
    /// A sample of the right hand's IMU, converted to 100 Hz.
    Right {
        /// Accelerometer in m/s²; with 6 values, also gyroscope in deg/s;
        /// with 9 values, also magnetometer in µT.
        values: &'a [f32],
    },
}

/// The operator's keys and buttons.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum OperatorKey {
    /// The operator stops the robot.
    Stop,
    /// The operator releases the stop (pressed and confirmed).
    Release,
    /// The operator ends only the arm's motion.
    EndArm,
    /// The operator begins to show gestures that are to be learnt.
    Show,
    /// That is over.
    Shown,
    /// The operator switches the left hand to the arm, or back to the base.
    Clutch,
}

/// The state of a session, borrowed.
#[derive(Clone, Copy)]
pub struct Now<'a> {
    /// Time of the session. In a played session, it is virtual.
    pub time_ms: u64,
    /// State of the links, hands, safety machine and caps.
    pub bridge: &'a Bridge,
    /// Base and arm, as reported by the robot.
    pub robot: &'a dyn Door,
}

/// An owned copy of a session's changing state.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Snapshot {
    /// Time of the session. In a played session, it is virtual.
    pub time_ms: u64,
    /// State of the safety machine; `stopped` until the operator's stop is released.
    pub safety: State,
    /// Whether the right hand drives the base, because there is no left hand.
    /// The tilt is then that of the right hand.
    pub one_handed: bool,
    /// Base and tilt.
    pub left: LeftSnapshot,
    /// Gestures.
    pub right: RightSnapshot,
    /// Caps on the base's speed.
    pub caps: Caps,
    /// The commanded speed of the base; zero unless armed.
    pub twist_asked: Twist,
    /// Position and speed of the base, derived from its wheels.
    pub odometry: Odometry,
    /// Age of the base's report; `None` if there is none.
    pub base_age_ms: Option<u64>,
    /// Speeds of the left and the right wheel.
    pub wheels_rad_s: [f64; 2],
    /// Total rotation of each wheel since the start.
    pub wheels_rad: [f64; 2],
    /// Joint angles and speeds, and the current motion.
    pub arm: ArmState,
    /// Age of the arm's report; `None` if there is none.
    pub arm_age_ms: Option<u64>,
    /// Current target of the arm while it follows a trajectory.
    pub reference_rad: Option<Joints>,
    /// Pose of the flange in the arm's base frame.
    pub flange: Pose,
    /// Distance between the gripper's fingers; `None` without a gripper or a report.
    pub opening_m: Option<f64>,
    /// Shapes of the tool in the flange's frame.
    pub tool: Vec<Capsule>,
    /// Objects of the scene at their current positions.
    pub objects: Vec<SceneObject>,
    /// The reason why the guard has stopped the base, or `None`.
    pub held: Option<String>,
    /// Whether the hand that drives is lent to the arm.
    /// The hand then moves the tool while armed, and the base stands still.
    pub jogging: bool,
    /// The reason why the tool does not follow the hand, or `None`.
    pub jog_held: Option<String>,
    /// The reason why the robot itself refuses to move, or `None` if it does not refuse.
    /// The cause may be its e-stop, a fault, or clocks that differ.
    pub refusal: Option<String>,
    /// The restriction of this session and its reason.
    pub restriction: Option<String>,
    /// Number of ticks in which the guard braked for an obstacle.
    pub guard_stops: u32,
    /// Number of times the robot had to stop by itself.
    pub robot_timeouts: u32,
    /// Numbers of dropped inputs so far.
    pub drops: Drops,
    /// Ages of samples when the robot reported their effect.
    pub accepted: Accepted,
}

/// The state of one hand's link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LinkSnapshot {
    /// Whether the hand has sent a hello.
    pub connected: bool,
    /// Whether the hand is connected, recent and healthy.
    pub live: bool,
    /// Age of the hand's newest valid sample.
    pub age_ms: Option<u64>,
    /// Round-trip time of the newest answered ping.
    pub round_trip_ms: Option<u64>,
    /// Statistics of the frames on the hand's link.
    pub counters: LinkCounters,
    /// Battery voltage of the board in millivolts, if known.
    pub battery_mv: Option<u16>,
    /// Bits of [`shared_proto::message::health`] in the hand's newest state.
    pub health: u8,
}

/// The state of the left hand.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LeftSnapshot {
    /// Its link.
    pub link: LinkSnapshot,
    /// Tilt about the lateral axis; positive means forward.
    pub pitch_rad: f64,
    /// Tilt about the forward axis; positive means to the left.
    pub roll_rad: f64,
    /// The meaning of the tilt, even if it has no effect.
    pub heading: Heading,
    /// Bends of the index finger since the board's start, wrapping.
    pub index_bends: u8,
    /// Bends of the middle finger since the board's start, wrapping.
    pub middle_bends: u8,
    /// Whether both fingers are held.
    pub stop: bool,
}

/// The state of the right hand.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RightSnapshot {
    /// Its link.
    pub link: LinkSnapshot,
    /// Names of the model's outputs.
    pub labels: Vec<String>,
    /// Newest probability of each label, 0 to 1; empty until the first window is full.
    pub scores: Vec<f32>,
    /// The gesture that is nearly recognised, or was nearly recognised a moment ago.
    pub nearly: Option<Nearly>,
    /// The current request to the hand's wearer.
    pub prompt: Option<Prompt>,
}

impl Snapshot {
    /// Copies the state.
    pub fn of(now: &Now<'_>) -> Self {
        let Now { time_ms, bridge, robot } = *now;
        let (left, picture) = (bridge.left_state(), robot.picture());
        let hand_is_there = |hand| hand == Hand::Right || !bridge.is_one_handed();
        let link = |hand, health| LinkSnapshot {
            // In one-handed mode, the safety machine's left hand is the right one.
            connected: bridge.safety().connected(hand) && hand_is_there(hand),
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
            one_handed: bridge.is_one_handed(),
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

/// The constant data of a session: the robot, its limits, its surroundings, and the rules for the caps.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Setting {
    /// The robot and its surroundings.
    #[serde(flatten)]
    pub robot: RobotSetting,
    /// Initial value of the caps and their changes.
    pub speed: SpeedRules,
}

impl Setting {
    /// The setting of a session.
    pub fn of(now: &Now<'_>) -> Self {
        Setting { robot: now.robot.setting(), speed: now.bridge.caps().rules }
    }
}

/// An event of a session.
#[derive(Clone, Debug, PartialEq)]
pub enum SessionEvent {
    /// On the bridge.
    Bridge(BridgeEvent),
    /// A recording has ended. Its hand is silent from now on, and the dead-man halts the robot.
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
        /// The effect of the mark.
        told: Told,
    },
    /// A message about the model for the right hand's wearer.
    Wearer {
        /// When.
        time_ms: u64,
        /// What.
        text: String,
    },
    /// The operator's stop discarded the current episode.
    EpisodeStopped {
        /// When.
        time_ms: u64,
        /// Number of the episode, from 1.
        number: usize,
    },
}

/// Frames of the arm's joints and its flange (last) in the world, for drawing and for transforms.
pub fn link_poses_in_world(now: &Now<'_>, joints_rad: &Joints) -> [Pose; JOINTS + 1] {
    let odometry = now.robot.picture().odometry;
    let base = Pose {
        position_m: DVec3::new(odometry.x_m, odometry.y_m, 0.0),
        rotation: DMat3::from_rotation_z(odometry.heading_rad),
    };
    let foot = base.then(now.robot.mount_m(), DMat3::IDENTITY);
    now.robot.link_poses(joints_rad).map(|link| foot.then(link.position_m, link.rotation))
}
