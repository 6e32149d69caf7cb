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

/// Bytes of biases at the start of a block of four rows.
pub(crate) const BIAS_BYTES: usize = 16;
/// Bytes of weights that meet one [`Quad`]: four rows of four weights.
pub(crate) const QUAD_WEIGHT_BYTES: usize = 16;

/// Four inputs, prepared: the words A and B, each two half-words.
pub(crate) type Quad = [u32; 2];

/// Prepares four inputs.
#[cfg(not(cortex_m4f))]
pub(crate) fn pack(x: [i8; 4]) -> Quad {
    let x = x.map(i32::from);
    let (a0, a1) = (x[1] - 127, x[3] - 127);
    let (b0, b1) = ((x[0] << 8) - a0, (x[2] << 8) - a1);
    let pair = |low: i32, high: i32| (low as u32 & 0xFFFF) | ((high as u32) << 16);
    [pair(a0, a1), pair(b0, b1)]
}

/// The four inputs that have been prepared.
pub(crate) fn unpack([a, b]: Quad) -> [i8; 4] {
    let half = |word: u32, shift: u32| i32::from((word >> shift) as i16);
    let odd = |shift: u32| half(a, shift) + 127;
    let even = |shift: u32| (half(b, shift) + half(a, shift)) >> 8;
    [even(0), odd(0), even(16), odd(16)].map(|value| value as i8)
}

/// Encodes four neighbouring weights of one row, each in −127..=127.
#[cfg(feature = "build")]
pub(crate) fn encode(weights: [i8; 4]) -> [u8; 4] {
    let half = |even: i8, odd: i8| ((i16::from(odd) << 8) + i16::from(even)).to_le_bytes();
    let ([a, b], [c, d]) = (half(weights[0], weights[1]), half(weights[2], weights[3]));
    [a, b, c, d]
}

/// Biases plus dot products of four rows with the inputs. `block` holds the four biases and then
/// [`QUAD_WEIGHT_BYTES`] for each quad: row 0 to 3 of the first four columns, then of the next four, and so on.
///
/// Works at any alignment; on a Cortex-M4F a multiple of 4 bytes is several times as fast.
#[inline(always)]
pub(crate) fn four_rows(block: &[u8], inputs: &[Quad]) -> [i32; 4] {
    #[cfg(cortex_m4f)]
    if block.as_ptr().addr() & 3 == 0 {
        return cortex_m4f::four_rows(block, inputs);
    }
    portable(block, inputs)
}

/// Says in plain arithmetic what the assembly below does.
#[cfg_attr(cortex_m4f, cold, inline(never))]
fn portable(block: &[u8], inputs: &[Quad]) -> [i32; 4] {
    let mut sums = [0i32; 4];
    let (biases, weights) = block.split_at(BIAS_BYTES.min(block.len()));
    for (block, &[a, b]) in weights.as_chunks::<QUAD_WEIGHT_BYTES>().0.iter().zip(inputs) {
        for (sum, row) in sums.iter_mut().zip(block.as_chunks::<4>().0) {
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
    for (sum, bias) in sums.iter_mut().zip(biases.as_chunks::<4>().0) {
        *sum = (*sum >> 8).wrapping_add(i32::from_le_bytes(*bias));
    }
    sums
}

#[cfg(cortex_m4f)]
pub(crate) use cortex_m4f::pack;

#[cfg(cortex_m4f)]
mod cortex_m4f {
    use super::{BIAS_BYTES, QUAD_WEIGHT_BYTES, Quad};

    /// Four rows times four columns: 14 instructions for 16 multiply-accumulates.
    macro_rules! quad {
        () => {
            "ldm r1!, {{r8-r11}}
             ldm r2!, {{r12, lr}}
             smlad r4, r8, r12, r4
             sxtb16 r8, r8
             smlad r4, r8, lr, r4
             smlad r5, r9, r12, r5
             sxtb16 r9, r9
             smlad r5, r9, lr, r5
             smlad r6, r10, r12, r6
             sxtb16 r10, r10
             smlad r6, r10, lr, r6
             smlad r7, r11, r12, r7
             sxtb16 r11, r11
             smlad r7, r11, lr, r7"
        };
    }

    core::arch::global_asm!(
        ".section .text.bimanual_four_rows,\"ax\",%progbits",
        ".global bimanual_four_rows",
        ".type bimanual_four_rows,%function",
        ".thumb_func",
        // r0 = sums, r1 = block, r2 = inputs, r3 = quads (at least 1)
        "bimanual_four_rows:",
        "push {{r4-r11, lr}}",
        "ldm r1!, {{r4-r7}}",
        "push {{r4-r7}}", // biases
        "movs r4, #0",
        "movs r5, #0",
        "movs r6, #0",
        "movs r7, #0",
        "lsrs r3, r3, #1",
        "bcc 1f",
        quad!(),
        "cmp r3, #0",
        "beq 2f",
        "1:",
        quad!(),
        quad!(),
        "subs r3, #1",
        "bne 1b",
        "2:",
        "pop {{r8-r11}}",
        "add r4, r8, r4, asr #8",
        "add r5, r9, r5, asr #8",
        "add r6, r10, r6, asr #8",
        "add r7, r11, r7, asr #8",
        "stm r0, {{r4-r7}}",
        "pop {{r4-r11, pc}}",
        ".size bimanual_four_rows, . - bimanual_four_rows",
        ".text",
    );

    unsafe extern "C" {
        fn bimanual_four_rows(sums: *mut [i32; 4], block: *const u8, inputs: *const Quad, quads: usize);
    }

    /// `block` must be aligned to 4 bytes; gives zeros if it is shorter than the inputs need.
    #[inline(always)]
    pub(super) fn four_rows(block: &[u8], inputs: &[Quad]) -> [i32; 4] {
        let mut sums = [0; 4];
        if !inputs.is_empty() && block.len() >= BIAS_BYTES + QUAD_WEIGHT_BYTES * inputs.len() {
            // SAFETY: the block is aligned (the caller has looked) and long enough; the routine keeps to the procedure
            // call standard and writes only `sums`.
            unsafe { bimanual_four_rows(&mut sums, block.as_ptr(), inputs.as_ptr(), inputs.len()) };
        }
        sums
    }

    /// As the portable one, in five instructions.
    #[inline(always)]
    pub(crate) fn pack(x: [i8; 4]) -> Quad {
        let x = u32::from_le_bytes(x.map(|x| x as u8));
        let (a, b): (u32, u32);
        // SAFETY: computes in registers, with the DSP instructions that this target has.
        unsafe {
            core::arch::asm!(
                "sxtb16 {a}, {x}, ror #8",
                "ssub16 {a}, {a}, {k}",
                "bic {b}, {x}, #0xFF00FF00",
                "lsl {b}, {b}, #8",
                "ssub16 {b}, {b}, {a}",
                x = in(reg) x,
                k = in(reg) 0x007F_007Fu32,
                a = out(reg) a,
                b = lateout(reg) b,
                options(pure, nomem, nostack)
            );
        }
        [a, b]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_values_survive_preparation() {
        for x in i8::MIN..=i8::MAX {
            for y in [-128, -127, -1, 0, 1, 126, 127] {
                assert_eq!(unpack(pack([x, y, y, x])), [x, y, y, x]);
            }
        }
    }

    #[test]
    fn four_rows_of_extreme_values_equal_plain_dot_products() {
        let extremes = [-127i8, -126, -1, 0, 1, 126, 127];
        let inputs_of = [-128i32, -127, -1, 0, 1, 126, 127];
        let columns = 256;
        for seed in 0..49usize {
            let weight = |row: usize, column: usize| extremes[(seed + row * 3 + column * (1 + seed % 7)) % 7];
            let input = |column: usize| inputs_of[(seed / 7 + column * (1 + seed % 5)) % 7];
            let inputs: std::vec::Vec<Quad> = (0..columns / 4)
                .map(|q| pack(core::array::from_fn(|i| input(4 * q + i) as i8)))
                .collect();
            let mut weights = std::vec::Vec::from([0; BIAS_BYTES]);
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
