//! Computes the features of a recording's windows, with the same code that boards run.

use shared_dsp::right::aligned::AlignedWindow;
use shared_dsp::right::features::FeatureWindow;
use shared_dsp::right::kind::FeatureKind;

use crate::recording::Recording;
use crate::{HOP, WINDOW};

/// The preparation of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Prepared {
    /// Whether the recording was shorter than a window and was padded.
    pub padded: bool,
    /// Whether the recording was resampled to the models' rate.
    pub resampled: bool,
}

/// Returns a recording at the models' rate that is at least one window long.
///
/// A shorter recording is extended periodically until the window is full.
/// The period is the one that best matches the end of the recording.
/// (If the recording were mirrored in time, a circle would change its direction.)
pub fn prepare(recording: &Recording) -> (Recording, Prepared) {
    let at_rate = recording.resampled();
    let resampled = at_rate.len() != recording.len() || !at_rate.samples().eq(recording.samples());
    let padded = at_rate.len() < WINDOW;
    let ready = if padded { continued(&at_rate) } else { at_rate };
    (ready, Prepared { padded, resampled })
}

/// Shortest period of a movement, in samples. This period corresponds to 5 strokes per second.
const LEAST_PERIOD: usize = 20;
/// Minimum and maximum number of samples at the end that are compared with the samples one period earlier.
const COMPARED: (usize, usize) = (12, 50);
/// Number of samples over which the jump at the seam fades.
const SEAM: usize = 10;

/// Extends the recording periodically until a window is full.
fn continued(recording: &Recording) -> Recording {
    let axes = recording.axes();
    let mut rows: Vec<Vec<f32>> = recording.samples().map(<[f32]>::to_vec).collect();
    let Some(last) = rows.last().cloned() else { return recording.clone() };
    match period(&rows) {
        Some(period) => {
            let jump: Vec<f32> =
                last.iter().zip(&rows[rows.len() - 1 - period]).map(|(a, b)| a - b).collect();
            let length = rows.len();
            while rows.len() < WINDOW {
                let left = 1.0 - ((rows.len() - length) as f32 / SEAM as f32).min(1.0);
                let before = &rows[rows.len() - period];
                rows.push(before.iter().zip(&jump).map(|(value, jump)| value + left * jump).collect());
            }
        }
        None => rows.resize(WINDOW, last),
    }
    let time_ms = (0..rows.len()).map(|n| n as f64 * 1000.0 / crate::RATE_HZ).collect();
    Recording::new(axes, time_ms, rows.concat())
}

/// Returns the period in samples with which the end of a short movement best matches its past.
/// The result is `None` if the movement is too short.
pub(crate) fn period<R: AsRef<[f32]>>(rows: &[R]) -> Option<usize> {
    let rows: Vec<&[f32]> = rows.iter().map(AsRef::as_ref).collect();
    let axes = rows.first()?.len().min(6);
    let count = rows.len() as f32;
    let weights: Vec<f32> = (0..axes)
        .map(|axis| {
            let mean = rows.iter().map(|row| row[axis]).sum::<f32>() / count;
            let variance = rows.iter().map(|row| (row[axis] - mean).powi(2)).sum::<f32>() / count;
            // Acceleration and rotation get the same total weight.
            // Axes with little movement are mostly noise, so they must not get the same weight as other axes.
            variance
        })
        .collect();
    let (least, most) = COMPARED;
    let difference = |lag: usize| -> f32 {
        let compared = (rows.len() - lag).min(most);
        let pairs = rows[rows.len() - compared..].iter().zip(&rows[rows.len() - compared - lag..]);
        let squares = |axes: std::ops::Range<usize>| -> f32 {
            let size: f32 = weights[axes.clone()].iter().sum::<f32>().max(1e-6);
            let sum: f32 = pairs
                .clone()
                .map(|(a, b)| axes.clone().map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f32>())
                .sum();
            sum / size / compared as f32
        };
        squares(0..3.min(axes)) + if axes > 3 { squares(3..axes) } else { 0.0 }
    };
    let lags = LEAST_PERIOD..(rows.len() + 1).saturating_sub(least);
    lags.map(|lag| (lag, difference(lag))).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(lag, _)| lag)
}

/// Returns the features of every window that starts at a multiple of `stride_hops` hops.
/// Recipes 1 and 2 have 13 features per axis, axis by axis. Recipe 3 has its own features.
pub fn features(recording: &Recording, recipe: FeatureKind, stride_hops: usize) -> Vec<Vec<f32>> {
    match recording.axes() {
        3 => stream::<3>(recording, recipe, stride_hops),
        6 => stream::<6>(recording, recipe, stride_hops),
        _ => stream::<9>(recording, recipe, stride_hops),
    }
}

/// Returns the features of recipe 3 for one window of [`WINDOW`] samples in sequence.
pub fn aligned_features(axes: usize, window: &[f32]) -> Vec<f32> {
    fn run<const A: usize>(window: &[f32]) -> Vec<f32> {
        let mut state = AlignedWindow::<A>::new();
        for sample in window.as_chunks::<A>().0 {
            state.push(sample);
        }
        state.features().to_vec()
    }
    match axes {
        3 => run::<3>(window),
        6 => run::<6>(window),
        _ => run::<9>(window),
    }
}

/// Number of samples between the starts of two training windows: 1 s.
#[cfg(feature = "adapt")]
const LEARNT_STRIDE: usize = crate::RATE_HZ as usize;

/// The windows of a prepared recording that recipe `aligned` learns.
/// Each window stores its samples in sequence.
#[cfg(feature = "adapt")]
pub(crate) fn cut(ready: &Recording) -> Vec<Vec<f32>> {
    let starts = (0..=ready.len().saturating_sub(WINDOW)).step_by(LEARNT_STRIDE);
    starts.map(|start| ready.slice(start, WINDOW).samples().flatten().copied().collect()).collect()
}

/// A recording as the slow window ([`shared_dsp::right::slow`]) receives it: pairs of samples are averaged.
pub fn slowed(recording: &Recording) -> Recording {
    let rows: Vec<&[f32]> = recording.samples().collect();
    let halves = rows.as_chunks::<2>().0.iter();
    let values = halves.flat_map(|[a, b]| a.iter().zip(*b).map(|(a, b)| 0.5 * a + 0.5 * b)).collect();
    let time_ms = (0..rows.len() / 2).map(|n| n as f64 * 1000.0 / crate::RATE_HZ).collect();
    Recording::new(recording.axes(), time_ms, values)
}

fn stream<const A: usize>(recording: &Recording, recipe: FeatureKind, stride_hops: usize) -> Vec<Vec<f32>> {
    match recipe {
        FeatureKind::Aligned => {
            let features = |window: &AlignedWindow<A>| window.features().to_vec();
            every(recording, stride_hops, AlignedWindow::new(), AlignedWindow::push, features)
        }
        FeatureKind::Raw | FeatureKind::LogPower => {
            let features = |window: &FeatureWindow<A>| {
                let transform = |(index, value): (usize, &f32)| recipe.transform(index, *value);
                window.features().iter().flat_map(|axis| axis.iter().enumerate().map(transform)).collect()
            };
            every(recording, stride_hops, FeatureWindow::new(), FeatureWindow::push, features)
        }
    }
}

/// Feeds a recording to a window and reads its features at every `stride_hops`th complete hop.
fn every<W, const A: usize>(
    recording: &Recording,
    stride_hops: usize,
    mut window: W,
    push: impl Fn(&mut W, &[f32; A]) -> bool,
    features: impl Fn(&W) -> Vec<f32>,
) -> Vec<Vec<f32>> {
    let mut all = Vec::new();
    let mut hops = 0;
    for sample in recording.samples().filter_map(|sample| sample.first_chunk::<A>()) {
        if push(&mut window, sample) {
            if hops % stride_hops == 0 {
                all.push(features(&window));
            }
            hops += 1;
        }
    }
    all
}

/// Returns the features of windows that start every `stride` samples, independent of the board's hops.
///
/// Each window is fed separately, because its start generally does not coincide with a hop.
pub fn features_every(recording: &Recording, recipe: FeatureKind, stride: usize) -> Vec<Vec<f32>> {
    if stride.is_multiple_of(HOP) {
        return features(recording, recipe, stride / HOP);
    }
    let starts = (0..=recording.len().saturating_sub(WINDOW)).step_by(stride);
    starts.flat_map(|start| features(&recording.slice(start, WINDOW), recipe, 1)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(len: usize) -> Recording {
        let time_ms = (0..len).map(|n| n as f64 * 10.0).collect();
        Recording::new(3, time_ms, (0..len).flat_map(|n| [n as f32, 0.0, 1.0]).collect())
    }

    #[test]
    fn a_short_recording_goes_on_as_it_did_until_the_window_is_full() {
        // A circle of 1.6 Hz, of which 1.1 s were recorded.
        let circle = |n: usize| {
            let angle = std::f32::consts::TAU * 1.6 * n as f32 / 100.0;
            [3.0 * angle.cos(), 3.0 * angle.sin(), 9.8]
        };
        let time_ms = (0..110).map(|n| f64::from(n) * 10.0).collect();
        let short = Recording::new(3, time_ms, (0..110).flat_map(circle).collect());
        let (ready, prepared) = prepare(&short);
        assert_eq!(prepared, Prepared { padded: true, resampled: false });
        assert_eq!(ready.len(), WINDOW);
        for (n, sample) in ready.samples().enumerate() {
            let expected = circle(n);
            assert!(
                (0..3).all(|axis| (sample[axis] - expected[axis]).abs() < 0.6),
                "{n}: {sample:?} {expected:?}"
            );
        }
        assert!(!prepare(&ramp(200)).1.padded);
        // The recording is too short to contain a period, so its last value is repeated.
        assert_eq!(prepare(&ramp(2)).0.samples().nth(199).unwrap()[0], 1.0);
    }

    #[test]
    fn windows_start_where_the_stride_says() {
        let recording = ramp(500);
        let means = |windows: Vec<Vec<f32>>| windows.iter().map(|w| w[0]).collect::<Vec<_>>();
        assert_eq!(means(features_every(&recording, FeatureKind::Raw, 100)), [99.5, 199.5, 299.5, 399.5]);
        assert_eq!(means(features(&recording, FeatureKind::Raw, 25)), [99.5, 299.5]);
    }
}
