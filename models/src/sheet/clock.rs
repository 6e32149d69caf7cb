//! Converts time columns to increasing milliseconds.

use crate::recording::{MAX_RATE_HZ, MIN_RATE_HZ, SAME_RATE};

/// Units of a time column without a declared unit, in milliseconds. The reader tries them in this order.
const UNITS: [(&str, f64); 4] = [("ms", 1.0), ("s", 1000.0), ("µs", 1e-3), ("ns", 1e-6)];

/// A cell in a time column: a number, or a time of day with an optional date. Times of day are converted to seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Stamp {
    Number(f64),
    Seconds(f64),
}

/// Parses a cell of a time column.
pub(super) fn stamp(cell: &str) -> Option<Stamp> {
    match super::text::number(cell) {
        Some(number) => Some(Stamp::Number(number)),
        None => of_day(cell).map(Stamp::Seconds),
    }
}

/// Returns the seconds in `2026-05-01 12:30:59.250`, `12:30:59,25`, `12:30:59:250` and similar texts.
fn of_day(cell: &str) -> Option<f64> {
    let cell = cell.trim().trim_end_matches('Z');
    let (date, clock) = match cell.split_once(['T', ' ']) {
        Some((date, clock)) => (Some(date), clock.trim()),
        None => (None, cell),
    };
    // The time zone after a time is the same in all rows, so it is ignored.
    let clock = clock.split_once(['+', ' ']).map_or(clock, |(clock, _)| clock);
    let clock = clock.rsplit_once('-').map_or(clock, |(clock, _)| clock);
    let parts: Vec<&str> = clock.split(':').collect();
    let whole =
        |text: &str, below: f64| text.parse::<u32>().ok().map(f64::from).filter(|value| *value < below);
    let seconds = match parts.as_slice() {
        [h, m, s] => {
            let seconds = super::text::number(s).filter(|s| (0.0..61.0).contains(s))?;
            whole(h, 24.0)? * 3600.0 + whole(m, 60.0)? * 60.0 + seconds
        }
        [h, m, s, fraction] => {
            let part = whole(fraction, 1e9)? / 10f64.powi(fraction.len() as i32);
            whole(h, 24.0)? * 3600.0 + whole(m, 60.0)? * 60.0 + whole(s, 61.0)? + part
        }
        _ => return None,
    };
    let days = match date {
        None => 0.0,
        Some(date) => {
            let mut numbers = date.split(['-', '/', '.']).map(|part| part.parse::<i64>().ok());
            let (a, b, c) = (numbers.next()??, numbers.next()??, numbers.next()??);
            let (year, month, day) = if a > 31 { (a, b, c) } else { (c, b, a) };
            let known = (1..=12).contains(&month) && (1..=31).contains(&day) && (1970..3000).contains(&year);
            if !known {
                return None;
            }
            days_since_1970(year, month, day) as f64
        }
    };
    Some(days * 86_400.0 + seconds)
}

/// Number of days in the Gregorian calendar until this date.
fn days_since_1970(year: i64, month: i64, day: i64) -> i64 {
    // If years begin in March, the leap day is the last day of the year.
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    365 * year + year / 4 - year / 100 + year / 400 + (153 * month + 2) / 5 + day - 719_469
}

/// Returns the unit of undeclared times with which the rate is plausible.
pub(super) fn unit(times: &[f64]) -> Option<(&'static str, f64)> {
    let interval = typical_interval(times)?;
    let slack = 1.0 + SAME_RATE;
    let usable = 1000.0 / MAX_RATE_HZ / slack..=1000.0 / MIN_RATE_HZ * slack;
    UNITS.into_iter().find(|(_, ms)| usable.contains(&(interval * ms)))
}

/// Returns the mean of all intervals except the longest.
/// Neither a gap nor equal time stamps therefore distort the mean.
pub(super) fn typical_interval(times: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_unstable_by(f64::total_cmp);
    steps.truncate(steps.len() - steps.len() / 20);
    let mean = steps.iter().sum::<f64>() / steps.len() as f64;
    (mean.is_finite() && mean > 0.0).then_some(mean)
}

/// Spreads samples with the same stamp evenly up to the next stamp. Returns the number of moved samples.
/// Times must not decrease.
///
/// Time stamps are equal if a clock counts only milliseconds, or if a radio delivers several samples at once.
pub(super) fn spread(times: &mut [f64]) -> usize {
    let Some(interval) = typical_interval(times) else { return 0 };
    let (mut moved, mut from) = (0, 0);
    while from < times.len() {
        let stamp = times[from];
        let run = times[from..].iter().take_while(|time| **time == stamp).count();
        if run > 1 {
            // The samples get the normal interval if no other time stamp follows, or if a gap is before it.
            let room = times.get(from + run).map_or(f64::INFINITY, |next| next - stamp);
            let even = room / run as f64;
            let step = if even <= 1.5 * interval { even } else { interval };
            for (n, time) in times[from..from + run].iter_mut().enumerate() {
                *time = stamp + n as f64 * step;
            }
            moved += run - 1;
        }
        from += run;
    }
    moved
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_day_are_seconds() {
        for (text, seconds) in [
            ("12:30:59.250", 45_059.25),
            ("12:30:59:250", 45_059.25),
            ("00:00:01,5", 1.5),
            ("1970-01-02 00:00:01", 86_401.0),
            ("2000-03-01T00:00:00.000Z", 951_868_800.0),
            ("2026-05-01 12:00:00.123 +0200", 1_777_636_800.123),
        ] {
            assert_eq!(stamp(text), Some(Stamp::Seconds(seconds)), "{text}");
        }
        for text in ["25:00:00", "12:61:00", "1:2", "2026-13-01 00:00:00", "x", ""] {
            assert_eq!(stamp(text), None, "{text}");
        }
    }

    #[test]
    fn a_unit_is_told_by_the_rate_it_gives() {
        let every = |step: f64| (0..50).map(|n| 1e6 + f64::from(n) * step).collect::<Vec<_>>();
        assert_eq!(unit(&every(9.6)), Some(("ms", 1.0)));
        assert_eq!(unit(&every(0.02)), Some(("s", 1000.0)));
        assert_eq!(unit(&every(8403.0)), Some(("µs", 1e-3)));
        assert_eq!(unit(&every(1e7)), Some(("ns", 1e-6)));
        assert_eq!((unit(&every(100.0)), unit(&every(0.0)), unit(&[1.0])), (None, None, None));
    }

    #[test]
    fn equal_stamps_are_spread_up_to_the_next_one_and_counted() {
        let mut times = [0.0, 0.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 90.0];
        assert_eq!(spread(&mut times), 2);
        assert_eq!(times[..3], [0.0, 10.0, 20.0]);
        assert_eq!(times[9..], [90.0, 99.0]);
        let mut batches: Vec<f64> = (0..10).flat_map(|n| [f64::from(n) * 40.0; 4]).collect();
        assert_eq!(spread(&mut batches), 30);
        assert!(batches.windows(2).all(|pair| pair[1] > pair[0]), "{batches:?}");
        let mut rising = [0.0, 10.0, 20.0];
        assert_eq!((spread(&mut rising), rising), (0, [0.0, 10.0, 20.0]));
    }
}
