//! Tests the dead-man with millions of steps of a hostile link.
//! An honest board is connected by a hostile line.
//! The line delays, repeats, swaps, damages and drops frames in both directions.
//! The board restarts, and the program sleeps.
//!
//! The test knows the true time of each sample, and checks after every step:
//! * there is no command unless the bridge is armed,
//! * a command follows the heading of a sample that is at most 250 ms old,
//!   plus the current turn of the loop,
//! * the bridge arms only after at least three consecutive neutral samples that span 100 ms.

mod support;

use std::collections::VecDeque;

use host_core::bridge::Bridge;
use host_core::intent::MotionMap;
use host_core::safety::{ARM_NEUTRAL_MS, Hand, NEUTRAL_SAMPLES, STALE_MS, State};
use host_robot::{Random, Twist};
use shared_proto::message::{BoardMessage, Heading, HostMessage, LeftState, Pong};
use support::{NoRobot, encode, hello};

/// A sample may still have an effect in the turn of the loop in which it becomes too old.
const TURN_MS: u64 = 20;
const SAMPLE_MS: u64 = 20;

/// Data on its way to the program.
struct OnItsWay {
    due_ms: u64,
    bytes: Vec<u8>,
    /// Sampling time and heading, if the data is a complete state.
    state: Option<(u64, Heading)>,
}

struct World {
    random: Random,
    now_ms: u64,
    bridge: Bridge,
    robot: NoRobot,
    line: VecDeque<OnItsWay>,
    /// Pings on their way to the board.
    pings: VecDeque<(u64, u32)>,
    state: LeftState,
    boot_id: u32,
    /// The difference between the board's clock and the test's clock.
    board_ahead_ms: u32,
    sampled_ms: u64,
    heading: Heading,
    /// The line's delay now.
    delay_ms: u64,
    /// The newest received sample of each heading.
    seen_ms: [u64; 6],
    /// Neutral samples since the last non-neutral sample, oldest first.
    /// The next field is the newest sample of any kind.
    neutral: Vec<u64>,
    newest_ms: u64,
    armed: u64,
    commands: u64,
    oldest_ms: u64,
}

fn place(heading: Heading) -> usize {
    match heading {
        Heading::Neutral => 0,
        Heading::Between => 1,
        Heading::Forward => 2,
        Heading::Backward => 3,
        Heading::Left => 4,
        Heading::Right => 5,
    }
}

/// Returns the heading that causes this speed.
fn asked(twist: Twist) -> Option<usize> {
    let Twist { linear_m_s, angular_rad_s } = twist;
    match (linear_m_s.partial_cmp(&0.0)?, angular_rad_s.partial_cmp(&0.0)?) {
        (std::cmp::Ordering::Greater, _) => Some(2),
        (std::cmp::Ordering::Less, _) => Some(3),
        (_, std::cmp::Ordering::Greater) => Some(4),
        (_, std::cmp::Ordering::Less) => Some(5),
        _ => None,
    }
}

impl World {
    fn new(seed: u64) -> Self {
        World {
            random: Random::new(seed),
            now_ms: 10_000,
            bridge: Bridge::new(MotionMap::default()).awaiting(Hand::Left),
            robot: NoRobot::default(),
            line: VecDeque::new(),
            pings: VecDeque::new(),
            state: LeftState::default(),
            boot_id: 1,
            board_ahead_ms: 77,
            sampled_ms: 0,
            heading: Heading::Neutral,
            delay_ms: 2,
            seen_ms: [0; 6],
            neutral: Vec::new(),
            newest_ms: 0,
            armed: 0,
            commands: 0,
            oldest_ms: 0,
        }
    }

    fn upto(&mut self, end: u64) -> u64 {
        (self.random.between(0.0, end as f64) as u64).min(end.saturating_sub(1))
    }

    fn chance(&mut self, one_in: u64) -> bool {
        self.upto(one_in) == 0
    }

    fn put(&mut self, bytes: Vec<u8>, state: Option<(u64, Heading)>) {
        // A line may delay data, but it preserves the order.
        let behind_ms = self.line.back().map_or(0, |last| last.due_ms);
        let due_ms = (self.now_ms + self.delay_ms + self.upto(4)).max(behind_ms);
        self.line.push_back(OnItsWay { due_ms, bytes, state });
    }

    /// The board samples, sends and answers. Its clock is honest.
    fn board(&mut self) {
        while let Some(&(due_ms, id)) = self.pings.front() {
            if due_ms > self.now_ms {
                break;
            }
            self.pings.pop_front();
            let board_time_ms = (self.now_ms as u32).wrapping_add(self.board_ahead_ms);
            if !self.chance(10) {
                self.put(encode(&BoardMessage::Pong(Pong { id, board_time_ms })), None);
            }
        }
        if self.now_ms < self.sampled_ms + SAMPLE_MS {
            return;
        }
        self.sampled_ms = self.now_ms;
        if self.chance(15) {
            let any = [
                Heading::Neutral,
                Heading::Neutral,
                Heading::Between,
                Heading::Forward,
                Heading::Backward,
                Heading::Left,
                Heading::Right,
            ];
            self.heading = any[self.upto(any.len() as u64) as usize];
        }
        self.state.sequence = self.state.sequence.wrapping_add(1);
        self.state.board_time_ms = (self.now_ms as u32).wrapping_add(self.board_ahead_ms);
        self.state.heading = self.heading;
        let mut bytes = encode(&BoardMessage::Left(self.state));
        let whole = Some((self.now_ms, self.heading));
        match self.upto(40) {
            // Swallowed.
            0 => {}
            // Damaged.
            1 => {
                let at = self.upto(bytes.len() as u64) as usize;
                bytes[at] ^= 1 << self.upto(8);
                self.put(bytes, None);
            }
            // Twice.
            2 => {
                self.put(bytes.clone(), whole);
                self.put(bytes, whole);
            }
            _ => self.put(bytes, whole),
        }
    }

    /// Changes the behaviour of the line.
    fn line_changes(&mut self) {
        match self.upto(400) {
            0 => self.delay_ms = self.upto(30),
            1 => self.delay_ms = 60 + self.upto(120),
            2 => self.delay_ms = self.upto(3000),
            // All waiting data arrives at once.
            3 => self.line.iter_mut().for_each(|it| it.due_ms = 0),
            // Two states change places.
            4 if self.line.len() > 1 && self.line.range(..2).all(|it| it.state.is_some()) => {
                self.line.swap(0, 1)
            }
            5 => self.line.clear(),
            6 => {
                let noise = (0..self.upto(40)).map(|n| (n * 37 % 251) as u8).collect();
                self.put(noise, None);
            }
            // The board restarts with an arbitrary clock.
            7 => {
                self.boot_id = self.boot_id.wrapping_add(1);
                self.board_ahead_ms = self.upto(u64::from(u32::MAX)) as u32;
                self.state.sequence = 0;
                let id = self.boot_id;
                self.put(hello(id), None);
            }
            // The program sleeps.
            8 => {
                let slept_ms = self.upto(1500);
                self.now_ms += slept_ms;
            }
            _ => {}
        }
    }

    fn program(&mut self) {
        while self.line.front().is_some_and(|it| it.due_ms <= self.now_ms) {
            let Some(OnItsWay { bytes, state, .. }) = self.line.pop_front() else { break };
            let was_armed = self.is_armed();
            let whole = self.bridge.link(Hand::Left).counters().frames;
            self.bridge.receive(Hand::Left, &bytes, self.now_ms, &mut self.robot);
            // Earlier noise on the line may have destroyed the frame.
            let came_through = self.bridge.link(Hand::Left).counters().frames > whole;
            if let Some((sampled_ms, heading)) = state.filter(|_| came_through) {
                // An overtaken state has no effect.
                if sampled_ms >= self.newest_ms {
                    self.newest_ms = sampled_ms;
                    if heading != Heading::Neutral {
                        self.neutral.clear();
                    } else if self.neutral.last() != Some(&sampled_ms) {
                        self.neutral.push(sampled_ms);
                    }
                }
                self.seen_ms[place(heading)] = self.seen_ms[place(heading)].max(sampled_ms);
            }
            // Frames are processed one by one, because the next frame may interrupt neutral.
            self.judge_arming(was_armed);
        }
        let was_armed = self.is_armed();
        self.bridge.step(self.now_ms, &mut self.robot);
        let hello = self.bridge.poll(Hand::Left, self.now_ms).is_some();
        if hello && !self.chance(5) {
            let id = self.boot_id;
            self.put(support::hello(id), None);
        }
        if let Some(HostMessage::Ping { id }) = self.bridge.ping(Hand::Left, self.now_ms) {
            let back_ms = self.upto(self.delay_ms + 1);
            self.pings.push_back((self.now_ms + back_ms, id));
        }
        self.bridge.take_events();
        self.judge_arming(was_armed);
        self.judge_command();
    }

    fn is_armed(&self) -> bool {
        self.bridge.safety().state() == State::Armed
    }

    /// Checks the command at the end of each turn.
    fn judge_command(&mut self) {
        if let Some(heading) = asked(self.robot.twist) {
            self.commands += 1;
            assert!(self.is_armed(), "moves unarmed at {}", self.now_ms);
            let age_ms = self.now_ms - self.seen_ms[heading];
            self.oldest_ms = self.oldest_ms.max(age_ms);
            assert!(age_ms <= STALE_MS + TURN_MS, "{age_ms} ms old, at {}", self.now_ms);
        }
    }

    fn judge_arming(&mut self, was_armed: bool) {
        if self.is_armed() && !was_armed {
            self.armed += 1;
            let span_ms =
                self.neutral.last().zip(self.neutral.first()).map_or(0, |(last, first)| last - first);
            assert!(
                span_ms >= ARM_NEUTRAL_MS && self.neutral.len() >= NEUTRAL_SAMPLES as usize,
                "armed on {} samples over {span_ms} ms, at {}",
                self.neutral.len(),
                self.now_ms
            );
        }
    }
}

#[test]
fn millions_of_steps_of_a_hostile_link_move_nothing_unarmed_late_or_without_neutral() {
    let steps: u64 = if std::env::var_os("BIMANUAL_FULL").is_some() { 10_000_000 } else { 100_000 };
    // Some runs restart occasionally, so that the result does not depend on a single seed.
    let (mut armed, mut commands, mut oldest_ms, mut done) = (0, 0, 0, 0);
    for seed in 0.. {
        let mut world = World::new(seed);
        for _ in 0..20_000 {
            world.now_ms += 1 + world.upto(TURN_MS);
            world.board();
            world.line_changes();
            world.program();
            done += 1;
        }
        armed += world.armed;
        commands += world.commands;
        oldest_ms = oldest_ms.max(world.oldest_ms);
        if done >= steps {
            break;
        }
    }
    println!("row: hostile link: moves unarmed, or armed without neutral | {done} steps | 0 | 0");
    println!(
        "row: hostile link: age of the acting state | {commands} commands, {armed} times armed | {oldest_ms} ms | 250 ms and a turn of {TURN_MS}"
    );
    // The robot did move; otherwise, the test would check nothing.
    assert!(armed > steps / 2000 && commands > steps / 20, "{armed} {commands}");
}
