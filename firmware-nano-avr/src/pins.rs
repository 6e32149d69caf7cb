//! Controls D13, the board's LED, and reads D2, which starts the calibration if it is grounded at power-on.

use avr_device::atmega328p::Peripherals;
use core::convert::Infallible;
use embedded_hal::digital::{ErrorType, InputPin, OutputPin};

/// D13 (PB5).
pub struct Light;

/// D2 (PD2), pulled up.
struct CalibrationPin;

/// Sets the directions of both pins and enables the pull-up of D2.
pub fn start() {
    // Safety: only this module uses both ports.
    let dp = unsafe { Peripherals::steal() };
    dp.PORTB.ddrb.write(|w| w.pb5().set_bit());
    dp.PORTB.portb.write(|w| unsafe { w.bits(0) });
    dp.PORTD.ddrd.write(|w| unsafe { w.bits(0) });
    dp.PORTD.portd.write(|w| w.pd2().set_bit());
    // During this delay, the pull-up charges the pin.
    for _ in 0..200 {
        avr_device::asm::nop();
    }
}

/// Returns whether D2 is held to ground.
pub fn calibration_wanted() -> bool {
    CalibrationPin.is_low().unwrap_or(false)
}

impl ErrorType for Light {
    type Error = Infallible;
}

impl OutputPin for Light {
    fn set_low(&mut self) -> Result<(), Infallible> {
        unsafe { Peripherals::steal() }.PORTB.portb.modify(|_, w| w.pb5().clear_bit());
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        unsafe { Peripherals::steal() }.PORTB.portb.modify(|_, w| w.pb5().set_bit());
        Ok(())
    }
}

impl ErrorType for CalibrationPin {
    type Error = Infallible;
}

impl InputPin for CalibrationPin {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(unsafe { Peripherals::steal() }.PORTD.pind.read().pd2().bit_is_set())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}
