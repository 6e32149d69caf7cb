//! TWIM: I2C controller with EasyDMA. Transfers take the time of their bits.

use super::events::Events;
use super::i2c::{Bus, Reply};
use super::memory::Ram;
use super::time::HZ;

const STOPPED: u32 = 1;
const ERROR: u32 = 9;
const SUSPENDED: u32 = 18;
const RXSTARTED: u32 = 19;
const TXSTARTED: u32 = 20;
const LASTRX: u32 = 23;
const LASTTX: u32 = 24;

const LASTTX_STARTRX: u32 = 1 << 7;
const LASTTX_SUSPEND: u32 = 1 << 8;
const LASTTX_STOP: u32 = 1 << 9;
const LASTRX_STARTTX: u32 = 1 << 10;
const LASTRX_STOP: u32 = 1 << 12;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Doing {
    Nothing,
    Sending,
    Receiving,
    Stopping,
    /// Waits for a free line without a time limit.
    Stuck,
}

/// One of TWIM0 and TWIM1.
#[derive(Clone, Debug)]
pub struct Twim {
    /// Events of this peripheral.
    pub events: Events,
    enable: u32,
    error: u32,
    frequency: u32,
    address: u32,
    /// Number of transfers at 400 kHz. At this rate, the low period is shorter than I2C allows (erratum 219).
    pub too_fast: u64,
    rx: [u32; 4],
    tx: [u32; 4],
    pins: [u32; 2],
    doing: Doing,
    suspended: bool,
    due: u64,
}

impl Default for Twim {
    fn default() -> Self {
        Self {
            events: Events::default(),
            enable: 0,
            error: 0,
            frequency: 0x0400_0000,
            address: 0,
            too_fast: 0,
            rx: [0; 4],
            tx: [0; 4],
            pins: [u32::MAX; 2],
            doing: Doing::Nothing,
            suspended: false,
            due: 0,
        }
    }
}

impl Twim {
    fn cycles(&self, bytes: u32) -> u64 {
        let hz = match self.frequency {
            0x0198_0000 => 100_000,
            0x0400_0000 => 250_000,
            0x0620_0000 => 390_000,
            _ => 400_000,
        };
        // The address and each byte take eight bits and an acknowledge; a start or stop takes one bit.
        u64::from((bytes + 1) * 9 + 1) * HZ / hz
    }

    fn begin(&mut self, doing: Doing, now: u64) {
        self.too_fast += u64::from(self.frequency == 0x0640_0000);
        self.doing = doing;
        let bytes = match doing {
            Doing::Sending => {
                self.events.fire(TXSTARTED);
                self.tx[1]
            }
            Doing::Receiving => {
                self.events.fire(RXSTARTED);
                self.rx[1]
            }
            _ => 0,
        };
        self.due = now + if doing == Doing::Stopping { HZ / 400_000 } else { self.cycles(bytes) };
    }

    /// Raises all events that are due.
    pub fn advance(&mut self, now: u64, ram: &mut Ram, bus: &mut Bus) {
        while matches!(self.doing, Doing::Sending | Doing::Receiving | Doing::Stopping) && self.due <= now {
            let at = self.due;
            let address = self.address as u8;
            match self.doing {
                Doing::Sending => {
                    let bytes =
                        ram.get(self.tx[0], self.tx[1] as usize).map(<[u8]>::to_vec).unwrap_or_default();
                    let reply = bus.write(address, &bytes, at);
                    self.tx[2] = bytes.len() as u32;
                    self.finish(reply, at, LASTTX);
                }
                Doing::Receiving => {
                    let mut bytes = vec![0; self.rx[1] as usize];
                    let reply = bus.read(address, &mut bytes, at);
                    if reply == Reply::Ack {
                        ram.put(self.rx[0], &bytes);
                        self.rx[2] = self.rx[1];
                    }
                    self.finish(reply, at, LASTRX);
                }
                _ => {
                    self.doing = Doing::Nothing;
                    self.events.fire(STOPPED);
                }
            }
        }
    }

    fn finish(&mut self, reply: Reply, now: u64, last: u32) {
        match reply {
            Reply::Ack => {}
            Reply::AddressNack => {
                self.error |= 1 << 1;
                self.doing = Doing::Nothing;
                self.events.fire(ERROR);
                return;
            }
            Reply::Stuck => {
                self.doing = Doing::Stuck;
                return;
            }
        }
        self.doing = Doing::Nothing;
        self.events.fire(last);
        let shorts = self.events.shorts;
        if last == LASTTX {
            if shorts & LASTTX_STARTRX != 0 {
                self.begin(Doing::Receiving, now);
            } else if shorts & LASTTX_STOP != 0 {
                self.begin(Doing::Stopping, now);
            } else if shorts & LASTTX_SUSPEND != 0 {
                self.suspended = true;
                self.events.fire(SUSPENDED);
            }
        } else if shorts & LASTRX_STOP != 0 {
            self.begin(Doing::Stopping, now);
        } else if shorts & LASTRX_STARTTX != 0 {
            self.begin(Doing::Sending, now);
        }
    }

    /// Returns the cycle of the next event.
    pub fn due(&self) -> Option<u64> {
        (!matches!(self.doing, Doing::Nothing | Doing::Stuck)).then_some(self.due)
    }

    /// Reads a register.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            0x4C4 => self.error,
            0x500 => self.enable,
            0x508 | 0x50C => self.pins[(offset as usize - 0x508) / 4],
            0x524 => self.frequency,
            0x534..=0x540 => self.rx[(offset as usize - 0x534) / 4],
            0x544..=0x550 => self.tx[(offset as usize - 0x544) / 4],
            0x588 => self.address,
            _ => self.events.read(offset).unwrap_or(0),
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, now: u64) {
        let enabled = self.enable == 6;
        match offset {
            0x000 if value & 1 != 0 && enabled => self.begin(Doing::Receiving, now),
            0x008 if value & 1 != 0 && enabled => self.begin(Doing::Sending, now),
            0x014 if value & 1 != 0 && enabled => {
                // A stop condition also needs a free line.
                if self.doing != Doing::Stuck {
                    self.begin(Doing::Stopping, now);
                }
            }
            0x01C if value & 1 != 0 && enabled => {
                self.suspended = true;
                self.events.fire(SUSPENDED);
            }
            0x020 => self.suspended = false,
            0x4C4 => self.error &= !value,
            0x500 => {
                self.enable = value & 0xF;
                if self.enable != 6 {
                    self.doing = Doing::Nothing;
                }
            }
            0x508 | 0x50C => self.pins[(offset as usize - 0x508) / 4] = value,
            0x524 => self.frequency = value,
            0x534..=0x540 => self.rx[(offset as usize - 0x534) / 4] = value,
            0x544..=0x550 => self.tx[(offset as usize - 0x544) / 4] = value,
            0x588 => self.address = value,
            _ => {
                self.events.write(offset, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nrf::lsm9ds1::{Lsm9ds1, Still};
    use crate::nrf::memory::RAM_START;
    use crate::nrf::time::us;

    fn set_up() -> (Twim, Ram, Bus) {
        let mut bus = Bus::new(Box::new(Lsm9ds1::new(Box::new(Still))));
        bus.powered = true;
        let mut twim = Twim::default();
        twim.write(0x500, 6, 0);
        twim.write(0x524, 0x0640_0000, 0);
        twim.write(0x588, 0x6B, 0);
        (twim, Ram::default(), bus)
    }

    #[test]
    fn a_write_then_read_goes_through_dma_and_takes_the_time_of_its_bits() {
        let (mut twim, mut ram, mut bus) = set_up();
        ram.put(RAM_START, &[0x0F]);
        for (offset, value) in [(0x544, RAM_START), (0x548, 1), (0x534, RAM_START + 4), (0x538, 1)] {
            twim.write(offset, value, 0);
        }
        twim.write(0x200, LASTTX_STARTRX | LASTRX_STOP, 0);
        twim.write(0x304, 1 << STOPPED, 0);
        twim.write(0x008, 1, 0);
        twim.advance(us(90), &mut ram, &mut bus);
        assert!(!twim.events.irq());
        // The transfer takes two times 19 bits at 400 kHz, and a stop.
        twim.advance(us(98), &mut ram, &mut bus);
        assert!(twim.events.irq());
        assert_eq!(ram.get(RAM_START + 4, 1), Some(&[0x68][..]));
    }

    #[test]
    fn a_missing_device_is_an_error_and_a_stuck_line_never_ends() {
        let (mut twim, mut ram, mut bus) = set_up();
        bus.unplugged = true;
        twim.write(0x544, RAM_START, 0);
        twim.write(0x548, 1, 0);
        twim.write(0x008, 1, 0);
        twim.advance(us(100), &mut ram, &mut bus);
        assert!(twim.events.stands(ERROR));
        assert_eq!(twim.read(0x4C4), 2);
        bus.stuck_clocks = 3;
        twim.write(0x008, 1, us(100));
        twim.advance(us(1_000_000), &mut ram, &mut bus);
        assert_eq!(twim.due(), None);
        for low in [true, false, true, false, true, false] {
            bus.drive_scl(low);
        }
        assert_eq!(bus.levels(), (true, true));
    }
}
