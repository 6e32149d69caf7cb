//! The sensor bus: who is on it, whether it has power and pull-ups, and a device that holds SDA low.

use super::lsm9ds1::Motion;
use super::time::ms;

/// From power to the first answer: the turn-on time of ST's sensors of this kind.
const BOOT: u64 = ms(35);

/// A motion sensor at the bus, with a clock of its own.
pub trait Sensor {
    /// Whether it answers at this address.
    fn has_address(&self, address: u8) -> bool;
    /// A write transfer: the first byte selects the register.
    fn write(&mut self, address: u8, bytes: &[u8], now: u64);
    /// A read transfer from the selected register.
    fn read(&mut self, address: u8, bytes: &mut [u8], now: u64);
    /// Loses its settings, as in a power dip.
    fn power_cycle(&mut self);
    /// The sensor is given to another hand.
    fn set_motion(&mut self, motion: Box<dyn Motion>);
    /// True period over nominal period of the sensor's own clock.
    fn set_clock_ratio(&mut self, ratio: f64);
    /// The next write to this register does not arrive.
    fn lose_write(&mut self, register: u8);
    /// Sets taken since power-up.
    fn sets(&self) -> u64;
    /// Breaks in a way that the sensor itself reports, if it can.
    fn fail(&mut self) {}
}

/// How a transfer ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply {
    /// All bytes were acknowledged.
    Ack,
    /// Nobody answers at the address.
    AddressNack,
    /// The line is stuck: the transfer never ends.
    Stuck,
}

/// The bus with its devices.
pub struct Bus {
    /// The sensor; other firmware-relevant devices are not on this board's bus.
    pub sensor: Box<dyn Sensor>,
    /// The sensor and the pull-ups are supplied.
    pub powered: bool,
    /// The next transfers are not acknowledged.
    pub nacks: u32,
    /// A device holds SDA low until it has seen this many clocks.
    pub stuck_clocks: u32,
    /// The sensor is unplugged.
    pub unplugged: bool,
    supplied: bool,
    /// The controller uses the sensor's pins.
    pub wired: bool,
    /// The sensors answer from this cycle on.
    awake_at: u64,
    /// Transfers so far.
    pub transfers: u64,
    scl_was_low: bool,
}

impl Bus {
    /// A bus with a sensor, without power.
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

    /// The sensor's supply and that of the pull-ups are on or off.
    pub fn supply(&mut self, sensors: bool, pull_ups: bool, now: u64) {
        if sensors && !self.supplied {
            self.awake_at = now + BOOT;
        }
        // Without its supply the sensor forgets.
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

    /// The controller writes.
    pub fn write(&mut self, address: u8, bytes: &[u8], now: u64) -> Reply {
        let reply = self.answers(address, now);
        if reply == Reply::Ack {
            self.sensor.write(address, bytes, now);
        }
        reply
    }

    /// The controller reads.
    pub fn read(&mut self, address: u8, bytes: &mut [u8], now: u64) -> Reply {
        let reply = self.answers(address, now);
        if reply == Reply::Ack {
            self.sensor.read(address, bytes, now);
        }
        reply
    }

    /// Levels of SDA and SCL as the pull-ups and devices leave them.
    pub fn levels(&self) -> (bool, bool) {
        (self.powered && self.stuck_clocks == 0, self.powered)
    }

    /// The processor drives SCL by hand.
    pub fn drive_scl(&mut self, low: bool) {
        if self.scl_was_low && !low {
            self.stuck_clocks = self.stuck_clocks.saturating_sub(1);
        }
        self.scl_was_low = low;
    }
}
