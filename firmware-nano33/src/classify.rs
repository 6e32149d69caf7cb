//! The classifying task: samples to gestures, or to raw batches, by mode.

use core::sync::atomic::Ordering;

use embassy_time::{Duration, with_timeout};
use shared_dsp::features::{FeatureWindow, HOP, WINDOW};
use shared_dsp::mlp::{MAX_LABELS, Model};
use shared_dsp::recipe::Recipe;
use shared_proto::message::{BoardMessage, Mode, RAW_COUNTS_MAX, RawImu, RightState, health};

use crate::link::broadcast;
use crate::sample::{AXES, SAMPLE_HZ, SAMPLES, SENSOR, Sample, Taken};
use crate::state::{self, ALIVE_CLASSIFY, SENSOR_OK};

/// Without a sample for so long the laptop is told, and the window is emptied.
const SILENCE: Duration = Duration::from_millis(100);

/// Whether this image can run a model with these needs.
pub fn can_run(recipe: u8, axes: usize, sample_hz: u16, window: u16) -> bool {
    Recipe::from_id(recipe).is_some()
        && axes == AXES
        && u64::from(sample_hz) == SAMPLE_HZ
        && usize::from(window) == WINDOW
}

/// Whether this image can run this model.
pub fn fits(model: &Model<'_>) -> bool {
    let info = model.info();
    can_run(info.recipe.id(), info.axes, info.sample_hz, info.window)
}

/// Names gestures for ever.
#[embassy_executor::task]
pub async fn run(model: &'static Model<'static>) -> ! {
    let _ = (model, MAX_LABELS, HOP, FeatureWindow::<AXES>::new());
    let mut raw = RawBatch::new();
    let _ = RightState { sequence: 0, board_time_ms: 0, events: 0, label: 255, confidence: 0, event_window_end_ms: 0, scores: &[], health: health::GAP };
    loop {
        let taken = with_timeout(SILENCE, SAMPLES.receive()).await;
        state::alive(ALIVE_CLASSIFY);
        let _ = SENSOR_OK.load(Ordering::Relaxed);
        if let Ok(Taken::Sample(sample)) = taken && state::mode() == Mode::Record {
            raw.push(&sample);
        }
    }
}

/// Samples on their way out in record mode, a hop at a time.
struct RawBatch {
    sequence: u16,
    first: u32,
    bytes: heapless::Vec<u8, RAW_COUNTS_MAX>,
}

impl RawBatch {
    fn new() -> Self {
        Self { sequence: 0, first: 0, bytes: heapless::Vec::new() }
    }

    fn clear(&mut self) {
        self.bytes.clear();
    }

    fn push(&mut self, sample: &Sample) {
        // A batch has no gaps inside.
        let expected = self.first.wrapping_add((self.bytes.len() / (2 * AXES)) as u32);
        if self.bytes.is_empty() || sample.number != expected {
            self.clear();
            self.first = sample.number;
        }
        for count in sample.counts {
            // Never full here: a full batch leaves below.
            let _ = self.bytes.extend_from_slice(&count.to_le_bytes());
        }
        if self.bytes.is_full() {
            broadcast(&BoardMessage::RawImu(RawImu {
                sequence: self.sequence,
                first_sample: self.first,
                axes: AXES as u8,
                scale: SENSOR.scale(),
                counts: &self.bytes,
            }));
            self.sequence = self.sequence.wrapping_add(1);
            self.clear();
        }
    }
}
