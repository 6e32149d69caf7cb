//! RTC: a 24-bit counter of the 32,768 Hz clock with four compare registers.

use super::events::Events;
use super::time::{cycle_of_tick, ticks};

const OVERFLOW: u32 = 1;
const COMPARE: u32 = 16;

/// One of RTC0, RTC1 and RTC2.
#[derive(Clone, Debug, Default)]
pub struct Rtc {
    /// Events of this peripheral.
    pub events: Events,
    prescaler: u64,
    cc: [u32; 4],
    running: bool,
    /// Tick of the 32,768 Hz clock at which the counter was 0. Overflows of the counter do not change it.
    zero_tick: u64,
    stopped_at: u64,
    /// Counter values up to this value have already been compared.
    compared: u64,
}

impl Rtc {
    fn count(&self, now: u64) -> u64 {
        if self.running { (ticks(now) - self.zero_tick) / (self.prescaler + 1) } else { self.stopped_at }
    }

    /// Returns the tick of the 32,768 Hz clock at which the counter was 0.
    pub fn zero_tick(&self) -> u64 {
        self.zero_tick
    }

    /// Returns the register COUNTER.
    pub fn counter(&self, now: u64) -> u32 {
        (self.count(now) & 0xFF_FFFF) as u32
    }

    fn compares(&self, index: usize) -> bool {
        self.events.is_enabled(COMPARE + index as u32)
    }

    /// Raises all events that are due.
    pub fn advance(&mut self, now: u64) {
        let count = self.count(now);
        if count <= self.compared {
            return;
        }
        for (index, &cc) in self.cc.iter().enumerate() {
            let distance = u64::from(cc).wrapping_sub(self.compared + 1) & 0xFF_FFFF;
            if self.compared + 1 + distance <= count {
                self.events.fire(COMPARE + index as u32);
            }
        }
        if count >> 24 != self.compared >> 24 {
            self.events.fire(OVERFLOW);
        }
        self.compared = count;
    }

    /// Returns the cycle of the next event that can interrupt.
    pub fn due(&self) -> Option<u64> {
        if !self.running {
            return None;
        }
        let next = self.compared + 1;
        let compare = (0..4)
            .filter(|&i| self.compares(i))
            .map(|i| next + (u64::from(self.cc[i]).wrapping_sub(next) & 0xFF_FFFF));
        let overflow = self.events.is_enabled(OVERFLOW).then_some(((next >> 24) + 1) << 24);
        let count = compare.chain(overflow).min()?;
        Some(cycle_of_tick(self.zero_tick + count * (self.prescaler + 1)))
    }

    /// Reads a register.
    pub fn read(&self, offset: u32, now: u64) -> u32 {
        match offset {
            0x504 => self.counter(now),
            0x508 => self.prescaler as u32,
            0x540..=0x54C => self.cc[(offset as usize - 0x540) / 4],
            _ => self.events.read(offset).unwrap_or(0),
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, now: u64) {
        self.advance(now);
        match offset {
            0x000 if value & 1 != 0 && !self.running => {
                self.zero_tick = ticks(now) - self.stopped_at * (self.prescaler + 1);
                self.running = true;
            }
            0x004 if value & 1 != 0 => {
                self.stopped_at = self.count(now);
                self.running = false;
            }
            0x008 if value & 1 != 0 => {
                self.zero_tick = ticks(now);
                self.stopped_at = 0;
                self.compared = 0;
            }
            0x508 => self.prescaler = u64::from(value & 0xFFF),
            0x540..=0x54C => self.cc[(offset as usize - 0x540) / 4] = value & 0xFF_FFFF,
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
    fn a_compare_comes_at_its_tick_and_the_interrupt_is_due_there() {
        let mut rtc = Rtc::default();
        rtc.write(0x000, 1, 0);
        rtc.write(0x544, 32_768, 0);
        assert_eq!(rtc.due(), None);
        rtc.write(0x304, 1 << 17, 0);
        assert_eq!(rtc.due(), Some(HZ));
        rtc.advance(HZ - 1);
        assert!(!rtc.events.irq());
        rtc.advance(HZ);
        assert!(rtc.events.irq());
        assert_eq!(rtc.read(0x504, HZ), 32_768);
    }

    #[test]
    fn a_compare_value_that_is_now_waits_a_whole_turn() {
        let mut rtc = Rtc::default();
        rtc.write(0x000, 1, 0);
        rtc.write(0x304, 1 << 16, 0);
        let now = cycle_of_tick(100);
        rtc.write(0x540, 100, now);
        assert_eq!(rtc.due(), Some(cycle_of_tick(100 + (1 << 24))));
    }

    #[test]
    fn the_counter_wraps_after_24_bits_and_says_so() {
        let mut rtc = Rtc::default();
        rtc.write(0x304, 1 << 1, 0);
        rtc.write(0x000, 1, 0);
        let turn = cycle_of_tick(1 << 24);
        assert_eq!(rtc.due(), Some(turn));
        rtc.advance(turn);
        assert!(rtc.events.stands(1));
        assert_eq!(rtc.counter(turn), 0);
    }
}
