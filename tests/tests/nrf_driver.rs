//! The LSM9DS1 driver against the sensor's model, without board or processor.
#![cfg(feature = "nrf")]

use std::pin::pin;
use std::task::{Context, Poll, Waker};

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use nano33_sensor::lsm9ds1::{AccelRange, Config, Lsm9ds1 as Driver, Rate, Scale};
use nano33_sensor::{Batch, Imu, ImuError};
use tests::nrf::i2c::{Bus, Reply};
use tests::nrf::lsm9ds1::{Lsm9ds1, Motion, Still};
use tests::nrf::time::{ms, us};

/// The emulated bus as a driver sees it; each transfer takes 100 us.
struct Wire<'a> {
    bus: &'a mut Bus,
    now: &'a mut u64,
}

#[derive(Debug)]
struct Nack;

impl embedded_hal_async::i2c::Error for Nack {
    fn kind(&self) -> ErrorKind {
        ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address)
    }
}

impl ErrorType for Wire<'_> {
    type Error = Nack;
}

impl I2c for Wire<'_> {
    async fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), Nack> {
        *self.now += us(100);
        for operation in operations {
            let reply = match operation {
                Operation::Write(bytes) => self.bus.write(address, bytes, *self.now),
                Operation::Read(bytes) => self.bus.read(address, bytes, *self.now),
            };
            if reply != Reply::Ack {
                return Err(Nack);
            }
        }
        Ok(())
    }
}

struct NoWait;

impl DelayNs for NoWait {
    async fn delay_ns(&mut self, _: u32) {}
}

fn wait<T>(future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    match future.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(value) => value,
        Poll::Pending => panic!("nothing here waits"),
    }
}

fn bus(motion: Box<dyn Motion>) -> Bus {
    let mut bus = Bus::new(Lsm9ds1::new(motion));
    bus.powered = true;
    bus
}

#[test]
fn every_setting_reads_one_g_and_the_earths_field_in_its_own_scale() {
    for accel in [AccelRange::G2, AccelRange::G4] {
        for rate in [Rate::Hz119, Rate::Hz238] {
            let mut now = 0;
            let mut bus = bus(Box::new(Still));
            let config = Config { accel, rate, scale: Scale::DataSheet };
            let mut driver = Driver::new(Wire { bus: &mut bus, now: &mut now }, config);
            wait(driver.start(&mut NoWait)).unwrap();
            let wire = driver.release();
            *wire.now += ms(100);
            let mut driver = Driver::new(wire, config);
            let mut batch = Batch::default();
            wait(driver.poll(&mut batch)).unwrap();
            let expected = if rate == Rate::Hz119 { 11 } else { 23 };
            assert!((expected..=expected + 2).contains(&batch.sets().len()), "{}", batch.sets().len());
            let [accel_scale, _, mag_scale] = config.scale();
            let z = f32::from(batch.sets()[0][2]) * accel_scale;
            assert!((z - 9.80665).abs() < accel_scale, "{z}");
            let field = batch.magnetometer.map(|c| f32::from(c) * mag_scale);
            assert!((field[0] - 20.0).abs() < mag_scale && (field[2] + 40.0).abs() < mag_scale, "{field:?}");
        }
    }
}

#[test]
fn arduinos_scale_is_12_8_per_cent_smaller_for_gyroscope_and_magnetometer() {
    let [_, gyro, mag] = Config::default().scale();
    let [_, gyro_arduino, mag_arduino] = Config { scale: Scale::Arduino, ..Config::default() }.scale();
    assert!((gyro / gyro_arduino - 1.1469).abs() < 1e-3);
    assert!((mag / mag_arduino - 1.1469).abs() < 1e-3);
}

#[test]
fn who_is_not_there_or_not_right_is_named() {
    let mut now = 0;
    let start = |bus: &mut Bus, now: &mut u64| {
        wait(Driver::new(Wire { bus, now }, Config::default()).start(&mut NoWait))
    };
    let mut away = bus(Box::new(Still));
    away.unplugged = true;
    assert_eq!(start(&mut away, &mut now), Err(ImuError::Missing(0x6B)));
    let mut rev2 = bus(Box::new(Still));
    rev2.rev2 = true;
    assert_eq!(start(&mut rev2, &mut now), Err(ImuError::Rev2));
    let mut flaky = bus(Box::new(Still));
    assert_eq!(start(&mut flaky, &mut now), Ok(()));
    let mut driver = Driver::new(Wire { bus: &mut flaky, now: &mut now }, Config::default());
    wait(driver.start(&mut NoWait)).unwrap();
    assert_eq!(wait(driver.check()), Ok(()));
    let wire = driver.release();
    wire.bus.sensor.power_cycle();
    let mut driver = Driver::new(wire, Config::default());
    assert_eq!(wait(driver.check()), Err(ImuError::Reset));
}

#[test]
fn a_late_poll_says_that_sets_are_lost() {
    let mut now = 0;
    let mut bus = bus(Box::new(Still));
    let mut driver = Driver::new(Wire { bus: &mut bus, now: &mut now }, Config::default());
    wait(driver.start(&mut NoWait)).unwrap();
    let wire = driver.release();
    *wire.now += ms(500);
    let mut driver = Driver::new(wire, Config::default());
    let mut batch = Batch::default();
    wait(driver.poll(&mut batch)).unwrap();
    assert!(batch.overrun);
    wait(driver.poll(&mut batch)).unwrap();
    assert!(!batch.overrun);
}
