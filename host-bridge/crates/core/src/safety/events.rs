//! Inputs and outputs of the safety machine.

use serde::Serialize;
use shared_proto::message::Heading;

use super::{Hand, State};
use crate::tilt::Tilt;

/// A gesture that a state reports for the first time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gesture {
    /// Index in the model's labels.
    pub label: u8,
    /// Time since the end of the gesture's window.
    pub age_ms: u64,
    /// This gesture ends a stop.
    pub releases: bool,
}

/// Inputs of the safety machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// Advances the time. This event is required at least every few milliseconds.
    Tick,
    /// A hand started: its hello had a boot id that is new on this link.
    Started(Hand),
    /// A hand cannot be used because its version differs. The hand counts as silent.
    Unusable(Hand),
    /// The hand answers no pings, so the age of its states is unknown. The hand counts as silent.
    Unanswered(Hand),
    /// A left-hand state that is newer than all earlier ones.
    Left {
        /// Upper bound of the sample's age.
        age_ms: u64,
        /// Whether the link's last round trip is recent and short. Only then does neutral count.
        prompt: bool,
        /// Whether the health flags permit use of this state.
        healthy: bool,
        /// The heading of the hand.
        heading: Heading,
        /// The tilt of the hand.
        tilt: Tilt,
        /// Bends of the index finger since the last state.
        index_bends: u8,
        /// Bends of the middle finger since the last state.
        middle_bends: u8,
        /// Both fingers are held.
        stop: bool,
    },
    /// A right-hand state that is newer than all earlier ones.
    Right {
        /// Upper bound of the newest sample's age.
        age_ms: u64,
        /// Whether the link's last round trip is recent and short. Only then does rest count.
        prompt: bool,
        /// Whether the health flags permit use of this state.
        healthy: bool,
        /// Whether a rest label has the highest score.
        resting: bool,
        /// The last gesture, if it is new.
        gesture: Option<Gesture>,
    },
    /// The robot itself begins to refuse motion, or no longer refuses it.
    /// The cause may be its e-stop, a fault, or clocks that differ.
    Robot {
        /// It refuses.
        refuses: bool,
    },
    /// The clutch switches the left hand to the arm, or back to the base.
    /// Lending requires the armed state.
    Clutch {
        /// It is lent.
        lends: bool,
    },
    /// The operator's stop, by a key or a button.
    StopKey,
    /// The operator pressed and confirmed the release key. The key counts only if no right hand is connected.
    ReleaseKey,
}

/// The reason why the robot halts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum HaltReason {
    /// Both fingers were held, or the stop key was pressed.
    OperatorStop,
    /// There was no valid state for 250 ms.
    Silence(Hand),
    /// No ping was answered for 500 ms.
    Unanswered(Hand),
    /// The hand reports that its states cannot be trusted.
    Unhealthy(Hand),
    /// The hand is new or has restarted.
    Restart(Hand),
    /// The robot itself refuses to move.
    RobotRefuses,
    /// The left hand has been lent to the arm, or returned to the base.
    Clutch,
    /// The left hand moves the arm, but the right hand does not rest.
    NotAtRest,
}

/// The reason why an input of a hand had no effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ignored {
    /// The state is older than 250 ms.
    LateState(Hand),
    /// The gesture's window ended more than 250 ms ago.
    LateGesture,
    /// The gesture arrived while not armed.
    GestureWhileNotArmed,
    /// One state contains more bends than fingers can make in that time.
    ImpossibleBends,
    /// The bends arrived while not armed.
    BendsWhileNotArmed,
    /// The release key was pressed while a right hand was connected, or before 1 s of neutral.
    ReleaseKey,
}

/// Actions of the bridge, in order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Bring base and arm to rest within their limits.
    Halt(HaltReason),
    /// Reset both caps to their initial value.
    ResetCaps,
    /// The state changed.
    Entered(State),
    /// The stop is over. The release alone starts no motion.
    Released,
    /// The left hand is lent to the arm, or (false) returned to the base. The change alone starts no motion.
    Lent(bool),
    /// These bends count.
    Bends {
        /// Number of bends of the index finger.
        index: u8,
        /// Number of bends of the middle finger.
        middle: u8,
    },
    /// This gesture counts.
    Gesture(Gesture),
    /// Something had no effect.
    Ignored(Ignored),
}
