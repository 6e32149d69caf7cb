//! A keyboard that replaces a hand, so that one board (or none) is enough.
//!
//! | key | hand | effect |
//! |---|---|---|
//! | arrows | left | drive forward or backward, turn left or right, while held |
//! | `q`, `z` | left | raise or lower the caps by one step (index bend, middle bend) |
//! | `1` … `6` | right | the six gestures in the order of the labels |
//!
//! Each keyboard hand is a normal board: it runs the boards' own code on samples that correspond to the keys.
//! Debouncing, the dead-man, the caps and the stop therefore apply to keyboard hands too.
//! A terminal reports key presses and repeats, but no releases.
//! An arrow is active for [`KeyTimes::first_press_ms`] after the press.
//! By then, the terminal has begun to repeat the key.
//! Afterwards, the arrow is active for [`KeyTimes::repeat_ms`] after each repeat.
//! Finally, the hand is neutral again.

use std::collections::VecDeque;

use host_core::source::HandSource;
use serde::{Deserialize, Serialize};
use shared_board::Identity;
use shared_board::hand::Hand;
use shared_board::memory::RamEeprom;
use shared_dsp::left::calibration::Calibration;
use shared_dsp::left::flex::Finger;
use shared_dsp::left::{AdcCounts, ONE_G};
use shared_dsp::right::RightOutput;
use shared_dsp::right::network::{MAX_AXES, MAX_LABELS};
use shared_proto::message::{Board, Heading, ModelInfo, Text};

use crate::hands::virtual_board::{PERIOD_MS, VirtualLeft, VirtualRight, no_store};

pub use host_core::source::HandKey;

/// The paper's labels: rest, followed by the gestures of keys 1 to 6.
pub const LABELS: &str = "idle,up-down,to-fro,left-right,rectangle,rectangle-flat,circle";
const LABEL_COUNT: u8 = 7;
const HOP_SAMPLES: u32 = 8;

/// Minimum time between steps, because a held key repeats up to thirty times per second.
const STEP_INTERVAL_MS: u64 = 200;
/// A bend is valid once it has lasted for 120 ms. The next bend is valid only once the finger has been straight.
const BENT_MS: u64 = 140;
/// Maximum number of steps that wait for the current one.
const STEPS_WAITING: usize = 2;
/// A board that has not run for this long was asleep. Its output would be late and is omitted.
const ASLEEP_MS: u64 = 100;

/// Durations for which a key is active, and the key that ends the arm's motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KeyTimes {
    /// Duration after the first press. It is slightly longer than the delay before terminals repeat a key.
    pub first_press_ms: u64,
    /// Duration after each repeat of the key.
    pub repeat_ms: u64,
    /// The key that ends only the arm's motion, while the base continues.
    pub end_arm: char,
}

impl Default for KeyTimes {
    fn default() -> Self {
        KeyTimes { first_press_ms: 600, repeat_ms: 200, end_arm: 'x' }
    }
}

fn identity(board: Board) -> Identity {
    Identity { board, firmware: "keyboard", boot_id: 1, sample_hz: 100 }
}

/// Counts the periods of a board up to a time.
#[derive(Clone, Copy, Debug, Default)]
struct Periods {
    next_ms: Option<u64>,
}

impl Periods {
    /// Returns the start of the next period, if it has begun.
    fn next(&mut self, now_ms: u64) -> Option<u64> {
        let due_ms = self.next_ms.filter(|due_ms| now_ms < due_ms + ASLEEP_MS).unwrap_or(now_ms);
        if due_ms > now_ms {
            return None;
        }
        self.next_ms = Some(due_ms + PERIOD_MS);
        Some(due_ms)
    }
}

/// A left hand that is controlled by the arrow keys, q and z.
#[derive(Clone, Debug)]
pub struct KeyLeft {
    times: KeyTimes,
    board: VirtualLeft,
    periods: Periods,
    /// The active arrow, and the time at which the arrow expires.
    held: Option<(Heading, u64)>,
    last_step_ms: Option<u64>,
    /// Fingers to bend, each with the start time of its bend. The current bend is first.
    steps: VecDeque<(Finger, u64)>,
    dither: u16,
}

impl KeyLeft {
    /// A hand at neutral.
    pub fn new(times: KeyTimes) -> Self {
        KeyLeft {
            times,
            board: VirtualLeft::start(identity(Board::LeftReplay), RamEeprom::with(&Calibration::DEFAULT)),
            periods: Periods::default(),
            held: None,
            last_step_ms: None,
            steps: VecDeque::new(),
            dither: 0,
        }
    }

    /// Returns the converter readings of a simulated hand that the keyboard moves.
    fn counts(&mut self, now_ms: u64) -> AdcCounts {
        self.held = self.held.filter(|&(_, until)| now_ms < until);
        while self.steps.front().is_some_and(|(_, from)| now_ms >= from + STEP_INTERVAL_MS) {
            self.steps.pop_front();
        }
        let bent = |finger| {
            self.steps
                .front()
                .is_some_and(|&(f, from)| f == finger && (from..from + BENT_MS).contains(&now_ms))
        };
        let Calibration { zero, rest, bend } = Calibration::DEFAULT;
        let reading = |finger, i: usize| if bent(finger) { bend[i] } else { rest[i] };
        // About 72 degrees, which is above the largest permitted threshold.
        let (tilted, upright) = (ONE_G / 100 * 95, ONE_G / 100 * 31);
        let [x, y, z] = match self.held.map(|(heading, _)| heading) {
            Some(Heading::Forward) => [tilted, 0, upright],
            Some(Heading::Backward) => [-tilted, 0, upright],
            Some(Heading::Left) => [0, tilted, upright],
            Some(Heading::Right) => [0, -tilted, upright],
            Some(Heading::Neutral | Heading::Between) | None => [0, 0, ONE_G],
        };
        // The last bit of a real converter always changes.
        self.dither ^= 1;
        AdcCounts {
            x: (zero[0] + x) as u16,
            y: (zero[1] + y) as u16,
            z: (zero[2] + z) as u16 + self.dither,
            index: reading(Finger::Index, 0),
            middle: reading(Finger::Middle, 1),
        }
    }

    fn bend(&mut self, finger: Finger, now_ms: u64) {
        if self.steps.len() > STEPS_WAITING {
            return;
        }
        let free_ms = self.steps.back().map_or(now_ms, |(_, from)| from + STEP_INTERVAL_MS);
        self.steps.push_back((finger, free_ms.max(now_ms)));
    }
}

impl HandSource for KeyLeft {
    fn press(&mut self, key: HandKey, now_ms: u64) {
        match key {
            HandKey::Arrow(heading) => {
                let repeated = self.held.is_some_and(|(h, until)| h == heading && now_ms < until);
                let first_ms = self.times.first_press_ms;
                self.held = Some(match self.held {
                    // A repeat never shortens the time that remains after the first press.
                    Some((_, until)) if repeated => (heading, until.max(now_ms + self.times.repeat_ms)),
                    _ => (heading, now_ms + first_ms),
                });
            }
            HandKey::Faster | HandKey::Slower => {
                if self.last_step_ms.is_some_and(|t| now_ms.saturating_sub(t) < STEP_INTERVAL_MS) {
                    return;
                }
                self.last_step_ms = Some(now_ms);
                self.bend(if key == HandKey::Faster { Finger::Index } else { Finger::Middle }, now_ms);
            }
            HandKey::Gesture(_) => {}
        }
    }

    fn release(&mut self, key: HandKey) {
        if let (HandKey::Arrow(heading), Some((held, _))) = (key, self.held)
            && heading == held
        {
            self.held = None;
        }
    }

    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        while let Some(period_ms) = self.periods.next(now_ms) {
            let counts = self.counts(period_ms);
            self.board.period(Some(counts), period_ms, wire);
        }
    }

    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        self.board.receive(bytes, now_ms, wire);
    }
}

/// Converts a key to a complete gesture of the right hand.
#[derive(Clone, Debug)]
struct KeyHand {
    output: RightOutput,
    samples: u32,
}

impl KeyHand {
    fn new() -> Self {
        let output = RightOutput {
            window_end_ms: 0,
            full: true,
            replaced: false,
            events: 0,
            is_event: false,
            label: u8::MAX,
            confidence: 0,
            event_window_end_ms: 0,
            scores: scores(0),
            label_count: LABEL_COUNT,
        };
        KeyHand { output, samples: 0 }
    }
}

/// Returns scores that are certain of one label.
fn scores(top: u8) -> [i8; MAX_LABELS] {
    std::array::from_fn(|i| if i == usize::from(top) { i8::MAX } else { i8::MIN })
}

impl Hand for KeyHand {
    /// The label of the pressed key.
    type Sample = Option<u8>;

    fn push(&mut self, pressed: &Option<u8>, time_ms: u32) -> bool {
        self.samples += 1;
        self.output.window_end_ms = time_ms;
        if let Some(label) = *pressed {
            self.output.events = self.output.events.wrapping_add(1);
            self.output.label = label;
            self.output.confidence = u8::MAX;
            self.output.event_window_end_ms = time_ms;
            self.output.scores = scores(label);
            self.samples = 0;
        } else if self.samples == HOP_SAMPLES {
            self.output.scores = scores(0);
            self.samples = 0;
        }
        self.output.is_event = pressed.is_some();
        self.samples == 0
    }

    fn gap(&mut self) {}

    fn output(&self) -> &RightOutput {
        &self.output
    }

    fn model(&self) -> ModelInfo<'_> {
        ModelInfo { model_id: 0, recipe: 0, axes: 0, sample_hz: 0, window: 0, labels: Text(LABELS) }
    }

    fn scale(&self) -> Option<[f32; 3]> {
        None
    }

    fn counts(&self, _sample: &Option<u8>, _counts: &mut [i16; MAX_AXES]) -> usize {
        0
    }
}

/// A right hand that is controlled by the keys 1 to 6.
#[derive(Clone, Debug)]
pub struct KeyRight {
    board: VirtualRight<KeyHand>,
    periods: Periods,
    /// The key for the next sample.
    pressed: Option<u8>,
    /// The last key and the time of its press.
    last_press: Option<(u8, u64)>,
}

impl Default for KeyRight {
    fn default() -> Self {
        Self::new()
    }
}

impl KeyRight {
    /// A hand at rest.
    pub fn new() -> Self {
        KeyRight {
            board: VirtualRight::start(identity(Board::RightReplay), KeyHand::new()),
            periods: Periods::default(),
            pressed: None,
            last_press: None,
        }
    }
}

impl HandSource for KeyRight {
    fn press(&mut self, key: HandKey, now_ms: u64) {
        let HandKey::Gesture(number @ 1..=6) = key else { return };
        // Repeats of a held key count as one gesture. They begin after about half a second and then come quickly.
        let is_repeat = self.last_press.is_some_and(|(n, t)| n == number && now_ms.saturating_sub(t) < 700);
        self.last_press = Some((number, now_ms));
        if !is_repeat {
            self.pressed = Some(number);
        }
    }

    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>) {
        while let Some(period_ms) = self.periods.next(now_ms) {
            let pressed = self.pressed.take();
            self.board.sample(&pressed, period_ms, wire);
        }
    }

    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) {
        self.board.receive(bytes, now_ms, wire, no_store);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, HOST_FRAME_MAX, encode_host};
    use shared_proto::message::{AckResult, BoardMessage, HostMessage, LeftState, Mode};

    /// Advances the time millisecond by millisecond, and returns the messages that `pick` selects.
    fn run<T>(
        hand: &mut impl HandSource,
        ms: std::ops::Range<u64>,
        pick: impl Fn(BoardMessage<'_>) -> Option<T>,
    ) -> Vec<T> {
        let mut wire = Vec::new();
        ms.for_each(|now_ms| hand.step(now_ms, &mut wire));
        read(&wire, pick)
    }

    fn read<T>(wire: &[u8], pick: impl Fn(BoardMessage<'_>) -> Option<T>) -> Vec<T> {
        let mut decoder = Decoder::<BOARD_FRAME_MAX>::new();
        wire.iter().filter_map(|&byte| decoder.push_board(byte).and_then(&pick)).collect()
    }

    fn left(message: BoardMessage<'_>) -> Option<LeftState> {
        if let BoardMessage::Left(state) = message { Some(state) } else { None }
    }

    /// Returns the events, the label, and the label with the highest score.
    fn right(message: BoardMessage<'_>) -> Option<(u8, u8, usize)> {
        let BoardMessage::Right(state) = message else { return None };
        assert_eq!((state.health, state.scores.len()), (0, 7));
        let top = (0..7).max_by_key(|&i| state.scores[i] as i8).unwrap();
        Some((state.events, state.label, top))
    }

    #[test]
    fn an_arrow_commands_within_100_ms_and_for_as_long_as_it_counts() {
        use Heading::{Backward, Forward, Left, Right};
        for heading in [Forward, Backward, Left, Right] {
            let mut hand = KeyLeft::new(KeyTimes::default());
            let before = run(&mut hand, 1000..1500, left);
            assert!(before[2..].iter().all(|s| (s.heading, s.health) == (Heading::Neutral, 0)), "{before:?}");
            hand.press(HandKey::Arrow(heading), 1500);
            let after = run(&mut hand, 1500..3000, left);
            let commands: Vec<_> = after.iter().filter(|s| s.heading == heading).collect();
            let (first, last) = (commands[0].board_time_ms, commands[commands.len() - 1].board_time_ms);
            // After a swing, the board waits until the direction is clear.
            assert!(first <= 1600, "{first}");
            // 600 ms and the debouncing.
            assert!((2060..2140).contains(&last), "{last}");
            assert!(after.iter().all(|s| (s.index_bends, s.middle_bends, s.stop) == (0, 0, false)));
            assert_eq!(after.last().unwrap().heading, Heading::Neutral);
        }
    }

    #[test]
    fn a_key_that_is_up_ends_the_command_at_once() {
        let mut hand = KeyLeft::new(KeyTimes::default());
        run(&mut hand, 0..500, left);
        hand.press(HandKey::Arrow(Heading::Left), 500);
        assert_eq!(run(&mut hand, 500..600, left).last().unwrap().heading, Heading::Left);
        hand.release(HandKey::Arrow(Heading::Left));
        assert_eq!(run(&mut hand, 600..660, left).last().unwrap().heading, Heading::Neutral);
    }

    #[test]
    fn q_and_z_are_bends_of_one_finger_each_even_close_together() {
        let mut hand = KeyLeft::new(KeyTimes::default());
        run(&mut hand, 0..500, left);
        let mut now_ms = 500;
        for key in [HandKey::Faster, HandKey::Slower, HandKey::Faster] {
            hand.press(key, now_ms);
            // A press that follows too quickly counts as a repeat.
            hand.press(key, now_ms + 50);
            run(&mut hand, now_ms..now_ms + 210, left);
            now_ms += 210;
        }
        let states = run(&mut hand, now_ms..now_ms + 1000, left);
        let last = states.last().unwrap();
        assert_eq!((last.index_bends, last.middle_bends, last.stop), (2, 1, false));
    }

    #[test]
    fn a_gesture_key_is_one_event_and_then_the_hand_rests() {
        let mut hand = KeyRight::new();
        assert!(run(&mut hand, 0..1000, right).iter().all(|&state| state == (0, 255, 0)));
        hand.press(HandKey::Gesture(3), 1000);
        // The terminal repeats it.
        hand.press(HandKey::Gesture(3), 1500);
        let states = run(&mut hand, 1000..2000, right);
        assert_eq!(states[0], (1, 3, 3), "at once");
        assert!(states[1..].iter().all(|&state| state == (1, 3, 0)), "{states:?}");
        hand.press(HandKey::Gesture(4), 2000);
        assert_eq!(run(&mut hand, 2000..2100, right)[0], (2, 4, 4));
    }

    #[test]
    fn keys_say_who_they_are_what_time_it_is_and_what_can_be_recorded() {
        let ask = |hand: &mut dyn HandSource, message: HostMessage<'_>| {
            let mut wire = Vec::new();
            let mut buffer = [0; HOST_FRAME_MAX];
            hand.receive(encode_host(&message, &mut buffer).unwrap(), 700, &mut wire);
            hand.step(700, &mut wire);
            wire
        };
        let (mut left, mut right) = (KeyLeft::new(KeyTimes::default()), KeyRight::new());
        let mut recorded = Vec::new();
        for hand in [&mut left as &mut dyn HandSource, &mut right] {
            let wire = ask(hand, HostMessage::HelloRequest);
            let names = read(&wire, |m| match m {
                BoardMessage::Hello(hello) => Some(hello.firmware.to_string()),
                _ => None,
            });
            assert_eq!(names, ["keyboard"]);
            let wire = ask(hand, HostMessage::Ping { id: 4 });
            let pongs = read(&wire, |m| if let BoardMessage::Pong(pong) = m { Some(pong) } else { None });
            assert_eq!((pongs[0].id, pongs[0].board_time_ms), (4, 700));
            let wire = ask(hand, HostMessage::SetMode { request: 1, mode: Mode::Record });
            let acks = read(&wire, |m| if let BoardMessage::Ack(ack) = m { Some(ack.result) } else { None });
            recorded.extend(acks);
        }
        // A right hand on the keyboard needs no samples, but a left hand always needs samples.
        assert_eq!(recorded, [AckResult::Ok, AckResult::Unsupported]);
    }

    #[test]
    fn what_a_sleeping_program_would_have_said_is_left_out() {
        let mut hand = KeyLeft::new(KeyTimes::default());
        run(&mut hand, 0..500, left);
        let mut wire = Vec::new();
        hand.step(3_600_000, &mut wire);
        assert!(read(&wire, left).len() <= 2);
        assert_eq!(run(&mut hand, 3_600_001..3_600_101, left).last().unwrap().health, 0);
    }
}
