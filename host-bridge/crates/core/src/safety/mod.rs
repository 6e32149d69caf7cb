//! The bridge's own stop: decides from elapsed time and the hands' states whether anything may move.
//!
//! Glossary
//! * **hand**: one board. It is *connected* from its first hello until the end of the session.
//!   A silent hand is not forgotten; it prevents motion until it returns.
//! * **awaited**: a hand that was announced but has not sent a hello.
//!   Until its hello arrives, nothing moves.
//!   The other hand must not drive without the hand that can stop it.
//! * **live**: a hand whose newest valid *sample* is younger than [`STALE_MS`].
//!   Older samples never move the robot.
//! * **prompt**: a link whose last round trip is recent and shorter than half of that limit.
//! * **neutral**: a left hand within its dead zone, or a right hand whose best label is rest.
//!   Neutral counts only on a prompt link.
//! * **release**: the gesture that ends a stop. It is the gesture that moves the arm home: up-down.
//!
//! The machine is sans-IO: [`Safety::step`] takes an event and the time, and returns actions.
//! The machine passes on bends, gestures and the heading only while armed. Earlier inputs are discarded.

mod events;
mod release;
mod watch;

pub use events::{Action, Event, Gesture, HaltReason, Ignored};
pub use shared_words::{Hand, PerHand};

use serde::{Deserialize, Serialize};
use shared_proto::message::Heading;

use crate::tilt::{Pointing, Tilts};
use watch::{Neutral, Watch};

/// A state older than this is dropped. A hand that is silent for this long halts the robot.
pub const STALE_MS: u64 = 250;

/// All hands must be neutral together for this long before anything may move.
/// The time is measured from the arrival of the first neutral sample to the acquisition of the newest one.
/// A burst after a stall, or one neutral frame followed by silence, is therefore not enough.
pub const ARM_NEUTRAL_MS: u64 = 100;

/// Maximum number of new bends of one finger in a state; states with more are rejected.
/// Two accepted states are at most [`STALE_MS`] apart, and a finger bends at most five times per second.
pub const BENDS_MAX: u8 = 3;

/// Neutral needs at least this many samples.
pub const NEUTRAL_SAMPLES: u32 = 3;

/// A hand whose pings are unanswered for this long is not used.
pub use crate::link::ANSWER_PATIENCE_MS;

/// The hands must be neutral for this long before a stop can be released.
pub const RELEASE_NEUTRAL_MS: u64 = 1000;

/// The three times above, for users who want stricter times than the defaults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SafetyTimes {
    /// See [`STALE_MS`].
    pub stale_ms: u64,
    /// See [`ARM_NEUTRAL_MS`].
    pub arm_neutral_ms: u64,
    /// See [`RELEASE_NEUTRAL_MS`].
    pub release_neutral_ms: u64,
}

impl SafetyTimes {
    /// Neutral counts only if round trips are shorter than this: half of [`STALE_MS`].
    pub fn prompt_ms(&self) -> u64 {
        self.stale_ms / 2
    }
}

impl Default for SafetyTimes {
    fn default() -> Self {
        SafetyTimes {
            stale_ms: STALE_MS,
            arm_neutral_ms: ARM_NEUTRAL_MS,
            release_neutral_ms: RELEASE_NEUTRAL_MS,
        }
    }
}

/// ```text
///      no hand awaited, all live and neutral for 100 ms
///   Waiting ─────────────────────────────────────────────► Armed
///    ▲   ▲                                                │ │ │
///    │   └──────────── a hand (re)started ────────────────┘ │ │
///    │                                                      │ │
///    │ all live             250 ms silence, no answers,     │ │
///    └────────── Stale ◄───────bad health, wrong version────┘ │
///                                                             │ both fingers, stop key
///   Armed ◄── neutral for 1 s, then the release ── Stopped ◄──┴── (from every state)
/// ```
/// Motion is possible only in `Armed`. Leaving this state halts base and arm.
/// `Stale` is reached by time alone.
/// A stopped robot stays stopped, whatever the links do.
/// A robot that itself refuses to move leads to `Refused` from every state except `Stopped`.
/// When the robot no longer refuses, the state is `Waiting`, and neutral is required;
/// no release skips this step.
/// The clutch, which switches the left hand between the base and the arm, leads from `Armed` to `Waiting`.
/// The same happens if the right hand does not rest while the left hand is lent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// Nothing moves until every awaited hand is present and every connected hand has been neutral.
    Waiting,
    /// The hands drive the robot.
    Armed,
    /// A connected hand is silent or cannot be used.
    Stale,
    /// The robot itself refuses to move and reports the reason.
    Refused,
    /// The operator stopped the robot.
    Stopped,
}

/// See the module documentation.
#[derive(Clone, Debug)]
pub struct Safety {
    times: SafetyTimes,
    state: State,
    now_ms: u64,
    left: Watch,
    right: Watch,
    heading: Heading,
    /// Tilts of the newest valid states.
    tilts: Tilts,
    /// Whether the right hand has rested long enough since the stop (only without a left board).
    right_rested: bool,
    /// Whether both states come from the right hand, which cannot be level while it draws.
    one_handed: bool,
    /// Whether the robot itself refuses to move.
    refused: bool,
    /// The left hand is lent to the arm.
    lent: bool,
}

impl Default for Safety {
    fn default() -> Self {
        Safety::new()
    }
}

impl Safety {
    /// Creates a machine that waits and has no connected hand.
    pub fn new() -> Self {
        Safety::with(SafetyTimes::default())
    }

    /// Like `new`, but with other times.
    pub fn with(times: SafetyTimes) -> Self {
        Safety {
            times,
            state: State::Waiting,
            now_ms: 0,
            left: Watch::default(),
            right: Watch::default(),
            heading: Heading::Neutral,
            tilts: Tilts::default(),
            right_rested: false,
            one_handed: false,
            refused: false,
            lent: false,
        }
    }

    /// Prevents all motion until this hand has sent a hello.
    pub fn await_hand(&mut self, hand: Hand) {
        let watch = self.watch_mut(hand);
        watch.awaited = !watch.connected;
    }

    /// The times in force.
    pub fn times(&self) -> SafetyTimes {
        self.times
    }

    /// The state now.
    pub fn state(&self) -> State {
        self.state
    }

    /// The heading that may drive the base: neutral unless armed, and while the hand is lent to the arm.
    pub fn heading(&self) -> Heading {
        if self.acts() && !self.lent { self.heading } else { Heading::Neutral }
    }

    fn acts(&self) -> bool {
        self.state == State::Armed && self.left.connected
    }

    /// Returns whether the left hand is lent to the arm. The state determines whether the hand moves the arm.
    pub fn is_lent(&self) -> bool {
        self.lent
    }

    /// Returns where the left hand points, or `None` if it may not move the arm's tool.
    pub fn jogging(&self) -> Option<Pointing> {
        (self.acts() && self.lent).then(|| Pointing { heading: self.heading, tilt: self.tilts.meant() })
    }

    /// Returns the heading that may drive the base, together with its tilt.
    pub fn pointing(&self) -> Pointing {
        Pointing { heading: self.heading(), tilt: self.tilts.meant() }
    }

    /// The hand has sent its hello.
    pub fn connected(&self, hand: Hand) -> bool {
        self.watch(hand).connected
    }

    /// Returns whether the hand is connected, recent and usable.
    pub fn live(&self, hand: Hand) -> bool {
        self.watch(hand).live
    }

    /// Returns the age of a connected hand's newest valid sample.
    pub fn age_ms(&self, hand: Hand, now_ms: u64) -> Option<u64> {
        let watch = self.watch(hand);
        watch.connected.then(|| now_ms.saturating_sub(watch.sample_ms))
    }

    /// Processes one event. `now_ms` is the laptop's clock.
    /// If that clock steps back, the machine's time stands still.
    #[must_use = "an action that is not carried out may leave the robot moving"]
    pub fn step(&mut self, event: Event, now_ms: u64) -> Vec<Action> {
        let mut actions = Vec::new();
        self.now_ms = self.now_ms.max(now_ms);
        self.watch_the_clock(&mut actions);
        match event {
            Event::Tick => {}
            Event::Started(hand) => {
                // A start counts as a sign of life, so a new hand has 250 ms to send its first state.
                *self.watch_mut(hand) = Watch {
                    awaited: false,
                    connected: true,
                    live: true,
                    sample_ms: self.now_ms,
                    reset_ms: self.now_ms,
                    neutral: None,
                };
                if hand == Hand::Right {
                    self.right_rested = false;
                }
                self.leave_armed(State::Waiting, HaltReason::Restart(hand), &mut actions);
            }
            Event::Unusable(hand) => {
                if self.connected(hand) {
                    let now_ms = self.now_ms;
                    self.watch_mut(hand).lose(now_ms);
                    self.leave_armed(State::Stale, HaltReason::Unhealthy(hand), &mut actions);
                }
            }
            Event::Unanswered(hand) => {
                if self.live(hand) {
                    let now_ms = self.now_ms;
                    self.watch_mut(hand).lose(now_ms);
                    self.leave_armed(State::Stale, HaltReason::Unanswered(hand), &mut actions);
                }
            }
            Event::Left { age_ms, prompt, healthy, heading, tilt, index_bends, middle_bends, stop } => {
                if !self.left.connected {
                    return actions;
                }
                let bends = index_bends != 0 || middle_bends != 0;
                if stop {
                    // The stop applies even for a late state or a hand in doubt,
                    // because halting is always safe.
                    self.stop(&mut actions);
                }
                if age_ms > self.times.stale_ms {
                    actions.push(Action::Ignored(Ignored::LateState(Hand::Left)));
                    return actions;
                }
                if !healthy {
                    self.left.lose(self.now_ms);
                    self.leave_armed(State::Stale, HaltReason::Unhealthy(Hand::Left), &mut actions);
                }
                if index_bends.max(middle_bends) > BENDS_MAX {
                    actions.push(Action::Ignored(Ignored::ImpossibleBends));
                } else if bends && self.state == State::Armed {
                    actions.push(Action::Bends { index: index_bends, middle: middle_bends });
                } else if bends {
                    actions.push(Action::Ignored(Ignored::BendsWhileNotArmed));
                }
                if healthy {
                    self.heading = heading;
                    self.tilts.see(heading, tilt);
                    let neutral = heading == Heading::Neutral && !stop && prompt;
                    self.left.refresh(age_ms, neutral, self.now_ms);
                }
            }
            Event::Right { age_ms, prompt, healthy, resting, gesture } => {
                if !self.right.connected {
                    return actions;
                }
                if age_ms > self.times.stale_ms {
                    actions.push(Action::Ignored(Ignored::LateState(Hand::Right)));
                    return actions;
                }
                if healthy {
                    self.right.refresh(age_ms, resting && gesture.is_none() && prompt, self.now_ms);
                    self.note_rest_during_stop();
                } else {
                    self.right.lose(self.now_ms);
                    self.leave_armed(State::Stale, HaltReason::Unhealthy(Hand::Right), &mut actions);
                }
                if self.lent && !(resting && gesture.is_none()) && self.state == State::Armed {
                    self.leave_armed(State::Waiting, HaltReason::NotAtRest, &mut actions);
                }
                if let Some(gesture) = gesture {
                    self.gesture(gesture, &mut actions);
                }
            }
            Event::Robot { refuses } => {
                self.refused = refuses;
                if refuses {
                    self.leave_armed(State::Refused, HaltReason::RobotRefuses, &mut actions);
                } else if self.state == State::Refused {
                    // From now on, only new neutral samples are accepted.
                    self.left.reset(self.now_ms);
                    self.right.reset(self.now_ms);
                    self.enter(State::Waiting, &mut actions);
                }
            }
            Event::Clutch { lends } => {
                if lends != self.lent && (!lends || self.acts()) {
                    self.lend(lends, &mut actions);
                    self.leave_armed(State::Waiting, HaltReason::Clutch, &mut actions);
                }
            }
            Event::StopKey => self.stop(&mut actions),
            Event::ReleaseKey => {
                let allowed = self.state == State::Stopped
                    && !self.right.connected
                    && self.neutral_long_enough_at(self.now_ms);
                if allowed {
                    self.release(&mut actions);
                } else {
                    actions.push(Action::Ignored(Ignored::ReleaseKey));
                }
            }
        }
        self.arm_if_all_neutral(&mut actions);
        actions
    }

    fn watch(&self, hand: Hand) -> &Watch {
        match hand {
            Hand::Left => &self.left,
            Hand::Right => &self.right,
        }
    }

    fn watch_mut(&mut self, hand: Hand) -> &mut Watch {
        match hand {
            Hand::Left => &mut self.left,
            Hand::Right => &mut self.right,
        }
    }

    fn watch_the_clock(&mut self, actions: &mut Vec<Action>) {
        let (now_ms, stale_ms) = (self.now_ms, self.times.stale_ms);
        for hand in Hand::BOTH {
            let watch = self.watch_mut(hand);
            if watch.connected && watch.live && now_ms.saturating_sub(watch.sample_ms) >= stale_ms {
                watch.lose(now_ms);
                self.leave_armed(State::Stale, HaltReason::Silence(hand), actions);
            }
        }
    }

    fn gesture(&mut self, gesture: Gesture, actions: &mut Vec<Action>) {
        let ended_ms = self.now_ms.saturating_sub(gesture.age_ms);
        if gesture.age_ms > self.times.stale_ms {
            actions.push(Action::Ignored(Ignored::LateGesture));
        } else if self.state == State::Armed {
            actions.push(Action::Gesture(gesture));
        } else if self.state == State::Stopped && gesture.releases && self.neutral_long_enough_at(ended_ms) {
            self.release(actions);
        } else {
            actions.push(Action::Ignored(Ignored::GestureWhileNotArmed));
        }
    }

    fn awaits_a_hand(&self) -> bool {
        self.left.awaited || self.right.awaited
    }

    fn connected_hands_live(&self) -> bool {
        [self.left, self.right].iter().all(|watch| !watch.connected || watch.live)
    }

    fn stop(&mut self, actions: &mut Vec<Action>) {
        // Only neutral samples after the stop are accepted.
        self.left.reset(self.now_ms);
        self.right.reset(self.now_ms);
        self.right_rested = false;
        self.lend(false, actions);
        if self.state != State::Stopped {
            actions.push(Action::Halt(HaltReason::OperatorStop));
            actions.push(Action::ResetCaps);
            self.enter(State::Stopped, actions);
        }
    }

    fn lend(&mut self, lends: bool, actions: &mut Vec<Action>) {
        if std::mem::replace(&mut self.lent, lends) != lends {
            actions.push(Action::Lent(lends));
        }
    }

    fn release(&mut self, actions: &mut Vec<Action>) {
        actions.push(Action::Released);
        self.enter(State::Armed, actions);
    }

    /// Halts if armed, and enters `next` unless the operator has stopped the robot.
    fn leave_armed(&mut self, next: State, reason: HaltReason, actions: &mut Vec<Action>) {
        // Hands that were neutral before the disturbance must be neutral again after it.
        self.left.reset(self.now_ms);
        self.right.reset(self.now_ms);
        self.right_rested = false;
        if self.state == State::Armed {
            actions.push(Action::Halt(reason));
        }
        if self.state != State::Stopped && self.state != next {
            // If one hand restarts, the machine still waits for another silent hand.
            let next = if self.connected_hands_live() { next } else { State::Stale };
            if self.state != next {
                self.enter(next, actions);
            }
        }
    }

    fn arm_if_all_neutral(&mut self, actions: &mut Vec<Action>) {
        if self.refused {
            if matches!(self.state, State::Waiting | State::Stale) && self.connected_hands_live() {
                self.enter(State::Refused, actions);
            }
            return;
        }
        if !matches!(self.state, State::Waiting | State::Stale)
            || self.awaits_a_hand()
            || !self.connected_hands_live()
        {
            return;
        }
        let hands = [self.left, self.right];
        let connected = || hands.iter().filter(|watch| watch.connected);
        if connected().next().is_none() {
            return;
        }
        // Only the time in which all hands were neutral together counts.
        let all: Option<Vec<Neutral>> = connected().map(|watch| watch.neutral).collect();
        let together = all.and_then(|all| {
            all.into_iter().reduce(|a, b| Neutral {
                first_ms: a.first_ms.max(b.first_ms),
                newest_ms: a.newest_ms.min(b.newest_ms),
                samples: a.samples.min(b.samples),
            })
        });
        if together.is_some_and(|neutral| neutral.held(self.times.arm_neutral_ms, self.now_ms)) {
            self.enter(State::Armed, actions);
        } else if self.state == State::Stale {
            self.enter(State::Waiting, actions);
        }
    }

    fn enter(&mut self, state: State, actions: &mut Vec<Action>) {
        self.state = state;
        actions.push(Action::Entered(state));
    }
}
