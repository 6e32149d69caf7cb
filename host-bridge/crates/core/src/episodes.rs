//! Episodes of a session, which the operator marks for training robots.
//!
//! ```text
//! gesture, key, page ─► Mark ─► Tally (determines the effect) ─► the session's file ─► the same Tally in `export`
//! ```

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// The marks of an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mark {
    /// One begins.
    Begin,
    /// The episode ends and is kept.
    End,
    /// The current or last episode failed and is discarded. Another episode begins.
    Again,
    /// The episode is good. An episode in progress ends.
    Good,
    /// The episode is bad and discarded. An episode in progress ends.
    Bad,
}

impl Mark {
    /// All marks in the order of their numbers in a session's file.
    pub const ALL: [Mark; 5] = [Mark::Begin, Mark::End, Mark::Again, Mark::Good, Mark::Bad];

    /// Returns the name used in files, pages and options.
    pub fn name(self) -> &'static str {
        match self {
            Mark::Begin => "begin",
            Mark::End => "end",
            Mark::Again => "again",
            Mark::Good => "good",
            Mark::Bad => "bad",
        }
    }
}

impl fmt::Display for Mark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Mark {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Mark::ALL.into_iter().find(|mark| mark.name() == text.trim());
        found
            .ok_or_else(|| format!("'{}' is no mark; marks are begin, end, again, good and bad", text.trim()))
    }
}

/// The origin of a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum MarkedBy {
    /// A gesture of the right hand set the mark.
    Gesture,
    /// On the terminal.
    Key,
    /// On the page.
    Page,
}

impl MarkedBy {
    /// The name of the origin, as written in files.
    pub fn name(self) -> &'static str {
        match self {
            MarkedBy::Gesture => "gesture",
            MarkedBy::Key => "key",
            MarkedBy::Page => "page",
        }
    }
}

/// A part of a session that was marked as an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Take {
    /// On the session's clock.
    pub start_ms: u64,
    /// On the session's clock.
    pub end_ms: u64,
    /// The result of the take.
    pub verdict: Verdict,
}

/// The result of a take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The take ended and was not judged.
    Ended,
    /// It was marked good.
    Good,
    /// The take is not an episode, for this reason.
    LeftOut(&'static str),
}

/// The effect of a mark, for users. Episodes are numbered from 1 in the order of their start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Told {
    /// One has begun.
    Begun(usize),
    /// The episode with this number ended after this duration.
    Ended(usize, u64),
    /// The first episode was discarded, and the second has begun.
    Repeated(usize, usize),
    /// This one is good.
    Good(usize),
    /// This episode is not exported.
    Bad(usize),
    /// There is no episode to mark.
    Nothing(Mark),
}

impl fmt::Display for Told {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Told::Begun(number) => write!(f, "episode {number} begins"),
            Told::Ended(number, ms) => write!(f, "episode {number} ends after {:.1} s", *ms as f64 / 1000.0),
            Told::Repeated(before, number) => {
                write!(f, "episode {before} is thrown away, episode {number} begins")
            }
            Told::Good(number) => write!(f, "episode {number} is good"),
            Told::Bad(number) => write!(f, "episode {number} is bad: it is left out"),
            Told::Nothing(mark) => write!(f, "'{mark}' marks nothing: no episode has begun"),
        }
    }
}

/// Collects the takes of a session from its marks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    open_ms: Option<u64>,
    takes: Vec<Take>,
}

impl Tally {
    /// Takes a mark.
    pub fn mark(&mut self, mark: Mark, time_ms: u64) -> Told {
        match (mark, self.open_ms) {
            (Mark::Begin, open) => {
                if open.is_some() {
                    self.close(time_ms, Verdict::LeftOut("another one began before it ended"));
                }
                self.begin(time_ms)
            }
            (Mark::Again, open) => {
                const AGAIN: Verdict = Verdict::LeftOut("it was repeated");
                match (open, self.takes.last_mut()) {
                    (Some(_), _) => {
                        self.close(time_ms, AGAIN);
                    }
                    (None, Some(last)) => last.verdict = AGAIN,
                    (None, None) => return self.begin(time_ms),
                }
                let before = self.takes.len();
                self.begin(time_ms);
                Told::Repeated(before, before + 1)
            }
            (Mark::End, Some(start_ms)) => {
                let number = self.close(time_ms, Verdict::Ended);
                Told::Ended(number, time_ms.saturating_sub(start_ms))
            }
            (Mark::Good, Some(_)) => Told::Good(self.close(time_ms, Verdict::Good)),
            (Mark::Bad, Some(_)) => Told::Bad(self.close(time_ms, BAD)),
            (Mark::Good | Mark::Bad, None) => {
                let number = self.takes.len();
                let Some(last) = self.takes.last_mut() else { return Told::Nothing(mark) };
                last.verdict = if mark == Mark::Good { Verdict::Good } else { BAD };
                if mark == Mark::Good { Told::Good(number) } else { Told::Bad(number) }
            }
            (Mark::End, None) => Told::Nothing(mark),
        }
    }

    /// Processes an operator's stop: discards the current take and returns its number, if there is one.
    pub fn stop(&mut self, time_ms: u64) -> Option<usize> {
        self.open_ms.is_some().then(|| self.close(time_ms, Verdict::LeftOut("somebody pressed stop")))
    }

    /// Ends the session and returns all takes in order.
    pub fn finish(mut self, time_ms: u64) -> Vec<Take> {
        if self.open_ms.is_some() {
            self.close(time_ms, Verdict::LeftOut("the session ended before it"));
        }
        self.takes
    }

    fn begin(&mut self, time_ms: u64) -> Told {
        self.open_ms = Some(time_ms);
        Told::Begun(self.takes.len() + 1)
    }

    fn close(&mut self, end_ms: u64, verdict: Verdict) -> usize {
        if let Some(start_ms) = self.open_ms.take() {
            self.takes.push(Take { start_ms, end_ms, verdict });
        }
        self.takes.len()
    }
}

const BAD: Verdict = Verdict::LeftOut("it was marked bad");

#[cfg(test)]
mod tests {
    use super::*;
    use Mark::{Again, Bad, Begin, End, Good};

    fn takes(marks: &[(u64, Mark)]) -> (Vec<String>, Vec<Take>) {
        let mut tally = Tally::default();
        let told = marks.iter().map(|&(time_ms, mark)| tally.mark(mark, time_ms).to_string()).collect();
        (told, tally.finish(100_000))
    }

    #[test]
    fn episodes_are_begun_ended_repeated_and_judged() {
        let (told, takes) = takes(&[
            (1_000, Begin),
            (3_500, End),
            (4_000, Begin),
            (5_000, Again),
            (7_000, Good),
            (8_000, Begin),
            (9_000, End),
            (9_500, Bad),
            (10_000, Begin),
            (11_000, End),
            (12_000, Again),
            (13_000, End),
            (13_100, Good),
        ]);
        assert_eq!(told[1], "episode 1 ends after 2.5 s");
        assert_eq!(told[3], "episode 2 is thrown away, episode 3 begins");
        assert_eq!(told[7], "episode 4 is bad: it is left out");
        assert_eq!(told[10], "episode 5 is thrown away, episode 6 begins");
        let left_out = |take: &Take| matches!(take.verdict, Verdict::LeftOut(_));
        let spans: Vec<_> = takes.iter().map(|t| (t.start_ms, t.end_ms, left_out(t))).collect();
        assert_eq!(
            spans,
            [
                (1_000, 3_500, false),
                (4_000, 5_000, true),
                (5_000, 7_000, false),
                (8_000, 9_000, true),
                (10_000, 11_000, true),
                (12_000, 13_000, false)
            ]
        );
        let goods: Vec<bool> = takes.iter().map(|take| take.verdict == Verdict::Good).collect();
        assert_eq!(goods, [false, false, true, false, false, true]);
    }

    #[test]
    fn marks_without_an_episode_say_so_and_change_nothing() {
        let (told, takes) = takes(&[(1_000, End), (2_000, Good), (3_000, Bad)]);
        assert!(takes.is_empty());
        assert!(told.iter().all(|line| line.ends_with("no episode has begun")), "{told:?}");
        assert_eq!(takes_of_again(), ["episode 1 begins"]);
    }

    fn takes_of_again() -> Vec<String> {
        takes(&[(1_000, Again)]).0
    }

    #[test]
    fn what_is_open_at_a_stop_a_second_begin_or_the_end_is_left_out() {
        let mut tally = Tally::default();
        tally.mark(Begin, 1_000);
        assert_eq!((tally.stop(2_000), tally.stop(2_100)), (Some(1), None));
        tally.mark(Begin, 3_000);
        tally.mark(Begin, 4_000);
        let whys: Vec<Verdict> = tally.finish(5_000).iter().map(|take| take.verdict).collect();
        assert_eq!(
            whys,
            [
                Verdict::LeftOut("somebody pressed stop"),
                Verdict::LeftOut("another one began before it ended"),
                Verdict::LeftOut("the session ended before it")
            ]
        );
    }

    #[test]
    fn names_are_read_back() {
        for mark in Mark::ALL {
            assert_eq!(mark.name().parse(), Ok(mark));
        }
        assert!("start".parse::<Mark>().unwrap_err().contains("begin, end, again, good and bad"));
    }
}
