//! Tests the sensor drivers with simulated sensors, without a board or processor.
#![cfg(feature = "nrf")]

use std::cell::Cell;
use std::pin::pin;
use std::rc::Rc;
use std::task::{Context, Poll, Waker};

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use nano33_sensor::bmi270::Bmi270 as Bmi270Driver;
use nano33_sensor::bmm150::{Bmm150 as Bmm150Driver, Trim};
use nano33_sensor::found::{Found, Kind};
use nano33_sensor::grid::Grid;
use nano33_sensor::lsm6ds3::Lsm6ds3 as Lsm6ds3Driver;
use nano33_sensor::lsm9ds1::{AccelRange, Config, Lsm9ds1 as Driver, Rate, Scale};
use nano33_sensor::{Batch, Imu, ImuError, SCALE};
use shared_proto::message::Sensor as WireSensor;
use tests::nrf::bmi270::Bmi270;
use tests::nrf::bmm150::Bmm150;
use tests::nrf::i2c::{Bus, Reply, Sensor};
use tests::nrf::lsm6ds3::Lsm6ds3;
use tests::nrf::lsm9ds1::{Lsm9ds1, Motion, Still};
use tests::nrf::time::{HZ, ms, us};

/// The emulated bus for a driver in virtual time. Each transfer takes 100 us.
#[derive(Clone)]
struct Wire {
    bus: Rc<Cell<Option<Bus>>>,
    now: Rc<Cell<u64>>,
}

impl Wire {
    fn new(sensor: impl Sensor + 'static) -> Self {
        let mut bus = Bus::new(Box::new(sensor));
        bus.powered = true;
        Self { bus: Rc::new(Cell::new(Some(bus))), now: Rc::default() }
    }

    /// Calls the function `what` with the bus.
    fn with<T>(&self, what: impl FnOnce(&mut Bus, u64) -> T) -> T {
        let mut bus = self.bus.take().expect("one at a time");
        let result = what(&mut bus, self.now.get());
        self.bus.set(Some(bus));
        result
    }

    fn pass(&self, time: u64) {
        self.now.set(self.now.get() + time);
    }

    fn delay(&self) -> Clock {
        Clock(self.now.clone())
    }
}

#[derive(Debug)]
struct Nack;

impl embedded_hal_async::i2c::Error for Nack {
    fn kind(&self) -> ErrorKind {
        ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address)
    }
}

impl ErrorType for Wire {
    type Error = Nack;
}

impl I2c for Wire {
    async fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), Nack> {
        self.pass(us(100));
        for operation in operations {
            let reply = self.with(|bus, now| match operation {
                Operation::Write(bytes) => bus.write(address, bytes, now),
                Operation::Read(bytes) => bus.read(address, bytes, now),
            });
            if reply != Reply::Ack {
                return Err(Nack);
            }
        }
        Ok(())
    }
}

struct Clock(Rc<Cell<u64>>);

impl DelayNs for Clock {
    async fn delay_ns(&mut self, ns: u32) {
        self.0.set(self.0.get() + u64::from(ns) * HZ / 1_000_000_000);
    }
}

fn wait<T>(future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    match future.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(value) => value,
        Poll::Pending => panic!("nothing here waits"),
    }
}

fn start<I: Imu>(driver: &mut I, wire: &Wire) -> Result<(), ImuError> {
    wait(driver.start(&mut wire.delay()))
}

/// Returns the sets of samples for this many milliseconds, fetched every 10 ms.
fn sets<I: Imu>(driver: &mut I, wire: &Wire, milliseconds: u64) -> Vec<[i16; 6]> {
    let mut all = Vec::new();
    let mut batch = Batch::default();
    for _ in 0..milliseconds / 10 {
        wire.pass(ms(10));
        wait(driver.poll(&mut batch)).unwrap();
        assert!(!batch.overrun);
        all.extend_from_slice(batch.sets());
    }
    all
}

#[test]
fn every_setting_reads_one_g_and_the_earths_field_in_its_own_scale() {
    for accel in [AccelRange::G2, AccelRange::G4] {
        for rate in [Rate::Hz119, Rate::Hz238] {
            let wire = Wire::new(Lsm9ds1::new(Box::new(Still)));
            let config = Config { accel, rate, scale: Scale::DataSheet };
            let mut driver = Driver::new(wire.clone(), config);
            start(&mut driver, &wire).unwrap();
            wire.pass(ms(100));
            let mut batch = Batch::default();
            wait(driver.poll(&mut batch)).unwrap();
            // The driver drops five sets while the filters settle.
            let expected = if rate == Rate::Hz119 { 6 } else { 18 };
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

/// A motion with different and changing values on all axes.
struct Swing;

impl Motion for Swing {
    fn at(&self, seconds: f64) -> [f64; 9] {
        let wave = |hz: f64| (std::f64::consts::TAU * hz * seconds).sin();
        [
            3.0 * wave(0.5),
            -2.0 * wave(0.7),
            9.8,
            200.0 * wave(0.4),
            50.0,
            -120.0 * wave(0.9),
            20.0,
            0.0,
            -40.0,
        ]
    }
}

/// Checks that the driver returns the motion's values, even with a late poll, in the common units and axes.
fn sees_the_swing<I: Imu>(driver: &mut I, wire: &Wire) {
    start(driver, wire).unwrap();
    let sets = sets(driver, wire, 1000);
    let period = 1.0 / f64::from(driver.nominal_hz());
    let newest = wire.now.get() as f64 / HZ as f64;
    // The age of the newest set is less than a period plus a transfer.
    for (n, set) in sets.iter().rev().take(100).enumerate() {
        let at = newest - (n as f64 + 0.5) * period;
        let wanted = Swing.at(at);
        for axis in 0..6 {
            let value = f64::from(set[axis]) * f64::from(SCALE[axis / 3]);
            // The tolerance is the fastest change of each axis over one and a half periods, plus rounding.
            let slack = [0.08, 0.08, 0.003, 5.0, 0.1, 6.5][axis];
            assert!(
                (value - wanted[axis]).abs() < slack,
                "set {n} axis {axis}: {value}, not {}",
                wanted[axis]
            );
        }
    }
}

#[test]
fn every_sensor_tells_the_same_motion_in_the_same_counts_and_axes() {
    let wire = Wire::new(Lsm9ds1::new(Box::new(Swing)));
    sees_the_swing(&mut Driver::new(wire.clone(), Config::default()), &wire);
    let wire = Wire::new(Bmi270::new(Box::new(Swing)));
    sees_the_swing(&mut Bmi270Driver::new(wire.clone()), &wire);
    let wire = Wire::new(Lsm6ds3::new(Box::new(Swing)));
    sees_the_swing(&mut Lsm6ds3Driver::new(wire.clone()), &wire);
}

#[test]
fn the_sensor_that_is_there_is_found_and_what_is_not_is_named() {
    const ALL: [Kind; 3] = [Kind::Lsm9ds1, Kind::Bmi270, Kind::Lsm6ds3];
    let find = |wire: &Wire, kinds: &[Kind]| wait(Found::find(wire.clone(), kinds)).map(|f| f.kind());
    let rev1 = Wire::new(Lsm9ds1::new(Box::new(Still)));
    let rev2 = Wire::new(Bmi270::new(Box::new(Still)));
    let xiao = Wire::new(Lsm6ds3::new(Box::new(Still)));
    assert_eq!(find(&rev1, &ALL), Ok(Kind::Lsm9ds1));
    assert_eq!(find(&rev2, &ALL), Ok(Kind::Bmi270));
    assert_eq!(find(&xiao, &ALL), Ok(Kind::Lsm6ds3));
    rev1.with(|bus, _| bus.unplugged = true);
    assert_eq!(find(&rev1, &ALL), Err(ImuError::Missing(0x6B)));
    assert_eq!(find(&xiao, &[Kind::Bmi270]), Err(ImuError::Missing(0x68)));
}

/// Starts the sensor, which loses one setting during or after the start. A wrong `register` changes the scale.
fn notices<I: Imu>(driver: &mut I, wire: &Wire, address: u8, register: u8) {
    wire.with(|bus, _| bus.sensor.lose_write(register));
    assert_eq!(start(driver, wire), Err(ImuError::Reset(address)), "{register:#x} did not arrive");
    assert_eq!(start(driver, wire), Ok(()));
    assert_eq!(wait(driver.check()), Ok(()));
    wire.with(|bus, _| bus.sensor.power_cycle());
    assert_eq!(wait(driver.check()), Err(ImuError::Reset(address)));
}

#[test]
fn a_setting_that_did_not_arrive_is_noticed_at_the_start_and_a_lost_one_later() {
    // Without CTRL_REG6_XL, the accelerometer would stay at ±2 g.
    // Without FIFO_CTRL or CTRL_REG9, the FIFO would be off.
    for register in [0x20, 0x23] {
        let wire = Wire::new(Lsm9ds1::new(Box::new(Still)));
        notices(&mut Driver::new(wire.clone(), Config::default()), &wire, 0x6B, register);
    }
    for register in [0x41, 0x49] {
        let wire = Wire::new(Bmi270::new(Box::new(Still)));
        notices(&mut Bmi270Driver::new(wire.clone()), &wire, 0x68, register);
    }
    for register in [0x10, 0x11] {
        let wire = Wire::new(Lsm6ds3::new(Box::new(Still)));
        notices(&mut Lsm6ds3Driver::new(wire.clone()), &wire, 0x6A, register);
    }
}

#[test]
fn a_broken_bmi270_and_one_with_half_a_configuration_are_not_started() {
    let wire = Wire::new(Bmi270::new(Box::new(Still)));
    let mut driver = Bmi270Driver::new(wire.clone());
    start(&mut driver, &wire).unwrap();
    wire.with(|bus, _| bus.sensor.fail());
    assert_eq!(wait(driver.check()), Err(ImuError::Reset(0x68)));
    // The upload loses a byte, so all later bytes are at a wrong position.
    wire.with(|bus, _| bus.sensor.lose_write(0x5E));
    assert_eq!(start(&mut driver, &wire), Err(ImuError::Reset(0x68)));
    assert_eq!(start(&mut driver, &wire), Ok(()));
}

fn says_that_sets_are_lost<I: Imu>(driver: &mut I, wire: &Wire) {
    start(driver, wire).unwrap();
    wire.pass(ms(500));
    let mut batch = Batch::default();
    wait(driver.poll(&mut batch)).unwrap();
    assert!(batch.overrun);
    wire.pass(ms(10));
    wait(driver.poll(&mut batch)).unwrap();
    assert!(!batch.overrun);
}

#[test]
fn a_late_poll_says_that_sets_are_lost() {
    let wire = Wire::new(Lsm9ds1::new(Box::new(Still)));
    says_that_sets_are_lost(&mut Driver::new(wire.clone(), Config::default()), &wire);
    let wire = Wire::new(Bmi270::new(Box::new(Still)));
    says_that_sets_are_lost(&mut Bmi270Driver::new(wire.clone()), &wire);
    let wire = Wire::new(Lsm6ds3::new(Box::new(Still)));
    says_that_sets_are_lost(&mut Lsm6ds3Driver::new(wire.clone()), &wire);
}

/// A magnetic field along the chip's axes.
struct Field([f64; 3]);

impl Motion for Field {
    fn at(&self, _: f64) -> [f64; 9] {
        let [x, y, z] = self.0;
        [0.0, 0.0, 9.80665, 0.0, 0.0, 0.0, x, y, z]
    }
}

#[test]
fn a_rev2s_magnetometer_gives_the_field_whatever_its_trimming_and_its_temperature() {
    for hall in [6100, 6500, 7100] {
        for field in [[0.0; 3], [20.0, 0.0, -40.0], [-1234.5, 640.0, 2400.0], [1300.0, -1100.0, -2500.0]] {
            let mut chip = Bmm150::new(Box::new(Field(field)), Trim::ODD);
            chip.hall = hall;
            let wire = Wire::new(chip);
            let mut driver = Bmm150Driver::new(wire.clone());
            wait(driver.start(&mut wire.delay())).unwrap();
            assert_eq!(wait(driver.field_ut()).unwrap(), None, "nothing is new yet");
            wire.pass(ms(34));
            let seen = wait(driver.field_ut()).unwrap().expect("a field");
            for (seen, field) in seen.into_iter().zip(field) {
                // Half a count is 0.19 uT for x and y and 0.20 uT for z.
                assert!((f64::from(seen) - field).abs() < 0.21, "hall {hall}: {seen:?} uT, not {field:?}");
            }
            assert_eq!(wait(driver.field_ut()).unwrap(), None, "read once");
        }
    }
}

#[test]
fn a_rev2s_magnetometer_beside_a_magnet_gives_nothing_and_its_faults_are_named() {
    let wire = Wire::new(Bmm150::new(Box::new(Field([20.0, 9000.0, 0.0])), Trim::ODD));
    let mut driver = Bmm150Driver::new(wire.clone());
    wait(driver.start(&mut wire.delay())).unwrap();
    wire.pass(ms(40));
    assert_eq!(wait(driver.field_ut()).unwrap(), None);
    wire.with(|bus, _| bus.sensor.set_motion(Box::new(Field([20.0, 9.0, 0.0]))));
    wire.pass(ms(40));
    assert!(wait(driver.field_ut()).unwrap().is_some(), "the magnet is gone");
    wire.with(|bus, _| bus.sensor.power_cycle());
    assert_eq!(wait(driver.check()), Err(ImuError::Reset(0x10)));
    for lost in [0x51, 0x52, 0x4C] {
        wire.with(|bus, _| bus.sensor.lose_write(lost));
        assert_eq!(wait(driver.start(&mut wire.delay())), Err(ImuError::Reset(0x10)), "{lost:#x}");
        wait(driver.start(&mut wire.delay())).unwrap();
    }
    wire.with(|bus, _| bus.unplugged = true);
    assert_eq!(wait(driver.start(&mut wire.delay())), Err(ImuError::Missing(0x10)));
    assert_eq!(wait(driver.field_ut()), Err(ImuError::Bus(0x10)));
}

/// Tests the instructions of docs/ADDING.md for another IMU: sampling requires only a driver that implements `Imu`.
struct OwnImu {
    now_us: u64,
    taken: u64,
}

/// The sensor's own clock is 3 % fast.
const OWN_US: u64 = 1_000_000 / 107;

impl Imu for OwnImu {
    fn nominal_hz(&self) -> f32 {
        104.0
    }

    fn axes(&self) -> usize {
        6
    }

    async fn start(&mut self, _: &mut impl DelayNs) -> Result<(), ImuError> {
        Ok(())
    }

    async fn poll(&mut self, batch: &mut Batch) -> Result<(), ImuError> {
        batch.clear();
        while (self.taken + 1) * OWN_US <= self.now_us {
            self.taken += 1;
            batch.push([(self.taken * OWN_US / 100) as i16, 0, 8192, 0, 0, 0]);
        }
        Ok(())
    }

    async fn check(&mut self) -> Result<(), ImuError> {
        Ok(())
    }
}

#[test]
fn an_imu_of_ones_own_comes_out_at_100_hz() {
    let mut imu = OwnImu { now_us: 0, taken: 0 };
    let (mut batch, mut grid) = (Batch::default(), Grid::new(imu.nominal_hz()));
    let mut values = Vec::new();
    for number in 1..=300u64 {
        imu.now_us = number * 10_000;
        wait(imu.poll(&mut batch)).unwrap();
        grid.push(batch.sets());
        grid.synchronise(imu.now_us);
        values.extend(grid.sample(imu.now_us));
    }
    assert!(values.len() > 290, "{} of 300", values.len());
    // The values count tenths of a millisecond. Once the sensor's rate is known, two samples differ by 100.
    for pair in values[100..].windows(2) {
        assert!((98..=102).contains(&(pair[1][0] - pair[0][0])), "{pair:?}");
    }
    let names = [Kind::Lsm9ds1, Kind::Bmi270, Kind::Lsm6ds3].map(|kind| WireSensor::from(kind as u8));
    assert_eq!(names, [WireSensor::Lsm9ds1, WireSensor::Bmi270, WireSensor::Lsm6ds3]);
}
