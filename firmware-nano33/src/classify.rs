//! The classifying task: samples to gestures, or to raw batches, by mode.

use core::sync::atomic::Ordering;

use embassy_time::{Duration, with_timeout};
use shared_dsp::decision::DecisionConfig;
use shared_dsp::features::{HOP, WINDOW};
use shared_dsp::mlp::Model;
use shared_dsp::recipe::Recipe;
use shared_dsp::right::{RightHand, RightOutput};
use shared_proto::message::{BoardMessage, Mode, RAW_COUNTS_MAX, RawImu, RightState, health};
use static_cell::StaticCell;

use crate::link::broadcast;
use crate::sample::{AXES, SAMPLE_HZ, SAMPLES, Sample, Taken};
use crate::state::{self, ALIVE_CLASSIFY, SENSOR_OK};

/// Without a sample for so long the window is emptied and the laptop is told, and again and again. Longer than
/// erasing a page of flash, in which samples wait in the sensor.
const SILENCE: Duration = Duration::from_millis(120);

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
    can_run(info.recipe.id(), info.axes, info.sample_hz, info.window) && usize::from(info.hop) == HOP
}

/// One sample into the window; tests watch its arguments and count its instructions.
#[inline(never)]
#[unsafe(no_mangle)]
extern "C" fn bimanual_sample(
    counts: &[i16; AXES],
    hand: &mut RightHand<'static, AXES>,
    time_ms: u32,
) -> bool {
    let scale = nano33_sensor::SCALE;
    let values = core::array::from_fn(|axis| f32::from(counts[axis]) * scale[axis / 3]);
    hand.push(&values, time_ms).is_some()
}

/// Names gestures for ever.
#[embassy_executor::task]
pub async fn run(model: &'static Model<'static>) -> ! {
    static HAND: StaticCell<RightHand<'static, AXES>> = StaticCell::new();
    let Ok(hand) = RightHand::new(*model, DecisionConfig::default()) else {
        defmt::unreachable!("the model was chosen to fit");
    };
    let hand = HAND.init(hand);
    let mut raw = RawBatch::new();
    let mut report = Report { sequence: 0, board_time_ms: 0 };
    loop {
        let taken = with_timeout(SILENCE, SAMPLES.receive()).await;
        state::alive(ALIVE_CLASSIFY);
        match (taken, state::mode()) {
            (Ok(Taken::Sample(sample)), Mode::Classify) => {
                report.board_time_ms = sample.board_time_ms;
                if bimanual_sample(&sample.counts, hand, sample.board_time_ms) {
                    report.send(hand.output());
                }
            }
            (Ok(Taken::Sample(sample)), mode) => {
                // Samples that the window did not see are a gap in it.
                hand.gap();
                if mode == Mode::Record {
                    raw.push(&sample);
                }
            }
            (Ok(Taken::Gap), _) => {
                hand.gap();
                raw.clear();
            }
            (Err(_), mode) => {
                hand.gap();
                raw.clear();
                if mode == Mode::Classify {
                    report.send(hand.output());
                }
            }
        }
    }
}

/// The hand's state on its way to the laptop.
struct Report {
    sequence: u16,
    board_time_ms: u32,
}

impl Report {
    fn send(&mut self, output: &RightOutput) {
        let mut flags = 0;
        if !SENSOR_OK.load(Ordering::Relaxed) {
            flags |= health::SENSOR;
        }
        if !output.full || output.replaced {
            flags |= health::GAP;
        }
        let scores = output.score_bytes();
        broadcast(&BoardMessage::Right(RightState {
            sequence: self.sequence,
            board_time_ms: self.board_time_ms,
            events: output.events,
            label: output.label,
            confidence: output.confidence,
            event_window_end_ms: output.event_window_end_ms,
            scores: &scores[..output.scores().len()],
            health: flags,
        }));
        self.sequence = self.sequence.wrapping_add(1);
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
                scale: nano33_sensor::SCALE,
                counts: &self.bytes,
            }));
            self.sequence = self.sequence.wrapping_add(1);
            self.clear();
        }
    }
}
