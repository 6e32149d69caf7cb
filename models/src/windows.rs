//! From a recording to the features of its windows, computed by the code that boards run.

use shared_dsp::aligned::AlignedWindow;
use shared_dsp::features::FeatureWindow;
use shared_dsp::recipe::Recipe;

use crate::recording::Recording;
use crate::{HOP, WINDOW};

/// What was done to a recording to make windows of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Prepared {
    /// It was shorter than a window and was padded.
    pub padded: bool,
    /// It was resampled to the models' rate.
    pub resampled: bool,
}

/// A recording at the models' rate and at least one window long.
///
/// A shorter one is padded by playing it forward, then backward, then forward again, and so on,
/// until the window is full: the motion goes on without a jump.
pub fn prepare(recording: &Recording) -> (Recording, Prepared) {
    let at_rate = recording.resampled();
    let resampled = at_rate.len() != recording.len() || !at_rate.samples().eq(recording.samples());
    let padded = at_rate.len() < WINDOW;
    let ready = if padded { mirrored(&at_rate) } else { at_rate };
    (ready, Prepared { padded, resampled })
}

fn mirrored(recording: &Recording) -> Recording {
    let rows: Vec<&[f32]> = recording.samples().collect();
    // There and back without repeating either end.
    let period = (2 * rows.len()).saturating_sub(2).max(1);
    let values = (0..WINDOW).flat_map(|n| {
        let at = n % period;
        rows[if at < rows.len() { at } else { period - at }].iter().copied()
    });
    let time_ms = (0..WINDOW).map(|n| n as f64 * 1000.0 / crate::RATE_HZ).collect();
    Recording::new(recording.axes(), time_ms, values.collect())
}

/// Features of every window of a prepared recording whose start is a multiple of `stride_hops`
/// hops, after `recipe`: 13 per axis, axis after axis, or those of recipe 3.
pub fn features(recording: &Recording, recipe: Recipe, stride_hops: usize) -> Vec<Vec<f32>> {
    match recording.axes() {
        3 => stream::<3>(recording, recipe, stride_hops),
        6 => stream::<6>(recording, recipe, stride_hops),
        _ => stream::<9>(recording, recipe, stride_hops),
    }
}

/// Features of recipe 3 of one window: [`WINDOW`] samples, one after the other.
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

fn stream<const A: usize>(recording: &Recording, recipe: Recipe, stride_hops: usize) -> Vec<Vec<f32>> {
    match recipe {
        Recipe::Aligned => {
            let features = |window: &AlignedWindow<A>| window.features().to_vec();
            every(recording, stride_hops, AlignedWindow::new(), AlignedWindow::push, features)
        }
        Recipe::Raw | Recipe::LogPower => {
            let features = |window: &FeatureWindow<A>| {
                let transform = |(index, value): (usize, &f32)| recipe.transform(index, *value);
                window.features().iter().flat_map(|axis| axis.iter().enumerate().map(transform)).collect()
            };
            every(recording, stride_hops, FeatureWindow::new(), FeatureWindow::push, features)
        }
    }
}

/// Pushes a recording through a window and reads its features at every `stride_hops`th full hop.
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

/// Features of windows that start every `stride` samples, whatever the hop.
///
/// Each window is fed anew, as its start is not one of the board's hops in general.
pub fn features_every(recording: &Recording, recipe: Recipe, stride: usize) -> Vec<Vec<f32>> {
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
    fn a_short_recording_is_played_to_and_fro_until_the_window_is_full() {
        let (ready, prepared) = prepare(&ramp(120));
        assert_eq!(prepared, Prepared { padded: true, resampled: false });
        let x: Vec<f32> = ready.samples().map(|s| s[0]).collect();
        assert_eq!(x.len(), WINDOW);
        assert_eq!(x[118..123], [118.0, 119.0, 118.0, 117.0, 116.0]);
        assert_eq!(prepare(&ramp(2)).0.samples().nth(3).unwrap()[0], 1.0);
        assert!(!prepare(&ramp(200)).1.padded);
    }

    #[test]
    fn windows_start_where_the_stride_says() {
        let recording = ramp(500);
        let means = |windows: Vec<Vec<f32>>| windows.iter().map(|w| w[0]).collect::<Vec<_>>();
        assert_eq!(means(features_every(&recording, Recipe::Raw, 100)), [99.5, 199.5, 299.5, 399.5]);
        assert_eq!(means(features(&recording, Recipe::Raw, 25)), [99.5, 299.5]);
    }
}
