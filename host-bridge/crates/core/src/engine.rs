//! The engine of all sessions: receive, decide, act, observe, always in this order.
//!
//! The engine is sans-IO: its inputs are bytes and the time.
//! Three drivers use the engine:
//! virtual time ([`crate::session`]), the wall clock (the program's control thread),
//! and session files (`replay`).
//!
//! ```text
//! advance(now):  the robot moves up to now ─► hands speak, their bytes are received ─► what boards need is sent
//!                ─► the bridge decides ─► a motion that was planned meanwhile begins ─► the robot is handed what was decided
//!                ─► observers look
//! receive(hand, bytes, now), stop_key(now), release_key(now): at once, between two turns
//! ```

use host_robot::{Door, MotionName};
use shared_proto::frame::{DELIMITER, HOST_FRAME_MAX, encode_host};
use shared_proto::message::{HostMessage, Mode, TiltThresholds};

use crate::bridge::{Bridge, BridgeEvent, EventKind, GestureOutcome, Prompt};
use crate::episodes::{Mark, MarkedBy, Tally};
use crate::feel;
use crate::intent::same_label;
use crate::observe::{Now, OperatorKey, SessionEvent, Tap, Turn};
use crate::safety::{Hand, PerHand};
use crate::source::{HandKey, Source};

/// Interval at which unacknowledged settings are sent again.
const SET_UP_INTERVAL_MS: u64 = 1000;
/// The engine numbers its own requests from 1. The numbers start again after each start of a board.
/// Requests of other programs have this number or a higher one.
pub const FOREIGN_REQUESTS: u16 = 0x4000;

/// See the module documentation. `'b` is the lifetime of the data that its hands borrow.
pub struct Engine<'b, D> {
    bridge: Bridge,
    door: D,
    /// The time up to which the robot has moved.
    moved_ms: u64,
    sources: PerHand<Source<'b>>,
    tilt: Option<TiltThresholds>,
    /// Whether events are signalled to the right hand's wearer.
    vibrates: bool,
    request: u16,
    /// Settings that still have to be sent to a hand's board after its start.
    set_ups: PerHand<Option<SetUp>>,
    /// Labels of gestures that mark episodes.
    marks: Vec<(String, Mark)>,
    episodes: Tally,
    /// Marks and messages to the wearer, which are shown in the next turn.
    marked: Vec<SessionEvent>,
    tap: Tap,
}

/// A message that a hand's board has not acknowledged yet.
#[derive(Clone, Copy, Debug)]
struct SetUp {
    request: u16,
    sent_ms: Option<u64>,
    what: Wanted,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wanted {
    /// Ends record mode, in which the board may still be.
    Classify,
    Thresholds,
}

impl<'b, D: Door> Engine<'b, D> {
    /// Creates an engine that starts at `now_ms`.
    pub fn new(bridge: Bridge, door: D, sources: impl Into<PerHand<Source<'b>>>, now_ms: u64) -> Self {
        let sources = sources.into();
        let boards = sources.iter().filter(|(_, source)| source.is_link());
        let boards: Vec<Hand> = boards.map(|(hand, _)| hand).collect();
        let bridge = boards
            .into_iter()
            .fold(bridge, Bridge::awaiting)
            .known_to(|motion: &MotionName| door.knows(motion));
        Engine {
            bridge,
            door,
            moved_ms: now_ms,
            sources,
            tilt: None,
            vibrates: false,
            request: 0,
            set_ups: PerHand::default(),
            marks: Vec::new(),
            episodes: Tally::default(),
            marked: Vec::new(),
            tap: Tap::default(),
        }
    }

    /// Sends these thresholds to left-hand boards after their start.
    #[must_use]
    pub fn with_tilt(self, tilt: TiltThresholds) -> Self {
        Engine { tilt: Some(tilt), ..self }
    }

    /// Sends vibration signals to the right hand's board, if the board supports them.
    #[must_use]
    pub fn with_vibration(self, vibrates: bool) -> Self {
        Engine { vibrates, ..self }
    }

    /// Sets which gesture labels mark the episodes of a recording.
    #[must_use]
    pub fn with_marks(self, marks: impl IntoIterator<Item = (String, Mark)>) -> Self {
        Engine { marks: marks.into_iter().collect(), ..self }
    }

    /// Returns the tap, where observers are attached.
    pub fn tap_mut(&mut self) -> &mut Tap {
        &mut self.tap
    }

    /// Returns the state at `now_ms` for observers.
    pub fn now(&self, now_ms: u64) -> Now<'_> {
        Now { time_ms: now_ms, bridge: &self.bridge, robot: &self.door }
    }

    /// The bridge.
    pub fn bridge(&self) -> &Bridge {
        &self.bridge
    }

    /// The door to the robot.
    pub fn door(&self) -> &D {
        &self.door
    }

    /// Returns the door, to pass external data to the robot.
    pub fn door_mut(&mut self) -> &mut D {
        &mut self.door
    }

    /// Processes bytes from a hand's board. `now_ms` is the time of *processing*.
    /// Bytes that waited in a buffer therefore have their true age, and are dropped if they are too old.
    pub fn receive(&mut self, hand: Hand, bytes: &[u8], now_ms: u64) {
        self.tap.show(|observer| observer.received(now_ms, hand, bytes));
        self.bridge.receive(hand, bytes, now_ms, &mut self.door);
    }

    /// Presses a key that controls a hand.
    pub fn press(&mut self, key: HandKey, now_ms: u64) {
        for source in self.sources.values_mut() {
            source.press(key, now_ms);
        }
    }

    /// Releases a key that controls a hand.
    pub fn release_hand_key(&mut self, key: HandKey) {
        for source in self.sources.values_mut() {
            source.release(key);
        }
    }

    /// The operator's stop.
    pub fn stop_key(&mut self, now_ms: u64) {
        self.tap.show(|observer| observer.operated(now_ms, OperatorKey::Stop));
        self.bridge.stop_key(now_ms, &mut self.door);
        self.door.send();
        if let Some(number) = self.episodes.stop(now_ms) {
            self.marked.push(SessionEvent::EpisodeStopped { time_ms: now_ms, number });
        }
    }

    /// Marks an episode on behalf of the operator. This neither moves nor stops anything.
    pub fn mark(&mut self, mark: Mark, by: MarkedBy, now_ms: u64) {
        let told = self.episodes.mark(mark, now_ms);
        self.marked.push(SessionEvent::Marked { time_ms: now_ms, mark, by, told });
    }

    /// Ends only the arm's motion on behalf of the operator.
    pub fn end_arm_key(&mut self, now_ms: u64) {
        self.tap.show(|observer| observer.operated(now_ms, OperatorKey::EndArm));
        self.bridge.end_arm_key(now_ms, &mut self.door);
        self.door.send();
    }

    /// Begins or ends the time in which the wearer shows gestures for training.
    /// Meanwhile, no gesture has an effect.
    pub fn show_key(&mut self, is_shown: bool, now_ms: u64) {
        let key = if is_shown { OperatorKey::Show } else { OperatorKey::Shown };
        self.tap.show(|observer| observer.operated(now_ms, key));
        self.bridge.show_key(is_shown);
    }

    /// Sets the request to the right hand's wearer.
    pub fn set_prompt(&mut self, prompt: Option<Prompt>) {
        self.bridge.set_prompt(prompt);
    }

    /// Shows a message to the wearer in the next turn.
    pub fn tell_wearer(&mut self, text: String, now_ms: u64) {
        self.marked.push(SessionEvent::Wearer { time_ms: now_ms, text });
    }

    /// Returns whether a hand's board has acknowledged all settings that it receives at its start.
    pub fn is_set_up(&self, hand: Hand) -> bool {
        self.set_ups[hand].is_none()
    }

    /// Sends a hand's board a message that the session itself does not need.
    /// Its `request` must be a number that the engine does not use:
    /// [`FOREIGN_REQUESTS`] or higher.
    pub fn send_to(&mut self, hand: Hand, message: &HostMessage<'_>, now_ms: u64) {
        self.send(hand, message, now_ms);
    }

    /// Processes the clutch's key, which switches the left hand from the base to the arm, or back.
    pub fn clutch_key(&mut self, now_ms: u64) {
        self.tap.show(|observer| observer.operated(now_ms, OperatorKey::Clutch));
        self.bridge.clutch_key(now_ms, &mut self.door);
        self.door.send();
    }

    /// The release key, pressed and confirmed.
    pub fn release_key(&mut self, now_ms: u64) {
        self.tap.show(|observer| observer.operated(now_ms, OperatorKey::Release));
        self.bridge.release_key(now_ms, &mut self.door);
    }

    /// Brings base and arm to rest at the end of the program.
    pub fn halt(&mut self) {
        self.door.halt();
        self.door.send();
    }

    /// Moves the robot, which is the first part of a turn.
    pub fn move_on(&mut self, passed_ms: u64) {
        self.tap.show(|observer| observer.turned(Turn::Moved(passed_ms)));
        self.moved_ms += passed_ms;
        self.door.step(self.moved_ms);
    }

    /// Lets the bridge decide, which is the last part of a turn.
    pub fn decide(&mut self, now_ms: u64) -> Vec<BridgeEvent> {
        let refusal = self.door.refusal();
        if self.bridge.is_news_of_robot(refusal.as_deref()) {
            self.tap.show(|observer| observer.refused(now_ms, refusal.as_deref()));
            self.bridge.robot_refuses(refusal, now_ms, &mut self.door);
        }
        self.tap.show(|observer| observer.turned(Turn::Decided(now_ms)));
        self.bridge.step(now_ms, &mut self.door);
        // The robot now knows the time.
        // If anything has halted in this turn, the plan has already been discarded.
        if self.door.plan_is_ready() {
            self.tap.show(|observer| observer.turned(Turn::Planned));
            self.door.begin_planned();
        }
        self.door.send();
        self.bridge.take_events()
    }

    /// Shows the events and the current state to observers.
    pub fn show(&mut self, events: &[SessionEvent], now_ms: u64) {
        if self.tap.is_idle() {
            return;
        }
        for event in events {
            self.tap.show(|observer| observer.happened(event));
        }
        let now = Now { time_ms: now_ms, bridge: &self.bridge, robot: &self.door };
        self.tap.show(|observer| observer.state(&now));
    }

    /// Advances the time to `now_ms`; call it every few milliseconds.
    /// `ready` lists the hands whose links accept bytes now.
    /// Returns the events. Data to be sent waits in [`Engine::take_outgoing`].
    pub fn advance(&mut self, now_ms: u64, ready: impl Into<PerHand<bool>>) -> Vec<SessionEvent> {
        let ready = ready.into();
        // The robot moves first. After a long suspension of this program, it has already stopped by itself.
        self.move_on(now_ms.saturating_sub(self.moved_ms));
        let mut happened = Vec::new();
        for hand in Hand::BOTH {
            self.play(hand, now_ms, &mut happened);
            if ready[hand] || !self.sources[hand].is_link() {
                let wanted = [self.bridge.poll(hand, now_ms), self.bridge.ping(hand, now_ms)];
                for message in wanted.into_iter().flatten() {
                    self.send(hand, &message, now_ms);
                }
            }
        }
        let events = self.decide(now_ms);
        for event in &events {
            if let EventKind::HandStarted { hand, .. } = event.kind {
                let wants = match hand {
                    // Hands inside this program keep their own thresholds.
                    Hand::Left => self.tilt.is_some() && self.sources[hand].is_link(),
                    // In one-handed mode, the same request lets a right board send its tilt.
                    Hand::Right => self.bridge.is_one_handed(),
                };
                self.want(hand, if wants { Wanted::Thresholds } else { Wanted::Classify });
            }
            if let EventKind::Gesture {
                label,
                outcome: GestureOutcome::NoMotion | GestureOutcome::NotArmed,
                ..
            } = &event.kind
                && !self.bridge.is_shown()
                && let Some((_, mark)) = self.marks.iter().find(|(marking, _)| same_label(marking, label))
            {
                self.mark(*mark, MarkedBy::Gesture, now_ms);
            }
        }
        self.feel(&events, ready.right, now_ms);
        for hand in Hand::BOTH {
            if ready[hand] || !self.sources[hand].is_link() {
                self.set_up(hand, now_ms);
            }
        }
        let events: Vec<SessionEvent> = events
            .into_iter()
            .map(SessionEvent::Bridge)
            .chain(happened)
            .chain(self.marked.drain(..))
            .collect();
        self.show(&events, now_ms);
        events
    }

    /// Returns whether all played recordings have ended.
    pub fn ended(&self) -> bool {
        self.sources.iter().all(|(_, source)| source.ended())
    }

    /// Returns the frames that wait for a hand's board.
    pub fn take_outgoing(&mut self, hand: Hand) -> Vec<Vec<u8>> {
        match &mut self.sources[hand] {
            Source::Link(frames) => std::mem::take(frames),
            _ => Vec::new(),
        }
    }

    fn want(&mut self, hand: Hand, what: Wanted) {
        if what == Wanted::Classify && !self.sources[hand].is_link() {
            // Hands inside this program have no record mode.
            self.set_ups[hand] = None;
            return;
        }
        self.request = self.request.wrapping_add(1);
        self.set_ups[hand] = Some(SetUp { request: self.request, sent_ms: None, what });
    }

    /// Sends thresholds to a board that has just started, and ends record mode on any board.
    /// The message is repeated until the board answers.
    fn set_up(&mut self, hand: Hand, now_ms: u64) {
        let Some(SetUp { request, what, .. }) = self.set_ups[hand] else { return };
        if self.bridge.last_ack(hand).is_some_and(|ack| ack.request == request) {
            self.set_ups[hand] = None;
            if what == Wanted::Thresholds {
                self.want(hand, Wanted::Classify);
            }
        }
        let Some(set_up) = &mut self.set_ups[hand] else { return };
        if set_up.sent_ms.is_some_and(|sent| now_ms.saturating_sub(sent) < SET_UP_INTERVAL_MS) {
            return;
        }
        set_up.sent_ms = Some(now_ms);
        let request = set_up.request;
        let message = match set_up.what {
            Wanted::Thresholds => {
                HostMessage::SetThresholds { request, thresholds: self.tilt.unwrap_or_default() }
            }
            Wanted::Classify => HostMessage::SetMode { request, mode: Mode::Classify },
        };
        self.send(hand, &message, now_ms);
    }

    fn feel(&mut self, events: &[BridgeEvent], ready: bool, now_ms: u64) {
        let knows_how = ready && self.bridge.link(Hand::Right).minor() >= feel::SINCE_MINOR;
        if let Some(signal) = feel::signal(events).filter(|_| self.vibrates && knows_how) {
            self.send(Hand::Right, &HostMessage::Feel { signal }, now_ms);
        }
    }

    fn send(&mut self, hand: Hand, message: &HostMessage<'_>, now_ms: u64) {
        let mut buffer = [0; HOST_FRAME_MAX];
        let Ok(frame) = encode_host(message, &mut buffer) else { return };
        self.tap.show(|observer| observer.sent(now_ms, hand, frame));
        let mut wire = Vec::new();
        match &mut self.sources[hand] {
            Source::Nobody => {}
            // The delimiter terminates any noise on the line.
            // Without answers to pings, the bridge is never armed.
            Source::Link(frames) => frames.push([&[DELIMITER], frame].concat()),
            Source::Here { hand, .. } => hand.receive(frame, now_ms, &mut wire),
        }
        if !wire.is_empty() {
            self.receive(hand, &wire, now_ms);
        }
    }

    fn play(&mut self, hand: Hand, now_ms: u64, happened: &mut Vec<SessionEvent>) {
        let mut wire = Vec::new();
        if let Source::Here { hand: played, end_noted } = &mut self.sources[hand] {
            played.step(now_ms, &mut wire);
            if let Some(sample) = played.sample().filter(|_| !self.tap.is_idle()) {
                self.tap.show(|observer| observer.sampled(now_ms, &sample));
            }
            if played.ended() && !*end_noted {
                *end_noted = true;
                happened.push(SessionEvent::RecordingEnded { time_ms: now_ms, hand });
            }
        }
        if !wire.is_empty() {
            self.receive(hand, &wire, now_ms);
        }
    }
}
