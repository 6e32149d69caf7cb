//! The bridge's own stop: decides, from elapsed time and what the hands say, what may act.
//!
//! Glossary
//! * **hand**: one board. It is *connected* from its first hello on, for the rest of the session: a
//!   hand that went silent is not forgotten, it holds the robot still until it is back.
//! * **awaited**: somebody said that this hand takes part, and it has not said hello yet. Until it has,
//!   nothing moves: the other hand must not drive without the one that can stop it.
//! * **live**: the hand's newest valid state is younger than [`STALE_MS`] by the time of its *sample*,
//!   so nothing older than that ever moves the robot.
//! * **prompt**: the link's last round trip is fresh, and shorter than half of that limit.
//! * **neutral**: the left hand within its dead zone; the right hand with a resting class on top. It counts
//!   on a prompt link only.
//! * **release**: the gesture that ends a stop (the one that brings the arm home: up-down).
//!
//! The machine is sans-IO: [`Safety::step`] takes an event and the time, and answers with actions.
//! It lets through (`Bends`, `Gesture`, the heading) only while armed; whatever a hand did before that
//! is gone for good.

mod events;
mod watch;

pub use events::{Action, Event, Gesture, HaltReason, Ignored};
pub use shared_words::{Hand, PerHand};

use serde::{Deserialize, Serialize};
use shared_proto::message::Heading;

use crate::tilt::{Pointing, Tilts};
use watch::{Neutral, Watch};

/// A state older than this is dropped; a hand silent for this long halts the robot.
pub const STALE_MS: u64 = 250;

/// All hands must be neutral together for this long before anything may act, from the arrival of the first
/// neutral sample to the taking of the newest: a burst after a stall, or one neutral frame and then
/// silence, proves nothing.
pub const ARM_NEUTRAL_MS: u64 = 100;

/// A state that reports more bends of one finger is not believed: between two states that count there are at
/// most [`STALE_MS`], and a finger bends and straightens five times a second at most.
pub const BENDS_MAX: u8 = 3;

/// Neutral needs at least this many samples.
pub const NEUTRAL_SAMPLES: u32 = 3;

/// A hand whose pings go unanswered for this long is not acted on.
pub use crate::link::ANSWER_PATIENCE_MS;

/// The hands must be neutral for this long before a stop can be released.
pub const RELEASE_NEUTRAL_MS: u64 = 1000;

/// The three times above, for somebody who wants stricter ones than the defaults.
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
    /// Neutral counts only while round trips are shorter than this: half of [`STALE_MS`].
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
/// Only in `Armed` does anything move. Leaving it halts base and arm. `Stale` is reached by time alone.
/// A stopped robot stays stopped whatever the links do. A robot that refuses by itself (`Refused`, from every state
/// but `Stopped`) is `Waiting` again when it does not any more, and neutral is needed; no release goes past it.
/// The clutch, which lends the left hand to the arm or takes it back, leads from `Armed` to `Waiting`; so does a right hand
/// that does not rest while the left one is lent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// Nothing moves until every awaited hand is there and every connected one was seen neutral.
    Waiting,
    /// The hands drive the robot.
    Armed,
    /// A connected hand is silent or not fit to act on.
    Stale,
    /// The robot itself refuses to move; what it says names the reason.
    Refused,
    /// The operator stopped the robot.
    Stopped,
}

/// See the module.
#[derive(Clone, Debug)]
pub struct Safety {
    times: SafetyTimes,
    state: State,
    now_ms: u64,
    left: Watch,
    right: Watch,
    heading: Heading,
    /// Tilts of the newest states that count.
    tilts: Tilts,
    /// The right hand has rested for long enough since the stop (where there is no left hand).
    right_rested: bool,
    /// The robot itself refuses to move.
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
    /// Waiting, no hand connected.
    pub fn new() -> Self {
        Safety::with(SafetyTimes::default())
    }

    /// As `new`, with other times.
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
            refused: false,
            lent: false,
        }
    }

    /// Nothing moves before this hand has said hello.
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

    /// The left hand is lent to the arm; whether it moves it depends on the state.
    pub fn is_lent(&self) -> bool {
        self.lent
    }

    /// Where the left hand points while it may move the arm's tool.
    pub fn jogging(&self) -> Option<Pointing> {
        (self.acts() && self.lent).then(|| Pointing { heading: self.heading, tilt: self.tilts.meant() })
    }

    /// The same with how far it is tilted.
    pub fn pointing(&self) -> Pointing {
        Pointing { heading: self.heading(), tilt: self.tilts.meant() }
    }

    /// The hand has said hello.
    pub fn connected(&self, hand: Hand) -> bool {
        self.watch(hand).connected
    }

    /// The hand is connected, fresh and fit to act on.
    pub fn live(&self, hand: Hand) -> bool {
        self.watch(hand).live
    }

    /// Age of a connected hand's newest valid sample.
    pub fn age_ms(&self, hand: Hand, now_ms: u64) -> Option<u64> {
        let watch = self.watch(hand);
        watch.connected.then(|| now_ms.saturating_sub(watch.sample_ms))
    }

    /// Handles one event. `now_ms` is the laptop's clock and must not run back; if it does, it stands.
    #[must_use = "an action that is not carried out may leave the robot moving"]
    pub fn step(&mut self, event: Event, now_ms: u64) -> Vec<Action> {
        let mut actions = Vec::new();
        self.now_ms = self.now_ms.max(now_ms);
        self.watch_the_clock(&mut actions);
        match event {
            Event::Tick => {}
            Event::Started(hand) => {
                // Counts as a sign of life, so that a new hand has 250 ms to send its first state.
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
                self.lend(false, &mut actions);
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
                    // Even late or from a hand in doubt: halting is never wrong.
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
                    self.lend(false, &mut actions);
                    self.leave_armed(State::Refused, HaltReason::RobotRefuses, &mut actions);
                } else if self.state == State::Refused {
                    // Neutral must be held from now on, not from before.
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

    /// Everybody connected is live, and the left hand (if there is one) has been neutral up to now,
    /// for a second already at `time_ms`. Without a left hand, the right one must have rested instead.
    fn neutral_long_enough_at(&self, time_ms: u64) -> bool {
        let all_live = (self.left.connected || self.right.connected)
            && !self.refused
            && !self.awaits_a_hand()
            && self.connected_hands_live();
        let neutral = if self.left.connected {
            self.left.neutral.is_some_and(|neutral| neutral.held(self.times.release_neutral_ms, time_ms))
        } else {
            self.right_rested
        };
        all_live && neutral
    }

    fn note_rest_during_stop(&mut self) {
        if self.state == State::Stopped
            && let Some(neutral) = self.right.neutral
            && neutral.held(self.times.release_neutral_ms, self.now_ms)
        {
            self.right_rested = true;
        }
    }

    fn awaits_a_hand(&self) -> bool {
        self.left.awaited || self.right.awaited
    }

    fn connected_hands_live(&self) -> bool {
        [self.left, self.right].iter().all(|watch| !watch.connected || watch.live)
    }

    fn stop(&mut self, actions: &mut Vec<Action>) {
        // Neutral must be held from the stop on, not from before it.
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

    /// Halts if armed, and goes to `next` unless the operator's stop holds.
    fn leave_armed(&mut self, next: State, reason: HaltReason, actions: &mut Vec<Action>) {
        // Whatever was neutral before the disturbance must be so again after it.
        self.left.reset(self.now_ms);
        self.right.reset(self.now_ms);
        self.right_rested = false;
        if self.state == State::Armed {
            actions.push(Action::Halt(reason));
        }
        if self.state != State::Stopped && self.state != next {
            // A restart of one hand does not end the wait for another that is silent.
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
        // Together: what counts is the time during which all of them were neutral.
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
