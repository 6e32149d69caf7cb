//! Measures the battery voltage on boards with a voltage divider.

use embassy_nrf::gpio::{AnyPin, Level, Output, OutputDrive};
use embassy_nrf::peripherals::SAADC;
use embassy_nrf::saadc::{self, AnyInput, ChannelConfig, Saadc};
use embassy_nrf::{Peri, bind_interrupts};
use embassy_time::{Duration, Timer};

use crate::about;

bind_interrupts!(struct Irqs {
    SAADC => saadc::InterruptHandler;
});

/// A minute: a battery changes slowly.
const BETWEEN: Duration = Duration::from_secs(60);
/// Full scale of the converter in millivolts, which follows from a 0.6 V reference, gain 1/6 and 12 bits.
const FULL_SCALE_MV: u32 = 3600;

/// The divider.
pub struct Parts {
    /// The converter.
    pub converter: Peri<'static, SAADC>,
    /// Its middle.
    pub middle: AnyInput<'static>,
    /// The lower end of the divider, which the board always drives low.
    /// If this end floated, the middle of the divider would rise to the battery's voltage, which is too high for a pin.
    pub low: Peri<'static, AnyPin>,
    /// Resistances of the whole divider and of its lower part, in kilohms.
    pub kilohms: (u32, u32),
}

/// Measures now and then.
#[embassy_executor::task]
pub async fn run(mut parts: Parts) -> ! {
    let _low = Output::new(parts.low, Level::Low, OutputDrive::Standard);
    let (whole, lower) = parts.kilohms;
    loop {
        Timer::after(Duration::from_millis(10)).await;
        let mut counts = [0];
        let channel = ChannelConfig::single_ended(parts.middle.reborrow());
        let config = saadc::Config::default();
        Saadc::new(parts.converter.reborrow(), Irqs, config, [channel]).sample(&mut counts).await;
        let pin_mv = (counts[0].max(0) as u32 * FULL_SCALE_MV) >> 12;
        about::battery((pin_mv * whole / lower) as u16);
        Timer::after(BETWEEN).await;
    }
}
