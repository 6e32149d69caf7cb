//! The left hand's task: combines the accelerometer's samples with the flex sensors, and passes both to the board's logic.

use embassy_nrf::gpio::{AnyPin, Level, Output, OutputDrive};
use embassy_nrf::peripherals::SAADC;
use embassy_nrf::saadc::{self, AnyInput, ChannelConfig, Gain, Oversample, Reference, Saadc};
use embassy_nrf::{Peri, bind_interrupts};
use embassy_time::{Duration, with_timeout};
use shared_dsp::left::{AdcCounts, ONE_G};

use super::board::Listeners;
use crate::board::{self, Board};
use crate::sample::{SAMPLES, Sample, Taken};
use crate::state::{self, ALIVE_CLASSIFY};

bind_interrupts!(struct Irqs {
    SAADC => saadc::InterruptHandler;
});

/// If no sample arrives for this long, the logic learns that samples are missing, first and then again.
/// While a laptop pairs, samples may be late and then arrive all at once with their own times.
const LATE: [Duration; 2] = [Duration::from_millis(100), Duration::from_millis(20)];
/// Counts of the accelerometer per g, at 0.122 mg each.
const SENSOR_ONE_G: i32 = 8197;
/// The reading without acceleration, which is the middle of the range as with an analog accelerometer.
const MIDDLE: i32 = 512 * 8;

/// The flex sensors and their converter.
pub struct Parts {
    /// The converter.
    pub converter: Peri<'static, SAADC>,
    /// The index finger's voltage divider.
    pub index: AnyInput<'static>,
    /// The middle finger's voltage divider.
    pub middle: AnyInput<'static>,
    /// The lower end of the battery's divider. The board always drives it low, because the middle of this divider would
    /// otherwise rise to the battery's voltage, which is too high for a pin.
    pub battery_low: Peri<'static, AnyPin>,
}

/// Averages eight conversions of a voltage. The full range is the supply, as for the dividers, so it does not matter.
async fn read(converter: Peri<'_, SAADC>, input: AnyInput<'_>) -> u16 {
    let mut channel = ChannelConfig::single_ended(input);
    channel.reference = Reference::VDD1_4;
    channel.gain = Gain::Gain1_4;
    let mut config = saadc::Config::default();
    config.oversample = Oversample::Over8x;
    let mut counts = [0];
    Saadc::new(converter, Irqs, config, [channel]).sample(&mut counts).await;
    // Twelve bits to the sum of eight conversions with ten bits.
    (2 * counts[0].max(0) as u16).min(AdcCounts::MAX)
}

/// Converts counts of the sensor to the readings of an analog accelerometer.
fn reading(count: i16) -> u16 {
    let product = i32::from(count) * i32::from(ONE_G);
    let half = if product < 0 { -SENSOR_ONE_G / 2 } else { SENSOR_ONE_G / 2 };
    (MIDDLE + (product + half) / SENSOR_ONE_G) as u16
}

fn counts(sample: &Sample, [index, middle]: [u16; 2]) -> AdcCounts {
    let [x, y, z, ..] = sample.counts.map(reading);
    AdcCounts { x, y, z, index, middle }
}

/// Passes one sample to the board. Tests inspect the arguments of this function.
#[inline(never)]
#[unsafe(no_mangle)]
extern "C" fn bimanual_left_sample(counts: &AdcCounts, board: &mut Board, time_ms: u32) {
    board.hand().period(time_ms, &mut Listeners);
    board.hand().sample(*counts, time_ms, &mut Listeners);
}

/// The board's time in the order in which the logic receives it. It never goes backwards.
#[derive(Default)]
struct Clock(u32);

impl Clock {
    fn at(&mut self, time_ms: u32) -> u32 {
        if time_ms.wrapping_sub(self.0) < 1 << 31 {
            self.0 = time_ms;
        }
        self.0
    }
}

/// Takes samples for ever.
#[embassy_executor::task]
pub async fn run(parts: Parts) -> ! {
    let Parts { mut converter, mut index, mut middle, battery_low } = parts;
    let _low = Output::new(battery_low, Level::Low, OutputDrive::Standard);
    let mut clock = Clock::default();
    let mut is_missing = false;
    loop {
        let taken = with_timeout(LATE[usize::from(is_missing)], SAMPLES.receive()).await;
        is_missing = taken.is_err();
        state::alive(ALIVE_CLASSIFY);
        match taken {
            Ok(Taken::Sample(sample)) => {
                let flex = [
                    read(converter.reborrow(), index.reborrow()).await,
                    read(converter.reborrow(), middle.reborrow()).await,
                ];
                let (counts, time_ms) = (counts(&sample, flex), clock.at(sample.board_time_ms));
                board::with(|board| bimanual_left_sample(&counts, board, time_ms));
            }
            // The missing samples' time passes below, or the next sample is already here.
            Ok(Taken::Gap) => {}
            Err(_) => {
                let time_ms = clock.at(state::now_ms());
                board::with(|board| board.hand().period(time_ms, &mut Listeners));
            }
        }
    }
}
