//! The common parts of all emulated sensors with one bus address.
//! Each sensor has 128 registers of one byte, and each transfer selects one register.
//! A [`Motion`] moves each sensor, and each sensor has its own clock.

use super::i2c::Sensor;
use super::lsm9ds1::Motion;

/// The registers and the motion of a chip.
pub struct Registers {
    /// The motion of the hand.
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
    /// Starts with registers that are all zero.
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

    /// Starts with registers that are zero except for these.
    pub fn reset(&mut self, values: &[(u8, u8)]) {
        self.bytes = [0; 128];
        for &(register, value) in values {
            self.set(register, value);
        }
    }

    /// Returns the value of a register.
    pub fn get(&self, register: u8) -> u8 {
        self.bytes[usize::from(register & 0x7F)]
    }

    /// Sets the value of a register.
    pub fn set(&mut self, register: u8, value: u8) {
        self.bytes[usize::from(register & 0x7F)] = value;
    }
}

/// The behaviour of a specific chip.
pub trait Chip {
    /// The bus address of the chip.
    const ADDRESS: u8;

    /// Returns the chip's registers.
    fn registers(&self) -> &Registers;
    /// Returns the chip's registers, mutably.
    fn registers_mut(&mut self) -> &mut Registers;
    /// Returns the chip to its state after power-up.
    fn reset(&mut self);
    /// Performs all actions that are due.
    fn advance(&mut self, now: u64);
    /// Processes a write to a register.
    fn written(&mut self, register: u8, value: u8, now: u64);
    /// Processes a read of a register.
    fn read(&mut self, register: u8) -> u8 {
        self.registers().get(register)
    }
    /// Returns the next register in a transfer.
    fn next(&self, register: u8) -> u8 {
        (register + 1) & 0x7F
    }
    /// Informs the chip about the end of a read transfer.
    fn read_ended(&mut self) {}
    /// Makes the chip fail in a way that it reports itself, if it can.
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

/// The bus master in a chip's own tests.
#[cfg(test)]
pub mod tests {
    use super::*;

    /// Reads consecutive registers, starting at a given register.
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
