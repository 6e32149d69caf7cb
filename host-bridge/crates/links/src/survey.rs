//! Measures the quality of a link for `doctor`. Times are arguments, and no function waits.

use shared_proto::counter::{Order, SequenceTracker};

/// Statistics of a hand's states.
#[derive(Clone, Debug, Default)]
pub struct Survey {
    order: SequenceTracker,
    states: u32,
    lost: u32,
    /// Arrival time and board time of each state, in ms after the first.
    times: Vec<(f64, f64)>,
    first: Option<(u64, u32)>,
    round_trips_ms: Vec<u64>,
}

impl Survey {
    /// A state arrived.
    pub fn state(&mut self, sequence: u16, board_time_ms: u32, at_ms: u64) {
        if let Order::New { lost } = self.order.see(sequence) {
            self.states += 1;
            self.lost += u32::from(lost);
            let (first_ms, first_board_ms) = *self.first.get_or_insert((at_ms, board_time_ms));
            let board_ms = board_time_ms.wrapping_sub(first_board_ms) as i32;
            self.times.push((at_ms.saturating_sub(first_ms) as f64, f64::from(board_ms)));
        }
    }

    /// Reports that a ping was answered.
    pub fn round_trip(&mut self, ms: u64) {
        self.round_trips_ms.push(ms);
    }

    /// Reports that the board has restarted with a new clock and new sequence numbers.
    pub fn restarted(&mut self) {
        *self = Survey { round_trips_ms: std::mem::take(&mut self.round_trips_ms), ..Survey::default() };
    }

    /// States seen.
    pub fn states(&self) -> u32 {
        self.states
    }

    /// Fraction of states that never arrived, 0 to 1.
    pub fn loss(&self) -> f64 {
        let all = self.states + self.lost;
        if all == 0 { 0.0 } else { f64::from(self.lost) / f64::from(all) }
    }

    /// Rate of arriving states per second.
    pub fn rate_hz(&self) -> Option<f64> {
        let span_ms = self.times.last()?.0;
        (span_ms > 0.0).then(|| (self.times.len() - 1) as f64 * 1000.0 / span_ms)
    }

    /// Returns the drift of the board's clock against ours in parts per million, and its standard deviation.
    /// The function fits a straight line through all times.
    pub fn drift_ppm(&self) -> Option<(f64, f64)> {
        let n = self.times.len() as f64;
        if n < 10.0 {
            return None;
        }
        let mean = |f: fn(&(f64, f64)) -> f64| self.times.iter().map(f).sum::<f64>() / n;
        let (mean_x, mean_y) = (mean(|t| t.0), mean(|t| t.1));
        let sum = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
            self.times.iter().map(|t| f(t.0 - mean_x, t.1 - mean_y)).sum()
        };
        let xx = sum(&|x, _| x * x);
        if xx <= 0.0 {
            return None;
        }
        let slope = sum(&|x, y| x * y) / xx;
        let residual = sum(&|x, y| (y - slope * x).powi(2)) / (n - 2.0);
        Some(((slope - 1.0) * 1e6, (residual / xx).sqrt() * 1e6))
    }

    /// Returns the median and the longest round trip.
    pub fn round_trip_ms(&self) -> Option<(u64, u64)> {
        let mut sorted = self.round_trips_ms.clone();
        sorted.sort_unstable();
        Some((*sorted.get(sorted.len() / 2)?, *sorted.last()?))
    }

    /// Returns advice about the measurements.
    /// The hand should send `expected_hz` states per second, and its clock may drift by `drift_limit_ppm`.
    pub fn advice(&self, expected_hz: f64, drift_limit_ppm: f64) -> Vec<String> {
        let mut advice = Vec::new();
        if self.states == 0 {
            return vec!["no states: the board is idle or its sensor does not work; restart it".to_owned()];
        }
        if self.loss() > 0.01 {
            advice.push(format!(
                "{:.1} % of the states are lost: use a shorter cable and no hub, close what else loads the laptop",
                self.loss() * 100.0
            ));
        }
        if let Some(rate_hz) = self.rate_hz()
            && (rate_hz / expected_hz - 1.0).abs() > 0.1
        {
            advice.push(format!(
                "{rate_hz:.1} states per second arrive instead of {expected_hz:.1}: the board is overloaded or \
                 its firmware is of another version"
            ));
        }
        if let Some((drift, error)) = self.drift_ppm()
            && drift.abs() - 3.0 * error > drift_limit_ppm
        {
            advice.push(format!(
                "the clock is {drift:.0} ppm off, more than the {drift_limit_ppm:.0} that ages allow for: \
                 late states may pass as fresh; replace the board"
            ));
        }
        if let Some((median_ms, _)) = self.round_trip_ms()
            && median_ms > 40
        {
            advice.push(format!(
                "a ping takes {median_ms} ms: FT232 adapters wait 16 ms by default \
                 (`echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer`)"
            ));
        }
        advice
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loss_rate_and_drift_come_out_of_what_arrives() {
        let mut survey = Survey::default();
        for n in 0..500u32 {
            if n % 10 != 9 {
                // The board is 5000 ppm fast, and the link has a little jitter.
                let at_ms = 1000 + u64::from(n) * 20 + u64::from(n % 3);
                survey.state(n as u16, 77 + (f64::from(n) * 20.1) as u32, at_ms);
            }
        }
        // The very last state is lost too, but no later state shows this loss.
        assert!((survey.loss() - 49.0 / 499.0).abs() < 1e-9, "{}", survey.loss());
        assert!((survey.rate_hz().unwrap() - 45.0).abs() < 0.5);
        let (drift, error) = survey.drift_ppm().unwrap();
        assert!((drift - 5000.0).abs() < 3.0 * error.max(20.0), "{drift} ± {error}");
        let advice = survey.advice(50.0, 10_000.0);
        assert_eq!(advice.len(), 1, "{advice:?}");
        assert!(advice[0].contains("lost"), "{advice:?}");
        assert!(survey.advice(45.0, 500.0).iter().any(|line| line.contains("clock")));
    }

    #[test]
    fn a_silent_board_has_its_own_advice() {
        assert!(Survey::default().advice(50.0, 500.0)[0].contains("no states"));
    }
}
