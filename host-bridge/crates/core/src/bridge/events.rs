//! What happens on the bridge, for people and files.

use serde::Serialize;
use shared_proto::message::Heading;

use host_robot::{MotionName, Part, Twist};

use crate::link::{Identity, ModelSummary};
use crate::safety::{HaltReason, Hand, Ignored, State};

/// Something that happened, and when on the laptop's clock.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BridgeEvent {
    /// Laptop time.
    pub time_ms: u64,
    /// What.
    #[serde(flatten)]
    pub kind: EventKind,
}

/// What can happen.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum EventKind {
    /// A hand said hello for the first time since its start.
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
        /// Why, and what to do.
        problem: String,
    },
    /// The right hand named its model.
    Model {
        /// What it expects and names.
        model: ModelSummary,
        /// Labels that do nothing here.
        without_motion: Vec<String>,
    },
    /// A board reported a fault.
    BoardFault {
        /// Which hand.
        hand: Hand,
        /// What is wrong, as the board names it.
        fault: String,
    },
    /// The flags of a hand's health changed.
    HandHealth {
        /// Which.
        hand: Hand,
        /// Bits of `shared_proto::message::health`; 0 = well.
        flags: u8,
        /// What they mean, and what to do.
        reasons: Vec<&'static str>,
    },
    /// The safety machine changed its state.
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
    /// The left hand points elsewhere.
    Heading {
        /// Where.
        heading: Heading,
        /// Speed that follows.
        twist: Twist,
        /// Board clock at the sample.
        sample_board_ms: u32,
        /// Age of the sample.
        age_ms: u64,
    },
    /// Bends changed the caps.
    Caps {
        /// Bends of the index finger.
        index: u8,
        /// Bends of the middle finger.
        middle: u8,
        /// The new cap (m/s and rad/s alike).
        cap: f64,
    },
    /// The right hand performed a gesture.
    Gesture {
        /// Its name.
        label: String,
        /// 0 to 1.
        confidence: f32,
        /// Board clock at the end of the deciding window.
        window_end_board_ms: u32,
        /// Age of that window's end.
        age_ms: u64,
        /// What follows from it.
        outcome: GestureOutcome,
    },
    /// The robot shows that it acts on a command.
    Accepted {
        /// Which part of it.
        part: Part,
        /// Age of the sample that the command came from.
        age_ms: u64,
    },
    /// The right hand's score for a gesture rose, but not high or long enough for the board.
    Almost {
        /// The nearest gesture.
        label: String,
        /// Its best mean probability, 0 to 1.
        confidence: f32,
    },
    /// An arm motion ended.
    MotionEnded {
        /// Which.
        motion: MotionName,
        /// At its pose, not halted.
        reached: bool,
    },
    /// An arm motion was asked for, but there is no safe way to its pose; nothing moves.
    MotionRefused {
        /// Which.
        motion: MotionName,
        /// Why, and what to do.
        reason: String,
    },
    /// The guard does not let the base drive as asked.
    BaseHeld {
        /// What is in the way, or what is not known.
        reason: String,
    },
    /// The base drives as asked again.
    BaseFree,
    /// The robot itself refuses to move: its e-stop, a fault, clocks apart.
    RobotRefuses {
        /// Why, and what to do.
        reason: String,
    },
    /// It no longer refuses; the hands must be neutral first.
    RobotReady,
    /// A key ended the arm's motion alone.
    ArmEnded,
    /// The left hand is lent to the arm, or taken back.
    Jogging {
        /// It is lent.
        lent: bool,
    },
    /// This session may do less than others.
    Restricted {
        /// What, and why.
        text: String,
    },
    /// The robot has something to say.
    Robot {
        /// What.
        text: String,
    },
    /// Something had no effect.
    Ignored {
        /// What and why.
        what: Ignored,
    },
}

/// What follows from a gesture.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum GestureOutcome {
    /// This motion starts.
    Started(MotionName),
    /// The stop is released. That alone moves nothing.
    Released,
    /// Dropped: this motion still runs.
    Busy(MotionName),
    /// Dropped: no safe way leads to this motion's pose.
    Refused(MotionName),
    /// The arm's motion is ended, and that alone.
    EndedArm,
    /// The left hand is lent to the arm; both hands have to be neutral first.
    Lent,
    /// It is taken back; neutral first.
    TakenBack,
    /// The label has no motion.
    NoMotion,
    /// Dropped: its window ended too long ago.
    Late,
    /// Dropped: not armed.
    NotArmed,
}

/// What was dropped, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Drops {
    /// States older than 250 ms.
    pub late_states: u32,
    /// States with more bends than fingers can make.
    pub bends_impossible: u32,
    /// Gestures decided more than 250 ms ago.
    pub late_gestures: u32,
    /// Gestures while another motion ran.
    pub gestures_while_busy: u32,
    /// Gestures while not armed.
    pub gestures_while_not_armed: u32,
    /// Gestures whose motion was not safe.
    pub gestures_refused: u32,
    /// Gestures without a motion.
    pub gestures_without_motion: u32,
    /// Gestures whose label was lost with their frames.
    pub gestures_unnamed: u32,
    /// States with bends that came while not armed.
    pub bends_while_not_armed: u32,
}
