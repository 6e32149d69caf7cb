//! TFLite's int8 softmax with the same bits, using a table of exponentials.
//!
//! TFLite (gemmlowp) subtracts the largest logit from each logit, and computes `exp` of the difference in 32-bit fixed point.
//! There are only 256 possible differences, so the blob contains their exponentials.
//! The board then needs only one reciprocal (three Newton steps) and one product per label.

use crate::right::network::MAX_LABELS;

/// The output scale is 1/256 and the output zero point is −128, as TFLite requires for int8.
const ACCUMULATOR_INTEGER_BITS: u32 = 12;

/// Returns the product of two Q0.31 numbers, rounded to nearest (ties up).
/// This is gemmlowp's `SaturatingRoundingDoublingHighMul` without its saturating case, −1 · −1, which cannot occur here.
#[inline(always)]
pub(crate) fn multiply_q31(a: i32, b: i32) -> i32 {
    ((i64::from(a) * i64::from(b) + (1 << 30)) >> 31) as i32
}

/// Returns `x / 2^exponent`, rounded to nearest (ties away from zero).
#[cfg(feature = "build")]
pub(crate) fn divide_by_power_of_two(x: i32, exponent: u32) -> i32 {
    let mask = ((1i64 << exponent) - 1) as i32;
    let threshold = (mask >> 1) + i32::from(x < 0);
    (x >> exponent) + i32::from((x & mask) > threshold)
}

/// Computes 1 / (1 + a) for a in [0, 1) as Q0.31, like gemmlowp.
fn reciprocal_of_one_plus(a: i32) -> i32 {
    const FORTY_EIGHT_SEVENTEENTHS: i32 = 1_515_870_810; // Q2.29
    const MINUS_THIRTY_TWO_SEVENTEENTHS: i32 = -1_010_580_540; // Q2.29
    const ONE: i32 = 1 << 29; // Q2.29
    let half_denominator = ((i64::from(a) + i64::from(i32::MAX) + 1) / 2) as i32;
    let mut x = FORTY_EIGHT_SEVENTEENTHS + multiply(half_denominator, MINUS_THIRTY_TWO_SEVENTEENTHS);
    for _ in 0..3 {
        let error = ONE - multiply(half_denominator, x);
        x += multiply(x, error) << 2;
    }
    x.saturating_mul(2)
}

/// Computes the softmax of `logits` into `scores`: (score + 128) / 256 is the probability.
///
/// `table[d]` is exp(−d · scale) in Q0.31, little-endian, for differences d = 0, 1, …
/// Beyond the end of the table, exponentials are too small to affect any output.
/// Both slices must have the same length, at most 16.
#[inline(never)]
pub(crate) fn softmax(table: &[[u8; 4]], logits: &[i8], scores: &mut [i8]) {
    let largest = logits.iter().copied().max().unwrap_or(0);
    let mut exponentials = [0; MAX_LABELS];
    let mut sum = 0;
    for (value, &logit) in exponentials.iter_mut().zip(logits) {
        *value = exponential(table, i32::from(largest) - i32::from(logit));
        // The value is rounded to a number with 12 integer bits, at most 2¹⁹.
        sum += (*value as u32 + (1 << 11)) >> ACCUMULATOR_INTEGER_BITS;
    }
    // The sum is at least 2¹⁹, which comes from the largest logit, and below 2²⁴.
    let headroom = sum.leading_zeros();
    let scale = reciprocal_of_one_plus((sum << (headroom & 31)).wrapping_sub(1 << 31) as i32);
    let shift = (ACCUMULATOR_INTEGER_BITS + 31 - 8).wrapping_sub(headroom) & 31;
    let half = (1u32 << shift) >> 1;
    for (score, &exponential) in scores.iter_mut().zip(&exponentials) {
        let probability = (multiply(scale, exponential) as u32 + half) >> shift;
        *score = (probability as i32 - 128).min(127) as i8;
    }
}

/// Returns exp(−difference · scale). It is not inlined, so that the loop above stays small.
#[inline(never)]
fn exponential(table: &[[u8; 4]], difference: i32) -> i32 {
    table.get(difference as usize).map_or(0, |value| i32::from_le_bytes(*value))
}

/// Like [`multiply_q31`], but not inlined, so that loops stay small.
#[inline(never)]
fn multiply(a: i32, b: i32) -> i32 {
    multiply_q31(a, b)
}

/// Returns the exponentials for [`softmax`], computed on the host.
#[cfg(feature = "build")]
pub(crate) mod table {
    use super::{divide_by_power_of_two, multiply_q31};
    use std::vec::Vec;

    /// Returns exp(a) for a ≤ 0 in Q5.26 as Q0.31 (gemmlowp's `exp_on_negative_values`).
    fn exp_on_negative_values(a: i32) -> i32 {
        if a == 0 {
            return i32::MAX;
        }
        const QUARTER: i32 = 1 << 24;
        let below_quarter = (a & (QUARTER - 1)) - QUARTER;
        // Taylor expansion around −1/8.
        const EXP_MINUS_EIGHTH: i32 = 1_895_147_668;
        const THIRD: i32 = 715_827_883;
        let x = (below_quarter << 5) + (1 << 28);
        let x2 = multiply_q31(x, x);
        let x3 = multiply_q31(x2, x);
        let x4 = multiply_q31(x2, x2);
        let tail = divide_by_power_of_two(multiply_q31(divide_by_power_of_two(x4, 2) + x3, THIRD) + x2, 1);
        let mut result = EXP_MINUS_EIGHTH + multiply_q31(EXP_MINUS_EIGHTH, x + tail);
        // The other factors are for quarters, halves, ones, …, sixteens.
        const EXP_MINUS_POWERS: [i32; 7] =
            [1_672_461_947, 1_302_514_674, 790_015_084, 290_630_308, 39_332_535, 720_401, 242];
        let remainder = below_quarter - a;
        for (bit, &factor) in EXP_MINUS_POWERS.iter().enumerate() {
            if remainder & (1 << (24 + bit)) != 0 {
                result = multiply_q31(result, factor);
            }
        }
        result
    }

    /// Returns the exponentials of 0, −1, −2, … steps, up to the last exponential that can affect an output.
    /// `multiplier` (Q0.31) and `left_shift` scale a step of the logits to Q5.26.
    pub(crate) fn exponentials(multiplier: i32, left_shift: u32) -> Vec<i32> {
        let limit = (31i64 << 26) >> left_shift;
        (0..256i64)
            .take_while(|&difference| difference <= limit)
            .map(|difference| {
                exp_on_negative_values(multiply_q31((-difference << left_shift) as i32, multiplier))
            })
            // Smaller values add nothing to the sum and round to zero in the output.
            .take_while(|&value| value >= 1 << 11)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The test performs the same operations as gemmlowp.
    fn rounding_doubling_high_mul(a: i32, b: i32) -> i32 {
        let product = i64::from(a) * i64::from(b);
        let nudge = if product >= 0 { 1 << 30 } else { 1 - (1 << 30) };
        ((product + nudge) / (1 << 31)) as i32
    }

    #[test]
    fn the_product_is_gemmlowps_also_for_negative_ties() {
        let edges = [
            i32::MIN + 1,
            -(1 << 30),
            -(1 << 16) - 1,
            -(1 << 15),
            -3,
            -1,
            0,
            1,
            2,
            1 << 15,
            1 << 30,
            i32::MAX,
        ];
        for a in edges {
            for b in edges {
                assert_eq!(multiply_q31(a, b), rounding_doubling_high_mul(a, b), "{a} · {b}");
            }
        }
        let mut state = 1u64;
        for _ in 0..200_000 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let (a, b) = ((state >> 32) as i32, (state << 7 >> 32) as i32);
            assert_eq!(multiply_q31(a, b), rounding_doubling_high_mul(a, b), "{a} · {b}");
        }
    }
}
