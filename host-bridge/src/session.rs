//! A session in virtual time: boards, wires, bridge and simulated robot, one millisecond after the other.
//!
//! Nothing here looks at a clock, so a session gives the same result at any speed.

use serde::Serialize;
use shared_proto::frame::{HOST_FRAME_MAX, encode_host};

use crate::arm::ArmMotion;
use crate::base::Odometry;
use crate::bridge::{Bridge, BridgeEvent, Drops, EventKind, GestureOutcome};
use crate::hands::Board;
use crate::intent::{Caps, MotionMap};
use crate::latency::{DelaySummary, Delays};
use crate::link::LinkCounters;
use crate::observe::{Now, OperatorKey, Tap, Turn};
use crate::robot::Robot;
use crate::safety::{HaltReason, Hand};
use crate::sim::{SimConfig, Simulator};
use crate::wire::{Pipe, SERIAL_115200};

/// After the last recording has ended, the robot has this long to come to rest.
const TAIL_MS: u64 = 3000;

/// One hand's board and the wires to it.
struct Line<'b> {
    hand: Hand,
    board: Box<dyn Board + 'b>,
    up: Pipe,
    down: Pipe,
    ended_noted: bool,
}

/// See the module.
pub struct Session<'b> {
    now_ms: u64,
    lines: Vec<Line<'b>>,
    bridge: Bridge,
    robot: Simulator,
    gesture_to_arm: Delays,
    tilt_to_wheels: Delays,
    ended_ms: Option<u64>,
    log: Vec<BridgeEvent>,
    tap: Tap,
}

impl<'b> Session<'b> {
    /// Boards, of which either may be missing, a bridge with this map, and a robot with nothing around it.
    pub fn new(
        left: Option<Box<dyn Board + 'b>>,
        right: Option<Box<dyn Board + 'b>>,
        map: MotionMap,
    ) -> Self {
        Session::with_robot(left, right, map, Simulator::new(SimConfig::default()))
    }

    /// The same with a robot of your own.
    pub fn with_robot(
        left: Option<Box<dyn Board + 'b>>,
        right: Option<Box<dyn Board + 'b>>,
        map: MotionMap,
        robot: Simulator,
    ) -> Self {
        let line = |hand, board: Option<Box<dyn Board + 'b>>| {
            board.map(|board| Line {
                hand,
                board,
                up: Pipe::new(SERIAL_115200),
                down: Pipe::new(SERIAL_115200),
                ended_noted: false,
            })
        };
        Session {
            now_ms: 0,
            lines: [line(Hand::Left, left), line(Hand::Right, right)].into_iter().flatten().collect(),
            bridge: Bridge::new(map),
            robot,
            gesture_to_arm: Delays::default(),
            tilt_to_wheels: Delays::default(),
            ended_ms: None,
            log: Vec::new(),
            tap: Tap::default(),
        }
    }

    /// Where observers look on.
    pub fn tap_mut(&mut self) -> &mut Tap {
        &mut self.tap
    }

    /// The state now, as observers see it.
    pub fn now(&self) -> Now<'_> {
        Now { time_ms: self.now_ms, bridge: &self.bridge, robot: &self.robot }
    }

    /// Virtual time.
    pub fn now_ms(&self) -> u64 {
        self.now_ms
    }

    /// The bridge.
    pub fn bridge(&self) -> &Bridge {
        &self.bridge
    }

    /// The robot.
    pub fn robot(&self) -> &Simulator {
        &self.robot
    }

    /// The operator presses the stop key now.
    pub fn stop_key(&mut self) {
        self.tap.show(|observer| observer.operated(self.now_ms, OperatorKey::Stop));
        self.bridge.stop_key(self.now_ms, &mut self.robot);
    }

    /// The operator has pressed and confirmed the release key now.
    pub fn release_key(&mut self) {
        self.tap.show(|observer| observer.operated(self.now_ms, OperatorKey::Release));
        self.bridge.release_key(self.now_ms, &mut self.robot);
    }

    /// All recordings are over and the robot rests, or has had its time to.
    pub fn finished(&self) -> bool {
        self.ended_ms.is_some_and(|ended_ms| {
            let passed_ms = self.now_ms - ended_ms;
            // The dead-man needs its 250 ms before rest means anything.
            passed_ms >= TAIL_MS || (passed_ms > 500 && self.robot.at_rest())
        })
    }

    /// Lets one millisecond pass; what happened in it.
    pub fn step(&mut self) -> Vec<SessionEvent> {
        let now_ms = self.now_ms;
        let mut ended = Vec::new();
        let mut bytes = Vec::new();
        for line in &mut self.lines {
            bytes.clear();
            line.board.step(now_ms, &mut bytes);
            if !self.tap.is_idle()
                && let Some(sample) = line.board.sample()
            {
                self.tap.show(|observer| observer.sampled(now_ms, &sample));
            }
            line.up.write(&bytes);
            bytes.clear();
            line.up.step(&mut bytes);
            if !bytes.is_empty() {
                self.tap.show(|observer| observer.received(now_ms, line.hand, &bytes));
            }
            self.bridge.receive(line.hand, &bytes, now_ms, &mut self.robot);

            let wanted = [self.bridge.poll(line.hand, now_ms), self.bridge.ping(line.hand, now_ms)];
            for message in wanted.into_iter().flatten() {
                let mut buffer = [0; HOST_FRAME_MAX];
                if let Ok(frame) = encode_host(&message, &mut buffer) {
                    self.tap.show(|observer| observer.sent(now_ms, line.hand, frame));
                    line.down.write(frame);
                }
            }
            bytes.clear();
            line.down.step(&mut bytes);
            let mut answer = Vec::new();
            line.board.receive(&bytes, &mut answer);
            line.up.write(&answer);
            if line.board.ended() && !line.ended_noted {
                line.ended_noted = true;
                ended.push(SessionEvent::RecordingEnded { time_ms: now_ms, hand: line.hand });
            }
        }
        self.tap.show(|observer| observer.turned(Turn::Decided(now_ms)));
        self.bridge.step(now_ms, &mut self.robot);
        let events = self.bridge.take_events();
        for event in &events {
            self.time(event);
        }
        self.tap.show(|observer| observer.turned(Turn::Moved(1)));
        self.robot.step(1);
        self.now_ms += 1;
        if !self.robot.arm().at_rest() {
            self.gesture_to_arm.moved(self.now_ms);
        }
        if self.robot.wheels_rad_s() != [0.0; 2] {
            self.tilt_to_wheels.moved(self.now_ms);
        }
        if self.ended_ms.is_none() && self.lines.iter().all(|line| line.board.ended()) {
            self.ended_ms = Some(self.now_ms);
        }
        self.log.extend(events.iter().cloned());
        let events: Vec<SessionEvent> = events.into_iter().map(SessionEvent::Bridge).chain(ended).collect();
        for event in &events {
            self.tap.show(|observer| observer.happened(event));
        }
        let now = Now { time_ms: self.now_ms, bridge: &self.bridge, robot: &self.robot };
        self.tap.show(|observer| observer.state(&now));
        events
    }

    /// Starts the measurement of a delay where an event is the cause of motion.
    fn time(&mut self, event: &BridgeEvent) {
        // The boards' clocks start with the session, so their times are the laptop's.
        match &event.kind {
            EventKind::Gesture { outcome: GestureOutcome::Started(_), window_end_board_ms, .. } => {
                self.gesture_to_arm.begin((*window_end_board_ms).into());
            }
            EventKind::MotionEnded { .. } => self.gesture_to_arm.cancel(),
            EventKind::Heading { twist, sample_board_ms, .. } => {
                // Only a start from rest has a first motion to see.
                let still = self.robot.wheels_rad_s() == [0.0; 2];
                self.tilt_to_wheels.cancel();
                if still && *twist != crate::base::Twist::ZERO {
                    self.tilt_to_wheels.begin((*sample_board_ms).into());
                }
            }
            _ => {}
        }
    }

    /// What the session came to.
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
                    outcome: *outcome,
                }),
                EventKind::MotionEnded { motion, reached: true } => {
                    poses_reached.push(PoseRecord { time_ms, motion: *motion });
                }
                EventKind::Halt { reason } => {
                    stops += u32::from(*reason == HaltReason::OperatorStop);
                    halts.push(HaltRecord { time_ms, reason: *reason });
                }
                EventKind::Released => releases += 1,
                _ => {}
            }
        }
        let line = |hand| self.lines.iter().any(|l| l.hand == hand);
        let counters = |hand| line(hand).then(|| self.bridge.link(hand).counters());
        Summary {
            seconds: self.now_ms as f64 / 1000.0,
            gestures,
            poses_reached,
            stops,
            releases,
            halts,
            caps: self.bridge.caps(),
            odometry: self.robot.odometry(),
            at_rest: self.robot.at_rest(),
            frames: Frames { left: counters(Hand::Left), right: counters(Hand::Right) },
            drops: self.bridge.drops(),
            robot_timeouts: self.robot.timeouts(),
            latency: Latency {
                window_end_to_arm: self.gesture_to_arm.summary(),
                sample_to_wheels: self.tilt_to_wheels.summary(),
            },
            events: self.log.clone(),
        }
    }
}

/// What happened in a session.
#[derive(Clone, Debug, PartialEq)]
pub enum SessionEvent {
    /// On the bridge.
    Bridge(BridgeEvent),
    /// A recording is over: its hand falls silent, and the dead-man halts the robot.
    RecordingEnded {
        /// Virtual time.
        time_ms: u64,
        /// Whose.
        hand: Hand,
    },
}

/// What a session came to; one JSON object.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Virtual time passed.
    pub seconds: f64,
    /// Every gesture event, in order.
    pub gestures: Vec<GestureRecord>,
    /// Arm motions that reached their pose, in order.
    pub poses_reached: Vec<PoseRecord>,
    /// Operator's stops.
    pub stops: u32,
    /// Releases of them.
    pub releases: u32,
    /// Every halt, in order.
    pub halts: Vec<HaltRecord>,
    /// The caps at the end.
    pub caps: Caps,
    /// The base at the end.
    pub odometry: Odometry,
    /// The robot rests at the end.
    pub at_rest: bool,
    /// What came over the links.
    pub frames: Frames,
    /// What was dropped.
    pub drops: Drops,
    /// How often the robot had to stop by itself.
    pub robot_timeouts: u32,
    /// Delays, in virtual time.
    pub latency: Latency,
    /// Everything that happened, in order.
    pub events: Vec<BridgeEvent>,
}

/// One gesture event.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GestureRecord {
    /// When the bridge heard of it.
    pub time_ms: u64,
    /// Its name.
    pub label: String,
    /// 0 to 1.
    pub confidence: f32,
    /// What followed.
    pub outcome: GestureOutcome,
}

/// One pose reached.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PoseRecord {
    /// When.
    pub time_ms: u64,
    /// By which motion.
    pub motion: ArmMotion,
}

/// One halt.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct HaltRecord {
    /// When.
    pub time_ms: u64,
    /// Why.
    pub reason: HaltReason,
}

/// Link counters of both hands; `null` for a hand that takes no part.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Frames {
    /// Of the left hand.
    pub left: Option<LinkCounters>,
    /// Of the right hand.
    pub right: Option<LinkCounters>,
}

/// Delays.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Latency {
    /// From the end of the deciding window to the arm's first joint velocity.
    pub window_end_to_arm: DelaySummary,
    /// From the sample that starts a command to the first wheel speed (starts from rest).
    pub sample_to_wheels: DelaySummary,
}
