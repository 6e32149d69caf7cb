//! The bridge's part of one-handed mode, in which the right hand's tilt acts as a left hand.

use host_robot::Door;
use shared_proto::message::{AckResult, LeftState, TiltThresholds};

use super::{Bridge, EventKind};
use crate::intent::is_rest;
use crate::one_handed::{OneHanded, SINCE_MINOR, TiltHand, TiltReport};
use crate::safety::{self, HaltReason, Hand};

impl Bridge {
    /// Lets the right hand drive by these rules, if they say so.
    #[must_use]
    pub fn one_handed(mut self, rules: OneHanded, thresholds: TiltThresholds) -> Self {
        if rules.on {
            self.tilt_hand = Some(TiltHand::new(rules, thresholds));
            self.safety.one_handed();
        }
        self
    }

    /// Returns whether the right hand drives the base.
    pub fn is_one_handed(&self) -> bool {
        self.tilt_hand.is_some()
    }

    /// Returns the hand whose tilt drives the base.
    pub fn driving_hand(&self) -> Hand {
        if self.is_one_handed() { Hand::Right } else { Hand::Left }
    }

    /// A hand has started. In one-handed mode, both hands of the safety machine start with the right hand.
    pub(super) fn one_hand_started(&mut self, hand: Hand, now_ms: u64, robot: &mut dyn Door) {
        let Some(tilt_hand) = self.tilt_hand.as_mut().filter(|_| hand == Hand::Right) else { return };
        tilt_hand.restart();
        self.draws = true;
        self.apply(safety::Event::Started(Hand::Left), now_ms, robot);
        let minor = self.links.right.minor();
        if minor < SINCE_MINOR {
            let problem = format!(
                "its firmware (wire 1.{minor}) sends no tilt, and one-handed mode needs it: update the board to wire \
                 1.{SINCE_MINOR} (firmware-nano33/README.md)"
            );
            self.refuse_one_handed(problem, now_ms, robot);
        }
    }

    /// Without a rest label, nobody knows whether the hand draws.
    pub(super) fn check_rest(&mut self, labels: &[String], now_ms: u64, robot: &mut dyn Door) {
        if !labels.iter().any(|label| is_rest(label)) {
            let problem = "its model names no resting class (idle), and one-handed mode needs it, because the base \
                           stands still while a gesture is drawn: train a model with one";
            self.refuse_one_handed(problem.to_owned(), now_ms, robot);
        }
    }

    /// The right hand's board has answered a request of the session.
    pub(super) fn check_answer(&mut self, hand: Hand, result: AckResult, now_ms: u64, robot: &mut dyn Door) {
        if hand != Hand::Right || result == AckResult::Ok {
            return;
        }
        let problem = match result {
            AckResult::NotBonded => {
                "it sends its tilt only to a bonded laptop: pair the board (firmware-nano33/README.md)"
                    .to_owned()
            }
            _ => {
                "it sends no tilt, and one-handed mode needs it: update the board (firmware-nano33/README.md)"
                    .to_owned()
            }
        };
        self.refuse_one_handed(problem, now_ms, robot);
    }

    /// Nothing moves until another board starts. The reason is reported once.
    fn refuse_one_handed(&mut self, problem: String, now_ms: u64, robot: &mut dyn Door) {
        let Some(tilt_hand) = &mut self.tilt_hand else { return };
        if std::mem::replace(&mut tilt_hand.is_refused, true) {
            return;
        }
        self.note(now_ms, EventKind::HandUnusable { hand: Hand::Right, problem });
        self.apply(safety::Event::Unusable(Hand::Left), now_ms, robot);
    }

    /// The right hand has reported its tilt, after the state of the same hop.
    pub(super) fn tilted(&mut self, report: &TiltReport, now_ms: u64, robot: &mut dyn Door) {
        let TiltReport { age_ms, board_time_ms, tilt } = *report;
        let draws = self.draws;
        let Some(hand) = self.tilt_hand.as_mut().filter(|hand| !hand.is_refused) else { return };
        let (heading, angles) = hand.step(tilt.sequence, tilt.acceleration_mm_s2, draws);
        let state = LeftState {
            sequence: tilt.sequence,
            board_time_ms,
            pitch_mrad: angles.pitch_mrad,
            roll_mrad: angles.roll_mrad,
            heading,
            health: self.right_health,
            ..LeftState::default()
        };
        self.left(age_ms, state, [0, 0], now_ms, robot);
    }

    /// Names the hand that the wearer wears.
    pub(super) fn worn(&self, reason: HaltReason) -> HaltReason {
        match reason {
            HaltReason::Silence(_) if self.is_one_handed() => HaltReason::Silence(Hand::Right),
            HaltReason::Unhealthy(_) if self.is_one_handed() => HaltReason::Unhealthy(Hand::Right),
            reason => reason,
        }
    }
}
