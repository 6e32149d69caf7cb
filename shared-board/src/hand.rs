//! What names the gestures of a right board: the network behind an IMU, or anything else that gives the same output.

use core::marker::PhantomData;

use shared_dsp::right::network::{self, MAX_AXES};
use shared_dsp::right::{RightHand, RightOutput};
use shared_proto::message::{ModelInfo, Text};

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
pub fn model_info_on_the_wire<'a>(info: &network::ModelHeader<'a>) -> ModelInfo<'a> {
    ModelInfo {
        model_id: info.model_id,
        recipe: info.recipe.id(),
        axes: info.axes as u8,
        sample_hz: info.sample_hz,
        window: info.window,
        labels: Text(info.label_text),
    }
}

/// The units in which a hand's samples come.
pub trait Reading: Copy {
    /// In m/s², deg/s or µT, where a count is `scale` of them.
    fn value(self, scale: f32) -> f32;

    /// In counts of `scale`.
    fn count(self, scale: f32) -> i16;
}

/// As the sensor's counts.
impl Reading for i16 {
    fn value(self, scale: f32) -> f32 {
        f32::from(self) * scale
    }

    fn count(self, _: f32) -> i16 {
        self
    }
}

/// In m/s², deg/s and µT, as recordings hold them.
impl Reading for f32 {
    fn value(self, _: f32) -> f32 {
        self
    }

    /// Rounds to the nearest count, within 16 bits; NaN becomes 0.
    fn count(self, scale: f32) -> i16 {
        let exact = self / scale;
        // The cast saturates at the limits, and truncates towards zero.
        (exact + if exact < 0.0 { -0.5 } else { 0.5 }) as i16
    }
}

/// A hand whose samples come as the sensor's counts.
pub type CountHand<'m, const A: usize> = SampledHand<'m, i16, A>;

/// A hand whose samples come in m/s², deg/s and µT.
pub type ValueHand<'m, const A: usize> = SampledHand<'m, f32, A>;

/// A hand that runs a model on samples of `A` readings.
#[derive(Clone, Debug)]
pub struct SampledHand<'m, R, const A: usize> {
    hand: RightHand<'m, A>,
    scale: [f32; 3],
    readings: PhantomData<R>,
}

impl<'m, R: Reading, const A: usize> SampledHand<'m, R, A> {
    /// `scale` is the physical value of one count, of the samples or in record mode: m/s², deg/s, µT.
    pub fn new(hand: RightHand<'m, A>, scale: [f32; 3]) -> Self {
        Self { hand, scale, readings: PhantomData }
    }
}

impl<R: Reading, const A: usize> Hand for SampledHand<'_, R, A> {
    type Sample = [R; A];

    fn push(&mut self, sample: &[R; A], time_ms: u32) -> bool {
        let values = core::array::from_fn(|axis| sample[axis].value(self.scale[axis / 3]));
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

    fn counts(&self, sample: &[R; A], counts: &mut [i16; MAX_AXES]) -> usize {
        for (axis, (count, reading)) in counts.iter_mut().zip(sample).enumerate() {
            *count = reading.count(self.scale[axis / 3]);
        }
        A.min(MAX_AXES)
    }
}
