//! A session in one-handed mode: the bundled model on a simulated wrist, the bridge and the simulated robot.
#![allow(dead_code)] // each test file uses its own part

use std::sync::{Arc, Mutex, MutexGuard};

use host_bridge::bridge::{EventKind, GestureOutcome};
use host_bridge::config::Config;
use host_bridge::engine::Engine;
use host_bridge::hands::ModelFile;
use host_bridge::hands::virtual_board::{PERIOD_MS, VirtualRight, no_store};
use host_bridge::observe::SessionEvent;
use host_bridge::source::{HandSource, Source};
use shared_board::Identity;
use shared_board::hand::ValueHand;
use shared_dsp::right::RightHand;
use shared_dsp::right::decision::DecisionConfig;
use shared_dsp::right::network::Model;
use shared_proto::message::Board;

use crate::support::{Robot, Virtual as _, bare};
use crate::wrist::Wrist;

/// The wrist with a board that runs the bundled model.
struct Worn {
    wrist: Arc<Mutex<Wrist>>,
    board: VirtualRight<ValueHand<'static, 9>>,
    next: u64,
}

impl Worn {
    fn new(wrist: Arc<Mutex<Wrist>>) -> Self {
        let blob = ModelFile::bundled().unwrap().blob().to_vec();
        let model = Model::parse(blob.leak()).unwrap();
        let hand = RightHand::<9>::new(model, DecisionConfig::default()).expect("nine axes");
        let identity = Identity { board: Board::RightReplay, firmware: "test", boot_id: 1, sample_hz: 100 };
        let scale = [0.000_732 * 9.806_65, 0.07, 0.014];
        Worn { wrist, board: VirtualRight::start(identity, ValueHand::new(hand, scale)), next: 0 }
    }
}

impl HandSource for Worn {
    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        while self.next * PERIOD_MS <= now_ms {
            let sample = self.wrist.lock().unwrap().sample().map(|value| value as f32);
            self.board.sample(&sample, self.next * PERIOD_MS, wire);
            self.next += 1;
        }
    }

    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        self.board.receive(bytes, now_ms, wire, no_store);
    }
}

pub struct Session {
    pub engine: Engine<'static, Robot>,
    wrist: Arc<Mutex<Wrist>>,
    pub now_ms: u64,
    pub events: Vec<EventKind>,
}

impl Session {
    pub fn new(config: &Config, wrist: Wrist) -> Self {
        let wrist = Arc::new(Mutex::new(wrist));
        let sources = [Source::Nobody, Source::here(Worn::new(Arc::clone(&wrist)))];
        let engine = Engine::new(config.bridge(config.motion_map()), bare(), sources, 0);
        Session { engine, wrist, now_ms: 0, events: Vec::new() }
    }

    pub fn wrist(&self) -> MutexGuard<'_, Wrist> {
        self.wrist.lock().unwrap()
    }

    pub fn run(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now_ms += 1;
            let events = self.engine.advance(self.now_ms, [false; 2]);
            self.events.extend(events.into_iter().filter_map(|event| match event {
                SessionEvent::Bridge(event) => Some(event.kind),
                _ => None,
            }));
        }
    }

    /// Runs until the condition holds, for at most 20 s.
    pub fn until(&mut self, holds: impl Fn(&Robot) -> bool) {
        let end_ms = self.now_ms + 20_000;
        while !holds(self.engine.door()) {
            assert!(self.now_ms < end_ms, "not within 20 s: {:?}", self.events.last());
            self.run(10);
        }
    }

    pub fn level(&mut self) {
        self.wrist().tilt(0.0, 0.0);
        self.run(1500);
    }

    pub fn path_m(&self) -> f64 {
        self.engine.door().odometry().path_m
    }

    pub fn asked_m_s(&self) -> f64 {
        self.engine.bridge().twist().linear_m_s
    }

    pub fn outcomes(&self) -> Vec<GestureOutcome> {
        let outcome = |event: &EventKind| match event {
            EventKind::Gesture { outcome, .. } => Some(outcome.clone()),
            _ => None,
        };
        self.events.iter().filter_map(outcome).collect()
    }
}
