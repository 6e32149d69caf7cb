//! What goes into the safety machine and what comes out of it.

use serde::Serialize;
use shared_proto::message::Heading;

use super::{Hand, State};
use crate::tilt::Tilt;

/// A gesture that a state reported for the first time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gesture {
    /// Index in the model's labels.
    pub label: u8,
    /// How old the end of the window is now.
    pub age_ms: u64,
    /// This gesture ends a stop.
    pub releases: bool,
}

/// What happens to the machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// Only time passes. Must come at least every few milliseconds.
    Tick,
    /// A hand started: a hello with a boot id that is new on this link.
    Started(Hand),
    /// A hand is there but must not be acted on, since the versions differ. It counts as silent.
    Unusable(Hand),
    /// The hand answers no pings, so nobody knows how old its states are. It counts as silent.
    Unanswered(Hand),
    /// The left hand's state, newer than all before it.
    Left {
        /// Upper bound of the sample's age.
        age_ms: u64,
        /// The link's last round trip is fresh and short: neutral counts.
        prompt: bool,
        /// Whether no health flag forbids acting on it.
        healthy: bool,
        /// Where the hand points.
        heading: Heading,
        /// How far it is tilted.
        tilt: Tilt,
        /// Bends of the index finger since the last state.
        index_bends: u8,
        /// Bends of the middle finger since the last state.
        middle_bends: u8,
        /// Both fingers are held.
        stop: bool,
    },
    /// The right hand's state, newer than all before it.
    Right {
        /// Upper bound of the newest sample's age.
        age_ms: u64,
        /// The link's last round trip is fresh and short: rest counts.
        prompt: bool,
        /// Whether no health flag forbids acting on it.
        healthy: bool,
        /// A resting class has the highest score.
        resting: bool,
        /// The last gesture, if it is new.
        gesture: Option<Gesture>,
    },
    /// The robot itself refuses to move (its e-stop, a fault, clocks apart), or does not any more.
    Robot {
        /// It refuses.
        refuses: bool,
    },
    /// The clutch: the left hand is lent to the arm, or taken back. Only somebody armed can lend it.
    Clutch {
        /// It is lent.
        lends: bool,
    },
    /// The operator's stop: a key, a button.
    StopKey,
    /// The operator's release key, pressed and confirmed. Only counts if no right hand is connected.
    ReleaseKey,
}

/// Why the robot halts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum HaltReason {
    /// Both fingers held, or the stop key.
    OperatorStop,
    /// No valid state for 250 ms.
    Silence(Hand),
    /// No ping was answered for 500 ms.
    Unanswered(Hand),
    /// The hand says that it cannot be trusted.
    Unhealthy(Hand),
    /// The hand is new or has restarted.
    Restart(Hand),
    /// The robot itself refuses to move.
    RobotRefuses,
    /// The left hand is lent to the arm, or taken back.
    Clutch,
    /// The left hand moves the arm, and the right one does not rest.
    NotAtRest,
}

/// Why something that a hand did had no effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ignored {
    /// The state is older than 250 ms.
    LateState(Hand),
    /// The gesture's window ended more than 250 ms ago.
    LateGesture,
    /// A gesture while not armed.
    GestureWhileNotArmed,
    /// More bends in one state than fingers can make in that time.
    ImpossibleBends,
    /// Bends while not armed.
    BendsWhileNotArmed,
    /// The release key while a right hand is connected, or before 1 s of neutral.
    ReleaseKey,
}

/// What the bridge must do now, in order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Bring base and arm to rest.
    Halt(HaltReason),
    /// Both caps back to their start.
    ResetCaps,
    /// The state changed.
    Entered(State),
    /// The stop is over. That alone moves nothing.
    Released,
    /// The left hand is lent to the arm, or (false) taken back. That alone moves nothing.
    Lent(bool),
    /// These bends count.
    Bends {
        /// Of the index finger.
        index: u8,
        /// Of the middle finger.
        middle: u8,
    },
    /// This gesture counts.
    Gesture(Gesture),
    /// Something had no effect.
    Ignored(Ignored),
}
