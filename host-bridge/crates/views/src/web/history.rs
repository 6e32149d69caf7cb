//! Data for pages: the newest state, and the last seconds of all sequences.

use std::collections::VecDeque;
use std::sync::Arc;

use serde::Serialize;

/// Number of stored right-hand samples: 8 s at 100 Hz.
const SAMPLES_MAX: usize = 800;
const EVENTS_MAX: usize = 200;
const PATH_MAX: usize = 3000;
const TRACE_MAX: usize = 1500;

/// The last items of a sequence, numbered from the start.
#[derive(Clone, Debug)]
pub struct Last<T> {
    items: VecDeque<T>,
    room: usize,
    /// Number of the next item.
    next: u64,
}

impl<T: Clone> Last<T> {
    fn new(room: usize) -> Self {
        Last { items: VecDeque::new(), room, next: 0 }
    }

    /// Adds an item. If the sequence is full, the oldest item is removed.
    pub fn push(&mut self, item: T) {
        if self.items.len() == self.room {
            self.items.pop_front();
        }
        self.items.push_back(item);
        self.next += 1;
    }

    /// The newest.
    pub fn newest(&self) -> Option<&T> {
        self.items.back()
    }

    /// Returns all stored items from number `seen` on, and sets `seen` to the next number.
    pub fn since(&self, seen: &mut u64) -> Vec<T> {
        let missing = self.next.saturating_sub(*seen).min(self.items.len() as u64) as usize;
        *seen = self.next;
        self.items.range(self.items.len() - missing..).cloned().collect()
    }
}

/// A line in the list of events.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EventLine {
    /// When.
    pub time_ms: u64,
    /// Style of the line: `halt`, `motion`, or empty.
    pub class: &'static str,
    /// For people.
    pub text: String,
}

/// See the module.
#[derive(Clone, Debug)]
pub struct History {
    /// The first message to each page. It does not exist before the session's first step.
    pub hello: Option<Arc<str>>,
    /// The newest [`host_core::observe::Snapshot`] as JSON.
    pub state: Arc<str>,
    /// Counts states; 0 = none yet.
    pub version: u64,
    /// Bends of the fingers, if known.
    pub bends_permille: Option<[i16; 2]>,
    /// Time in ms, followed by the values of one IMU sample.
    pub imu: Last<Vec<f32>>,
    /// The events with their times.
    pub events: Last<EventLine>,
    /// Path of the base in m.
    pub path: Last<[f64; 2]>,
    /// Path of the flange in the world in m.
    pub trace: Last<[f64; 3]>,
}

impl Default for History {
    fn default() -> Self {
        History {
            hello: None,
            state: Arc::from(""),
            version: 0,
            bends_permille: None,
            imu: Last::new(SAMPLES_MAX),
            events: Last::new(EVENTS_MAX),
            path: Last::new(PATH_MAX),
            trace: Last::new(TRACE_MAX),
        }
    }
}

/// The data that one page has already received.
#[derive(Clone, Copy, Debug, Default)]
pub struct Told {
    version: u64,
    imu: u64,
    events: u64,
    path: u64,
    trace: u64,
}

#[derive(Serialize)]
struct News<'a> {
    bends_permille: Option<[i16; 2]>,
    imu: &'a [Vec<f32>],
    events: &'a [EventLine],
    path: &'a [[f64; 2]],
    trace: &'a [[f64; 3]],
}

/// The data for one message, which is copied under the lock and formatted outside of it.
pub struct Frame {
    version: u64,
    state: Arc<str>,
    bends_permille: Option<[i16; 2]>,
    imu: Vec<Vec<f32>>,
    events: Vec<EventLine>,
    path: Vec<[f64; 2]>,
    trace: Vec<[f64; 3]>,
}

impl History {
    /// Returns the data that a page has not received yet, if there is a newer state.
    pub fn frame(&self, told: &mut Told) -> Option<Frame> {
        if self.version == told.version {
            return None;
        }
        told.version = self.version;
        Some(Frame {
            version: self.version,
            state: self.state.clone(),
            bends_permille: self.bends_permille,
            imu: self.imu.since(&mut told.imu),
            events: self.events.since(&mut told.events),
            path: self.path.since(&mut told.path),
            trace: self.trace.since(&mut told.trace),
        })
    }
}

impl Frame {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        let Frame { version, state, bends_permille, imu, events, path, trace } = self;
        let news = News { bends_permille: *bends_permille, imu, events, path, trace };
        // Serialisation cannot fail, because the data consists of numbers, texts and lists.
        let news = serde_json::to_string(&news).unwrap_or_default();
        format!(r#"{{"frame":{version},"state":{state},"news":{news}}}"#)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_gets_everything_once_and_one_that_was_away_what_is_left() {
        let mut last = Last::new(3);
        let (mut quick, mut slow) = (0, 0);
        assert!(last.since(&mut quick).is_empty());
        last.push('a');
        last.push('b');
        assert_eq!(last.since(&mut quick), ['a', 'b']);
        last.push('c');
        last.push('d');
        assert_eq!(last.since(&mut quick), ['c', 'd']);
        assert!(last.since(&mut quick).is_empty());
        assert_eq!(last.since(&mut slow), ['b', 'c', 'd']);
        assert_eq!(last.newest(), Some(&'d'));
    }

    #[test]
    fn a_frame_comes_only_with_a_newer_state_and_is_json() {
        let mut history = History::default();
        let mut told = Told::default();
        history.path.push([1.0, 2.0]);
        assert!(history.frame(&mut told).is_none());
        history.state = Arc::from(r#"{"time_ms":5}"#);
        history.version = 7;
        let text = history.frame(&mut told).unwrap().to_json();
        let frame: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(frame["frame"], 7);
        assert_eq!(frame["state"]["time_ms"], 5);
        assert_eq!(frame["news"]["path"][0][1], 2.0);
        assert!(history.frame(&mut told).is_none());
    }
}
