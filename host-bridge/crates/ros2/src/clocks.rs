//! Compares the robot's clock with this machine's clock, and determines the stamps of commands.
//!
//! A received stamp was set shortly before arrival.
//! `stamp - local time` is therefore the clock difference minus the transmission time.
//! The largest such value of the last seconds is the most accurate one.
//! A robot that stamps its states late looks like a robot whose clock is behind.
//! Stamped commands are unsuitable for both robots.
//!
//! If `/clock` is published, it defines the graph's time (`use_sim_time`), and all stamps are compared with it.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

/// Maximum clock difference at which the robot may be armed, in seconds.
pub const DIFFERENCE_MAX_S: f64 = 0.1;
/// Stamps that arrived within this time are compared.
const WINDOW_MS: u64 = 2000;
/// A simulation's clock that is silent for this long has stopped or disappeared.
const SIMULATED_SILENCE_MS: u64 = 1000;
/// Minimum number of stamps for reporting a difference.
const STAMPS_MIN: usize = 3;
/// Maximum number of stamps that are kept.
const STAMPS_MAX: usize = 1024;

/// The kinds of stamps for the base's speed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stamp {
    /// Zero, which Jazzy's diff_drive_controller replaces with the time of arrival.
    /// The controller's timeout therefore works with any clocks.
    #[default]
    Zero,
    /// The graph's time: `/clock` if published, otherwise this machine's clock plus the measured difference.
    Clock,
    /// This machine's clock, unchanged.
    Wall,
}

/// The origin of a stamp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// `/joint_states`.
    JointStates,
    /// The base's odometry.
    Odometry,
}

/// The measured difference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// The robot's clock minus its reference in seconds. It is negative if the robot's clock is behind.
    pub seconds: f64,
    /// Whether the robot's time is simulated and comes from `/clock`.
    pub is_simulated: bool,
}

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct Clocks {
    /// Time of arrival, and the stamp minus its reference in seconds.
    heard: [VecDeque<(u64, f64)>; 2],
    /// Time of arrival in ms, and the simulated time in s.
    simulated: Option<(u64, f64)>,
}

impl Clocks {
    /// A message of `/clock`.
    pub fn hear_clock(&mut self, time_s: f64, now_ms: u64) {
        if !time_s.is_finite() {
            return;
        }
        if self.simulated.is_none() {
            // Earlier comparisons with this machine's clock no longer apply.
            self.heard.iter_mut().for_each(VecDeque::clear);
        }
        self.simulated = Some((now_ms, time_s));
    }

    /// Processes a stamp of the robot. Zero means that there is no stamp.
    pub fn hear(&mut self, source: Source, stamp_s: f64, wall_s: f64, now_ms: u64) {
        if stamp_s == 0.0 || !stamp_s.is_finite() {
            return;
        }
        let difference = stamp_s - self.reference_s(wall_s, now_ms);
        let heard = &mut self.heard[source as usize];
        if heard.len() == STAMPS_MAX {
            heard.pop_front();
        }
        heard.push_back((now_ms, difference));
    }

    /// Returns the graph's time if the clocks agree: `/clock`, or otherwise this machine's time.
    pub fn reference_s(&self, wall_s: f64, now_ms: u64) -> f64 {
        match self.simulated {
            Some((at_ms, time_s)) => {
                time_s + now_ms.saturating_sub(at_ms).min(SIMULATED_SILENCE_MS) as f64 / 1000.0
            }
            None => wall_s,
        }
    }

    /// Returns the clock difference, or `None` if there are too few recent stamps.
    /// If there are several sources, the largest difference is returned.
    pub fn difference(&self, now_ms: u64) -> Option<Difference> {
        let newest = |heard: &VecDeque<(u64, f64)>| {
            let lately = heard.iter().filter(|(at_ms, _)| now_ms.saturating_sub(*at_ms) <= WINDOW_MS);
            let (count, most) =
                lately.fold((0, f64::NEG_INFINITY), |(n, most), (_, d)| (n + 1, most.max(*d)));
            (count >= STAMPS_MIN).then_some(most)
        };
        let worst = self.heard.iter().filter_map(newest).max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
        Some(Difference { seconds: worst, is_simulated: self.simulated.is_some() })
    }

    /// Returns why the robot may not be armed, or `None` if the clocks agree or the robot sends no stamps.
    pub fn refusal(&self, now_ms: u64) -> Option<String> {
        if let Some((at_ms, _)) = self.simulated
            && now_ms.saturating_sub(at_ms) > SIMULATED_SILENCE_MS
        {
            return Some(
                "the simulation's /clock stands still: start it, or end it and this program".to_owned(),
            );
        }
        let difference = self.difference(now_ms)?;
        (difference.seconds.abs() > DIFFERENCE_MAX_S).then(|| advice(difference))
    }

    /// Like [`Self::refusal`], but for speeds with stamps of this kind.
    pub fn refusal_of(&self, stamp: Stamp, now_ms: u64) -> Option<String> {
        if self.simulated.is_some() && stamp == Stamp::Wall {
            return Some(
                "stamp = \"wall\" in [ros2], but time is simulated here: the base would never stop by itself; take \"zero\""
                    .to_owned(),
            );
        }
        self.refusal(now_ms)
    }

    /// Returns the robot's time of a decision made now in seconds, or `None` if the robot's clock is unknown.
    /// Commands that the robot executes by its own clock (an arm's trajectory) get this stamp.
    pub fn robot_s(&self, wall_s: f64, now_ms: u64) -> Option<f64> {
        let difference = self.difference(now_ms);
        match self.simulated {
            Some(_) => Some(self.reference_s(wall_s, now_ms) + difference.map_or(0.0, |d| d.seconds)),
            None => difference.map(|d| wall_s + d.seconds),
        }
    }

    /// Returns the stamp in seconds for a speed that was decided at `wall_s`; zero means "on arrival".
    pub fn stamp_s(&self, stamp: Stamp, wall_s: f64, now_ms: u64) -> f64 {
        match stamp {
            Stamp::Zero => 0.0,
            Stamp::Wall => wall_s,
            Stamp::Clock => self.robot_s(wall_s, now_ms).unwrap_or(0.0),
        }
    }
}

/// Explains a difference and gives advice.
pub fn advice(Difference { seconds, is_simulated }: Difference) -> String {
    let (apart, side) = (seconds.abs(), if seconds < 0.0 { "behind" } else { "ahead of" });
    if is_simulated {
        return format!(
            "the robot's stamps are {apart:.2} s {side} /clock: its nodes need use_sim_time, or whoever publishes \
             /clock should not"
        );
    }
    // Current clocks never show the year 2001.
    if apart > 0.5e9 {
        return "the robot's stamps are a simulation's, but nobody publishes /clock: start the simulator's clock \
                bridge, or its nodes without use_sim_time"
            .to_owned();
    }
    format!(
        "the robot's stamps are {apart:.2} s {side} this machine's clock: set both by NTP or chrony (`chronyc tracking` \
         on each); if they agree, the robot sends its states late"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const WALL_S: f64 = 1_790_000_000.0;

    /// Receives stamps for a second; `late_s` is the varying transmission time.
    fn heard(offset_s: f64, late_s: f64) -> Clocks {
        let mut clocks = Clocks::default();
        for n in 0..100_u64 {
            let now = WALL_S + n as f64 * 0.01;
            let on_the_way = late_s * (1.0 + (n % 7) as f64);
            clocks.hear(Source::JointStates, now + offset_s - on_the_way, now, n * 10);
        }
        clocks
    }

    #[test]
    fn the_difference_is_what_the_fastest_messages_say() {
        let clocks = heard(-2.0, 0.001);
        let difference = clocks.difference(1000).unwrap();
        assert!((difference.seconds + 2.001).abs() < 1e-6, "{difference:?}");
        assert!(clocks.refusal(1000).unwrap().contains("2.00 s behind"));
        // Too long ago.
        assert_eq!(clocks.difference(4000), None);
        assert_eq!(heard(0.05, 0.001).refusal(1000), None);
        assert!(heard(10.0, 0.0).refusal(1000).unwrap().contains("10.00 s ahead of this machine"));
    }

    #[test]
    fn zero_stamps_and_few_stamps_say_nothing() {
        let mut clocks = Clocks::default();
        for n in 0..100 {
            clocks.hear(Source::Odometry, 0.0, WALL_S, n);
        }
        clocks.hear(Source::Odometry, f64::NAN, WALL_S, 100);
        clocks.hear(Source::Odometry, 5.0, WALL_S, 100);
        assert_eq!((clocks.difference(100), clocks.refusal(100)), (None, None));
    }

    #[test]
    fn of_two_sources_the_worse_counts() {
        let mut clocks = heard(0.0, 0.001);
        for n in 0..10 {
            clocks.hear(Source::Odometry, WALL_S + 0.9 - 30.0, WALL_S + 0.9, 900 + n);
        }
        assert!(clocks.refusal(1000).unwrap().contains("30.00 s behind"));
    }

    #[test]
    fn simulated_time_is_followed_and_stamps_of_the_wall_are_then_refused() {
        let mut clocks = heard(0.0, 0.001);
        clocks.hear_clock(10.0, 1000);
        assert_eq!(clocks.difference(1000), None, "compared with another clock");
        for n in 0..10 {
            clocks.hear_clock(10.0 + n as f64 * 0.01, 1000 + n * 10);
            clocks.hear(Source::JointStates, 10.0 + n as f64 * 0.01, WALL_S, 1000 + n * 10);
        }
        assert_eq!(clocks.refusal(1090), None);
        assert!((clocks.robot_s(WALL_S, 1190).unwrap() - 10.19).abs() < 1e-6);
        assert_eq!(clocks.stamp_s(Stamp::Zero, WALL_S, 1190), 0.0);
        assert!((clocks.stamp_s(Stamp::Clock, WALL_S, 1190) - 10.19).abs() < 1e-6);
        assert_eq!(clocks.stamp_s(Stamp::Wall, WALL_S, 1190), WALL_S);
        for n in 0..10 {
            clocks.hear(Source::Odometry, WALL_S, WALL_S, 1100 + n);
        }
        assert!(clocks.refusal(1190).unwrap().contains("use_sim_time"));
        assert!(clocks.refusal(3000).unwrap().contains("stands still"));
    }

    /// A base with diff_drive_controller, which replaces a zero stamp with the time of arrival.
    /// The controller brakes if a command is more than 0.5 s old by the controller's clock.
    #[test]
    fn with_any_clocks_the_base_stops_soon_after_the_last_command_or_nothing_arms() {
        let (mut worst_s, mut refused, mut count) = (0.0_f64, 0, 0);
        for simulated in [false, true] {
            for apart_s in [0.05, 0.09, 0.11, 0.5, 2.0, 10.0, 30.0_f64].iter().flat_map(|s| [*s, -*s]) {
                for stamp in [Stamp::Zero, Stamp::Clock, Stamp::Wall] {
                    let mut clocks = Clocks::default();
                    // The graph's time is wall-clock time or simulated time.
                    // The robot's time differs from the graph's time.
                    let graph_s = |wall_s: f64| if simulated { wall_s - WALL_S + 10.0 } else { wall_s };
                    for n in 0..200_u64 {
                        let now = WALL_S + n as f64 * 0.01;
                        if simulated {
                            clocks.hear_clock(graph_s(now), n * 10);
                        }
                        clocks.hear(Source::Odometry, graph_s(now) + apart_s, now, n * 10);
                    }
                    count += 1;
                    if let Some(why) = clocks.refusal_of(stamp, 2000) {
                        assert!(
                            why.contains("the robot's stamps are") || why.contains("never stop"),
                            "{why}"
                        );
                        refused += 1;
                        continue;
                    }
                    let sent_s = WALL_S + 2.0;
                    let robot_s = |wall_s: f64| graph_s(wall_s) + apart_s;
                    let stamp_s = clocks.stamp_s(stamp, sent_s, 2000);
                    let stored_s = if stamp_s == 0.0 { robot_s(sent_s) } else { stamp_s };
                    // The robot brakes when its clock is 0.5 s after the stored stamp.
                    let stops_s = stored_s + 0.5 - robot_s(sent_s);
                    assert!(
                        stops_s <= 0.6 + 1e-6,
                        "{apart_s} s, {stamp:?}, simulated: {simulated}: {stops_s} s"
                    );
                    worst_s = worst_s.max(stops_s);
                }
            }
        }
        println!(
            "row: v clocks apart: base at rest after the last command | {count}, {refused} refused | {:.0} ms | 600 ms",
            worst_s * 1000.0
        );
        assert_eq!(refused, 2 * 10 * 3 + 4, "beyond 0.1 s, and stamps of the wall in simulated time");
    }

    #[test]
    fn stamps_of_a_simulation_without_its_clock_are_named() {
        let mut clocks = Clocks::default();
        for n in 0..10_u64 {
            clocks.hear(Source::Odometry, 12.0, WALL_S, n);
        }
        assert!(clocks.refusal(10).unwrap().contains("nobody publishes /clock"));
        assert!((clocks.robot_s(WALL_S + 5.0, 10).unwrap() - 17.0).abs() < 1e-6);
    }
}
