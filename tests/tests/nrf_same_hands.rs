//! Tests that a model trained on one sensor recognises the same gestures with another sensor.
//! The sensors differ in rate, scale and axes, and some have no magnetometer.
//!
//! Drivers, grid and hand logic run as on the board, but without the emulated processor.
#![cfg(feature = "nrf")]

use std::cell::RefCell;
use std::pin::pin;
use std::rc::Rc;
use std::task::{Context, Poll, Waker};

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use models::synth::{self, Segment};
use nano33_sensor::found::{Found, Kind};
use nano33_sensor::grid::Grid;
use nano33_sensor::{Batch, Imu, SCALE};
use shared_dsp::right::RightHand;
use shared_dsp::right::decision::DecisionConfig;
use shared_dsp::right::network::Model;
use tests::is_full;
use tests::nrf::bmi270::Bmi270;
use tests::nrf::i2c::Sensor;
use tests::nrf::lsm6ds3::Lsm6ds3;
use tests::nrf::lsm9ds1::{Lsm9ds1, Replay};
use tests::nrf::recordings;
use tests::nrf::time::{HZ, ms, us};

/// A simulated sensor on its bus, and the current time.
#[derive(Clone)]
struct Wire(Rc<RefCell<(Box<dyn Sensor>, u64)>>);

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
        let (sensor, now) = &mut *self.0.borrow_mut();
        if !sensor.has_address(address) {
            return Err(Nack);
        }
        for operation in operations {
            *now += us(20);
            match operation {
                Operation::Write(bytes) => sensor.write(address, bytes, *now),
                Operation::Read(bytes) => sensor.read(address, bytes, *now),
            }
        }
        Ok(())
    }
}

impl DelayNs for Wire {
    async fn delay_ns(&mut self, ns: u32) {
        self.0.borrow_mut().1 += u64::from(ns) * HZ / 1_000_000_000;
    }
}

fn wait<T>(future: impl Future<Output = T>) -> T {
    match pin!(future).as_mut().poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(value) => value,
        Poll::Pending => panic!("nothing here waits"),
    }
}

/// Returns the events that a board with this sensor detects in these 100 Hz rows: labels and times in seconds.
fn events(sensor: Box<dyn Sensor>, model: &Model<'_>, seconds: u64) -> Vec<(f64, usize)> {
    let wire = Wire(Rc::new(RefCell::new((sensor, 0))));
    let mut imu = wait(Found::find(wire.clone(), &[Kind::Lsm9ds1, Kind::Bmi270, Kind::Lsm6ds3])).unwrap();
    wait(imu.start(&mut wire.clone())).unwrap();
    let mut grid = Grid::new(imu.nominal_hz());
    let mut hand = RightHand::<9>::new(*model, DecisionConfig::default()).unwrap();
    let mut batch = Batch::default();
    let mut found = Vec::new();
    let micros = |cycles: u64| cycles * 1_000_000 / HZ;
    let first = wire.0.borrow().1 / ms(10) + 1;
    for tick in first..100 * seconds {
        wire.0.borrow_mut().1 = ms(10) * tick;
        wait(imu.poll(&mut batch)).unwrap();
        assert!(!batch.overrun);
        grid.push(batch.sets());
        grid.synchronise(micros(ms(10) * tick));
        let Some(set) = grid.sample(micros(ms(10) * tick)) else { continue };
        let mut values = [0.0; 9];
        for axis in 0..6 {
            values[axis] = f32::from(set[axis]) * SCALE[axis / 3];
        }
        if let Some(output) = hand.push(&values, 10 * tick as u32)
            && output.is_event
        {
            found.push((tick as f64 / 100.0, usize::from(output.label)));
        }
    }
    found
}

/// Counts the gestures that are recognised correctly with each of the three sensors.
/// A correct gesture has an event with its label, and no other event during it or shortly after.
fn right(rows: &[[f64; 9]], wanted: &[(f64, f64, usize)], model: &Model<'_>) -> [usize; 3] {
    const LEAD_S: f64 = 3.0;
    let replay = || Box::new(Replay { rows: rows.to_vec(), interval: 0.01, start: LEAD_S });
    let seconds = rows.len() as u64 / 100 + 5;
    let sensors: [(Box<dyn Sensor>, f64); 3] = [
        (Box::new(Lsm9ds1::new(replay())), 1.013),
        (Box::new(Bmi270::new(replay())), 0.975),
        (Box::new(Lsm6ds3::new(replay())), 1.031),
    ];
    sensors.map(|(mut sensor, ratio)| {
        sensor.set_clock_ratio(ratio);
        let events = events(sensor, model, seconds);
        let named = |&&(from, to, label): &&(f64, f64, usize)| {
            let mut during =
                events.iter().filter(|(at, _)| (LEAD_S + from..LEAD_S + to).contains(at)).peekable();
            during.peek().is_some() && during.all(|&(_, is)| is == label)
        };
        wanted.iter().filter(named).count()
    })
}

#[test]
fn a_model_trained_on_rev1_names_as_many_gestures_right_through_the_sensors_of_rev2_and_xiao() {
    let blob = models::bundled::blob().expect("the bundled model is intact");
    let model = Model::parse(&blob).unwrap();
    let label = |name: &str| model.info().labels().position(|l| l == name).expect("a label of the model");
    let wearers = if is_full() { 60 } else { 20 };
    let mut total = [0; 3];
    let mut drawn = 0;
    for index in 1..=wearers {
        let mut script = vec![Segment::new(synth::Motion::IDLE, 2.0)];
        let (mut wanted, mut at) = (Vec::new(), 2.0);
        for gesture in synth::Motion::GESTURES {
            script.push(Segment::new(gesture, 2.5));
            script.push(Segment::new(synth::Motion::IDLE, 1.5));
            wanted.push((at, at + 4.0, label(gesture.label())));
            at += 4.0;
        }
        let recording = synth::session(&synth::Wearer::evaluation(23, index), 0, &script);
        let named = right(&recordings::rows(&recording), &wanted, &model);
        total = std::array::from_fn(|i| total[i] + named[i]);
        drawn += wanted.len();
    }
    let [rev1, rev2, xiao] = total.map(|right| 100.0 * right as f64 / drawn as f64);
    println!("of {drawn} gestures named right: Rev1 {rev1:.1} %, Rev2 {rev2:.1} %, XIAO {xiao:.1} %");
    assert!(rev1 > 80.0, "the comparison means something");
    assert!((rev2 - rev1).abs() <= 1.0 && (xiao - rev1).abs() <= 1.0);
}
