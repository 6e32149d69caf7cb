//! Collects raw samples of a hand into one recording. Gaps and clipping are detected but not repaired.

use models::recording::Recording;
use shared_dsp::left::AdcCounts;
use shared_proto::message::RawAdc;

use crate::talk::RawBatch;
use models::adc::AdcRecording;

/// Collects the samples of a right hand.
#[derive(Clone, Debug)]
pub struct Collector {
    wanted: usize,
    sample_hz: u16,
    axes: Option<usize>,
    values: Vec<f32>,
    next_sample: u32,
    clipped: usize,
}

/// The reason why a recording cannot continue, with a remedy in the text.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CaptureProblem {
    /// Samples are missing, so the data before and after the gap are not continuous.
    #[error("{missing} samples are missing after {after_ms} ms; check the cable and record again")]
    Gap {
        /// How many.
        missing: u32,
        /// Position of the gap, counted from the start.
        after_ms: u64,
    },
    /// The number of samples decreased, so the board has restarted.
    #[error("the board restarted after {after_ms} ms; check its power and record again")]
    Restart {
        /// Time of the restart, counted from the start.
        after_ms: u64,
    },
    /// The board changed its number of axes during the recording.
    #[error("the board changed from {from} to {to} axes; restart it and record again")]
    Axes {
        /// Before.
        from: usize,
        /// Now.
        to: usize,
    },
}

impl Collector {
    /// Creates a collector for `wanted` samples at this sampling rate.
    pub fn new(wanted: usize, sample_hz: u16) -> Self {
        Collector { wanted, sample_hz, axes: None, values: Vec::new(), next_sample: 0, clipped: 0 }
    }

    /// Adds a batch of samples. Returns true if there are enough samples.
    ///
    /// # Errors
    /// Returns [`CaptureProblem`] if the batch does not continue the previous one.
    pub fn push(&mut self, batch: &RawBatch) -> Result<bool, CaptureProblem> {
        let axes = usize::from(batch.axes);
        let after_ms = self.len() as u64 * 1000 / u64::from(self.sample_hz.max(1));
        match self.axes {
            None => self.axes = Some(axes),
            Some(from) if from != axes => return Err(CaptureProblem::Axes { from, to: axes }),
            Some(_) => {
                let missing = batch.first_sample.wrapping_sub(self.next_sample) as i32;
                if missing < 0 {
                    return Err(CaptureProblem::Restart { after_ms });
                }
                if missing > 0 {
                    return Err(CaptureProblem::Gap { missing: missing as u32, after_ms });
                }
            }
        }
        let samples = batch.counts.len() / axes.max(1);
        self.next_sample = batch.first_sample.wrapping_add(samples as u32);
        for sample in batch.counts.chunks_exact(axes.max(1)) {
            if self.is_full() {
                break;
            }
            self.clipped += usize::from(sample.iter().any(|&c| c == i16::MAX || c == i16::MIN));
            self.values
                .extend(sample.iter().enumerate().map(|(i, &c)| f32::from(c) * batch.scale[(i / 3).min(2)]));
        }
        Ok(self.is_full())
    }

    fn is_full(&self) -> bool {
        self.len() >= self.wanted
    }

    /// Samples so far.
    pub fn len(&self) -> usize {
        self.axes.map_or(0, |axes| self.values.len() / axes)
    }

    /// Nothing yet.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of samples in which an axis was at the end of its range.
    pub fn clipped(&self) -> usize {
        self.clipped
    }

    /// Returns the magnitude of the acceleration in the newest `count` samples, oldest first, in m/s².
    pub fn newest_acceleration(&self, count: usize) -> Vec<f32> {
        let axes = self.axes.unwrap_or(3);
        let from = self.len().saturating_sub(count);
        let length = |s: &[f32]| s[..3].iter().map(|v| v * v).sum::<f32>().sqrt();
        self.values.chunks_exact(axes).skip(from).map(length).collect()
    }

    /// Returns the recording, with times from 0.
    pub fn recording(self) -> Recording {
        let interval_ms = 1000.0 / f64::from(self.sample_hz.max(1));
        let time_ms = (0..self.len()).map(|n| n as f64 * interval_ms).collect();
        Recording::new(self.axes.unwrap_or(9), time_ms, self.values)
    }
}

/// Collects the samples of a left hand.
#[derive(Clone, Debug)]
pub struct LeftCollector {
    wanted: usize,
    period_ms: u32,
    /// Board time of the first sample.
    first_ms: u32,
    samples: Vec<(u64, AdcCounts)>,
}

impl LeftCollector {
    /// Creates a collector for `wanted` samples at this sampling rate.
    pub fn new(wanted: usize, sample_hz: u16) -> Self {
        let period_ms = 1000 / u32::from(sample_hz.clamp(1, 1000));
        LeftCollector { wanted, period_ms, first_ms: 0, samples: Vec::new() }
    }

    /// Adds a sample. Returns true if there are enough samples.
    ///
    /// # Errors
    /// Returns [`CaptureProblem`] if the sample does not continue the previous one.
    pub fn push(&mut self, raw: &RawAdc) -> Result<bool, CaptureProblem> {
        if self.samples.is_empty() {
            self.first_ms = raw.board_time_ms;
        }
        let time_ms = raw.board_time_ms.wrapping_sub(self.first_ms) as i32;
        if let Some(&(before_ms, _)) = self.samples.last() {
            let step = i64::from(time_ms) - before_ms as i64;
            if step <= 0 {
                return Err(CaptureProblem::Restart { after_ms: before_ms });
            }
            let missing = (step as u32).saturating_sub(1) / self.period_ms;
            if missing > 0 {
                return Err(CaptureProblem::Gap { missing, after_ms: before_ms });
            }
        }
        if self.samples.len() < self.wanted {
            let [x, y, z, index, middle] = raw.counts;
            self.samples.push((time_ms.max(0) as u64, AdcCounts { x, y, z, index, middle }));
        }
        Ok(self.samples.len() >= self.wanted)
    }

    /// Samples so far.
    pub fn len(&self) -> usize {
        self.samples.len()
    }

    /// Nothing yet.
    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    /// Number of samples in which a channel was at an end of the converter's range.
    pub fn clipped(&self) -> usize {
        let ends = |sum: u16| sum == 0 || sum >= AdcCounts::MAX;
        self.samples.iter().filter(|(_, counts)| counts.as_array().into_iter().any(ends)).count()
    }

    /// Returns one of the five channels in the newest `count` samples, oldest first.
    /// The values are fractions of the converter's range.
    pub fn newest(&self, line: usize, count: usize) -> Vec<f32> {
        let from = self.samples.len().saturating_sub(count);
        let part = |counts: &AdcCounts| f32::from(counts.as_array()[line]) / f32::from(AdcCounts::MAX);
        self.samples[from..].iter().map(|(_, counts)| part(counts)).collect()
    }

    /// Returns the recording, with times from 0.
    pub fn recording(self) -> AdcRecording {
        AdcRecording { samples: self.samples }
    }
}

/// Draws values as a line of bars, scaled from `least` to `most`.
pub fn sparkline(values: &[f32], least: f32, most: f32) -> String {
    const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    let bar = |value: &f32| {
        let part = (value - least) / (most - least);
        BARS[((part * 8.0) as usize).min(7)]
    };
    values.iter().map(bar).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn batch(first_sample: u32, counts: Vec<i16>) -> RawBatch {
        RawBatch { first_sample, axes: 3, scale: [0.01, 0.0, 0.0], counts }
    }

    #[test]
    fn batches_in_a_row_become_one_recording_of_the_length_asked_for() {
        let mut collector = Collector::new(3, 100);
        assert_eq!(collector.push(&batch(u32::MAX, vec![0, 0, 981, 1, 2, 3])), Ok(false));
        assert_eq!(collector.push(&batch(1, vec![4, 5, i16::MAX, 7, 8, 9])), Ok(true));
        assert_eq!(collector.clipped(), 1);
        let recording = collector.recording();
        assert_eq!(recording.time_ms(), [0.0, 10.0, 20.0]);
        let last: Vec<f32> = recording.samples().last().unwrap().to_vec();
        assert_eq!(last, [4.0 * 0.01, 5.0 * 0.01, 32767.0 * 0.01]);
    }

    #[test]
    fn a_gap_and_a_restart_are_told_apart() {
        let mut collector = Collector::new(100, 100);
        collector.push(&batch(50, vec![0; 24])).unwrap();
        let gap = collector.clone().push(&batch(60, vec![0; 24]));
        assert_eq!(gap, Err(CaptureProblem::Gap { missing: 2, after_ms: 80 }));
        assert_eq!(collector.push(&batch(0, vec![0; 24])), Err(CaptureProblem::Restart { after_ms: 80 }));
    }

    fn sample(board_time_ms: u32) -> RawAdc {
        RawAdc { board_time_ms, counts: [4099, 0, 4912, 5632, 5632] }
    }

    #[test]
    fn a_left_hands_samples_keep_their_eighths_and_their_times() {
        let mut collector = LeftCollector::new(3, 100);
        // The board's clock wraps after 49 days.
        let start_ms = u32::MAX - 9;
        assert_eq!(collector.push(&sample(start_ms)), Ok(false));
        assert_eq!(collector.push(&sample(start_ms.wrapping_add(10))), Ok(false));
        assert_eq!(collector.push(&sample(start_ms.wrapping_add(20))), Ok(true));
        assert_eq!(collector.clipped(), 3, "y is shorted");
        assert_eq!(collector.newest(3, 2), [5632.0 / 8184.0; 2]);
        let text = collector.recording().to_csv();
        assert_eq!(text.lines().nth(2), Some("10,512.375,0,614,704,704"));
        assert_eq!(text.lines().count(), 4);
    }

    #[test]
    fn a_left_hands_gap_and_restart_are_told_apart() {
        let mut collector = LeftCollector::new(100, 100);
        for n in 0..8 {
            collector.push(&sample(5000 + 10 * n)).unwrap();
        }
        let gap = collector.clone().push(&sample(5000 + 100));
        assert_eq!(gap, Err(CaptureProblem::Gap { missing: 2, after_ms: 70 }));
        assert_eq!(collector.push(&sample(10)), Err(CaptureProblem::Restart { after_ms: 70 }));
    }

    #[test]
    fn a_sparkline_spans_its_range_and_takes_what_lies_outside() {
        assert_eq!(sparkline(&[-5.0, 0.0, 4.0, 7.9, 99.0, f32::NAN], 0.0, 8.0), "▁▁▅██▁");
    }
}
