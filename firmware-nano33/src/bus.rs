//! Power supply and I2C bus of the sensors inside the module.

use embassy_nrf::gpio::{AnyPin, Flex, Level, Output, OutputDrive};
use embassy_nrf::peripherals::TWISPI0;
use embassy_nrf::twim::{self, Twim};
use embassy_nrf::{Peri, bind_interrupts};
use embassy_time::{Duration, Timer};
use embedded_hal_async::i2c::{ErrorType, I2c, Operation};
use static_cell::ConstStaticCell;

use crate::boards;

bind_interrupts!(struct Irqs {
    TWISPI0 => twim::InterruptHandler<TWISPI0>;
});

/// The sensor's pins.
pub struct SensorPins {
    /// I2C data.
    pub sda: Peri<'static, AnyPin>,
    /// I2C clock.
    pub scl: Peri<'static, AnyPin>,
    /// This pin supplies the sensor while it is high.
    pub power: Peri<'static, AnyPin>,
    /// This pin supplies the pull-ups of the bus while it is high. Not all boards have this pin.
    pub pull_ups: Option<Peri<'static, AnyPin>>,
}

/// The bus runs at 390 kHz. At the nominal 400 kHz, its low period is shorter than I2C allows (nRF52840 erratum 219).
const FREQUENCY: u32 = 0x0620_0000;

/// The I2C bus inside the module, which is not the bus on the board's header.
pub struct SensorBus {
    twim: Peri<'static, TWISPI0>,
    sda: Peri<'static, AnyPin>,
    scl: Peri<'static, AnyPin>,
    power: Output<'static>,
    pull_ups: Option<Output<'static>>,
    tx_buffer: &'static mut [u8; 8],
}

static TX_BUFFER: ConstStaticCell<[u8; 8]> = ConstStaticCell::new([0; 8]);

impl SensorBus {
    /// The bus without power.
    pub fn new(twim: Peri<'static, TWISPI0>, pins: SensorPins) -> Self {
        Self {
            twim,
            sda: pins.sda,
            scl: pins.scl,
            // The sensors of a Rev2 and of a XIAO work only with high drive strength.
            power: Output::new(pins.power, Level::Low, OutputDrive::HighDrive),
            pull_ups: pins.pull_ups.map(|pin| Output::new(pin, Level::Low, OutputDrive::Standard)),
            tx_buffer: TX_BUFFER.take(),
        }
    }

    /// Switches the sensor on and, 10 ms later, the pull-ups, as Arduino's core does.
    /// After that, it waits for the sensor to start.
    pub async fn power_up(&mut self) {
        self.power.set_high();
        Timer::after(Duration::from_millis(10)).await;
        if let Some(pull_ups) = &mut self.pull_ups {
            pull_ups.set_high();
        }
        Timer::after(Duration::from_millis(boards::START_MS - 10)).await;
    }

    /// If a device drives SDA low, frees the bus with up to nine clock pulses and a stop condition.
    /// Returns whether the bus was stuck. Afterwards both lines are high unless the fault persists.
    pub async fn clear(&mut self) -> bool {
        let mut sda = Flex::new(self.sda.reborrow());
        let mut scl = Flex::new(self.scl.reborrow());
        let half = Duration::from_micros(31);
        for line in [&mut sda, &mut scl] {
            line.set_high();
            line.set_as_input_output(embassy_nrf::gpio::Pull::None, OutputDrive::Standard0Disconnect1);
        }
        Timer::after(half).await;
        let stuck = sda.is_low() || scl.is_low();
        if !stuck {
            return false;
        }
        for _ in 0..9 {
            if sda.is_high() {
                break;
            }
            scl.set_low();
            Timer::after(half).await;
            scl.set_high();
            Timer::after(half).await;
        }
        scl.set_low();
        sda.set_low();
        Timer::after(half).await;
        scl.set_high();
        Timer::after(half).await;
        sda.set_high();
        Timer::after(half).await;
        true
    }

    /// Opens the bus controller until the returned value is dropped.
    pub fn open(&mut self) -> Wire<'_> {
        let mut config = twim::Config::default();
        config.frequency = twim::Frequency::K400;
        let (twim, sda, scl) = (self.twim.reborrow(), self.sda.reborrow(), self.scl.reborrow());
        let wire = Wire(Twim::new(twim, Irqs, sda, scl, config, self.tx_buffer));
        let frequency = twim::Frequency::from_bits(FREQUENCY);
        embassy_nrf::pac::TWIM0.frequency().write(|w| w.set_frequency(frequency));
        wire
    }
}

/// The bus controller. After a failed transfer, it pauses.
///
/// After an error, embassy-nrf's driver requests a stop condition but does not wait for it.
/// Without the pause, the late "stopped" event would end the next transfer too early and leave a buffer of zeros.
pub struct Wire<'a>(Twim<'a>);

impl ErrorType for Wire<'_> {
    type Error = twim::Error;
}

impl I2c for Wire<'_> {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), twim::Error> {
        let result = I2c::transaction(&mut self.0, address, operations).await;
        if result.is_err() {
            Timer::after(Duration::from_micros(200)).await;
        }
        result
    }
}
