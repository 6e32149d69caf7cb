//! A window of four seconds, for gestures that do not fit in the normal window.
//!
//! Pairs of consecutive samples are averaged, and a second [`AlignedWindow`] receives the means.
//! In this window, the hand seems to move at twice its tempo, and the same network classifies it.
//! The network has learned gestures at various tempos, some of them slower and some faster than normal.
//! In a two-second window of an accelerometer, a left-right of 0.45 Hz is hard to distinguish from swaying.
//! In the slow window, the same movement appears as 0.9 Hz.
//! (The accelerations stay the same, but a real gesture at twice the tempo has four times the acceleration.
//! The difference hardly matters, because most features are ratios.)
//!
//! Only models without a gyroscope use this window. Their features take half the time.
//! With a gyroscope, the slow window does not improve the results on recordings of real people.
//! With 6 or 9 axes, this code therefore computes nothing.

use crate::right::aligned::AlignedWindow;

/// A window of 4 s over samples of `A` axes, with a hop of 16 samples.
#[derive(Clone, Debug)]
pub struct SlowWindow<const A: usize> {
    window: AlignedWindow<A>,
    /// The first sample of a pair, which waits for the second sample.
    first: Option<[f32; A]>,
    is_new: bool,
}

impl<const A: usize> SlowWindow<A> {
    /// Whether samples with this number of axes have no gyroscope.
    const RUNS: bool = A < 6;

    /// An empty window.
    pub const fn new() -> Self {
        Self { window: AlignedWindow::new(), first: None, is_new: false }
    }

    /// Adds a sample. If either sample of a pair is NaN, the last valid pair is used.
    #[inline]
    pub fn push(&mut self, sample: &[f32; A]) {
        if !Self::RUNS {
            return;
        }
        let Some(first) = self.first.take() else {
            self.first = Some(*sample);
            self.is_new = false;
            return;
        };
        // Both values are halved first, because the sum of two large values may be infinite.
        self.is_new = self.window.push(&core::array::from_fn(|axis| 0.5 * first[axis] + 0.5 * sample[axis]));
    }

    /// Returns the features, if the last sample completed a hop and the window is full.
    pub fn new_features(&self) -> Option<&[f32]> {
        (Self::RUNS && self.is_new).then(|| self.window.features())
    }

    /// Whether the window contains values that replaced NaN.
    pub fn is_tainted(&self) -> bool {
        self.window.is_tainted()
    }

    /// Forgets all samples.
    pub fn reset(&mut self) {
        *self = Self::new();
    }
}

impl<const A: usize> Default for SlowWindow<A> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Generates the samples of a board that lies flat and sways at `hz` hertz.
    fn sway(hz: f32, samples: usize) -> Vec<[f32; 3]> {
        let angle = |n: usize| core::f32::consts::TAU * hz * n as f32 / 100.0;
        (0..samples).map(|n| [3.0 * angle(n).sin(), angle(2 * n).cos(), 9.8]).collect()
    }

    /// Returns the numbers of the samples at which features were available, and the last features.
    fn play(samples: &[[f32; 3]]) -> (Vec<usize>, Vec<f32>) {
        let mut slow = SlowWindow::<3>::new();
        let mut last = Vec::new();
        let mut new = Vec::new();
        for (n, sample) in samples.iter().enumerate() {
            slow.push(sample);
            if let Some(features) = slow.new_features() {
                new.push(n + 1);
                last = features.to_vec();
            }
        }
        (new, last)
    }

    #[test]
    fn features_are_new_after_four_seconds_and_then_every_sixteen_samples() {
        assert_eq!(play(&sway(0.45, 450)).0, [400, 416, 432, 448]);
    }

    #[test]
    fn a_movement_looks_as_it_does_to_the_usual_window_at_twice_its_tempo() {
        // At 0.5 Hz, four seconds contain two periods, as do two seconds at 1 Hz.
        let (_, slow) = play(&sway(0.5, 400));
        let mut usual = AlignedWindow::<3>::new();
        sway(1.0, 200).iter().for_each(|sample| {
            usual.push(sample);
        });
        for (index, (a, b)) in slow.iter().zip(usual.features()).enumerate() {
            assert!((a - b).abs() < 0.05, "feature {index}: {a} and {b}");
        }
        // These features differ from those of the normal window.
        sway(0.5, 200).iter().for_each(|sample| {
            usual.push(sample);
        });
        assert!(slow.iter().zip(usual.features()).any(|(a, b)| (a - b).abs() > 0.5));
    }

    #[test]
    fn bad_values_stay_finite_and_leave_with_a_reset() {
        let mut samples = sway(0.5, 400);
        samples[100] = [f32::NAN, f32::INFINITY, f32::MAX];
        samples[101] = [f32::MAX; 3];
        let (new, features) = play(&samples);
        assert_eq!(new, [400]);
        assert!(features.iter().all(|value| value.is_finite()), "{features:?}");

        let mut slow = SlowWindow::<3>::new();
        samples[..101].iter().for_each(|sample| slow.push(sample));
        slow.reset();
        let (_, expected) = play(&sway(0.5, 400));
        sway(0.5, 400).iter().for_each(|sample| slow.push(sample));
        assert_eq!(
            slow.new_features(),
            Some(expected.as_slice()),
            "also the sample that waited for its pair"
        );
    }

    #[test]
    fn with_a_gyroscope_nothing_is_computed() {
        let mut slow = SlowWindow::<6>::new();
        (0..1000).for_each(|_| slow.push(&[1.0; 6]));
        assert_eq!(slow.new_features(), None);
    }
}
