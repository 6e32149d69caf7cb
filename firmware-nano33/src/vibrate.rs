//! Drives the pin of the vibration motor with the pulse width that the board's logic sets.
//! While the motor is off, its pin is low and the PWM clock is stopped.

use embassy_futures::select::select;
use embassy_nrf::Peri;
use embassy_nrf::gpio::AnyPin;
use embassy_nrf::peripherals::PWM1;
use embassy_nrf::pwm::{DutyCycle, Prescaler, SimpleConfig, SimplePwm};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Timer};

use crate::{board, state};

/// Signals that the laptop has requested vibration.
pub static FELT: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// Clock cycles per per cent of pulse width: 16 MHz / 20 kHz / 100. People cannot hear 20 kHz.
const PERCENT: u16 = 8;

/// The pin that controls the transistor of an optional motor.
pub struct Parts {
    /// The PWM generator. PWM0 is not used, because the stock bootloader leaves it running.
    pub pwm: Peri<'static, PWM1>,
    /// Its pin.
    pub pin: Peri<'static, AnyPin>,
}

/// Drives the pin without end.
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
                // Disabling stops the generator's clock and returns the pin to the GPIO port, which drives it low.
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
