//! Patterns of the vibration motor at the right hand's board. The wearer's wrist can distinguish them.
//!
//! | | pulses |
//! |---|---|
//! | accepted | one, short and light |
//! | refused | two, short and strong |
//! | stopped | one, long |
//! | link lost | three, of middle length |
//!
//! The laptop requests the first three patterns, and also the last one if the *other* hand is lost.
//! If the laptop itself is silent, the board plays the last pattern without a request.

use shared_proto::message::Signal;

/// If a laptop has requested signals and then sends nothing for this long, it counts as lost.
/// The laptop normally sends pings ten times as often.
pub const LAPTOP_LOST_MS: u32 = 1000;

struct Pattern {
    pulses: u32,
    on_ms: u32,
    off_ms: u32,
    percent: u8,
    /// Priority of the signal. A less important signal does not interrupt a more important signal.
    weight: u8,
}

impl Pattern {
    const fn of(signal: Signal) -> Option<Self> {
        Some(match signal {
            Signal::Accepted => Self { pulses: 1, on_ms: 80, off_ms: 0, percent: 60, weight: 0 },
            Signal::Refused => Self { pulses: 2, on_ms: 80, off_ms: 100, percent: 100, weight: 0 },
            Signal::Stopped => Self { pulses: 1, on_ms: 600, off_ms: 0, percent: 100, weight: 1 },
            Signal::LinkLost => Self { pulses: 3, on_ms: 250, off_ms: 150, percent: 100, weight: 1 },
            Signal::Ready | Signal::Unknown(_) => return None,
        })
    }

    const fn length_ms(&self) -> u32 {
        self.pulses * (self.on_ms + self.off_ms) - self.off_ms
    }

    /// Returns the strength at this time after the start of the pattern, and the time of the next change.
    const fn at(&self, passed_ms: u32) -> (u8, u32) {
        let in_pulse_ms = passed_ms % (self.on_ms + self.off_ms);
        if in_pulse_ms < self.on_ms {
            (self.percent, self.on_ms - in_pulse_ms)
        } else {
            (0, self.on_ms + self.off_ms - in_pulse_ms)
        }
    }
}

/// The current state of the motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Motor {
    /// Strength in per cent: 0 means off, 100 means maximum.
    pub percent: u8,
    /// Time after which to ask again, or `None` if nothing will change without a request.
    pub for_ms: Option<u32>,
}

/// Converts signals to the strength of the motor.
#[derive(Clone, Copy, Debug, Default)]
pub struct Vibration {
    /// The current signal, and the time at which it started.
    playing: Option<(Signal, u32)>,
    /// Time of the laptop's last message. It is `None` if the laptop has requested no signals or is disconnected.
    heard_ms: Option<u32>,
    /// Whether signals were requested since start.
    wanted: bool,
}

impl Vibration {
    /// Reports a message from the laptop.
    pub fn heard(&mut self, now_ms: u32) {
        if self.wanted {
            self.heard_ms = Some(now_ms);
        }
    }

    /// Starts a signal that the laptop requests.
    pub fn feel(&mut self, signal: Signal, now_ms: u32) {
        self.wanted = true;
        self.heard(now_ms);
        self.play(signal, now_ms);
    }

    /// Returns the current state of the motor.
    pub fn motor(&mut self, now_ms: u32) -> Motor {
        if self.heard_ms.is_some_and(|heard| now_ms.wrapping_sub(heard) >= LAPTOP_LOST_MS) {
            self.heard_ms = None;
            self.play(Signal::LinkLost, now_ms);
        }
        let lost_in_ms = self.heard_ms.map(|heard| LAPTOP_LOST_MS - now_ms.wrapping_sub(heard));
        let Some((pattern, passed_ms)) = self.pattern(now_ms) else {
            self.playing = None;
            return Motor { percent: 0, for_ms: lost_in_ms };
        };
        let (percent, for_ms) = pattern.at(passed_ms);
        Motor { percent, for_ms: Some(lost_in_ms.map_or(for_ms, |lost| lost.min(for_ms))) }
    }

    /// Returns the current pattern unless it has ended.
    fn pattern(&self, now_ms: u32) -> Option<(Pattern, u32)> {
        let (signal, since_ms) = self.playing?;
        let (pattern, passed_ms) = (Pattern::of(signal)?, now_ms.wrapping_sub(since_ms));
        (passed_ms < pattern.length_ms()).then_some((pattern, passed_ms))
    }

    fn play(&mut self, signal: Signal, now_ms: u32) {
        let Some(new) = Pattern::of(signal) else { return };
        if self.pattern(now_ms).is_none_or(|(old, _)| new.weight >= old.weight) {
            self.playing = Some((signal, now_ms));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;
    use std::vec::Vec;

    /// Returns each strength and its duration from `from_ms` on, in the same way as a driver obtains them.
    /// The pattern ends at `until_ms`, or when nothing changes for a second.
    fn played(vibration: &mut Vibration, from_ms: u32, until_ms: u32) -> Vec<(u8, u32)> {
        let mut seen: Vec<(u8, u32)> = Vec::new();
        let mut now_ms = from_ms;
        while now_ms.wrapping_sub(from_ms) < until_ms.wrapping_sub(from_ms) {
            // The laptop sends pings.
            vibration.heard(now_ms);
            let motor = vibration.motor(now_ms);
            let left_ms = until_ms.wrapping_sub(now_ms);
            let for_ms = motor.for_ms.unwrap_or(u32::MAX).min(left_ms).min(50);
            match seen.last_mut() {
                Some((percent, length_ms)) if *percent == motor.percent => *length_ms += for_ms,
                _ => seen.push((motor.percent, for_ms)),
            }
            now_ms = now_ms.wrapping_add(for_ms);
        }
        seen
    }

    #[test]
    fn four_signals_have_four_patterns() {
        for (signal, pulses) in [
            (Signal::Ready, vec![(0, 2000)]),
            (Signal::Accepted, vec![(60, 80), (0, 1920)]),
            (Signal::Refused, vec![(100, 80), (0, 100), (100, 80), (0, 1740)]),
            (Signal::Stopped, vec![(100, 600), (0, 1400)]),
            (Signal::LinkLost, vec![(100, 250), (0, 150), (100, 250), (0, 150), (100, 250), (0, 950)]),
            (Signal::Unknown(77), vec![(0, 2000)]),
        ] {
            // The pattern must be the same when the clock wraps.
            for now_ms in [0, 12_345, u32::MAX - 90] {
                let mut vibration = Vibration::default();
                vibration.feel(signal, now_ms);
                let seen = played(&mut vibration, now_ms, now_ms.wrapping_add(2000));
                assert_eq!(seen, pulses, "{signal:?} at {now_ms}");
            }
        }
    }

    #[test]
    fn what_matters_more_is_not_cut_short_and_cuts_what_matters_less() {
        let mut vibration = Vibration::default();
        vibration.feel(Signal::Stopped, 0);
        vibration.feel(Signal::Refused, 100);
        assert_eq!(vibration.motor(100), Motor { percent: 100, for_ms: Some(500) });
        vibration.feel(Signal::LinkLost, 200);
        assert_eq!(vibration.motor(200), Motor { percent: 100, for_ms: Some(250) });
        vibration.feel(Signal::Accepted, 2000);
        vibration.feel(Signal::Stopped, 2010);
        assert_eq!(vibration.motor(2010), Motor { percent: 100, for_ms: Some(600) });
    }

    #[test]
    fn a_laptop_that_falls_silent_is_felt_once_and_only_where_it_had_asked_for_signals() {
        let mut vibration = Vibration::default();
        vibration.heard(0);
        assert_eq!(vibration.motor(5000), Motor { percent: 0, for_ms: None });
        vibration.feel(Signal::Ready, 5000);
        assert_eq!(vibration.motor(5000), Motor { percent: 0, for_ms: Some(1000) });
        vibration.heard(5900);
        assert_eq!(vibration.motor(6000), Motor { percent: 0, for_ms: Some(900) });
        assert_eq!(vibration.motor(6900), Motor { percent: 100, for_ms: Some(250) });
        assert_eq!(vibration.motor(8000), Motor { percent: 0, for_ms: None });
        assert_eq!(vibration.motor(60_000), Motor { percent: 0, for_ms: None });
        // The laptop comes back and is lost again.
        vibration.heard(70_000);
        assert_eq!(vibration.motor(70_999), Motor { percent: 0, for_ms: Some(1) });
        assert_eq!(vibration.motor(71_000).percent, 100);
    }
}
