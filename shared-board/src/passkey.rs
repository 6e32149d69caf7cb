//! Shows a passkey with a light of three colours, for owners without a cable.
//!
//! The digits follow one another from left to right, and then begin again.
//! A digit is the sum of its flashes: red counts 5, green counts 1, and a single blue flash is 0.
//! A laptop waits 30 s for a passkey. Nine equal flashes per digit would take longer.

/// Digits of a passkey.
const DIGITS: u8 = 6;
/// Number of dark steps after a digit, and after the last digit.
const DARK: u8 = 2;
const LONG_DARK: u8 = 6;

/// The colour of one flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flash {
    /// Blue: the digit is 0.
    Zero,
    /// Green: counts 1.
    One,
    /// Red: counts 5.
    Five,
}

/// The next step of the light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PasskeyLight {
    passkey: u32,
    place: u8,
    step: u8,
}

impl PasskeyLight {
    /// Returns the colour of the next step, or `None` if it is dark. All steps take equally long.
    /// Another passkey starts from its first digit.
    pub fn next(&mut self, passkey: u32) -> Option<Flash> {
        if passkey != self.passkey {
            *self = Self { passkey, ..Self::default() };
        }
        let below = 10_u32.pow((DIGITS - 1 - self.place).into());
        let digit = (passkey / below % 10) as u8;
        let (fives, ones) = (digit / 5, digit % 5);
        let flashes = (fives + ones).max(1);
        let flash = match self.step {
            step if step >= flashes => None,
            _ if digit == 0 => Some(Flash::Zero),
            step if step < fives => Some(Flash::Five),
            _ => Some(Flash::One),
        };
        let is_last = self.place + 1 == DIGITS;
        self.step += 1;
        if self.step == flashes + if is_last { LONG_DARK } else { DARK } {
            self.step = 0;
            self.place = if is_last { 0 } else { self.place + 1 };
        }
        flash
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::String;

    fn shown(light: &mut PasskeyLight, passkey: u32, steps: usize) -> String {
        let letter = |flash| match flash {
            None => '.',
            Some(Flash::Zero) => 'b',
            Some(Flash::One) => 'g',
            Some(Flash::Five) => 'r',
        };
        (0..steps).map(|_| letter(light.next(passkey))).collect()
    }

    #[test]
    fn digits_are_fives_and_ones_from_left_to_right_and_begin_again() {
        let mut light = PasskeyLight::default();
        assert_eq!(shown(&mut light, 50_917, 29), "b..r..b..rgggg..g..rgg......b");
    }

    #[test]
    fn another_passkey_begins_with_its_first_digit() {
        let mut light = PasskeyLight::default();
        shown(&mut light, 999_999, 3);
        assert_eq!(shown(&mut light, 123_456, 4), "g..g");
    }

    #[test]
    fn every_passkey_of_six_digits_takes_at_most_46_steps() {
        for passkey in [0, 7, 111_111, 999_999, u32::MAX] {
            let steps = shown(&mut PasskeyLight::default(), passkey, 100);
            assert!(steps.find("......").is_some_and(|end| end <= 40), "{passkey}: {steps}");
        }
    }
}
