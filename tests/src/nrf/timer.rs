//! A TIMER that counts task triggers (the only use in the image), or 16 MHz ticks, which are read by capture.

use super::events::Events;

const COMPARE: u32 = 16;

/// One of TIMER0 to TIMER4.
#[derive(Clone, Debug, Default)]
pub struct Timer {
    /// Events of this peripheral.
    pub events: Events,
    mode: u32,
    bitmode: u32,
    prescaler: u32,
    cc: [u32; 6],
    count: u32,
    running: bool,
    started: u64,
}

impl Timer {
    fn mask(&self) -> u32 {
        match self.bitmode {
            0 => 0xFFFF,
            1 => 0xFF,
            2 => 0xFF_FFFF,
            _ => u32::MAX,
        }
    }

    fn value(&self, now: u64) -> u32 {
        let since =
            if self.mode == 0 && self.running { ((now - self.started) / 4) >> self.prescaler } else { 0 };
        self.count.wrapping_add(since as u32) & self.mask()
    }

    /// Reads a register.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            0x504 => self.mode,
            0x508 => self.bitmode,
            0x510 => self.prescaler,
            0x540..=0x554 => self.cc[(offset as usize - 0x540) / 4],
            _ => self.events.read(offset).unwrap_or(0),
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, now: u64) {
        match offset {
            0x000 if value & 1 != 0 => {
                self.started = now;
                self.running = true;
            }
            0x004 | 0x010 if value & 1 != 0 => {
                self.count = self.value(now);
                self.running = false;
            }
            0x008 if value & 1 != 0 && self.mode != 0 && self.running => {
                self.count = self.count.wrapping_add(1) & self.mask();
                for index in 0..6 {
                    if self.cc[index] == self.count {
                        self.events.fire(COMPARE + index as u32);
                        if self.events.shorts & (1 << index) != 0 {
                            self.count = 0;
                        }
                    }
                }
            }
            0x00C if value & 1 != 0 => {
                self.count = 0;
                self.started = now;
            }
            0x040..=0x054 if value & 1 != 0 => self.cc[(offset as usize - 0x40) / 4] = self.value(now),
            0x504 => self.mode = value,
            0x508 => self.bitmode = value,
            0x510 => self.prescaler = value & 0xF,
            0x540..=0x554 => self.cc[(offset as usize - 0x540) / 4] = value,
            _ => {
                self.events.write(offset, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn in_counter_mode_it_counts_triggers_and_captures_them() {
        let mut timer = Timer::default();
        timer.write(0x504, 1, 0);
        timer.write(0x508, 3, 0);
        timer.write(0x000, 1, 0);
        timer.write(0x544, 2, 0);
        for _ in 0..3 {
            timer.write(0x008, 1, 0);
        }
        timer.write(0x040, 1, 0);
        assert_eq!(timer.read(0x540), 3);
        assert!(timer.events.stands(17) && !timer.events.stands(16));
    }

    #[test]
    fn in_timer_mode_a_capture_reads_16_mhz_ticks() {
        let mut timer = Timer::default();
        timer.write(0x508, 3, 0);
        timer.write(0x510, 4, 0);
        timer.write(0x000, 1, 0);
        timer.write(0x040, 1, 64_000);
        assert_eq!(timer.read(0x540), 1000);
    }
}
