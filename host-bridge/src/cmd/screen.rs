//! The terminal of a running session: the live view or lines, and its keys.

use std::io::Write as _;
use std::time::{Duration, Instant};

use anyhow::Result;
use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use host_bridge::control::{Control, Flags, Order, Report};
use host_bridge::describe;
use host_bridge::episodes::Mark;
use host_bridge::keyboard::HandKey;
use host_bridge::observe::{Now, SessionEvent};
use host_bridge::robot::Door;
use host_bridge::ros2::Counts;
use host_bridge::safety::{Hand, PerHand};
use host_bridge::view::{Scene, View};
use shared_proto::message::Heading;

use super::keep::Keeper;
use super::lines::{EndLine, LinkLine};

/// Interval for checking keys, also while nothing happens.
const PATIENCE: Duration = Duration::from_millis(10);
/// Time within which the release key must be pressed twice.
const CONFIRM: Duration = Duration::from_secs(2);

/// Ordinary terminals repeat a held key. The repeats begin after 250 to 660 ms, and then come faster.
const HELD: Duration = Duration::from_millis(700);

const KEYS: &str = "space: stop   r r: release a stop (no right hand)   Esc: quit   end the arm's motion:";
const MARK_KEYS: &str = "episode: b begins, e ends, a again, g good, n no good";
const SHOW_KEYS: &str = "t: show each gesture three times, and the model learns your hand; t again: give up";
/// The key for that.
pub const SHOW: char = 't';
const HAND_KEYS: &str = "keyboard: arrows drive while held, q faster, z slower; 1-6 gestures";

/// Describes the keys: those of a keyboard hand, of a recorded session,
/// and of a wearer who can show gestures.
pub fn keys(end_arm: char, clutch: Option<char>, has_hands: bool, records: bool, shows: bool) -> String {
    let mut keys = format!("{KEYS} {end_arm}");
    if let Some(clutch) = clutch {
        keys += &format!("   jog, and back: {clutch}");
    }
    for (more, wanted) in [(HAND_KEYS, has_hands), (MARK_KEYS, records), (SHOW_KEYS, shows)] {
        if wanted {
            keys += &format!("\n{more}");
        }
    }
    keys
}

/// Returns the mark of a key.
fn mark_of(letter: char) -> Option<Mark> {
    Some(match letter {
        'b' => Mark::Begin,
        'e' => Mark::End,
        'a' => Mark::Again,
        'g' => Mark::Good,
        'n' => Mark::Bad,
        _ => return None,
    })
}

/// Draws, prints and reads keys. Nothing here can delay the control thread.
pub struct Screen {
    /// The live view, if there is one.
    pub view: Option<View>,
    /// Lines are JSON.
    pub json: bool,
    /// The session's file.
    pub keeper: Keeper,
    /// The hands that are connected over Bluetooth.
    pub over_air: PerHand<bool>,
    /// Time at which the release key was pressed once.
    pub released: Option<Instant>,
    /// Whether there is a file for marks.
    pub records: bool,
    /// Whether the wearer of the right hand can show gestures by a key.
    pub shows: bool,
    /// Which key does what.
    pub keys: String,
    /// The key that ends the arm's motion.
    pub end_arm: char,
    /// The key that switches the left hand from the base to the arm, and back.
    pub clutch: Option<char>,
    /// Whether the clutch's key is held.
    pub clutch_held: Held,
}

/// Distinguishes a key that is pressed from a key that is held.
#[derive(Default)]
pub struct Held {
    /// Time at which the key was last seen, whether it counted or not.
    seen: Option<Instant>,
}

impl Held {
    /// Records that the key is seen now, and returns whether this counts as a press.
    fn is_new(&mut self, now: Instant) -> bool {
        self.seen.replace(now).is_none_or(|seen| now.duration_since(seen) > HELD)
    }
}

impl Screen {
    /// Runs until the user quits or the session ends.
    pub fn show<D: Door + Send + 'static>(&mut self, control: &Control<D>, flags: &Flags) -> Result<()> {
        loop {
            let Ok(report) = control.report(PATIENCE) else { return Ok(()) };
            if let Some(problem) = self.keeper.take_problem() {
                self.told(&problem);
            }
            let Report { events, links, snapshot } = report.unwrap_or_default();
            for event in &events {
                self.note(event)?;
            }
            for link in links {
                let what =
                    if self.over_air[link.hand] { "connected over Bluetooth" } else { "the port is open" };
                self.link_line(
                    link.time_ms,
                    link.hand,
                    link.closed.is_none(),
                    link.closed.as_deref().unwrap_or(what),
                );
            }
            let Some(view) = &mut self.view else { continue };
            if let Some(snapshot) = &snapshot {
                view.draw(&Scene { snapshot, keys: &self.keys, pace: String::new() })?;
            }
            while let Some(key) = self.view.as_mut().and_then(|view| view.pressed().transpose()) {
                if self.press(key?, control, flags) {
                    return Ok(());
                }
            }
        }
    }

    fn link_line(&mut self, time_ms: u64, hand: Hand, open: bool, text: &str) {
        if self.json {
            let line = LinkLine { time_ms, event: "link", hand, open, text };
            self.line(&serde_json::to_string(&line).unwrap_or_default());
        } else {
            self.line(&format!("{:>8.3} s  {hand} hand: {text}", time_ms as f64 / 1000.0));
        }
    }

    fn note(&mut self, event: &SessionEvent) -> Result<()> {
        if let (true, SessionEvent::Bridge(event)) = (self.json, event) {
            let line = serde_json::to_string(event)?;
            self.line(&line);
        } else if let (true, SessionEvent::Marked { time_ms, mark, by, .. }) = (self.json, event) {
            let text = describe::text(event);
            let line = serde_json::json!({
                "time_ms": time_ms, "event": "mark", "mark": mark, "by": by, "text": text
            });
            self.line(&line.to_string());
        } else if let (true, SessionEvent::Wearer { time_ms, text }) = (self.json, event) {
            let line = serde_json::json!({ "time_ms": time_ms, "event": "wearer", "text": text });
            self.line(&line.to_string());
        } else if !self.json && !describe::is_echo(event) {
            let time_s = describe::time_ms(event) as f64 / 1000.0;
            self.line(&format!("{time_s:>8.3} s  {}", describe::text(event)));
        }
        Ok(())
    }

    /// Prints a line of text or JSON.
    pub fn line(&mut self, line: &str) {
        match &mut self.view {
            Some(view) => view.note(line.to_owned()),
            // A closed pipe must not stop the robot with a panic.
            None => {
                let mut out = std::io::stdout();
                let _ = writeln!(out, "{line}").and_then(|()| out.flush());
            }
        }
    }

    /// Processes a key. Returns true if the user quits.
    fn press<D: Door + Send + 'static>(
        &mut self,
        key: KeyEvent,
        control: &Control<D>,
        flags: &Flags,
    ) -> bool {
        let hand_key = match key.code {
            KeyCode::Up => Some(HandKey::Arrow(Heading::Forward)),
            KeyCode::Down => Some(HandKey::Arrow(Heading::Backward)),
            KeyCode::Left => Some(HandKey::Arrow(Heading::Left)),
            KeyCode::Right => Some(HandKey::Arrow(Heading::Right)),
            KeyCode::Char('q') => Some(HandKey::Faster),
            KeyCode::Char('z') => Some(HandKey::Slower),
            KeyCode::Char(digit @ '1'..='6') => Some(HandKey::Gesture(digit as u8 - b'0')),
            _ => None,
        };
        match (key.kind, hand_key) {
            (KeyEventKind::Release, Some(key)) => control.order(Order::Up(key)),
            (KeyEventKind::Release, None) => {}
            (_, Some(key)) => control.order(Order::Press(key)),
            (_, None) => match key.code {
                KeyCode::Esc => return true,
                KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => return true,
                KeyCode::Char(' ') => flags.stop(),
                KeyCode::Char(key) if key == self.end_arm => control.order(Order::EndArm),
                KeyCode::Char(letter) if Some(letter) == self.clutch => {
                    // The key counts once, however long it is held.
                    let is_new = self.clutch_held.is_new(Instant::now());
                    if is_new && key.kind == KeyEventKind::Press {
                        control.order(Order::Clutch);
                    }
                }
                KeyCode::Char('r') => self.release(control),
                KeyCode::Char(SHOW) if self.shows && key.kind == KeyEventKind::Press => {
                    control.order(Order::Show);
                }
                KeyCode::Char(letter) if self.records && key.kind == KeyEventKind::Press => {
                    if let Some(mark) = mark_of(letter) {
                        control.order(Order::Mark(mark));
                    }
                }
                _ => {}
            },
        }
        false
    }

    /// Processes the release key, which counts at the second press.
    fn release<D: Door + Send + 'static>(&mut self, control: &Control<D>) {
        if self.released.take().is_some_and(|at| at.elapsed() < CONFIRM) {
            control.order(Order::Release);
        } else {
            self.released = Some(Instant::now());
            self.line("press r again to release the stop");
        }
    }

    /// About the session's file.
    pub fn told(&mut self, text: &str) {
        if self.json {
            let line = serde_json::json!({ "event": "file", "text": text });
            self.line(&line.to_string());
        } else {
            self.line(text);
        }
    }

    /// The session's result.
    pub fn end(&mut self, now: &Now<'_>, ros2: Option<Counts>, dropped: u64) {
        let odometry = now.robot.picture().odometry;
        let links = [Hand::Left, Hand::Right].map(|hand| now.bridge.link(hand));
        if self.json {
            let end = EndLine {
                time_ms: now.time_ms,
                event: "end",
                odometry,
                frames: links.map(|link| link.counters()),
                round_trip_ms: links.map(|link| link.round_trip_ms()),
                events_not_printed: dropped,
                accepted: now.bridge.accepted(),
                ros2,
            };
            self.line(&serde_json::to_string(&end).unwrap_or_default());
            return;
        }
        let text = format!(
            "{:.1} s; base: {:.2} m driven; frames: left {} ({} lost), right {} ({} lost)",
            now.time_ms as f64 / 1000.0,
            odometry.path_m,
            links[0].counters().frames,
            links[0].counters().lost,
            links[1].counters().frames,
            links[1].counters().lost
        );
        self.line(&text);
        if dropped > 0 {
            self.line(&format!("{dropped} events were not printed: the terminal was too slow"));
        }
        if let Some(counts) = ros2 {
            self.line(&format!("ROS 2: {} speeds and {} arm motions sent", counts.twists, counts.motions));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_that_is_held_counts_once_and_again_only_after_it_was_let_go() {
        let (mut held, began) = (Held::default(), Instant::now());
        let at = |ms| began + Duration::from_millis(ms);
        assert!(held.is_new(at(0)));
        // The first repeat of a slow terminal is followed by thirty repeats per second for five seconds.
        let repeats = std::iter::once(660).chain((690..5690).step_by(33));
        for ms in repeats {
            assert!(!held.is_new(at(ms)), "{ms}");
        }
        assert!(!held.is_new(at(6300)), "too soon after the last one");
        assert!(held.is_new(at(7100)));
    }
}
