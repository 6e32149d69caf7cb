//! Selects vibration signals for the wearer of the right hand, if a motor is connected to the board.

use shared_proto::message::{HostMessage, Signal};

use crate::bridge::{BridgeEvent, EventKind, GestureOutcome};
use crate::safety::HaltReason;

/// The first minor version of boards that support [`Signal`].
pub const SINCE_MINOR: u8 = HostMessage::Feel { signal: Signal::Ready }.row().since;

/// Returns the signal for the events of a turn.
/// If there are several events, the most serious one is signalled, because a wrist can feel only one signal at a time.
pub fn signal(events: &[BridgeEvent]) -> Option<Signal> {
    let weight = |signal: &Signal| match signal {
        Signal::LinkLost => 3,
        Signal::Stopped => 2,
        Signal::Refused => 1,
        _ => 0,
    };
    events.iter().filter_map(of).max_by_key(weight)
}

fn of(event: &BridgeEvent) -> Option<Signal> {
    Some(match &event.kind {
        EventKind::Halt { reason } => match reason {
            HaltReason::Silence(_) | HaltReason::Unanswered(_) => Signal::LinkLost,
            HaltReason::OperatorStop
            | HaltReason::Unhealthy(_)
            | HaltReason::Restart(_)
            | HaltReason::RobotRefuses
            | HaltReason::NotAtRest => Signal::Stopped,
            HaltReason::Clutch => Signal::Accepted,
        },
        EventKind::Gesture { outcome, .. } => match outcome {
            GestureOutcome::Started(_)
            | GestureOutcome::EndedArm
            | GestureOutcome::Released
            | GestureOutcome::Lent
            | GestureOutcome::TakenBack => Signal::Accepted,
            GestureOutcome::Busy(_)
            | GestureOutcome::Refused(_)
            | GestureOutcome::NoMotion
            | GestureOutcome::Late
            | GestureOutcome::NotArmed => Signal::Refused,
        },
        EventKind::HandStarted { .. } => Signal::Ready,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::safety::Hand;
    use host_robot::MotionName;

    fn gesture(outcome: GestureOutcome) -> EventKind {
        EventKind::Gesture {
            label: "circle".to_owned(),
            confidence: 0.9,
            window_end_board_ms: 0,
            age_ms: 7,
            outcome,
        }
    }

    fn felt(kinds: Vec<EventKind>) -> Option<Signal> {
        let events: Vec<_> = kinds.into_iter().map(|kind| BridgeEvent { time_ms: 1, kind }).collect();
        signal(&events)
    }

    #[test]
    fn a_gesture_is_felt_as_accepted_only_where_something_follows_from_it() {
        let motion = || MotionName::from("home");
        for (outcome, wanted) in [
            (GestureOutcome::Started(motion()), Signal::Accepted),
            (GestureOutcome::Released, Signal::Accepted),
            (GestureOutcome::EndedArm, Signal::Accepted),
            (GestureOutcome::Busy(motion()), Signal::Refused),
            (GestureOutcome::Refused(motion()), Signal::Refused),
            (GestureOutcome::NoMotion, Signal::Refused),
            (GestureOutcome::Late, Signal::Refused),
            (GestureOutcome::NotArmed, Signal::Refused),
        ] {
            assert_eq!(felt(vec![gesture(outcome.clone())]), Some(wanted), "{outcome:?}");
        }
    }

    #[test]
    fn a_halt_says_whether_somebody_stopped_or_a_link_is_lost_and_outweighs_a_gesture() {
        let halt = |reason| EventKind::Halt { reason };
        for (reason, wanted) in [
            (HaltReason::OperatorStop, Signal::Stopped),
            (HaltReason::Silence(Hand::Left), Signal::LinkLost),
            (HaltReason::Unanswered(Hand::Right), Signal::LinkLost),
            (HaltReason::Unhealthy(Hand::Left), Signal::Stopped),
            (HaltReason::Restart(Hand::Left), Signal::Stopped),
            (HaltReason::RobotRefuses, Signal::Stopped),
        ] {
            let events = vec![halt(reason), gesture(GestureOutcome::NotArmed)];
            assert_eq!(felt(events), Some(wanted), "{reason:?}");
        }
        assert_eq!(felt(vec![EventKind::BaseFree]), None);
    }
}
