//! Lines that `run --json` prints in addition to the events.

use host_bridge::ros2::Counts;
use host_bridge::safety::Hand;
use serde::Serialize;

#[derive(Serialize)]
pub(super) struct LinkLine<'a> {
    pub(super) time_ms: u64,
    pub(super) event: &'static str,
    pub(super) hand: Hand,
    pub(super) open: bool,
    pub(super) text: &'a str,
}

#[derive(Serialize)]
pub(super) struct PageLine<'a> {
    pub(super) time_ms: u64,
    pub(super) event: &'static str,
    pub(super) url: &'a str,
}

#[derive(Serialize)]
pub(super) struct EndLine {
    pub(super) time_ms: u64,
    pub(super) event: &'static str,
    pub(super) odometry: host_bridge::base::Odometry,
    pub(super) frames: [host_bridge::link::LinkCounters; 2],
    pub(super) round_trip_ms: [Option<u64>; 2],
    pub(super) events_not_printed: u64,
    pub(super) accepted: host_bridge::bridge::Accepted,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) ros2: Option<Counts>,
}
