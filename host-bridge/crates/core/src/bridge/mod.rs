//! The bridge connects links, safety and intents to a robot. Its inputs are bytes and the time.

mod accepted;
mod clutch;
mod driving;
mod events;
mod judged;
mod one_handed;
mod restriction;
mod wearer;

pub use accepted::{Acceptance, Accepted};
pub use events::{BridgeEvent, Drops, EventKind, GestureOutcome};
pub use restriction::Restriction;
pub use wearer::{Nearly, Prompt};

use shared_proto::message::{Ack, Heading, HostMessage, LeftState, health};

use accepted::Acceptances;
use host_robot::{Busy, DRIVE_INTERVAL_MS, DVec3, Door, MotionName, NotStarted, Part, Report, Twist};
use judged::{rests, without_figures};
use wearer::{NEARLY_SHOWN_MS, Seen};

use crate::almost::Almost;
use crate::engine::FOREIGN_REQUESTS;
use crate::intent::{Caps, MotionMap, SpeedRules};
use crate::jog::{JogRules, Lift};
use crate::link::{HandLink, Heard, NewGesture, RightReport};
use crate::one_handed::TiltHand;
use crate::safety::{self, Action, Hand, Ignored, PerHand, Safety, SafetyTimes, State};
use crate::tilt::TiltDrive;
use crate::{describe, doubt};

/// The bridge.
#[derive(Clone, Debug)]
pub struct Bridge {
    links: PerHand<HandLink>,
    safety: Safety,
    caps: Caps,
    drive: TiltDrive,
    map: MotionMap,
    drops: Drops,
    scores: Vec<f32>,
    almost: Almost,
    wearer: Seen,
    left_state: LeftState,
    right_health: u8,
    /// The right hand as a left hand, in one-handed mode.
    tilt_hand: Option<TiltHand>,
    /// Whether the newest right state draws, or reports a gesture.
    draws: bool,
    was_armed: bool,
    driven: (Twist, u64),
    events: Vec<BridgeEvent>,
    heard: Vec<Heard>,
    last_acks: PerHand<Option<Ack>>,
    /// The health flags that were last reported.
    told_health: PerHand<u8>,
    acceptances: Acceptances,
    /// The reason why the robot itself refuses to move.
    refusal: Option<String>,
    /// Restrictions of this session.
    restriction: Option<Restriction>,
    jog: JogRules,
    lift: Lift,
    /// The last speed that was requested of the tool.
    jogged_m_s: DVec3,
}

impl Bridge {
    /// Creates a bridge that waits for its hands.
    pub fn new(map: MotionMap) -> Self {
        Bridge::with(map, SpeedRules::default(), SafetyTimes::default())
    }

    /// Like `new`, but with other limits.
    pub fn with(map: MotionMap, speed: SpeedRules, times: SafetyTimes) -> Self {
        Bridge {
            links: PerHand::of(HandLink::new),
            safety: Safety::with(times),
            caps: Caps::new(speed),
            drive: TiltDrive::DEFAULT,
            map,
            drops: Drops::default(),
            scores: Vec::new(),
            almost: Almost::default(),
            wearer: Seen::default(),
            left_state: LeftState { heading: Heading::Neutral, ..LeftState::default() },
            right_health: 0,
            tilt_hand: None,
            draws: false,
            was_armed: false,
            driven: (Twist::ZERO, 0),
            events: Vec::new(),
            heard: Vec::new(),
            last_acks: PerHand::default(),
            told_health: PerHand::default(),
            acceptances: Acceptances::default(),
            refusal: None,
            restriction: None,
            jog: JogRules::off(),
            lift: Lift::default(),
            jogged_m_s: DVec3::ZERO,
        }
    }

    /// Sets the rules by which the base follows the left hand's tilt.
    #[must_use]
    pub fn driving(self, drive: TiltDrive) -> Self {
        Bridge { drive, ..self }
    }

    /// Sets the robot's reason for refusing to move from now on; `None` ends the refusal.
    pub fn robot_refuses(&mut self, refusal: Option<String>, now_ms: u64, robot: &mut dyn Door) {
        let kind = match &refusal {
            Some(reason) => EventKind::RobotRefuses { reason: reason.clone() },
            None => EventKind::RobotReady,
        };
        self.note(now_ms, kind);
        let refuses = refusal.is_some();
        self.refusal = refusal;
        self.apply(safety::Event::Robot { refuses }, now_ms, robot);
    }

    /// Returns whether this text is a new message.
    /// A text is not new if it differs from the last message only in its numbers, which change continually.
    pub fn is_news_of_robot(&self, refusal: Option<&str>) -> bool {
        match (self.refusal(), refusal) {
            (Some(known), Some(said)) => !without_figures(known).eq(without_figures(said)),
            (known, said) => known != said,
        }
    }

    /// Returns the reason why the robot itself refuses to move, or `None` if it does not refuse.
    pub fn refusal(&self) -> Option<&str> {
        self.refusal.as_deref()
    }

    /// Prevents all motion until this hand has sent a hello.
    #[must_use]
    pub fn awaiting(mut self, hand: Hand) -> Self {
        self.safety.await_hand(hand);
        self
    }

    /// Removes motions that the robot does not have.
    #[must_use]
    pub fn known_to(mut self, knows: impl Fn(&MotionName) -> bool) -> Self {
        self.map = self.map.known_to(|motion| *motion == *MotionName::END_ARM || knows(motion));
        self
    }

    /// Processes bytes of one hand's link, in portions of any size.
    pub fn receive(&mut self, hand: Hand, bytes: &[u8], now_ms: u64, robot: &mut dyn Door) {
        let mut heard = std::mem::take(&mut self.heard);
        self.link_mut(hand).receive(bytes, now_ms, &mut heard);
        for message in heard.drain(..) {
            self.handle(hand, message, now_ms, robot);
        }
        self.heard = heard;
    }

    /// Advances the time. Call it every few milliseconds, even without new bytes.
    pub fn step(&mut self, now_ms: u64, robot: &mut dyn Door) {
        self.apply(safety::Event::Tick, now_ms, robot);
        for hand in Hand::BOTH {
            // Until the first state, the dead-man limits the wait for the first answer to a ping to 250 ms.
            if self.safety.live(hand) && self.link(hand).stopped_answering(now_ms) {
                self.apply(safety::Event::Unanswered(hand), now_ms, robot);
            }
        }
        for report in robot.take_reports() {
            self.acceptances.see(&report);
            let kind = match report {
                Report::Accepted(part) => match self.acceptances.accept(part, now_ms) {
                    Some(age_ms) => EventKind::Accepted { part, age_ms },
                    None => continue,
                },
                Report::MotionEnded { motion, reached } => EventKind::MotionEnded { motion, reached },
                Report::MotionRefused { motion, reason } => {
                    self.drops.gestures_refused += 1;
                    EventKind::MotionRefused { motion, reason }
                }
                Report::BaseHeld { reason } => EventKind::BaseHeld { reason },
                Report::BaseFree => EventKind::BaseFree,
                Report::Note(text) => EventKind::Robot { text },
            };
            self.note(now_ms, kind);
        }
        let due = now_ms.saturating_sub(self.driven.1) >= DRIVE_INTERVAL_MS;
        // Before the first neutral, nothing is sent at all.
        if self.was_armed && (due || self.twist() != self.driven.0) {
            self.drive(now_ms, robot);
        }
        self.move_tool(due, now_ms, robot);
    }

    /// Returns the message to send to a hand's board now, if any.
    pub fn poll(&mut self, hand: Hand, now_ms: u64) -> Option<HostMessage<'static>> {
        self.link_mut(hand).poll(now_ms)
    }

    /// Returns the ping that is due for a hand's board. Call it only if the ping can be sent immediately.
    pub fn ping(&mut self, hand: Hand, now_ms: u64) -> Option<HostMessage<'static>> {
        self.link_mut(hand).ping(now_ms)
    }

    /// Returns the board's newest answer to one of the session's own requests; hellos and pongs do not count.
    pub fn last_ack(&self, hand: Hand) -> Option<Ack> {
        self.last_acks[hand]
    }

    /// Stops the robot on behalf of the operator (a key or a button).
    pub fn stop_key(&mut self, now_ms: u64, robot: &mut dyn Door) {
        self.apply(safety::Event::StopKey, now_ms, robot);
    }

    /// Ends only the arm's motion, while the base continues.
    pub fn end_arm_key(&mut self, now_ms: u64, robot: &mut dyn Door) {
        robot.halt_arm();
        self.note(now_ms, EventKind::ArmEnded);
        self.take_back(now_ms, robot);
    }

    /// Processes the release key, pressed and confirmed. It has an effect only if no right hand is connected.
    pub fn release_key(&mut self, now_ms: u64, robot: &mut dyn Door) {
        self.apply(safety::Event::ReleaseKey, now_ms, robot);
    }

    /// Returns the events since the last call.
    pub fn take_events(&mut self) -> Vec<BridgeEvent> {
        std::mem::take(&mut self.events)
    }

    /// The safety machine.
    pub fn safety(&self) -> &Safety {
        &self.safety
    }

    /// The link of one hand.
    pub fn link(&self, hand: Hand) -> &HandLink {
        &self.links[hand]
    }

    /// The caps now.
    pub fn caps(&self) -> Caps {
        self.caps
    }

    /// Returns the commanded speed of the base: zero unless armed.
    pub fn twist(&self) -> Twist {
        self.caps.twist_of(self.safety.pointing(), &self.drive)
    }

    /// Returns the numbers of dropped inputs so far.
    pub fn drops(&self) -> Drops {
        self.drops
    }

    /// Returns the ages of samples when the robot reported their effect.
    pub fn accepted(&self) -> Accepted {
        self.acceptances.seen
    }

    /// Returns the right hand's newest scores, one per label of its model.
    pub fn scores(&self) -> &[f32] {
        &self.scores
    }

    /// Returns the left hand's newest pitch and roll in milliradians and its heading.
    /// These values are returned even if they have no effect.
    pub fn left_hand(&self) -> (i16, i16, Heading) {
        let LeftState { pitch_mrad, roll_mrad, heading, .. } = self.left_state;
        (pitch_mrad, roll_mrad, heading)
    }

    /// Returns the left hand's newest state as received, late or not.
    pub fn left_state(&self) -> &LeftState {
        &self.left_state
    }

    /// Returns the health flags of the right hand's newest state.
    pub fn right_health(&self) -> u8 {
        self.right_health
    }

    fn link_mut(&mut self, hand: Hand) -> &mut HandLink {
        &mut self.links[hand]
    }

    fn note(&mut self, time_ms: u64, kind: EventKind) {
        self.events.push(BridgeEvent { time_ms, kind });
    }

    fn handle(&mut self, hand: Hand, heard: Heard, now_ms: u64, robot: &mut dyn Door) {
        match heard {
            Heard::Started(identity) => {
                self.note(now_ms, EventKind::HandStarted { hand, identity });
                if hand == Hand::Right {
                    self.scores.clear();
                    self.almost = Almost::default();
                }
                self.apply(safety::Event::Started(hand), now_ms, robot);
                self.one_hand_started(hand, now_ms, robot);
            }
            Heard::Unusable(problem) => {
                self.note(now_ms, EventKind::HandUnusable { hand, problem });
                self.apply(safety::Event::Unusable(hand), now_ms, robot);
                if self.is_one_handed() {
                    self.apply(safety::Event::Unusable(Hand::Left), now_ms, robot);
                }
            }
            Heard::Model(model) => {
                self.check_rest(&model.labels, now_ms, robot);
                let without = self.map.without_motion(&model.labels);
                let without = without.into_iter().filter(|label| !self.is_clutch(label));
                let without_motion = without.map(str::to_owned).collect();
                self.note(now_ms, EventKind::Model { model, without_motion });
            }
            Heard::Left { age_ms, state, index_bends, middle_bends } => {
                self.tell_health(hand, state.health, now_ms);
                self.left(age_ms, state, [index_bends, middle_bends], now_ms, robot);
            }
            Heard::Tilt(report) => self.tilted(&report, now_ms, robot),
            Heard::Right(report) => self.right(report, now_ms, robot),
            Heard::Fault(fault) => {
                let fault = format!("{:?} (detail {:#x})", fault.kind, fault.detail);
                self.note(now_ms, EventKind::BoardFault { hand, fault });
            }
            Heard::Pairing(pairing) => {
                self.note(now_ms, EventKind::Pairing { hand, text: describe::pairing(pairing) });
            }
            // Answers to other programs' requests must not hide the answers to the session's own requests.
            Heard::Ack(ack) if ack.request < FOREIGN_REQUESTS => {
                self.last_acks[hand] = Some(ack);
                self.check_answer(hand, ack.result, now_ms, robot);
            }
            Heard::Ack(_) => {}
        }
    }

    /// Reports why a hand is in doubt, before this halts anything.
    fn tell_health(&mut self, hand: Hand, flags: u8, now_ms: u64) {
        if std::mem::replace(&mut self.told_health[hand], flags) != flags {
            self.note(now_ms, EventKind::HandHealth { hand, flags, reasons: doubt::reasons(flags) });
        }
    }

    fn right(&mut self, report: RightReport, now_ms: u64, robot: &mut dyn Door) {
        self.tell_health(Hand::Right, report.health, now_ms);
        let labels = self.links.right.model().map_or(&[][..], |model| &model.labels);
        let resting = rests(labels, &report.scores);
        let label = |new: NewGesture| labels.get(usize::from(new.label)).cloned();
        let named = report.gesture.and_then(|new| label(new).map(|label| (new, label)));
        if let Some(new) = report.gesture {
            let unnamed = if named.is_some() { new.unnamed } else { new.unnamed.saturating_add(1) };
            self.drops.gestures_unnamed += u32::from(unnamed);
        }
        let acts = named.as_ref().filter(|_| !self.wearer.is_shown);
        // The safety machine accepts gestures only while armed, so the clutch is no gesture for it.
        let clutch = acts.filter(|(_, label)| self.is_clutch(label)).map(|(new, _)| new.age_ms);
        let gesture = acts.filter(|_| clutch.is_none()).map(|(new, label)| safety::Gesture {
            label: new.label,
            age_ms: new.age_ms,
            releases: self.map.motion(label).is_some_and(|motion| *motion == *MotionName::HOME),
        });
        let almost = self.almost.see(labels, &report.scores, report.gesture.is_some());
        if let Some((label, confidence)) = almost {
            let label = labels[label].clone();
            let nearly = Nearly { label: label.clone(), confidence };
            self.wearer.nearly = Some((nearly, now_ms.saturating_add(NEARLY_SHOWN_MS)));
            self.note(now_ms, EventKind::Almost { label, confidence });
        }
        self.scores = report.scores;
        self.right_health = report.health;
        self.draws = !resting || report.gesture.is_some();
        let event = safety::Event::Right {
            age_ms: report.age_ms,
            prompt: self.links.right.is_prompt(self.safety.times().prompt_ms(), now_ms),
            healthy: health::is_fit(report.health),
            resting: resting && clutch.is_none(),
            gesture,
        };
        let outcome = self.apply(event, now_ms, robot);
        let outcome = clutch.map(|age_ms| self.clutch(age_ms, now_ms, robot)).or(outcome);
        if let Some((new, label)) = named {
            self.wearer.nearly = None;
            let outcome = match outcome {
                _ if self.wearer.is_shown => GestureOutcome::NotArmed,
                outcome => outcome.unwrap_or(GestureOutcome::Late),
            };
            match &outcome {
                GestureOutcome::Started(_) => self.acceptances.ask(Part::Arm, new.age_ms, now_ms),
                GestureOutcome::Released
                | GestureOutcome::EndedArm
                | GestureOutcome::Lent
                | GestureOutcome::TakenBack => {}
                GestureOutcome::Busy(_) => self.drops.gestures_while_busy += 1,
                GestureOutcome::Refused(_) => self.drops.gestures_refused += 1,
                GestureOutcome::NoMotion => self.drops.gestures_without_motion += 1,
                GestureOutcome::Late => self.drops.late_gestures += 1,
                GestureOutcome::NotArmed => self.drops.gestures_while_not_armed += 1,
            }
            let event = EventKind::Gesture {
                label,
                confidence: new.confidence,
                window_end_board_ms: new.window_end_ms,
                age_ms: new.age_ms,
                outcome,
            };
            self.note(now_ms, event);
        }
    }

    /// Passes an event to the safety machine and executes its actions.
    /// Returns the effect of a gesture, if there was one.
    fn apply(&mut self, event: safety::Event, now_ms: u64, robot: &mut dyn Door) -> Option<GestureOutcome> {
        let mut outcome = None;
        for action in self.safety.step(event, now_ms) {
            match action {
                Action::Halt(reason) => {
                    robot.halt();
                    self.acceptances.forget();
                    self.driven = (Twist::ZERO, now_ms);
                    (self.jogged_m_s, self.lift) = (DVec3::ZERO, Lift::default());
                    let reason = self.worn(reason);
                    self.note(now_ms, EventKind::Halt { reason });
                }
                Action::ResetCaps => {
                    self.caps = Caps::new(self.caps.rules);
                    robot.pace(self.caps.pace);
                }
                Action::Entered(state) => {
                    self.was_armed |= state == State::Armed;
                    self.note(now_ms, EventKind::State { state });
                }
                Action::Released => {
                    outcome = Some(GestureOutcome::Released);
                    self.note(now_ms, EventKind::Released);
                }
                Action::Lent(lent) => {
                    self.lift = Lift::default();
                    self.note(now_ms, EventKind::Jogging { hand: self.driving_hand(), lent });
                }
                Action::Bends { index, middle } => self.bends(index, middle, now_ms, robot),
                Action::Gesture(gesture) => outcome = Some(self.start(gesture.label, now_ms, robot)),
                Action::Ignored(what) => {
                    match what {
                        Ignored::LateState(_) => self.drops.late_states += 1,
                        Ignored::ImpossibleBends => self.drops.bends_impossible += 1,
                        Ignored::BendsWhileNotArmed => self.drops.bends_while_not_armed += 1,
                        Ignored::LateGesture => outcome = Some(GestureOutcome::Late),
                        Ignored::GestureWhileNotArmed => outcome = Some(GestureOutcome::NotArmed),
                        Ignored::ReleaseKey => {}
                    }
                    // Late states come in bursts, so only their count is reported.
                    if !matches!(what, Ignored::LateState(_)) {
                        self.note(now_ms, EventKind::Ignored { what });
                    }
                }
            }
        }
        outcome
    }

    fn start(&mut self, label: u8, now_ms: u64, robot: &mut dyn Door) -> GestureOutcome {
        let name = self.links.right.model().and_then(|model| model.labels.get(usize::from(label)));
        let Some(motion) = name.and_then(|name| self.map.motion(name)).cloned() else {
            return GestureOutcome::NoMotion;
        };
        if motion == *MotionName::END_ARM {
            robot.halt_arm();
            self.take_back(now_ms, robot);
            return GestureOutcome::EndedArm;
        }
        let started = match &self.restriction {
            Some(restriction) => Err(NotStarted::Refused(restriction.text.clone())),
            None => robot.start_motion(&motion),
        };
        match started {
            Ok(()) => GestureOutcome::Started(motion),
            Err(NotStarted::Busy(Busy(running))) => GestureOutcome::Busy(running),
            Err(NotStarted::Refused(reason)) => self.refuse(motion, reason, now_ms),
        }
    }
}
