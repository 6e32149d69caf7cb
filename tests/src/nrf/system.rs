//! The small peripherals for the start of a program: clock, power, random numbers, watchdog.

use super::events::Events;
use super::time::{cycle_of_tick, ms, ticks, us};

const HFCLKSTARTED: u32 = 0;
const LFCLKSTARTED: u32 = 1;
const USBDETECTED: u32 = 7;
const USBREMOVED: u32 = 8;
const USBPWRRDY: u32 = 9;

/// CLOCK and POWER, which share a page and an interrupt.
#[derive(Clone, Debug, Default)]
pub struct ClockPower {
    /// Events of these peripherals.
    pub events: Events,
    hf_due: Option<u64>,
    lf_due: Option<u64>,
    usb_ready_due: Option<u64>,
    /// Whether the 32 MHz crystal runs.
    pub crystal: bool,
    lf_running: bool,
    lf_source: u32,
    /// RESETREAS: the causes of resets.
    pub reset_reasons: u32,
    /// GPREGRET and GPREGRET2, which survive only a soft reset.
    pub retained: [u32; 2],
    /// DCDCEN: whether the main regulator's converter is on.
    pub converter: bool,
    vbus: bool,
    usb_ready: bool,
    other: u32,
}

impl ClockPower {
    /// Connects or disconnects the USB cable.
    pub fn set_vbus(&mut self, on: bool, now: u64) {
        if on != self.vbus {
            self.vbus = on;
            self.usb_ready = false;
            self.usb_ready_due = on.then_some(now + ms(1));
            self.events.fire(if on { USBDETECTED } else { USBREMOVED });
        }
    }

    /// Raises all events that are due.
    pub fn advance(&mut self, now: u64) {
        if self.hf_due.is_some_and(|d| d <= now) {
            self.hf_due = None;
            self.crystal = true;
            self.events.fire(HFCLKSTARTED);
        }
        if self.lf_due.is_some_and(|d| d <= now) {
            self.lf_due = None;
            self.lf_running = true;
            self.events.fire(LFCLKSTARTED);
        }
        if self.usb_ready_due.is_some_and(|d| d <= now) {
            self.usb_ready_due = None;
            self.usb_ready = true;
            self.events.fire(USBPWRRDY);
        }
    }

    /// Returns the cycle of the next event.
    pub fn due(&self) -> Option<u64> {
        [self.hf_due, self.lf_due, self.usb_ready_due].into_iter().flatten().min()
    }

    /// Resets the peripheral without a power-up.
    pub fn reset(&mut self, reason: u32) {
        const SOFT: u32 = 1 << 2;
        *self = Self {
            reset_reasons: self.reset_reasons | reason,
            retained: if reason == SOFT { self.retained } else { [0; 2] },
            vbus: self.vbus,
            usb_ready: self.usb_ready,
            usb_ready_due: self.usb_ready_due,
            ..Self::default()
        };
        if self.vbus {
            self.events.fire(USBDETECTED);
            self.events.fire(USBPWRRDY);
        }
    }

    /// Reads a register.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            0x400 => self.reset_reasons,
            0x408 | 0x414 => 1,
            0x40C => u32::from(self.crystal) | (1 << 16),
            0x418 => self.lf_source | (u32::from(self.lf_running) << 16),
            0x438 => u32::from(self.vbus) | (u32::from(self.usb_ready) << 1),
            0x518 => self.lf_source,
            0x51C => self.retained[0],
            0x520 => self.retained[1],
            0x558 => self.other,
            0x578 => u32::from(self.converter),
            _ => self.events.read(offset).unwrap_or(0),
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, now: u64) {
        match offset {
            0x000 if value & 1 != 0 => self.hf_due = Some(now + us(360)),
            0x004 if value & 1 != 0 => self.crystal = false,
            // A real crystal needs a quarter of a second, but this does not matter here.
            0x008 if value & 1 != 0 => self.lf_due = Some(now + ms(1)),
            0x00C if value & 1 != 0 => self.lf_running = false,
            0x400 => self.reset_reasons &= !value,
            0x518 => self.lf_source = value & 3,
            0x51C => self.retained[0] = value & 0xFF,
            0x520 => self.retained[1] = value & 0xFF,
            0x558 => self.other = value,
            0x578 => self.converter = value & 1 != 0,
            _ => {
                self.events.write(offset, value);
            }
        }
    }
}

/// RNG: generates pseudo-random numbers from the test's seed.
#[derive(Clone, Debug, Default)]
pub struct Rng {
    /// Events of this peripheral.
    pub events: Events,
    state: u64,
    running: bool,
    due: u64,
    value: u32,
}

impl Rng {
    /// Creates a generator with this seed.
    pub fn new(seed: u64) -> Self {
        Self { state: seed, ..Self::default() }
    }

    /// Raises all events that are due.
    pub fn advance(&mut self, now: u64) {
        if self.running && self.due <= now {
            self.state =
                self.state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            self.value = (self.state >> 56) as u32;
            self.due = now + us(120);
            self.events.fire(0);
        }
    }

    /// Returns the cycle of the next value.
    pub fn due(&self) -> Option<u64> {
        self.running.then_some(self.due)
    }

    /// Reads a register.
    pub fn read(&self, offset: u32) -> u32 {
        if offset == 0x508 { self.value } else { self.events.read(offset).unwrap_or(0) }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, now: u64) {
        match offset {
            0x000 if value & 1 != 0 => {
                self.running = true;
                self.due = now + us(120);
            }
            0x004 if value & 1 != 0 => self.running = false,
            _ => {
                self.events.write(offset, value);
            }
        }
    }
}

/// WDT: resets the chip unless all enabled reload registers were written in time.
#[derive(Clone, Debug, Default)]
pub struct Watchdog {
    /// Events of this peripheral.
    pub events: Events,
    running: bool,
    reload: u32,
    channels: u32,
    pending: u32,
    config: u32,
    fed_tick: u64,
}

impl Watchdog {
    /// Returns whether the watchdog's time has expired.
    pub fn bites(&self, now: u64) -> bool {
        self.due().is_some_and(|d| d <= now)
    }

    /// Returns the cycle at which the watchdog resets the chip.
    pub fn due(&self) -> Option<u64> {
        self.running.then(|| cycle_of_tick(self.fed_tick + u64::from(self.reload) + 1))
    }

    /// Reads a register.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            0x400 => u32::from(self.running),
            0x404 => self.pending,
            0x504 => self.reload,
            0x508 => self.channels,
            0x50C => self.config,
            _ => self.events.read(offset).unwrap_or(0),
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, now: u64) {
        match offset {
            0x000 if value & 1 != 0 && !self.running => {
                self.running = true;
                self.pending = self.channels;
                self.fed_tick = ticks(now);
            }
            0x504 if !self.running => self.reload = value,
            0x508 if !self.running => self.channels = value & 0xFF,
            0x50C if !self.running => self.config = value,
            0x600..=0x61C if value == 0x6E52_4635 => {
                self.pending &= !(1 << ((offset - 0x600) / 4));
                if self.running && self.pending == 0 {
                    self.pending = self.channels;
                    self.fed_tick = ticks(now);
                }
            }
            _ => {
                self.events.write(offset, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nrf::time::HZ;

    #[test]
    fn clocks_start_after_a_while_and_usb_power_follows_the_cable() {
        let mut power = ClockPower::default();
        power.write(0x000, 1, 0);
        power.advance(us(359));
        assert_eq!(power.read(0x100), 0);
        power.advance(us(360));
        assert_eq!(power.read(0x100), 1);
        power.set_vbus(true, 0);
        assert_eq!(power.read(0x438), 1);
        power.advance(ms(1));
        assert_eq!(power.read(0x438), 3);
        power.write(0x51C, 0xB0, 0);
        power.reset(4);
        assert_eq!((power.read(0x51C), power.read(0x400)), (0xB0, 4));
        // A watchdog reset clears registers that a soft reset preserves.
        power.reset(2);
        assert_eq!((power.read(0x51C), power.read(0x400)), (0, 6));
    }

    #[test]
    fn the_watchdog_bites_unless_fed_with_the_right_word() {
        let mut dog = Watchdog::default();
        dog.write(0x504, 32_767, 0);
        dog.write(0x508, 1, 0);
        dog.write(0x000, 1, 0);
        assert!(!dog.bites(HZ - 1) && dog.bites(HZ));
        dog.write(0x600, 1, HZ / 2);
        assert!(dog.bites(HZ));
        dog.write(0x600, 0x6E52_4635, HZ / 2);
        assert!(!dog.bites(HZ) && dog.bites(HZ + HZ / 2));
    }

    #[test]
    fn random_values_come_one_by_one_and_differ() {
        let mut rng = Rng::default();
        rng.write(0x000, 1, 0);
        let mut values = Vec::new();
        for i in 1..=4 {
            rng.advance(us(120 * i));
            assert_eq!(rng.read(0x100), 1);
            rng.write(0x100, 0, 0);
            values.push(rng.read(0x508));
        }
        values.dedup();
        assert!(values.len() > 1);
    }
}
