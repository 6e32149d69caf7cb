//! A session in virtual time, which runs the engine one millisecond at a time.
//!
//! This code never reads a clock, so a session has the same result at any speed.

use host_robot::{Door, MotionName, Odometry, SceneObject, Twist};
use serde::Serialize;

use crate::bridge::{Bridge, BridgeEvent, Drops, EventKind, GestureOutcome};
use crate::engine::Engine;
use crate::intent::{Caps, MotionMap};
use crate::latency::{DelaySummary, Delays};
use crate::link::LinkCounters;
use crate::observe::{Now, SessionEvent, Tap};
use crate::safety::{HaltReason, Hand, PerHand};
use crate::source::Source;

/// Time for the robot to come to rest after the end of the last recording.
const TAIL_MS: u64 = 3000;

/// See the module documentation.
pub struct Session<'b, D> {
    engine: Engine<'b, D>,
    now_ms: u64,
    takes_part: PerHand<bool>,
    gesture_to_arm: Delays,
    tilt_to_wheels: Delays,
    ended_ms: Option<u64>,
    log: Vec<BridgeEvent>,
}

impl<'b, D: Door> Session<'b, D> {
    /// Creates a session with hands (either may be missing), a map of gestures, and a robot behind its door.
    pub fn new(sources: impl Into<PerHand<Source<'b>>>, map: MotionMap, door: D) -> Self {
        let sources = sources.into();
        let takes_part = PerHand::of(|hand| sources[hand].is_there());
        Session {
            engine: Engine::new(Bridge::new(map), door, sources, 0),
            now_ms: 0,
            takes_part,
            gesture_to_arm: Delays::default(),
            tilt_to_wheels: Delays::default(),
            ended_ms: None,
            log: Vec::new(),
        }
    }

    /// Returns the tap, where observers are attached.
    pub fn tap_mut(&mut self) -> &mut Tap {
        self.engine.tap_mut()
    }

    /// Returns the current state for observers.
    pub fn now(&self) -> Now<'_> {
        self.engine.now(self.now_ms)
    }

    /// Virtual time.
    pub fn now_ms(&self) -> u64 {
        self.now_ms
    }

    /// The bridge.
    pub fn bridge(&self) -> &Bridge {
        self.engine.bridge()
    }

    /// The door to the robot.
    pub fn door(&self) -> &D {
        self.engine.door()
    }

    /// Presses the operator's stop key.
    pub fn stop_key(&mut self) {
        self.engine.stop_key(self.now_ms);
    }

    /// Presses and confirms the operator's release key.
    pub fn release_key(&mut self) {
        self.engine.release_key(self.now_ms);
    }

    fn at_rest(&self) -> bool {
        let picture = self.door().picture();
        picture.arm.at_rest() && picture.wheels_rad_s == [0.0; 2]
    }

    /// Returns whether all recordings have ended and the robot rests or has run out of time.
    pub fn finished(&self) -> bool {
        self.ended_ms.is_some_and(|ended_ms| {
            let passed_ms = self.now_ms - ended_ms;
            // The robot is considered at rest only after the dead-man's timeout of 250 ms.
            passed_ms >= TAIL_MS || (passed_ms > 500 && self.at_rest())
        })
    }

    /// Advances by one millisecond (the first call is at time 0). Returns the events of this step.
    pub fn step(&mut self) -> Vec<SessionEvent> {
        let events = self.engine.advance(self.now_ms, PerHand::default());
        let picture = self.door().picture();
        if !picture.arm.at_rest() {
            self.gesture_to_arm.moved(self.now_ms);
        }
        let wheels_rest = picture.wheels_rad_s == [0.0; 2];
        if !wheels_rest {
            self.tilt_to_wheels.moved(self.now_ms);
        }
        for event in &events {
            if let SessionEvent::Bridge(event) = event {
                self.time(event, wheels_rest);
                self.log.push(event.clone());
            }
        }
        self.now_ms += 1;
        if self.ended_ms.is_none() && self.engine.ended() {
            self.ended_ms = Some(self.now_ms);
        }
        events
    }

    /// Starts the measurement of a delay if the event causes motion.
    fn time(&mut self, event: &BridgeEvent, wheels_rest: bool) {
        // The boards' clocks start with the session, so their times equal the laptop's.
        match &event.kind {
            EventKind::Gesture { outcome: GestureOutcome::Started(_), window_end_board_ms, .. } => {
                self.gesture_to_arm.begin((*window_end_board_ms).into());
            }
            EventKind::MotionEnded { .. } => self.gesture_to_arm.cancel(),
            EventKind::Heading { twist, sample_board_ms, .. } => {
                // Only a start from rest has a visible first motion.
                self.tilt_to_wheels.cancel();
                if wheels_rest && *twist != Twist::ZERO {
                    self.tilt_to_wheels.begin((*sample_board_ms).into());
                }
            }
            _ => {}
        }
    }

    /// The session's result.
    pub fn summary(&self) -> Summary {
        let mut gestures = Vec::new();
        let mut poses_reached = Vec::new();
        let mut halts = Vec::new();
        let (mut stops, mut releases) = (0, 0);
        for event in &self.log {
            let time_ms = event.time_ms;
            match &event.kind {
                EventKind::Gesture { label, confidence, outcome, .. } => gestures.push(GestureRecord {
                    time_ms,
                    label: label.clone(),
                    confidence: *confidence,
                    outcome: outcome.clone(),
                }),
                EventKind::MotionEnded { motion, reached: true } => {
                    poses_reached.push(PoseRecord { time_ms, motion: motion.clone() });
                }
                EventKind::Halt { reason } => {
                    stops += u32::from(*reason == HaltReason::OperatorStop);
                    halts.push(HaltRecord { time_ms, reason: *reason });
                }
                EventKind::Released => releases += 1,
                _ => {}
            }
        }
        let bridge = self.bridge();
        let counters = |hand: Hand| self.takes_part[hand].then(|| bridge.link(hand).counters());
        let picture = self.door().picture();
        Summary {
            seconds: self.now_ms as f64 / 1000.0,
            gestures,
            poses_reached,
            stops,
            releases,
            halts,
            caps: bridge.caps(),
            odometry: picture.odometry,
            objects: picture.objects,
            at_rest: self.at_rest(),
            frames: Frames { left: counters(Hand::Left), right: counters(Hand::Right) },
            drops: bridge.drops(),
            robot_timeouts: picture.timeouts,
            latency: Latency {
                window_end_to_arm: self.gesture_to_arm.summary(),
                sample_to_wheels: self.tilt_to_wheels.summary(),
            },
            events: self.log.clone(),
        }
    }
}

/// The result of a session as one JSON object.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Virtual time passed.
    pub seconds: f64,
    /// All gesture events in the order of occurrence.
    pub gestures: Vec<GestureRecord>,
    /// Arm motions that reached their pose, in the order of occurrence.
    pub poses_reached: Vec<PoseRecord>,
    /// Operator's stops.
    pub stops: u32,
    /// Releases of them.
    pub releases: u32,
    /// Every halt in the order of occurrence.
    pub halts: Vec<HaltRecord>,
    /// The caps at the end of the session.
    pub caps: Caps,
    /// The state of the base at the end.
    pub odometry: Odometry,
    /// Final positions of the scene's objects.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub objects: Vec<SceneObject>,
    /// Whether the robot rests at the end.
    pub at_rest: bool,
    /// Statistics of the received frames.
    pub frames: Frames,
    /// What was dropped.
    pub drops: Drops,
    /// Number of times the robot had to stop by itself.
    pub robot_timeouts: u32,
    /// Delays, in virtual time.
    pub latency: Latency,
    /// All events in the order of occurrence.
    pub events: Vec<BridgeEvent>,
}

/// One gesture event.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GestureRecord {
    /// Time at which the bridge received the gesture.
    pub time_ms: u64,
    /// Its name.
    pub label: String,
    /// 0 to 1.
    pub confidence: f32,
    /// What followed.
    pub outcome: GestureOutcome,
}

/// One pose reached.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PoseRecord {
    /// When.
    pub time_ms: u64,
    /// The name of the motion.
    pub motion: MotionName,
}

/// One halt.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct HaltRecord {
    /// When.
    pub time_ms: u64,
    /// Why.
    pub reason: HaltReason,
}

/// Link counters of both hands; `null` for a hand that does not take part.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Frames {
    /// The counters of the left hand.
    pub left: Option<LinkCounters>,
    /// The counters of the right hand.
    pub right: Option<LinkCounters>,
}

/// Delays.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Latency {
    /// Time from the end of the deciding window to the arm's first joint velocity.
    pub window_end_to_arm: DelaySummary,
    /// Time from the sample that starts a command to the first wheel speed (only for starts from rest).
    pub sample_to_wheels: DelaySummary,
}
