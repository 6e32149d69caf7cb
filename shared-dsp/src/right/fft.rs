//! Computes the powers of a 16-point FFT of real samples, for a window that advances by half a frame.

const C1: f32 = 0.923_879_5; // cos(π/8)
const C3: f32 = 0.382_683_43; // cos(3π/8)
const R: f32 = core::f32::consts::FRAC_1_SQRT_2; // cos(2π/8)

/// Eight samples. They are stored as the first sample and the deviations of the other seven from it.
///
/// For a signal such as gravity with a little tremor, the deviations are exact and small.
/// Sums and products of the deviations therefore lose no precision to the large constant part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfFrame {
    /// The first sample.
    pub first: f32,
    /// Samples 1 to 7 minus the first sample.
    pub deviations: [f32; 7],
}

impl HalfFrame {
    /// Eight zeros.
    pub const ZERO: Self = Self { first: 0.0, deviations: [0.0; 7] };

    /// Splits eight samples.
    #[inline(always)]
    pub fn new(samples: &[f32; 8]) -> Self {
        let [first, rest @ ..] = *samples;
        Self { first, deviations: rest.map(|sample| sample - first) }
    }
}

/// Computes |X\[k\]|² for k = 0 to 7 of the frame that consists of two halves, X\[k\] = Σ x\[n\]·exp(−2πi·n·k/16).
///
/// The constant part of each half affects few terms.
/// The sum of the two constant parts affects only X\[0\], and their difference affects only the odd bins.
/// The code therefore adds the constants only to these bins.
#[inline(always)]
pub fn powers(old: &HalfFrame, new: &HalfFrame) -> [f32; 8] {
    let ([o1, o2, o3, o4, o5, o6, o7], [n1, n2, n3, n4, n5, n6, n7]) = (old.deviations, new.deviations);
    let step = old.first - new.first;

    // Even bins: an 8-point transform of old + new, whose element 0 is zero.
    let (s1, t1) = sum_difference(o1 + n1, o5 + n5);
    let (s2, t2) = sum_difference(o2 + n2, o6 + n6);
    let (s3, t3) = sum_difference(o3 + n3, o7 + n7);
    let a4 = o4 + n4;
    let x0 = (a4 + s2) + (s1 + s3) + 8.0 * (old.first + new.first);
    let (x4_re, x4_im) = (a4 - s2, s1 - s3);
    let (u, v) = (R * (t1 - t3), R * (t1 + t3));
    let (x2_re, x2_im) = (u - a4, v + t2);
    let (x6_re, x6_im) = (u + a4, v - t2);

    // Odd bins: old − new, folded by the symmetry between n and 8 − n. Element 0 is only the step.
    let (b1, b2, b3, b5, b6, b7) = (o1 - n1, o2 - n2, o3 - n3, o5 - n5, o6 - n6, o7 - n7);
    let b4 = (o4 - n4) + step;
    let steps = step + step;
    let (p1, p2, p3) = (b1 - b7, b2 - b6, b3 - b5);
    let (q1, q2, q3) = ((b1 + b7) + steps, (b2 + b6) + steps, (b3 + b5) + steps);
    let (u, v) = (step + R * p2, step - R * p2);
    let (e, f) = (C1 * p1 + C3 * p3, C3 * p1 - C1 * p3);
    let (g, h) = (b4 + R * q2, b4 - R * q2);
    let (m, w) = (C3 * q1 + C1 * q3, C1 * q1 - C3 * q3);

    [
        x0 * x0,
        square_sum(u + e, m + g),
        square_sum(x2_re, x2_im),
        square_sum(v + f, w - h),
        square_sum(x4_re, x4_im),
        square_sum(v - f, w + h),
        square_sum(x6_re, x6_im),
        square_sum(u - e, m - g),
    ]
}

#[inline(always)]
fn sum_difference(a: f32, b: f32) -> (f32, f32) {
    (a + b, a - b)
}

#[inline(always)]
fn square_sum(a: f32, b: f32) -> f32 {
    a * a + b * b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_equal_the_definition() {
        let mut state = 1u32;
        for round in 0..1000 {
            let samples: [f32; 16] = core::array::from_fn(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                9.81 + (state >> 8) as f32 / 1e7 * f32::from(round as i16 % 7)
            });
            let half = |at: usize| HalfFrame::new(samples[at..at + 8].try_into().unwrap());
            let got = powers(&half(0), &half(8));
            for (k, &power) in got.iter().enumerate() {
                let (mut re, mut im) = (0f64, 0f64);
                for (n, &x) in samples.iter().enumerate() {
                    let angle = -core::f64::consts::TAU * (n * k) as f64 / 16.0;
                    re += f64::from(x) * angle.cos();
                    im += f64::from(x) * angle.sin();
                }
                let expected = re * re + im * im;
                let error = (f64::from(power) - expected).abs();
                assert!(error <= 1e-5 * expected + 1e-9, "bin {k}: {power} instead of {expected}");
            }
        }
    }
}
