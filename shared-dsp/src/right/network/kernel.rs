//! The inner loop of a dense layer. It processes four rows at a time, with two multiply-accumulates per instruction.
//!
//! A Cortex-M4F multiplies two pairs of 16-bit numbers in one instruction (SMLAD).
//! However, int8 numbers must first be widened, which takes the same time again.
//! The following algebra avoids most of this work. For two adjacent weights (w0, w1) and inputs (x0, x1), let
//!
//! ```text
//! h = 256·w0 + w1            a half-word of the blob; w1 is its low byte
//! X = 256·x1 + (127 − x0)    a half-word of the scratch memory: two bytes, the first one as x0 XOR 0x7F
//! v = 128 + x0               the low byte of NOT X, as an unsigned number
//! h·v + w1·X = 256·(w0·x0 + w1·x1) + 256·(128·w0 + w1) − w1
//! ```
//!
//! The code multiplies raw half-words of weights and inputs, and widens only the low byte of each.
//! The code then shifts the sum right by 8.
//! The remaining terms are equal for all inputs, so the blob's builder subtracts them from the bias.

/// Number of bias bytes at the start of a block of four rows.
pub(crate) const BIAS_BYTES: usize = 16;
/// Number of weight bytes for one [`Quad`]: four rows of four weights.
pub(crate) const QUAD_WEIGHT_BYTES: usize = 16;
/// Number of scale bytes for four rows with individual scales: four multipliers and four shifts.
pub(crate) const ROW_SCALE_BYTES: usize = 20;

/// Four inputs in the form that the kernel needs: two half-words X.
pub(crate) type Quad = u32;

const FLIP: u32 = 0x007F_007F;

/// Converts four inputs to the form that the kernel needs.
#[inline(always)]
pub(crate) fn pack(x: [i8; 4]) -> Quad {
    u32::from_le_bytes(x.map(|x| x as u8)) ^ FLIP
}

/// Converts the kernel's form back to the four inputs.
#[inline(always)]
pub(crate) fn unpack(quad: Quad) -> [i8; 4] {
    (quad ^ FLIP).to_le_bytes().map(|byte| byte as i8)
}

/// Encodes four adjacent weights of one row, each in −127..=127.
#[cfg(feature = "build")]
pub(crate) fn encode([a, b, c, d]: [i8; 4]) -> [u8; 4] {
    let half = |w0: i8, w1: i8| ((i16::from(w0) << 8) + i16::from(w1)).to_le_bytes();
    let ([a, b], [c, d]) = (half(a, b), half(c, d));
    [a, b, c, d]
}

/// The amount by which the kernel's sum exceeds Σ w·x for a row of weights.
#[cfg(feature = "build")]
pub(crate) fn surplus(row: &[i8]) -> i64 {
    let sum = |parity: usize| row.iter().skip(parity).step_by(2).map(|&w| i64::from(w)).sum::<i64>();
    let (first, second) = (sum(0), sum(1));
    128 * first + second + (-second).div_euclid(256)
}

/// How sums are converted to outputs.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(crate) struct Requantise {
    /// A multiplier in 2³⁰..2³¹.
    pub multiplier: i32,
    /// The product is divided by 2^shift, where the shift is 1 to 62.
    pub shift: u32,
    /// The output value that represents 0.
    pub zero_point: i32,
    /// Minimum output, at least −128.
    pub smallest: i32,
}

impl Requantise {
    /// Converts an accumulator to int8 with one fixed-point product, which is rounded once (ties up).
    #[cfg_attr(cortex_m4f, inline(never))]
    fn apply(&self, sum: i32) -> i8 {
        let product = i64::from(sum) * i64::from(self.multiplier);
        let scaled = ((product + (1 << (self.shift - 1))) >> self.shift).clamp(-1024, 1024) as i32;
        (scaled + self.zero_point).max(self.smallest).clamp(-128, 127) as i8
    }
}

/// Computes a layer, four outputs at a time.
/// For every four outputs, `blocks` contains four biases, then [`QUAD_WEIGHT_BYTES`] for each quad of inputs.
/// These bytes are rows 0 to 3 of the first four columns, then of the next four columns, and so on.
/// If the numbers of outputs and blocks differ, the surplus is ignored.
///
/// Any alignment works, but a multiple of 4 bytes is several times faster on a Cortex-M4F.
pub(crate) fn layer(blocks: &[u8], inputs: &[Quad], outputs: &mut [Quad], requantise: &Requantise) {
    #[cfg(cortex_m4f)]
    if cortex_m4f::layer(blocks, inputs, outputs, requantise) {
        return;
    }
    portable(blocks, inputs, outputs, requantise);
}

/// Computes a layer whose rows have individual scales.
/// The function works like [`layer`], but also reads [`ROW_SCALE_BYTES`] of `scales` for every four outputs.
/// The zero point and minimum output of `shared` apply to all rows, and no output exceeds `largest`.
#[cfg_attr(cortex_m4f, inline(never))]
pub(crate) fn layer_per_row(
    blocks: &[u8],
    scales: &[u8],
    inputs: &[Quad],
    outputs: &mut [Quad],
    shared: &Requantise,
    largest: i8,
) {
    let block_bytes = BIAS_BYTES + inputs.len() * QUAD_WEIGHT_BYTES;
    let (scales, _) = scales.as_chunks::<ROW_SCALE_BYTES>();
    for ((block, scales), output) in blocks.chunks_exact(block_bytes).zip(scales).zip(outputs) {
        let mut sums = [0; 4];
        sums_of(block, inputs, &mut sums);
        let (multipliers, shifts) = scales.split_at(16);
        let mut values = [0; 4];
        for (((value, sum), multiplier), shift) in
            values.iter_mut().zip(sums).zip(multipliers.as_chunks::<4>().0).zip(shifts)
        {
            let own = Requantise {
                multiplier: i32::from_le_bytes(*multiplier),
                shift: u32::from(*shift),
                ..*shared
            };
            *value = own.apply(sum).min(largest);
        }
        *output = pack(values);
    }
}

/// Computes the weighted sums of the four rows of a block, including their biases.
fn sums_of(block: &[u8], inputs: &[Quad], sums: &mut [i32; 4]) {
    #[cfg(cortex_m4f)]
    if cortex_m4f::sums(block, inputs, sums) {
        return;
    }
    let (words, _) = block.as_chunks::<4>();
    for (row, sum) in sums.iter_mut().enumerate() {
        *sum = row_sum(words, row, inputs);
    }
}

/// Computes the weighted sum of one row of a block, including its bias.
#[cfg_attr(cortex_m4f, cold, inline(never))]
fn row_sum(words: &[[u8; 4]], row: usize, inputs: &[Quad]) -> i32 {
    let Some((bias, weights)) = words.get(row..).and_then(<[_]>::split_first) else { return 0 };
    let sum = weights.iter().skip(3).step_by(4).zip(inputs).fold(0, |sum, (h, &x)| one_quad(sum, *h, x));
    (sum >> 8).wrapping_add(i32::from_le_bytes(*bias))
}

/// The portable code that does the same as the assembly below.
#[cfg_attr(cortex_m4f, cold, inline(never))]
fn portable(blocks: &[u8], inputs: &[Quad], outputs: &mut [Quad], requantise: &Requantise) {
    let block_bytes = BIAS_BYTES + inputs.len() * QUAD_WEIGHT_BYTES;
    for (block, output) in blocks.chunks_exact(block_bytes).zip(outputs) {
        let (words, _) = block.as_chunks::<4>();
        let mut values = [0; 4];
        for (row, value) in values.iter_mut().enumerate() {
            *value = requantise.apply(row_sum(words, row, inputs));
        }
        *output = pack(values);
    }
}

/// Adds the products of four weights and inputs to `sum`.
#[cfg_attr(cortex_m4f, inline(never))]
fn one_quad(sum: i32, weights: [u8; 4], x: Quad) -> i32 {
    let half = |word: u32, shift: u32| i32::from((word >> shift) as i16);
    let (h, v) = (u32::from_le_bytes(weights), !x & 0x00FF_00FF);
    let pair = |shift: u32| {
        let w1 = i32::from((h >> shift) as i8);
        (half(h, shift) * half(v, shift)).wrapping_add(w1 * half(x, shift))
    };
    sum.wrapping_add(pair(0)).wrapping_add(pair(16))
}

#[cfg(cortex_m4f)]
mod cortex_m4f {
    use super::{BIAS_BYTES, QUAD_WEIGHT_BYTES, Quad, Requantise};

    /// Four rows times four columns: 16 instructions for 16 multiply-accumulates.
    macro_rules! quad {
        () => {
            "ldm r1!, {{r8-r11}}
             ldr lr, [r2], #4
             mvn r12, lr
             uxtb16 r12, r12
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

    /// Computes the sums of a block's four rows in r4 to r7, including biases. r0 = arguments, r1 = block (which advances).
    macro_rules! sums {
        () => {
            concat!(
                "adds r1, #16\n", // the biases come last
                "ldrd r2, r3, [r0]\n",
                "movs r4, #0\n",
                "movs r5, #0\n",
                "movs r6, #0\n",
                "movs r7, #0\n",
                "lsrs r3, r3, #1\n",
                "bcc 1f\n",
                quad!(),
                "\ncmp r3, #0\n",
                "beq 2f\n",
                "1:\n",
                quad!(),
                "\n",
                quad!(),
                "\nsubs r3, #1\n",
                "bne 1b\n",
                "2:\n",
                "ldr r2, [r0, #8]\n",
                "subs r2, r1, r2\n",
                "ldm r2, {{r8-r11}}\n",
                "add r4, r8, r4, asr #8\n",
                "add r5, r9, r5, asr #8\n",
                "add r6, r10, r6, asr #8\n",
                "add r7, r11, r7, asr #8"
            )
        };
    }

    /// The assembly below depends on this layout.
    #[repr(C)]
    struct Arguments {
        inputs: *const Quad,      // 0
        quads: usize,             // 4, at least 1
        block_bytes: usize,       // 8
        outputs: *mut Quad,       // 12, moves
        multiplier: i32,          // 16
        rounding: i32,            // 20
        shift: u32,               // 24, of the high word
        zero_point: i32,          // 28
        smallest: i32,            // 32
        outputs_end: *const Quad, // 36
    }

    core::arch::global_asm!(
        ".section .text.bimanual_layer,\"ax\",%progbits",
        ".global bimanual_layer",
        ".type bimanual_layer,%function",
        ".thumb_func",
        // r0 = arguments, r1 = blocks
        "bimanual_layer:",
        "push {{r4-r11, lr}}",
        "0:",
        sums!(),
        "add r2, r0, #12",
        "ldm r2, {{r3, r8-r12}}", // outputs, multiplier, rounding, shift, zero point, smallest
        "smmla r4, r4, r8, r9",
        "smmla r5, r5, r8, r9",
        "smmla r6, r6, r8, r9",
        "smmla r7, r7, r8, r9",
        "asr r4, r4, r10",
        "asr r5, r5, r10",
        "asr r6, r6, r10",
        "asr r7, r7, r10",
        "add r4, r4, r11",
        "add r5, r5, r11",
        "add r6, r6, r11",
        "add r7, r7, r11",
        "cmn r12, #128", // the usual smallest output is that of int8 itself
        "beq 3f",
        "cmp r4, r12",
        "it lt",
        "movlt r4, r12",
        "cmp r5, r12",
        "it lt",
        "movlt r5, r12",
        "cmp r6, r12",
        "it lt",
        "movlt r6, r12",
        "cmp r7, r12",
        "it lt",
        "movlt r7, r12",
        "3:",
        "ssat r4, #8, r4",
        "ssat r5, #8, r5",
        "ssat r6, #8, r6",
        "ssat r7, #8, r7",
        "bfi r4, r5, #8, #8",
        "bfi r4, r6, #16, #8",
        "bfi r4, r7, #24, #8",
        "eor r4, r4, #0x007F007F",
        "str r4, [r3], #4",
        "str r3, [r0, #12]",
        "ldr r2, [r0, #36]",
        "cmp r3, r2",
        "bne 0b",
        "pop {{r4-r11, pc}}",
        ".size bimanual_layer, . - bimanual_layer",
        ".text",
    );

    core::arch::global_asm!(
        ".section .text.bimanual_sums,\"ax\",%progbits",
        ".global bimanual_sums",
        ".type bimanual_sums,%function",
        ".thumb_func",
        // r0 = arguments, r1 = block
        "bimanual_sums:",
        "push {{r4-r11, lr}}",
        sums!(),
        "ldr r3, [r0, #12]",
        "stm r3, {{r4-r7}}",
        "pop {{r4-r11, pc}}",
        ".size bimanual_sums, . - bimanual_sums",
        ".text",
    );

    /// The first fields of [`Arguments`], and the place where the sums are written.
    #[repr(C)]
    struct SumArguments {
        inputs: *const Quad, // 0
        quads: usize,        // 4, at least 1
        block_bytes: usize,  // 8
        sums: *mut [i32; 4], // 12
    }

    unsafe extern "C" {
        fn bimanual_layer(arguments: *mut Arguments, blocks: *const u8);
        fn bimanual_sums(arguments: *const SumArguments, block: *const u8);
    }

    /// Returns false and does nothing if the assembly is not applicable.
    #[inline(always)]
    pub(super) fn sums(block: &[u8], inputs: &[Quad], sums: &mut [i32; 4]) -> bool {
        let block_bytes = BIAS_BYTES + inputs.len() * QUAD_WEIGHT_BYTES;
        let fits = block.as_ptr().addr() & 3 == 0 && !inputs.is_empty() && block.len() >= block_bytes;
        if fits {
            let arguments = SumArguments { inputs: inputs.as_ptr(), quads: inputs.len(), block_bytes, sums };
            // SAFETY: the block is aligned and matches the inputs' length.
            // The routine reads the block and the inputs, and writes the sums.
            // The routine follows Arm's procedure call standard.
            unsafe { bimanual_sums(&arguments, block.as_ptr()) };
        }
        fits
    }

    /// Returns false and does nothing if the assembly is not applicable.
    #[inline(always)]
    pub(super) fn layer(
        blocks: &[u8],
        inputs: &[Quad],
        outputs: &mut [Quad],
        requantise: &Requantise,
    ) -> bool {
        let block_bytes = BIAS_BYTES + inputs.len() * QUAD_WEIGHT_BYTES;
        let fits = blocks.as_ptr().addr() & 3 == 0
            && requantise.shift > 32
            && !inputs.is_empty()
            && !outputs.is_empty()
            && blocks.len() >= block_bytes * outputs.len();
        if fits {
            let range = outputs.as_mut_ptr_range();
            let mut arguments = Arguments {
                inputs: inputs.as_ptr(),
                quads: inputs.len(),
                block_bytes,
                outputs: range.start,
                multiplier: requantise.multiplier,
                // The shift does not affect the low word, so the high half of the product is enough.
                rounding: 1 << ((requantise.shift - 33) & 31),
                shift: (requantise.shift - 32) & 31,
                zero_point: requantise.zero_point,
                smallest: requantise.smallest,
                outputs_end: range.end,
            };
            // SAFETY: the blocks are aligned and there is one for each output.
            // The routine reads the blocks and the inputs, writes the outputs, and follows the procedure call standard.
            unsafe { bimanual_layer(&mut arguments, blocks.as_ptr()) };
        }
        fits
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn all_values_survive_preparation() {
        for x in i8::MIN..=i8::MAX {
            for y in [-128, -127, -1, 0, 1, 126, 127] {
                assert_eq!(unpack(pack([x, y, y, x])), [x, y, y, x]);
            }
        }
    }

    #[test]
    fn extreme_values_in_the_widest_layer_equal_plain_dot_products() {
        let extremes = [-127i8, -126, -1, 0, 1, 126, 127];
        let inputs_of = [-128i8, -127, -1, 0, 1, 126, 127];
        const COLUMNS: usize = 256;
        // The outputs show the raw sums in steps of 2¹⁶, so that they fit in int8.
        let requantise = Requantise { multiplier: 1 << 30, shift: 46, zero_point: 0, smallest: -128 };
        for seed in 0..49usize {
            let weight = |row: usize, c: usize| extremes[(seed + row * 3 + c * (1 + seed % 7)) % 7];
            let input = |c: usize| inputs_of[(seed / 7 + c * (1 + seed % 5)) % 7];
            let quads: Vec<Quad> =
                (0..COLUMNS / 4).map(|q| pack(core::array::from_fn(|i| input(4 * q + i)))).collect();
            let mut block = Vec::new();
            for row in 0..4 {
                let weights: Vec<i8> = (0..COLUMNS).map(|c| weight(row, c)).collect();
                block.extend((-surplus(&weights) as i32).to_le_bytes());
            }
            for q in 0..COLUMNS / 4 {
                for row in 0..4 {
                    block.extend(encode(core::array::from_fn(|i| weight(row, 4 * q + i))));
                }
            }
            let mut output = [0];
            layer(&block, &quads, &mut output, &requantise);
            let expected = core::array::from_fn(|row| {
                let sum: i32 = (0..COLUMNS).map(|c| i32::from(weight(row, c)) * i32::from(input(c))).sum();
                requantise.apply(sum)
            });
            assert_eq!(unpack(output[0]), expected, "seed {seed}");
        }
    }
}
