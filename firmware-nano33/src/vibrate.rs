//! The vibration motor's pin: what the board's logic says, as a pulse width. Low and unclocked while the motor is still.

use embassy_futures::select::select;
use embassy_nrf::Peri;
use embassy_nrf::gpio::AnyPin;
use embassy_nrf::peripherals::PWM1;
use embassy_nrf::pwm::{DutyCycle, Prescaler, SimpleConfig, SimplePwm};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Timer};

use crate::{board, state};

/// The laptop asks for a signal.
pub static FELT: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// Of the 16 MHz clock: a period of 20 kHz, which nobody hears, has a hundred.
const PERCENT: u16 = 8;

/// The pin to which a motor's transistor may be wired.
pub struct Parts {
    /// The generator. Not the first one, which the stock bootloader leaves running.
    pub pwm: Peri<'static, PWM1>,
    /// Its pin.
    pub pin: Peri<'static, AnyPin>,
}

/// Drives the pin for ever.
#[embassy_executor::task]
pub async fn run(parts: Parts) -> ! {
    let mut config = SimpleConfig::default();
    config.prescaler = Prescaler::Div1;
    config.max_duty = 100 * PERCENT;
    let mut pwm = SimplePwm::new_1ch(parts.pwm, parts.pin, &config);
    pwm.disable();
    let mut percent = 0;
    loop {
        let motor = board::with(|board| board.motor(state::now_ms()));
        if motor.percent != percent {
            percent = motor.percent;
            pwm.enable();
            // With this polarity the pin is high while the counter is below the value.
            pwm.set_duty(0, DutyCycle::inverted(PERCENT * u16::from(percent)));
            if percent == 0 {
                // Its clock is off, and the pin is the port's again: low.
                pwm.disable();
            }
        }
        match motor.for_ms {
            Some(ms) => {
                select(FELT.wait(), Timer::after(Duration::from_millis(ms.into()))).await;
            }
            None => FELT.wait().await,
        }
    }
}
