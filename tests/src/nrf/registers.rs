//! The common parts of the emulated sensors with a single address: 128 byte registers, one of which is selected.
//! A [`Motion`] moves the sensors, and each has its own clock.

use super::i2c::Sensor;
use super::lsm9ds1::Motion;

/// The registers and the motion of a chip.
pub struct Registers {
    /// The hand.
    pub motion: Box<dyn Motion>,
    /// Ratio of true to nominal period of the chip's own clock.
    pub clock_ratio: f64,
    /// No samples are taken before this cycle.
    pub busy_until: u64,
    /// Number of samples taken since power-up.
    pub sets: u64,
    bytes: [u8; 128],
    selected: u8,
    loses_write: Option<u8>,
}

impl Registers {
    /// Registers of zeros.
    pub fn new(motion: Box<dyn Motion>) -> Self {
        Self {
            motion,
            clock_ratio: 1.0,
            busy_until: 0,
            sets: 0,
            bytes: [0; 128],
            selected: 0,
            loses_write: None,
        }
    }

    /// Zeros but for these.
    pub fn reset(&mut self, values: &[(u8, u8)]) {
        self.bytes = [0; 128];
        for &(register, value) in values {
            self.set(register, value);
        }
    }

    /// The value of a register.
    pub fn get(&self, register: u8) -> u8 {
        self.bytes[usize::from(register & 0x7F)]
    }

    /// Puts it there.
    pub fn set(&mut self, register: u8, value: u8) {
        self.bytes[usize::from(register & 0x7F)] = value;
    }
}

/// The behaviour of a specific chip.
pub trait Chip {
    /// Its bus address.
    const ADDRESS: u8;

    /// Its registers.
    fn registers(&self) -> &Registers;
    /// Its registers.
    fn registers_mut(&mut self) -> &mut Registers;
    /// As after power-up.
    fn reset(&mut self);
    /// Performs all actions that are due.
    fn advance(&mut self, now: u64);
    /// A register is written.
    fn written(&mut self, register: u8, value: u8, now: u64);
    /// A register is read.
    fn read(&mut self, register: u8) -> u8 {
        self.registers().get(register)
    }
    /// Returns the next register in a transfer.
    fn next(&self, register: u8) -> u8 {
        (register + 1) & 0x7F
    }
    /// Reports the end of a read transfer.
    fn read_ended(&mut self) {}
    /// Fails in a way that the sensor itself reports, if it can.
    fn break_down(&mut self) {}
}

impl<C: Chip> Sensor for C {
    fn has_address(&self, address: u8) -> bool {
        address == C::ADDRESS
    }

    fn write(&mut self, _: u8, bytes: &[u8], now: u64) {
        self.advance(now);
        let Some((&register, data)) = bytes.split_first() else { return };
        self.registers_mut().selected = register & 0x7F;
        for &value in data {
            let registers = self.registers_mut();
            let register = registers.selected;
            let lost = registers.loses_write.take_if(|lost| *lost == register).is_some();
            if !lost && now >= registers.busy_until {
                self.written(register, value, now);
            }
            self.registers_mut().selected = self.next(register);
        }
    }

    fn read(&mut self, _: u8, bytes: &mut [u8], now: u64) {
        self.advance(now);
        for byte in bytes {
            let register = self.registers().selected;
            *byte = Chip::read(self, register);
            self.registers_mut().selected = self.next(register);
        }
        self.read_ended();
    }

    fn power_cycle(&mut self) {
        self.reset();
    }

    fn set_motion(&mut self, motion: Box<dyn Motion>) {
        self.registers_mut().motion = motion;
    }

    fn set_clock_ratio(&mut self, ratio: f64) {
        self.registers_mut().clock_ratio = ratio;
    }

    fn lose_write(&mut self, register: u8) {
        self.registers_mut().loses_write = Some(register);
    }

    fn sets(&self) -> u64 {
        self.registers().sets
    }

    fn fail(&mut self) {
        self.break_down();
    }
}

/// The laptop's end of a chip in its own tests.
#[cfg(test)]
pub mod tests {
    use super::*;

    /// Reads from a register on.
    pub fn get<const N: usize>(chip: &mut impl Chip, register: u8, now: u64) -> [u8; N] {
        Sensor::write(chip, 0, &[register], now);
        let mut bytes = [0; N];
        Sensor::read(chip, 0, &mut bytes, now);
        bytes
    }

    /// Writes registers one by one.
    pub fn set(chip: &mut impl Chip, values: &[(u8, u8)], now: u64) {
        for &(register, value) in values {
            Sensor::write(chip, 0, &[register, value], now);
        }
    }
}
