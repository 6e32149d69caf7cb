//! The sampling task operates the sensor and resamples its data to the exact 100 Hz grid.
//!
//! Grid time k is tick `k · 32768 / 100` of the crystal, rounded down.
//! Grid times are 327 or 328 ticks apart, and their average rate is exactly 100 Hz.
//! A 10 ms timer in whole ticks would have a period of 327 ticks (100.2 Hz) or 328 ticks (99.9 Hz).
//! Sample number k always belongs to grid time k.
//! A sample that could not be taken is counted and leaves a gap in the window.

use core::sync::atomic::Ordering;

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_time::{Delay, Duration, Instant, TICK_HZ, Timer, with_timeout};
use nano33_sensor::found::Found;
use nano33_sensor::grid::Grid;
use nano33_sensor::{Batch, Imu, ImuError};
use shared_proto::message::FaultKind;

use crate::bus::SensorBus;
use crate::state::{self, ALIVE_SAMPLE, DROPPED_SAMPLES, SENSOR_ERRORS, SENSOR_OK};
use crate::{board, boards};

/// Samples per second.
pub const SAMPLE_HZ: u64 = 100;
/// Values per sample.
pub const AXES: usize = 9;

/// One sample on the grid. The order is accX accY accZ gyrX gyrY gyrZ magX magY magZ, in counts of [`nano33_sensor::SCALE`].
/// The last three values are 0 on a board without a magnetometer.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Its number since start.
    #[cfg(not(feature = "left"))]
    pub number: u32,
    /// Grid time of the sample, on the board's clock.
    pub board_time_ms: u32,
    /// The counts.
    pub counts: [i16; AXES],
}

/// A message to the classification task.
#[derive(Clone, Copy, Debug)]
pub enum Taken {
    /// The next sample.
    Sample(Sample),
    /// Samples are missing here.
    Gap,
}

/// Samples that wait for the classification task.
pub static SAMPLES: Channel<CriticalSectionRawMutex, Taken, 16> = Channel::new();

/// Time limit of one poll, after which the bus counts as stuck.
/// The transfers of a poll take about 1 ms, or 15 ms with a full FIFO.
/// Erasing a page of flash can stop the processor for another 85 ms.
const POLL_TIMEOUT: Duration = Duration::from_millis(150);
/// If no new sets arrive for this long, the task checks the sensor's settings.
const SILENCE: Duration = Duration::from_millis(50);
/// A failing sensor is restarted after this time, which is shorter than the 134 ms that the sensor's FIFO holds.
const PATIENCE: Duration = Duration::from_millis(60);
/// Time limit for the configuration of a sensor. The BMI270 needs half of it to load its configuration file.
const START_TIMEOUT: Duration = Duration::from_millis(800);
/// Pause between attempts to start the sensor.
const RETRY: Duration = Duration::from_millis(250);
/// Number of consecutive failures after which the laptop is notified, because a single failure may be transient.
/// Later every fourth failure is reported.
const TOLD_FROM: u32 = 2;

fn tick_of(number: u64) -> Instant {
    Instant::from_ticks(number * TICK_HZ / SAMPLE_HZ)
}

fn micros(time: Instant) -> u64 {
    // Exact: 1e6 / 32768 = 15625 / 512.
    time.as_ticks() * 15625 / 512
}

/// Takes samples for ever.
#[embassy_executor::task]
pub async fn run(mut bus: SensorBus) -> ! {
    bus.power_up().await;
    let mut batch = Batch::default();
    let mut next = 0;
    let mut attempt = 0u32;
    loop {
        let why = attempt_once(&mut bus, &mut batch, &mut next, &mut attempt).await;
        SENSOR_OK.store(false, Ordering::Relaxed);
        let _ = SAMPLES.try_send(Taken::Gap);
        if bus.clear().await {
            state::report(FaultKind::BusStuck, attempt);
        } else if attempt >= TOLD_FROM && (attempt - TOLD_FROM).is_multiple_of(4) {
            say(why);
        }
        // The first restart follows immediately, so that a transient failure causes only a short gap.
        if attempt > 0 {
            Timer::after(RETRY).await;
        }
        attempt = attempt.wrapping_add(1);
        state::alive(ALIVE_SAMPLE);
        skip_past(&mut next);
    }
}

/// Detects and starts the sensor, and then takes samples until the sensor fails.
async fn attempt_once(bus: &mut SensorBus, batch: &mut Batch, next: &mut u64, attempt: &mut u32) -> ImuError {
    let mut imu = match with_timeout(POLL_TIMEOUT, Found::find(bus.open(), boards::SENSORS)).await {
        Ok(Ok(imu)) => imu,
        Ok(Err(error)) => return error,
        Err(_) => return ImuError::Bus(boards::SENSORS[0].address()),
    };
    board::found(imu.kind(), imu.axes());
    match with_timeout(START_TIMEOUT, imu.start(&mut Delay)).await {
        Ok(Ok(())) => {
            *attempt = 0;
            batch.magnetometer = [0; 3];
            stream(&mut imu, batch, next).await
        }
        Ok(Err(error)) => error,
        Err(_) => ImuError::Bus(imu.kind().address()),
    }
}

fn say(why: ImuError) {
    match why {
        ImuError::Missing(address) | ImuError::Bus(address) | ImuError::Reset(address) => {
            state::report(FaultKind::SensorMissing, address.into());
        }
        ImuError::Unknown(who) => state::report(FaultKind::SensorUnknown, who.into()),
    }
}

/// Advances to the first grid time that is not in the past. Every skipped sample counts as dropped.
fn skip_past(next: &mut u64) {
    let now = Instant::now();
    while tick_of(*next) < now {
        *next += 1;
        DROPPED_SAMPLES.fetch_add(1, Ordering::Relaxed);
    }
}

/// Takes samples until the sensor fails.
async fn stream<I: Imu>(imu: &mut I, batch: &mut Batch, next: &mut u64) -> ImuError {
    let mut grid = Grid::new(imu.nominal_hz());
    let mut last_good = Instant::now();
    let mut last_sets = Instant::now();
    skip_past(next);
    loop {
        Timer::at(tick_of(*next)).await;
        state::alive(ALIVE_SAMPLE);
        let asked = Instant::now();
        let result = with_timeout(POLL_TIMEOUT, imu.poll(batch)).await;
        if batch.overrun {
            grid.restart();
        }
        grid.push(batch.sets());
        match result {
            Ok(Ok(())) => {
                grid.synchronise(micros(asked));
                last_good = asked;
            }
            Ok(Err(error)) => {
                SENSOR_ERRORS.fetch_add(1, Ordering::Relaxed);
                if asked - last_good > PATIENCE {
                    return error;
                }
                // The next poll fetches the sets that remain in the sensor's FIFO.
                Timer::after(Duration::from_millis(2)).await;
                continue;
            }
            Err(_) => {
                SENSOR_ERRORS.fetch_add(1, Ordering::Relaxed);
                return ImuError::Bus(boards::SENSORS[0].address());
            }
        }
        if !batch.sets().is_empty() {
            last_sets = asked;
            SENSOR_OK.store(true, Ordering::Relaxed);
        } else if asked - last_sets > SILENCE {
            match imu.check().await {
                Err(error) => return error,
                Ok(()) if asked - last_sets > SILENCE * 2 => {
                    return ImuError::Reset(boards::SENSORS[0].address());
                }
                Ok(()) => {}
            }
        }
        while tick_of(*next) <= asked {
            match grid.sample(micros(tick_of(*next))) {
                Some(set) => {
                    let mut counts = [0; AXES];
                    counts[..6].copy_from_slice(&set);
                    counts[6..].copy_from_slice(&batch.magnetometer);
                    let board_time_ms = (micros(tick_of(*next)) / 1000) as u32;
                    let sample = Sample {
                        #[cfg(not(feature = "left"))]
                        number: *next as u32,
                        board_time_ms,
                        counts,
                    };
                    if SAMPLES.try_send(Taken::Sample(sample)).is_err() {
                        DROPPED_SAMPLES.fetch_add(1, Ordering::Relaxed);
                    }
                }
                None => {
                    let _ = SAMPLES.try_send(Taken::Gap);
                    DROPPED_SAMPLES.fetch_add(1, Ordering::Relaxed);
                }
            }
            *next += 1;
        }
    }
}
