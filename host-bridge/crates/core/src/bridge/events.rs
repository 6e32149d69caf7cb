//! Events of the bridge for users and files.

use serde::Serialize;
use shared_proto::message::Heading;

use host_robot::{MotionName, Part, Twist};

use crate::link::{Identity, ModelSummary};
use crate::safety::{HaltReason, Hand, Ignored, State};

/// An event with its time on the laptop's clock.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BridgeEvent {
    /// Laptop time.
    pub time_ms: u64,
    /// What.
    #[serde(flatten)]
    pub kind: EventKind,
}

/// The kinds of events.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum EventKind {
    /// A hand sent its first hello after a start.
    HandStarted {
        /// Which.
        hand: Hand,
        /// Who.
        identity: Identity,
    },
    /// A board cannot be used.
    HandUnusable {
        /// Which.
        hand: Hand,
        /// The reason and a remedy.
        problem: String,
    },
    /// The right hand reported its model.
    Model {
        /// The requirements and labels of the model.
        model: ModelSummary,
        /// Labels for which this robot has no motion.
        without_motion: Vec<String>,
    },
    /// A board reported a fault.
    BoardFault {
        /// Which hand.
        hand: Hand,
        /// The problem, as the board reports it.
        fault: String,
    },
    /// A board said how a laptop pairs or has paired with it over Bluetooth.
    Pairing {
        /// Which hand.
        hand: Hand,
        /// What its owner should know.
        text: String,
    },
    /// The flags of a hand's health changed.
    HandHealth {
        /// Which.
        hand: Hand,
        /// Bits of `shared_proto::message::health`; 0 means no problem.
        flags: u8,
        /// The meaning of the flags, and remedies.
        reasons: Vec<&'static str>,
    },
    /// The state of the safety machine changed.
    State {
        /// The new state.
        state: State,
    },
    /// Base and arm were halted.
    Halt {
        /// Why.
        reason: HaltReason,
    },
    /// The operator's stop ended.
    Released,
    /// The heading of the hand that drives changed.
    Heading {
        /// The left hand, or in one-handed mode the right one.
        hand: Hand,
        /// Where.
        heading: Heading,
        /// The resulting speed of the base.
        twist: Twist,
        /// Time of the sample on the board's clock.
        sample_board_ms: u32,
        /// Age of the sample.
        age_ms: u64,
    },
    /// Bends of the fingers changed the caps.
    Caps {
        /// Bends of the index finger.
        index: u8,
        /// Bends of the middle finger.
        middle: u8,
        /// The new cap, whose value applies in m/s and in rad/s.
        cap: f64,
    },
    /// The right hand performed a gesture.
    Gesture {
        /// Its name.
        label: String,
        /// 0 to 1.
        confidence: f32,
        /// Time of the deciding window's end on the board's clock.
        window_end_board_ms: u32,
        /// Time since the end of that window.
        age_ms: u64,
        /// The effect of the gesture.
        outcome: GestureOutcome,
    },
    /// The robot reported that it acts on a command.
    Accepted {
        /// The part of the robot.
        part: Part,
        /// Age of the sample that caused the command.
        age_ms: u64,
    },
    /// The score of a gesture rose, but not far or long enough for the board to detect it.
    Almost {
        /// The nearest gesture.
        label: String,
        /// Highest mean probability of the gesture, 0 to 1.
        confidence: f32,
    },
    /// An arm motion ended.
    MotionEnded {
        /// Which.
        motion: MotionName,
        /// Whether the arm reached its pose without a halt.
        reached: bool,
    },
    /// A requested arm motion has no safe path to its pose, so the robot does not move.
    MotionRefused {
        /// Which.
        motion: MotionName,
        /// The reason and a remedy.
        reason: String,
    },
    /// The guard prevents the requested motion of the base.
    BaseHeld {
        /// The obstacle, or the missing information.
        reason: String,
    },
    /// The base follows its commands again.
    BaseFree,
    /// The robot itself refuses to move because of its e-stop, a fault, or clocks that differ.
    RobotRefuses {
        /// The reason and a remedy.
        reason: String,
    },
    /// The robot no longer refuses, but the hands must be neutral before it moves.
    RobotReady,
    /// A key ended only the arm's motion.
    ArmEnded,
    /// The hand that drives is lent to the arm, or returned to the base.
    Jogging {
        /// The left hand, or in one-handed mode the right one.
        hand: Hand,
        /// It is lent.
        lent: bool,
    },
    /// This session has fewer rights than others.
    Restricted {
        /// What, and why.
        text: String,
    },
    /// A message from the robot.
    Robot {
        /// What.
        text: String,
    },
    /// An input had no effect.
    Ignored {
        /// What and why.
        what: Ignored,
    },
}

/// The effect of a gesture.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum GestureOutcome {
    /// This motion starts.
    Started(MotionName),
    /// The stop is released. The release itself starts no motion.
    Released,
    /// The gesture was dropped, because this motion is still running.
    Busy(MotionName),
    /// The gesture was dropped, because there is no safe path to this motion's pose.
    Refused(MotionName),
    /// Only the arm's motion is ended.
    EndedArm,
    /// The hand that drives is lent to the arm; all hands must be neutral before the arm moves.
    Lent,
    /// The hand is returned to the base; all hands must be neutral first.
    TakenBack,
    /// The label has no motion.
    NoMotion,
    /// The gesture was dropped, because its window ended too long ago.
    Late,
    /// Dropped: not armed.
    NotArmed,
}

/// Numbers of dropped inputs, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Drops {
    /// States older than 250 ms.
    pub late_states: u32,
    /// States with more bends than fingers can make in their time span.
    pub bends_impossible: u32,
    /// Gestures that were decided more than 250 ms ago.
    pub late_gestures: u32,
    /// Gestures that arrived while another motion was running.
    pub gestures_while_busy: u32,
    /// Gestures that arrived while not armed.
    pub gestures_while_not_armed: u32,
    /// Gestures for which no safe motion exists.
    pub gestures_refused: u32,
    /// Gestures that are mapped to no motion.
    pub gestures_without_motion: u32,
    /// Gestures whose label is unknown because their frames were lost.
    pub gestures_unnamed: u32,
    /// States with bends that arrived while not armed.
    pub bends_while_not_armed: u32,
}
