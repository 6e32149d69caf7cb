//! What names the gestures of a right board: the network behind an IMU, or anything else that gives the same output.

use shared_dsp::mlp::{self, MAX_AXES};
use shared_dsp::right::{RightHand, RightOutput};
use shared_proto::message::ModelInfo;

/// Samples in, gestures out.
pub trait Hand {
    /// One sample.
    type Sample;

    /// Takes the sample of `time_ms`; true once per hop, when [`Hand::output`] is new.
    fn push(&mut self, sample: &Self::Sample, time_ms: u32) -> bool;

    /// Samples are missing here: the window starts over. Events and their counter stay.
    fn gap(&mut self);

    /// The state at the last hop.
    fn output(&self) -> &RightOutput;

    /// What the model needs and names.
    fn model(&self) -> ModelInfo<'_>;

    /// Physical value of one count (m/s², deg/s, µT); `None` for a hand whose samples cannot be recorded.
    fn scale(&self) -> Option<[f32; 3]>;

    /// Writes a sample in counts (accelerometer, gyroscope, magnetometer) and returns how many values it has.
    fn counts(&self, sample: &Self::Sample, counts: &mut [i16; MAX_AXES]) -> usize;
}

/// What the wire says of a model.
pub fn model_info_on_the_wire<'a>(info: &mlp::ModelInfo<'a>) -> ModelInfo<'a> {
    ModelInfo {
        model_id: info.model_id,
        recipe: info.recipe.id(),
        axes: info.axes as u8,
        sample_hz: info.sample_hz,
        window: info.window,
        labels: info.label_text,
    }
}

/// A hand whose samples come as the sensor's counts.
#[derive(Clone, Debug)]
pub struct CountHand<'m, const A: usize> {
    hand: RightHand<'m, A>,
    scale: [f32; 3],
}

impl<'m, const A: usize> CountHand<'m, A> {
    /// `scale` is the physical value of one count: m/s², deg/s, µT.
    pub fn new(hand: RightHand<'m, A>, scale: [f32; 3]) -> Self {
        Self { hand, scale }
    }
}

impl<const A: usize> Hand for CountHand<'_, A> {
    type Sample = [i16; A];

    fn push(&mut self, counts: &[i16; A], time_ms: u32) -> bool {
        let values = core::array::from_fn(|axis| f32::from(counts[axis]) * self.scale[axis / 3]);
        self.hand.push(&values, time_ms).is_some()
    }

    fn gap(&mut self) {
        self.hand.gap();
    }

    fn output(&self) -> &RightOutput {
        self.hand.output()
    }

    fn model(&self) -> ModelInfo<'_> {
        model_info_on_the_wire(self.hand.model().info())
    }

    fn scale(&self) -> Option<[f32; 3]> {
        Some(self.scale)
    }

    fn counts(&self, sample: &[i16; A], counts: &mut [i16; MAX_AXES]) -> usize {
        let len = A.min(MAX_AXES);
        counts[..len].copy_from_slice(&sample[..len]);
        len
    }
}

/// A hand whose samples come in m/s², deg/s and µT, as recordings hold them.
#[derive(Clone, Debug)]
pub struct ValueHand<'m, const A: usize> {
    hand: RightHand<'m, A>,
    scale: [f32; 3],
}

impl<'m, const A: usize> ValueHand<'m, A> {
    /// `scale` is the physical value of one count in record mode: m/s², deg/s, µT.
    pub fn new(hand: RightHand<'m, A>, scale: [f32; 3]) -> Self {
        Self { hand, scale }
    }
}

impl<const A: usize> Hand for ValueHand<'_, A> {
    type Sample = [f32; A];

    fn push(&mut self, sample: &[f32; A], time_ms: u32) -> bool {
        self.hand.push(sample, time_ms).is_some()
    }

    fn gap(&mut self) {
        self.hand.gap();
    }

    fn output(&self) -> &RightOutput {
        self.hand.output()
    }

    fn model(&self) -> ModelInfo<'_> {
        model_info_on_the_wire(self.hand.model().info())
    }

    fn scale(&self) -> Option<[f32; 3]> {
        Some(self.scale)
    }

    /// To the nearest count, within what 16 bits hold; NaN is 0.
    fn counts(&self, sample: &[f32; A], counts: &mut [i16; MAX_AXES]) -> usize {
        let len = A.min(MAX_AXES);
        for (axis, (count, value)) in counts.iter_mut().zip(sample).enumerate() {
            let exact = value / self.scale[axis / 3];
            // The cast goes to the limits where the value lies outside, and cuts towards zero.
            *count = (exact + if exact < 0.0 { -0.5 } else { 0.5 }) as i16;
        }
        len
    }
}
