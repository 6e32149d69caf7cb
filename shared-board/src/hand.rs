//! The source of a right board's gestures: a network with an IMU, or anything else with the same output.

use core::borrow::BorrowMut;
use core::marker::PhantomData;

use shared_dsp::right::network::{self, MAX_AXES};
use shared_dsp::right::{RightHand, RightOutput, Windows};
use shared_proto::message::{ModelInfo, Text};

/// Converts samples to gestures.
pub trait Hand {
    /// The type of a sample.
    type Sample;

    /// Adds the sample that was taken at `time_ms`. Returns true once per hop, when [`Hand::output`] is new.
    fn push(&mut self, sample: &Self::Sample, time_ms: u32) -> bool;

    /// Reports missing samples. The window must fill again, but past events and their counter remain.
    fn gap(&mut self);

    /// Returns the state after the last hop.
    fn output(&self) -> &RightOutput;

    /// Returns the requirements of the model, and its labels.
    fn model(&self) -> ModelInfo<'_>;

    /// Returns the physical value of one count (m/s², deg/s, µT), or `None` if samples cannot be recorded.
    fn scale(&self) -> Option<[f32; 3]>;

    /// Writes a sample in counts (accelerometer, gyroscope, magnetometer) and returns the number of values.
    fn counts(&self, sample: &Self::Sample, counts: &mut [i16; MAX_AXES]) -> usize;
}

/// Converts a model's description to its message on the wire.
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

/// The unit in which a hand's samples are given.
pub trait Reading: Copy {
    /// Converts the reading to m/s², deg/s or µT. The value of one count is `scale`.
    fn value(self, scale: f32) -> f32;

    /// Converts the reading to counts. The value of one count is `scale`.
    fn count(self, scale: f32) -> i16;
}

/// Counts of the sensor.
impl Reading for i16 {
    fn value(self, scale: f32) -> f32 {
        f32::from(self) * scale
    }

    fn count(self, _: f32) -> i16 {
        self
    }
}

/// Values in m/s², deg/s and µT, which recordings also contain.
impl Reading for f32 {
    fn value(self, _: f32) -> f32 {
        self
    }

    /// Rounds to the nearest count within 16 bits. NaN becomes 0.
    fn count(self, scale: f32) -> i16 {
        let exact = self / scale;
        // The cast saturates at the limits and rounds towards zero.
        (exact + if exact < 0.0 { -0.5 } else { 0.5 }) as i16
    }
}

/// A hand whose samples are counts of the sensor.
pub type CountHand<'m, const A: usize, W = Windows<A>> = SampledHand<'m, i16, A, W>;

/// A hand whose samples are in m/s², deg/s and µT.
pub type ValueHand<'m, const A: usize> = SampledHand<'m, f32, A>;

/// A hand that runs a model on samples with `A` values each. `W` holds its windows ([`RightHand`]).
#[derive(Clone, Debug)]
pub struct SampledHand<'m, R, const A: usize, W = Windows<A>> {
    hand: RightHand<'m, A, W>,
    scale: [f32; 3],
    readings: PhantomData<R>,
}

impl<'m, R: Reading, const A: usize, W> SampledHand<'m, R, A, W> {
    /// `scale` is the physical value of one count in m/s², deg/s and µT.
    /// The scale converts samples in counts. For other samples, it is used only in record mode.
    pub fn new(hand: RightHand<'m, A, W>, scale: [f32; 3]) -> Self {
        Self { hand, scale, readings: PhantomData }
    }
}

impl<R: Reading, const A: usize, W: BorrowMut<Windows<A>>> Hand for SampledHand<'_, R, A, W> {
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
