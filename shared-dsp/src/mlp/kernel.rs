//! The inner loop of a dense layer: four dot products at once.
//!
//! A Cortex-M4F multiplies two pairs of 16-bit numbers in one instruction (SMLAD), but int8 weights must
//! be widened first. We save half of that work by algebra. Let a half-word of weights be
//! `h = 256·o + e` (o and e two neighbouring weights) and prepare of each pair of inputs (xe, xo)
//!
//! ```text
//! A = xo − 127          B = 256·xe − A          (both fit 16 bits for every int8 input)
//! h·A + e·B = 256·(o·A + e·xe)
//! ```
//!
//! so the *raw* half-word is multiplied by A, only its low byte is widened for B, and the sum is exact
//! after a shift by 8. The 127·o that A misses is a constant, which the blob's builder folds into the bias.

/// Bytes of weights that meet one [`Quad`]: four rows of four weights.
pub(crate) const QUAD_WEIGHT_BYTES: usize = 16;

/// Four inputs, prepared: the words A and B, each two half-words.
pub(crate) type Quad = [u32; 2];

/// Prepares four inputs in int8 range.
pub(crate) fn pack(x: [i32; 4]) -> Quad {
    let (a0, a1) = (x[1] - 127, x[3] - 127);
    let (b0, b1) = ((x[0] << 8) - a0, (x[2] << 8) - a1);
    let pair = |low: i32, high: i32| (low as u32 & 0xFFFF) | ((high as u32) << 16);
    [pair(a0, a1), pair(b0, b1)]
}

/// Encodes four neighbouring weights of one row, each in −127..=127.
#[cfg(feature = "build")]
pub(crate) fn encode(weights: [i8; 4]) -> [u8; 4] {
    let half = |even: i8, odd: i8| ((i16::from(odd) << 8) + i16::from(even)).to_le_bytes();
    let ([a, b], [c, d]) = (half(weights[0], weights[1]), half(weights[2], weights[3]));
    [a, b, c, d]
}

/// Dot products of four rows with the inputs. `weights` holds [`QUAD_WEIGHT_BYTES`] for each quad: row 0 to 3
/// of the first four columns, then of the next four, and so on.
///
/// Works at any alignment; on a Cortex-M4F a 4-byte alignment is about three times as fast.
pub(crate) fn four_rows(weights: &[u8], inputs: &[Quad]) -> [i32; 4] {
    #[cfg(cortex_m4f)]
    if weights.as_ptr().addr() & 3 == 0 && weights.len() >= QUAD_WEIGHT_BYTES * inputs.len() {
        return cortex_m4f::four_rows(weights, inputs);
    }
    portable(weights, inputs)
}

/// Says in plain arithmetic what the assembly below does.
fn portable(weights: &[u8], inputs: &[Quad]) -> [i32; 4] {
    let mut sums = [0i32; 4];
    let (blocks, _) = weights.as_chunks::<QUAD_WEIGHT_BYTES>();
    for (block, &[a, b]) in blocks.iter().zip(inputs) {
        let (rows, _) = block.as_chunks::<4>();
        for (sum, row) in sums.iter_mut().zip(rows) {
            let weight = |low: usize| i32::from(i16::from_le_bytes([row[low], row[low + 1]]));
            let even = |low: usize| i32::from(row[low] as i8);
            let half = |word: u32, shift: u32| i32::from((word >> shift) as i16);
            *sum = sum
                .wrapping_add(weight(0) * half(a, 0))
                .wrapping_add(weight(2) * half(a, 16))
                .wrapping_add(even(0) * half(b, 0))
                .wrapping_add(even(2) * half(b, 16));
        }
    }
    sums.map(|sum| sum >> 8)
}

#[cfg(cortex_m4f)]
mod cortex_m4f {
    use super::Quad;

    core::arch::global_asm!(
        ".section .text.bimanual_four_rows,\"ax\",%progbits",
        ".global bimanual_four_rows",
        ".type bimanual_four_rows,%function",
        ".thumb_func",
        // r0 = sums, r1 = weights, r2 = inputs, r3 = quads (at least 1)
        "bimanual_four_rows:",
        "push {{r4-r11, lr}}",
        "movs r4, #0",
        "movs r5, #0",
        "movs r6, #0",
        "movs r7, #0",
        "1:",
        "ldm r1!, {{r8-r11}}",
        "ldm r2!, {{r12, lr}}",
        "smlad r4, r8, r12, r4",
        "sxtb16 r8, r8",
        "smlad r4, r8, lr, r4",
        "smlad r5, r9, r12, r5",
        "sxtb16 r9, r9",
        "smlad r5, r9, lr, r5",
        "smlad r6, r10, r12, r6",
        "sxtb16 r10, r10",
        "smlad r6, r10, lr, r6",
        "smlad r7, r11, r12, r7",
        "sxtb16 r11, r11",
        "smlad r7, r11, lr, r7",
        "subs r3, #1",
        "bne 1b",
        "asr r4, r4, #8",
        "asr r5, r5, #8",
        "asr r6, r6, #8",
        "asr r7, r7, #8",
        "stm r0, {{r4-r7}}",
        "pop {{r4-r11, pc}}",
        ".size bimanual_four_rows, . - bimanual_four_rows",
        ".text",
    );

    unsafe extern "C" {
        fn bimanual_four_rows(sums: *mut [i32; 4], weights: *const u8, inputs: *const Quad, quads: usize);
    }

    pub(super) fn four_rows(weights: &[u8], inputs: &[Quad]) -> [i32; 4] {
        let mut sums = [0; 4];
        if !inputs.is_empty() {
            // SAFETY: the caller has checked alignment and that there are 16 bytes of weights for each quad;
            // the routine keeps to the procedure call standard and writes only `sums`.
            unsafe { bimanual_four_rows(&mut sums, weights.as_ptr(), inputs.as_ptr(), inputs.len()) };
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_rows_of_extreme_values_equal_plain_dot_products() {
        let extremes = [-127i8, -126, -1, 0, 1, 126, 127];
        let inputs_of = [-128i32, -127, -1, 0, 1, 126, 127];
        let columns = 256;
        for seed in 0..49usize {
            let weight = |row: usize, column: usize| extremes[(seed + row * 3 + column * (1 + seed % 7)) % 7];
            let input = |column: usize| inputs_of[(seed / 7 + column * (1 + seed % 5)) % 7];
            let inputs: std::vec::Vec<Quad> = (0..columns / 4)
                .map(|q| pack([input(4 * q), input(4 * q + 1), input(4 * q + 2), input(4 * q + 3)]))
                .collect();
            let mut weights = std::vec::Vec::new();
            for q in 0..columns / 4 {
                for row in 0..4 {
                    weights.extend(encode(core::array::from_fn(|i| weight(row, 4 * q + i))));
                }
            }
            let expected: [i32; 4] = core::array::from_fn(|row| {
                (0..columns)
                    .map(|c| i32::from(weight(row, c)) * (input(c) - if c % 2 == 1 { 127 } else { 0 }))
                    .sum()
            });
            assert_eq!(portable(&weights, &inputs), expected, "seed {seed}");
        }
    }
}
