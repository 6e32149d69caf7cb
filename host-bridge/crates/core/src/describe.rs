//! Formats events as lines for users. Only this module uses degrees.

use crate::bridge::{BridgeEvent, EventKind, GestureOutcome};
use crate::observe::SessionEvent;
use crate::safety::{HaltReason, Hand, Ignored, State};
use crate::session::Summary;
use shared_proto::message::{Pairing, PairingKind};
use shared_words::Heading;

/// Explains how a laptop pairs or has paired with a board over Bluetooth.
pub fn pairing(pairing: Pairing) -> String {
    match pairing.kind {
        PairingKind::Passkey => {
            format!("type {:06} where a laptop pairs with this board", pairing.passkey % 1_000_000)
        }
        PairingKind::JustWorks => {
            "Bluetooth paired by \"just works\": nobody compared a number, so somebody nearby may have paired \
             instead; pair again with a passkey to rule this out"
                .to_owned()
        }
        PairingKind::PasskeyTyped => "Bluetooth paired with a passkey".to_owned(),
        PairingKind::Unknown(number) => {
            format!("Bluetooth paired in a way that is not known here ({number}): update host-bridge")
        }
    }
}

/// Formats one line without its time.
pub fn text(event: &SessionEvent) -> String {
    let kind = match event {
        SessionEvent::RecordingEnded { hand, .. } => {
            return format!("{hand} hand: the recording is over; silence will halt the robot");
        }
        SessionEvent::Marked { told, by, .. } => return format!("{told} ({})", by.name()),
        SessionEvent::Wearer { text, .. } => return format!("wearer: {text}"),
        SessionEvent::EpisodeStopped { number, .. } => {
            return format!("episode {number} is thrown away: somebody pressed stop");
        }
        SessionEvent::Bridge(BridgeEvent { kind, .. }) => kind,
    };
    match kind {
        EventKind::HandStarted { hand, identity } => {
            format!("{hand} hand: {}, firmware {}", identity.board, identity.firmware)
        }
        EventKind::HandUnusable { hand, problem } => format!("{hand} hand: {problem}"),
        EventKind::Model { model, without_motion } => {
            let mut line = format!("model {:08x}: {}", model.model_id, model.labels.join(", "));
            if !without_motion.is_empty() {
                line += &format!("; without a motion (see --map): {}", without_motion.join(", "));
            }
            line
        }
        EventKind::BoardFault { hand, fault } => format!("{hand} hand: fault {fault}"),
        EventKind::Pairing { hand, text } => format!("{hand} hand: {text}"),
        EventKind::HandHealth { hand, reasons, .. } if reasons.is_empty() => {
            format!("{hand} hand: well again")
        }
        EventKind::HandHealth { hand, reasons, .. } => format!("{hand} hand: {}", reasons.join("; ")),
        EventKind::State { state } => match state {
            State::Waiting => "waiting for neutral".to_owned(),
            State::Armed => "armed".to_owned(),
            State::Stale => "a hand is silent or in doubt: still until it is back and neutral".to_owned(),
            State::Refused => {
                "the robot refuses to move: still until it does not any more and the hands are neutral"
                    .to_owned()
            }
            State::Stopped => "stopped: hold neutral for 1 s, then up-down".to_owned(),
        },
        EventKind::Halt { reason } => match reason {
            HaltReason::OperatorStop => "HALT: stop by the operator; caps back to 0.50".to_owned(),
            HaltReason::Silence(hand) => format!("HALT: nothing valid from the {hand} hand for 250 ms"),
            HaltReason::Unanswered(hand) => {
                format!(
                    "HALT: the {hand} hand has not answered for 500 ms: how old its states are, nobody knows"
                )
            }
            HaltReason::Unhealthy(hand) => format!("HALT: the {hand} hand is in doubt"),
            HaltReason::Restart(hand) => format!("HALT: the {hand} hand has started anew"),
            HaltReason::RobotRefuses => "HALT: the robot refuses to move".to_owned(),
            HaltReason::Clutch => {
                "HALT: the hand changes over between base and arm; neutral first".to_owned()
            }
            HaltReason::NotAtRest => {
                "HALT: the right hand does not rest, so the tool does not move".to_owned()
            }
        },
        EventKind::Released => "the stop is released".to_owned(),
        EventKind::Heading { hand, heading, twist, .. } => match heading {
            Heading::Neutral | Heading::Between => format!("{hand} hand: base halts"),
            Heading::Forward | Heading::Backward => {
                format!("{hand} hand: {} at {:.2} m/s", heading.name(), twist.linear_m_s.abs())
            }
            Heading::Left | Heading::Right => {
                let speed_deg_s = twist.angular_rad_s.abs().to_degrees();
                format!("{hand} hand: turn {} at {speed_deg_s:.0}°/s", heading.name())
            }
        },
        EventKind::Caps { index, middle, cap } => {
            let finger = if *index >= *middle { "index" } else { "middle" };
            format!("left hand: {finger} bend, cap {cap:.3}")
        }
        EventKind::Gesture { label, confidence, outcome, .. } => {
            let then = match outcome {
                GestureOutcome::Started(motion) => format!("the arm starts {motion}"),
                GestureOutcome::Released => "releases the stop".to_owned(),
                GestureOutcome::Busy(motion) => format!("dropped, the arm is busy with {motion}"),
                GestureOutcome::Refused(motion) => format!("dropped, {motion} is not safe now"),
                GestureOutcome::EndedArm => "ends the arm's motion".to_owned(),
                GestureOutcome::Lent => "lends the hand to the arm; neutral first".to_owned(),
                GestureOutcome::TakenBack => "takes the hand back; neutral first".to_owned(),
                GestureOutcome::NoMotion => "no motion (see --map)".to_owned(),
                GestureOutcome::Late => "dropped, too old".to_owned(),
                GestureOutcome::NotArmed => "dropped, not armed".to_owned(),
            };
            format!("right hand: {label} ({confidence:.2}) → {then}")
        }
        EventKind::Accepted { part, age_ms } => {
            format!("{}: acts on the hand's sample, {age_ms} ms old now", part.name())
        }
        EventKind::Almost { label, confidence } => format!("right hand: almost: {label} {confidence:.1}"),
        EventKind::MotionEnded { motion, reached: true } => format!("arm: {motion} reached"),
        EventKind::MotionEnded { motion, reached: false } => format!("arm: {motion} given up on the way"),
        EventKind::MotionRefused { motion, reason } => format!("arm: {motion} refused: {reason}"),
        EventKind::BaseHeld { reason } => format!("the base is held back: {reason}"),
        EventKind::BaseFree => "the base is free again".to_owned(),
        EventKind::RobotRefuses { reason } => format!("the robot refuses to move: {reason}"),
        EventKind::RobotReady => "the robot does not refuse any more; neutral first".to_owned(),
        EventKind::ArmEnded => "arm: its motion is ended by a key".to_owned(),
        EventKind::Jogging { hand, lent: true } => {
            format!("jogging: the {hand} hand moves the arm's tool, the base stands still")
        }
        EventKind::Jogging { hand, lent: false } => format!("jogging ends: the {hand} hand drives the base"),
        EventKind::Restricted { text } => format!("restricted: {text}"),
        EventKind::Robot { text } => format!("robot: {text}"),
        EventKind::Ignored { what } => match what {
            Ignored::LateState(hand) => format!("{hand} hand: a late state was dropped"),
            Ignored::LateGesture => "a late gesture was dropped".to_owned(),
            Ignored::GestureWhileNotArmed => "a gesture while not armed was dropped".to_owned(),
            Ignored::ImpossibleBends => {
                "more bends in one state than fingers can make were dropped".to_owned()
            }
            Ignored::BendsWhileNotArmed => "bends while not armed were dropped".to_owned(),
            Ignored::ReleaseKey => "the release key has no effect now".to_owned(),
        },
    }
}

/// Returns whether the line would only repeat the next or the previous one.
pub fn is_echo(event: &SessionEvent) -> bool {
    let SessionEvent::Bridge(event) = event else { return false };
    let gesture = |what: &Ignored| matches!(what, Ignored::LateGesture | Ignored::GestureWhileNotArmed);
    matches!(&event.kind, EventKind::Ignored { what } if gesture(what))
}

/// Returns the time of an event.
pub fn time_ms(event: &SessionEvent) -> u64 {
    match event {
        SessionEvent::Bridge(event) => event.time_ms,
        SessionEvent::RecordingEnded { time_ms, .. }
        | SessionEvent::Marked { time_ms, .. }
        | SessionEvent::Wearer { time_ms, .. }
        | SessionEvent::EpisodeStopped { time_ms, .. } => *time_ms,
    }
}

/// Formats the result of a session in a few lines.
pub fn summary(summary: &Summary) -> String {
    let here = summary.odometry;
    let delay = |d: crate::latency::DelaySummary| match (d.median_ms, d.worst_ms) {
        (Some(median), Some(worst)) => format!("median {median} ms, worst {worst} ms of {}", d.count),
        _ => "none".to_owned(),
    };
    let line = |hand: Hand, counters: Option<crate::link::LinkCounters>| match counters {
        Some(c) => format!("{hand} {} ({} damaged, {} lost)", c.frames, c.damaged, c.lost),
        None => format!("{hand} none"),
    };
    format!(
        "{:.1} s: {} gestures, {} poses reached, {} stops, {} releases\n\
         base: x {:.3} m, y {:.3} m, {:.1}°, {:.2} m driven; caps {:.3}\n\
         frames: {}, {}\n\
         latency: window end → arm {}; sample → wheels {}",
        summary.seconds,
        summary.gestures.len(),
        summary.poses_reached.len(),
        summary.stops,
        summary.releases,
        here.x_m,
        here.y_m,
        here.heading_rad.to_degrees(),
        here.path_m,
        summary.caps.linear_m_s,
        line(Hand::Left, summary.frames.left),
        line(Hand::Right, summary.frames.right),
        delay(summary.latency.window_end_to_arm),
        delay(summary.latency.sample_to_wheels),
    )
}
