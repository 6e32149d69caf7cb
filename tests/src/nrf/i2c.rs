//! The sensor bus: who is on it, whether it has power and pull-ups, and a device that holds SDA low.

use super::lsm9ds1::Lsm9ds1;

/// How a transfer ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply {
    /// All bytes were acknowledged.
    Ack,
    /// Nobody answers at the address.
    AddressNack,
    /// The line does not move: the transfer never ends.
    Stuck,
}

/// The bus with its devices.
pub struct Bus {
    /// The sensor; other firmware-relevant devices are not on this board's bus.
    pub sensor: Lsm9ds1,
    /// P0.22 and P1.00 are high.
    pub powered: bool,
    /// The next transfers are not acknowledged.
    pub nacks: u32,
    /// A device holds SDA low until it has seen so many clocks.
    pub stuck_clocks: u32,
    /// The sensor is unplugged.
    pub unplugged: bool,
    /// The sensors of a Rev2 board are there instead.
    pub rev2: bool,
    /// Transfers so far.
    pub transfers: u64,
    scl_was_low: bool,
}

impl Bus {
    /// A bus with a sensor, without power.
    pub fn new(sensor: Lsm9ds1) -> Self {
        Self {
            sensor,
            powered: false,
            nacks: 0,
            stuck_clocks: 0,
            unplugged: false,
            rev2: false,
            transfers: 0,
            scl_was_low: false,
        }
    }

    fn answers(&mut self, address: u8) -> Reply {
        self.transfers += 1;
        if self.stuck_clocks > 0 {
            return Reply::Stuck;
        }
        if self.nacks > 0 {
            self.nacks -= 1;
            return Reply::AddressNack;
        }
        let there =
            if self.rev2 { address == 0x68 || address == 0x10 } else { Lsm9ds1::has_address(address) };
        if self.powered && !self.unplugged && there { Reply::Ack } else { Reply::AddressNack }
    }

    /// The controller writes.
    pub fn write(&mut self, address: u8, bytes: &[u8], now: u64) -> Reply {
        let reply = self.answers(address);
        if reply == Reply::Ack && !self.rev2 {
            self.sensor.write(address, bytes, now);
        }
        reply
    }

    /// The controller reads.
    pub fn read(&mut self, address: u8, bytes: &mut [u8], now: u64) -> Reply {
        let reply = self.answers(address);
        if reply == Reply::Ack {
            if self.rev2 {
                bytes.fill(if address == 0x68 { 0x24 } else { 0x32 });
            } else {
                self.sensor.read(address, bytes, now);
            }
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
