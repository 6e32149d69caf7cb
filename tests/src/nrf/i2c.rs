//! The sensor bus: its devices, power and pull-ups, including a device that holds SDA low.

use super::lsm9ds1::Motion;
use super::time::ms;

/// Time from power-on to the first answer, which is typical of ST sensors of this type.
const BOOT: u64 = ms(35);

/// A motion sensor on the bus, with its own clock.
pub trait Sensor {
    /// Returns whether the device answers at this address.
    fn has_address(&self, address: u8) -> bool;
    /// Performs a write transfer, whose first byte selects the register.
    fn write(&mut self, address: u8, bytes: &[u8], now: u64);
    /// Performs a read transfer from the selected register.
    fn read(&mut self, address: u8, bytes: &mut [u8], now: u64);
    /// Makes the sensor lose all settings, as after a power dip.
    fn power_cycle(&mut self);
    /// Moves the sensor to another hand.
    fn set_motion(&mut self, motion: Box<dyn Motion>);
    /// Sets the ratio of true to nominal period of the sensor's own clock.
    fn set_clock_ratio(&mut self, ratio: f64);
    /// Makes the next write to this register fail silently.
    fn lose_write(&mut self, register: u8);
    /// Number of samples taken since power-up.
    fn sets(&self) -> u64;
    /// Makes the sensor fail in a way that it reports itself, if it can.
    fn fail(&mut self) {}
}

/// The result of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply {
    /// All bytes were acknowledged.
    Ack,
    /// No device answers at the address.
    AddressNack,
    /// The line is stuck, so the transfer never ends.
    Stuck,
}

/// The bus with its devices.
pub struct Bus {
    /// The sensor, which is the only relevant device on this bus.
    pub sensor: Box<dyn Sensor>,
    /// Whether the sensor and the pull-ups have power.
    pub powered: bool,
    /// Number of the next transfers that will not be acknowledged.
    pub nacks: u32,
    /// Number of clock pulses until a device releases SDA.
    pub stuck_clocks: u32,
    /// Whether the sensor is unplugged.
    pub unplugged: bool,
    supplied: bool,
    /// Whether the controller uses the sensor's pins.
    pub wired: bool,
    /// Cycle from which the sensors answer.
    awake_at: u64,
    /// Number of transfers so far.
    pub transfers: u64,
    scl_was_low: bool,
}

impl Bus {
    /// Returns a bus with a sensor that has no power.
    pub fn new(sensor: Box<dyn Sensor>) -> Self {
        Self {
            sensor,
            powered: false,
            nacks: 0,
            stuck_clocks: 0,
            unplugged: false,
            supplied: false,
            wired: true,
            awake_at: 0,
            transfers: 0,
            scl_was_low: false,
        }
    }

    /// Switches the supplies of the sensor and of the pull-ups.
    pub fn supply(&mut self, sensors: bool, pull_ups: bool, now: u64) {
        if sensors && !self.supplied {
            self.awake_at = now + BOOT;
        }
        // The sensor loses its settings when it has no power.
        if !sensors && self.supplied {
            self.sensor.power_cycle();
        }
        self.supplied = sensors;
        self.powered = sensors && pull_ups;
    }

    fn answers(&mut self, address: u8, now: u64) -> Reply {
        self.transfers += 1;
        if self.stuck_clocks > 0 {
            return Reply::Stuck;
        }
        if self.nacks > 0 {
            self.nacks -= 1;
            return Reply::AddressNack;
        }
        let there = self.sensor.has_address(address);
        if self.powered && self.wired && now >= self.awake_at && !self.unplugged && there {
            Reply::Ack
        } else {
            Reply::AddressNack
        }
    }

    /// Performs a write transfer of the controller.
    pub fn write(&mut self, address: u8, bytes: &[u8], now: u64) -> Reply {
        let reply = self.answers(address, now);
        if reply == Reply::Ack {
            self.sensor.write(address, bytes, now);
        }
        reply
    }

    /// Performs a read transfer of the controller.
    pub fn read(&mut self, address: u8, bytes: &mut [u8], now: u64) -> Reply {
        let reply = self.answers(address, now);
        if reply == Reply::Ack {
            self.sensor.read(address, bytes, now);
        }
        reply
    }

    /// Returns the levels of SDA and SCL, determined by the pull-ups and devices.
    pub fn levels(&self) -> (bool, bool) {
        (self.powered && self.stuck_clocks == 0, self.powered)
    }

    /// Lets the processor control SCL directly.
    pub fn drive_scl(&mut self, low: bool) {
        if self.scl_was_low && !low {
            self.stuck_clocks = self.stuck_clocks.saturating_sub(1);
        }
        self.scl_was_low = low;
    }
}
