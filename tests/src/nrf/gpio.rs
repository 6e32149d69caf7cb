//! GPIO ports P0 and P1.

/// One GPIO port.
#[derive(Clone, Debug, Default)]
pub struct Port {
    out: u32,
    dir: u32,
    config: [u32; 32],
    /// External levels, which apply to pins that are not outputs.
    pub outside: u32,
}

impl Port {
    /// The level that the pin drives, if any. Open drain ("standard 0, disconnect 1") drives only low.
    pub fn drives(&self, pin: u32) -> Option<bool> {
        if self.dir & (1 << pin) == 0 {
            return None;
        }
        let high = self.out & (1 << pin) != 0;
        let drive = (self.config[pin as usize] >> 8) & 7;
        // Modes 6 and 7 disconnect the pin at level 1; modes 4 and 5 disconnect it at level 0.
        match (drive, high) {
            (6 | 7, true) | (4 | 5, false) => None,
            _ => Some(high),
        }
    }

    /// Returns whether the pin drives high with full strength ("high 0, high 1").
    pub fn drives_strongly(&self, pin: u32) -> bool {
        self.drives(pin) == Some(true) && (self.config[pin as usize] >> 8) & 7 == 3
    }

    /// Returns whether the pin's pull-up resistor is on.
    pub fn pulls_up(&self, pin: u32) -> bool {
        (self.config[pin as usize] >> 2) & 3 == 3
    }

    fn level(&self) -> u32 {
        (0..32).fold(0, |levels, pin| {
            let high = self.drives(pin).unwrap_or(self.outside & (1 << pin) != 0);
            levels | (u32::from(high) << pin)
        })
    }

    /// Reads a register (offset from 0x5000_0000 for P0, 0x5000_0300 for P1).
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            0x504 | 0x508 | 0x50C => self.out,
            0x510 => self.level(),
            0x514 | 0x518 | 0x51C => self.dir,
            0x700..=0x77C => self.config[(offset as usize - 0x700) / 4],
            _ => 0,
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32) {
        match offset {
            0x504 => self.out = value,
            0x508 => self.out |= value,
            0x50C => self.out &= !value,
            0x514 => self.dir = value,
            0x518 => self.dir |= value,
            0x51C => self.dir &= !value,
            0x700..=0x77C => {
                let pin = (offset as usize - 0x700) / 4;
                self.config[pin] = value;
                self.dir = (self.dir & !(1 << pin)) | ((value & 1) << pin);
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_open_drain_output_drives_low_and_lets_the_line_float_high() {
        let mut port = Port { outside: 1 << 14, ..Port::default() };
        port.write(0x508, 1 << 14);
        // The pin is an output with connected input, in the mode "standard 0, disconnect 1".
        port.write(0x700 + 14 * 4, 1 | (6 << 8));
        assert_eq!(port.drives(14), None);
        assert_ne!(port.read(0x510) & (1 << 14), 0);
        port.outside = 0;
        assert_eq!(port.read(0x510) & (1 << 14), 0);
        port.write(0x50C, 1 << 14);
        assert_eq!(port.drives(14), Some(false));
    }

    #[test]
    fn direction_can_be_set_by_bit_and_by_pin() {
        let mut port = Port::default();
        port.write(0x518, 1 << 3);
        assert_eq!(port.drives(3), Some(false));
        port.write(0x70C, 0);
        assert_eq!(port.drives(3), None);
    }
}
