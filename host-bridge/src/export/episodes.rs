//! Finds the start and end of episodes.

use host_core::episodes::{Take, Tally, Verdict};

use super::session::{Happened, Streams};

/// The division of a session into episodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Cut {
    /// The complete session is one episode.
    Whole,
    /// One episode for each motion of the arm, from the gesture to the end of the motion.
    /// A motion that did not reach its pose must be repeated, and is therefore omitted.
    Motions,
    /// Episodes are defined by the marks that the operator set during the session.
    Marks {
        /// Whether to select only good episodes instead of all completed episodes.
        only_good: bool,
    },
    /// Gestures that are reserved for marking.
    Gestures {
        /// Begins an episode.
        begin: String,
        /// Ends the episode and marks it as good.
        end: String,
        /// Discards the current episode and begins again.
        again: Option<String>,
    },
}

/// A part of a session that is exported.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Episode {
    /// Start time on the session's clock.
    pub start_ms: u64,
    /// End time on the session's clock, at least one frame after the start.
    pub end_ms: u64,
    /// A description of the task.
    pub task: String,
}

/// Episodes, and the reasons why parts of the session were omitted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// In order of time.
    pub episodes: Vec<Episode>,
    /// The time and reason of each omission.
    pub left_out: Vec<(u64, String)>,
}

/// Splits a session. `task` has priority over the session's own task.
pub fn find(streams: &Streams, cut: &Cut, task: Option<&str>) -> Found {
    let first = |times: [Option<u64>; 3]| times.into_iter().flatten().max().unwrap_or_default();
    let begun = first([
        streams.joints.first().map(|(time, _)| *time),
        streams.base.first().map(|(time, _)| *time),
        streams.asked.first().map(|(time, _)| *time),
    ]);
    let last = [
        streams.joints.last().map(|(time, _)| *time),
        streams.base.last().map(|(time, _)| *time),
        streams.asked.last().map(|(time, _)| *time),
    ];
    let over = last.into_iter().flatten().min().unwrap_or_default();
    let mut cutter = Cutter { found: Found::default(), open: None, begun, over };
    let task = task.or(streams.task.as_deref());
    let words = |said: &str| task.map_or_else(|| said.replace(['-', '_'], " "), str::to_owned);
    let titled = || words(if streams.title.is_empty() { "a session of two hands" } else { &streams.title });
    if *cut == Cut::Whole {
        cutter.begin(begun, titled());
        cutter.end(over);
        return cutter.found;
    }
    if let Cut::Marks { only_good } = *cut {
        for take in takes(streams, over) {
            cutter.begin(take.start_ms, titled());
            match take.verdict {
                Verdict::LeftOut(why) => cutter.give_up(why),
                Verdict::Ended if only_good => cutter.give_up("it was not marked good"),
                Verdict::Ended | Verdict::Good => cutter.end(take.end_ms),
            }
        }
        return cutter.found;
    }
    for (time, happened) in &streams.events {
        match (cut, happened) {
            (Cut::Motions, Happened::Gesture(_, Some(motion))) => {
                cutter.give_up("another motion began before it ended");
                cutter.begin(*time, words(motion));
            }
            (Cut::Motions, Happened::MotionEnded(_, true)) => cutter.end(*time),
            (Cut::Motions, Happened::MotionEnded(motion, false)) => {
                cutter.give_up(&format!("{motion} did not reach its pose"));
            }
            (Cut::Gestures { begin, end, again }, Happened::Gesture(label, _)) => {
                if label == end {
                    cutter.end(*time);
                } else if Some(label) == again.as_ref() {
                    cutter.give_up(&format!("{label} asked for it again"));
                    cutter.begin(*time, titled());
                } else if label == begin {
                    cutter.give_up("another one began before it ended");
                    cutter.begin(*time, titled());
                }
            }
            (_, Happened::StopKey) => cutter.give_up("somebody pressed stop"),
            _ => {}
        }
    }
    cutter.give_up("the session ended before it");
    cutter.found
}

/// Returns the episodes that the operator's marks define. The session's own reports used the same rules.
fn takes(streams: &Streams, over_ms: u64) -> Vec<Take> {
    let mut tally = Tally::default();
    for (time_ms, happened) in &streams.events {
        match happened {
            Happened::Marked(mark) => {
                tally.mark(*mark, *time_ms);
            }
            Happened::StopKey => {
                tally.stop(*time_ms);
            }
            _ => {}
        }
    }
    tally.finish(over_ms)
}

struct Cutter {
    found: Found,
    open: Option<(u64, String)>,
    begun: u64,
    over: u64,
}

impl Cutter {
    fn begin(&mut self, time: u64, task: String) {
        self.open = Some((time.max(self.begun), task));
    }

    fn end(&mut self, time: u64) {
        let Some((start_ms, task)) = self.open.take() else { return };
        let end_ms = time.min(self.over);
        if end_ms > start_ms {
            self.found.episodes.push(Episode { start_ms, end_ms, task });
        } else {
            self.found.left_out.push((start_ms, "it has no length".to_owned()));
        }
    }

    fn give_up(&mut self, why: &str) {
        if let Some((start_ms, task)) = self.open.take() {
            self.found.left_out.push((start_ms, format!("{task}: {why}")));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn streams(events: Vec<(u64, Happened)>) -> Streams {
        let ends = [100, 9_900];
        Streams {
            title: "sort-the-cups".to_owned(),
            joints: ends.map(|time| (time, vec![0.0])).to_vec(),
            base: ends.map(|time| (time, [0.0; 5])).to_vec(),
            asked: ends.map(|time| (time, [0.0; 2])).to_vec(),
            events,
            ..Streams::default()
        }
    }

    fn gesture(label: &str, motion: Option<&str>) -> Happened {
        Happened::Gesture(label.to_owned(), motion.map(str::to_owned))
    }

    #[test]
    fn a_motion_is_an_episode_from_its_gesture_to_its_pose() {
        let ended = |reached| Happened::MotionEnded("pick-up".to_owned(), reached);
        let events = vec![
            (1_000, gesture("circle", Some("pick-up"))),
            (1_500, gesture("wave", None)),
            (3_000, ended(true)),
            (4_000, gesture("circle", Some("pick-up"))),
            (4_500, ended(false)),
            (5_000, gesture("circle", Some("pick-up"))),
            (5_500, Happened::StopKey),
            (5_600, ended(false)),
            (9_000, gesture("circle", Some("pick-up"))),
        ];
        let found = find(&streams(events), &Cut::Motions, None);
        assert_eq!(found.episodes, [Episode { start_ms: 1_000, end_ms: 3_000, task: "pick up".to_owned() }]);
        let whys: Vec<&str> = found.left_out.iter().map(|(_, why)| why.as_str()).collect();
        assert_eq!(
            whys,
            [
                "pick up: pick-up did not reach its pose",
                "pick up: somebody pressed stop",
                "pick up: the session ended before it"
            ]
        );
    }

    #[test]
    fn gestures_begin_end_and_repeat_episodes() {
        let cut = Cut::Gestures {
            begin: "circle".to_owned(),
            end: "up-down".to_owned(),
            again: Some("left-right".to_owned()),
        };
        let events = ["circle", "up-down", "up-down", "circle", "left-right", "up-down"];
        let events = (1..).zip(events).map(|(n, label)| (n * 1000, gesture(label, None))).collect();
        let found = find(&streams(events), &cut, Some("stack two cups"));
        let spans: Vec<(u64, u64)> = found.episodes.iter().map(|e| (e.start_ms, e.end_ms)).collect();
        assert_eq!(spans, [(1_000, 2_000), (5_000, 6_000)]);
        assert!(found.episodes.iter().all(|episode| episode.task == "stack two cups"));
        assert_eq!(found.left_out.len(), 1);
    }

    #[test]
    fn marks_make_episodes_and_what_was_repeated_bad_or_stopped_is_left_out() {
        use host_core::episodes::Mark::{Again, Bad, Begin, End, Good};
        let marks = [(1_000, Begin), (2_000, End), (3_000, Begin), (3_500, Again), (4_000, Good)];
        let more = [(5_000, Begin), (5_500, Bad), (6_000, Begin), (7_500, Begin), (8_000, End)];
        let marked = |(time, mark)| (time, Happened::Marked(mark));
        let mut events: Vec<_> = marks.into_iter().chain(more).map(marked).collect();
        events.insert(8, (7_000, Happened::StopKey));
        let session = Streams { task: Some("stack two cups".to_owned()), ..streams(events) };
        let spans = |only_good| {
            let found = find(&session, &Cut::Marks { only_good }, None);
            assert!(found.episodes.iter().all(|episode| episode.task == "stack two cups"));
            let spans: Vec<_> = found.episodes.iter().map(|e| (e.start_ms, e.end_ms)).collect();
            (spans, found.left_out.len())
        };
        assert_eq!(spans(false), (vec![(1_000, 2_000), (3_500, 4_000), (7_500, 8_000)], 3));
        assert_eq!(spans(true), (vec![(3_500, 4_000)], 5));
    }

    #[test]
    fn a_whole_session_is_what_all_streams_cover() {
        let found = find(&streams(Vec::new()), &Cut::Whole, None);
        let task = "sort the cups".to_owned();
        assert_eq!(found.episodes, [Episode { start_ms: 100, end_ms: 9_900, task }]);
    }
}
