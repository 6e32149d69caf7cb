//! Power and wires of the sensors inside the module.

use embassy_nrf::gpio::{Flex, Level, Output, OutputDrive};
use embassy_nrf::peripherals::{P0_14, P0_15, P0_22, P1_00, TWISPI0};
use embassy_nrf::twim::{self, Twim};
use embassy_nrf::{Peri, bind_interrupts};
use embassy_time::{Duration, Timer};
use embedded_hal_async::i2c::{ErrorType, I2c, Operation};
use static_cell::ConstStaticCell;

bind_interrupts!(struct Irqs {
    TWISPI0 => twim::InterruptHandler<TWISPI0>;
});

/// The internal I2C bus. (The bus on the header, A4 and A5, is another one.)
pub struct SensorBus {
    twim: Peri<'static, TWISPI0>,
    sda: Peri<'static, P0_14>,
    scl: Peri<'static, P0_15>,
    power: Output<'static>,
    pull_ups: Output<'static>,
    tx_buffer: &'static mut [u8; 8],
}

static TX_BUFFER: ConstStaticCell<[u8; 8]> = ConstStaticCell::new([0; 8]);

impl SensorBus {
    /// The bus without power.
    pub fn new(
        twim: Peri<'static, TWISPI0>,
        sda: Peri<'static, P0_14>,
        scl: Peri<'static, P0_15>,
        power: Peri<'static, P0_22>,
        pull_ups: Peri<'static, P1_00>,
    ) -> Self {
        Self {
            twim,
            sda,
            scl,
            // A Rev2's sensors need the high drive.
            power: Output::new(power, Level::Low, OutputDrive::HighDrive),
            pull_ups: Output::new(pull_ups, Level::Low, OutputDrive::Standard),
            tx_buffer: TX_BUFFER.take(),
        }
    }

    /// Sensors on (P0.22), 10 ms, then the pull-ups (P1.00): the order of this board.
    pub async fn power_up(&mut self) {
        self.power.set_high();
        Timer::after(Duration::from_millis(10)).await;
        self.pull_ups.set_high();
        Timer::after(Duration::from_millis(1)).await;
    }

    /// Frees a bus on which a device holds SDA low: up to nine clocks until it lets go, then a stop.
    /// Returns whether the bus had been stuck; both lines are high afterwards unless the fault stays.
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

    /// The bus controller at 400 kHz, until it is dropped.
    pub fn open(&mut self) -> Wire<'_> {
        let mut config = twim::Config::default();
        config.frequency = twim::Frequency::K400;
        let (twim, sda, scl) = (self.twim.reborrow(), self.sda.reborrow(), self.scl.reborrow());
        Wire(Twim::new(twim, Irqs, sda, scl, config, self.tx_buffer))
    }
}

/// The bus controller, with a pause after a failed transfer.
///
/// embassy-nrf's driver asks for a stop condition after an error and does not wait for it: the "stopped" event
/// would end the next transfer before it has begun, with a buffer of zeros.
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
