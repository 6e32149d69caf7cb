//! Fills the history for pages from the tap.

use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::Serialize;

use super::Shared;
use super::history::EventLine;
use host_core::bridge::{BridgeEvent, EventKind};
use host_core::describe;
use host_core::observe::SessionEvent;
use host_core::observe::{Now, Observer, Sample, Setting, Snapshot, link_poses_in_world};

/// Minimum time between two published states, slightly less than a frame of a 60 Hz display.
pub const INTERVAL: Duration = Duration::from_millis(15);

/// Interval at which path and trace are sampled, in the session's time.
const TRAIL_INTERVAL_MS: u64 = 40;
/// Minimum distance between two points of the path, in m.
const PATH_STEP_M: f64 = 0.02;
const TRACE_STEP_M: f64 = 0.01;

#[derive(Serialize)]
struct Hello<'a> {
    hello: u32,
    version: &'a str,
    title: &'a str,
    /// Episodes can be marked.
    marks: bool,
    setting: &'a Setting,
}

/// An observer of a session, which never waits for a page.
pub struct Watcher {
    shared: Arc<Shared>,
    title: String,
    published: Option<Instant>,
    trail_due_ms: u64,
}

impl Watcher {
    pub(super) fn new(shared: Arc<Shared>, title: &str) -> Self {
        Watcher { shared, title: title.to_owned(), published: None, trail_due_ms: 0 }
    }

    fn greet(&self, now: &Now<'_>) {
        let (setting, version) = (Setting::of(now), env!("CARGO_PKG_VERSION"));
        let hello = Hello {
            hello: 1,
            version,
            title: &self.title,
            marks: self.shared.marks.is_some(),
            setting: &setting,
        };
        let hello = serde_json::to_string(&hello).unwrap_or_default();
        self.shared.history().hello = Some(hello.into());
    }

    fn trail(&mut self, now: &Now<'_>) {
        let picture = now.robot.picture();
        let odometry = picture.odometry;
        let here = [odometry.x_m, odometry.y_m];
        let flange = link_poses_in_world(now, &picture.arm.joints_rad)[host_robot::JOINTS];
        let flange = flange.position_m.to_array();
        let mut history = self.shared.history();
        if history.path.newest().is_none_or(|last| distance(last, &here) >= PATH_STEP_M) {
            history.path.push(here);
        }
        if history.trace.newest().is_none_or(|last| distance(last, &flange) >= TRACE_STEP_M) {
            history.trace.push(flange);
        }
    }
}

/// Publishes this as the newest state.
pub(super) fn publish(shared: &Shared, now: &Now<'_>) {
    // Serialisation cannot fail, because the data consists of numbers, texts and lists.
    let state = serde_json::to_string(&Snapshot::of(now)).unwrap_or_default();
    let mut history = shared.history();
    history.state = state.into();
    history.version += 1;
}

fn distance<const N: usize>(one: &[f64; N], two: &[f64; N]) -> f64 {
    one.iter().zip(two).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

impl Observer for Watcher {
    fn sampled(&mut self, time_ms: u64, sample: &Sample<'_>) {
        let mut history = self.shared.history();
        match sample {
            Sample::Left { bends_permille, .. } => history.bends_permille = Some(*bends_permille),
            Sample::Right { values } => {
                let time = std::iter::once(time_ms as f32);
                history.imu.push(time.chain(values.iter().copied()).collect());
            }
        }
    }

    fn happened(&mut self, event: &SessionEvent) {
        if describe::is_echo(event) {
            return;
        }
        let class = match event {
            SessionEvent::Bridge(BridgeEvent { kind, .. }) => match kind {
                EventKind::Halt { .. } | EventKind::HandUnusable { .. } | EventKind::BoardFault { .. } => {
                    "halt"
                }
                EventKind::Gesture { .. } | EventKind::MotionEnded { .. } => "motion",
                _ => "",
            },
            SessionEvent::RecordingEnded { .. } => "",
            SessionEvent::Marked { .. }
            | SessionEvent::EpisodeStopped { .. }
            | SessionEvent::Wearer { .. } => "motion",
        };
        let line = EventLine { time_ms: describe::time_ms(event), class, text: describe::text(event) };
        self.shared.history().events.push(line);
    }

    fn state(&mut self, now: &Now<'_>) {
        if now.time_ms >= self.trail_due_ms {
            self.trail_due_ms = now.time_ms + TRAIL_INTERVAL_MS;
            self.trail(now);
        }
        if self.published.is_none() {
            self.greet(now);
        }
        if self.published.is_none_or(|at| at.elapsed() >= INTERVAL) {
            self.published = Some(Instant::now());
            publish(&self.shared, now);
        }
    }
}
