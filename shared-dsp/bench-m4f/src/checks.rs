//! Checksums of results for fixed inputs. The board and the laptop compile this same file.

use shared_dsp::right::features::FeatureWindow;
use shared_dsp::right::network::{Model, crc32};

fn mix(sum: u32, bytes: &[u8]) -> u32 {
    sum.rotate_left(5) ^ crc32(bytes)
}

/// Returns sample `index` of the reference windows.
pub fn sample(windows: &[u8], index: usize) -> [f32; 9] {
    core::array::from_fn(|axis| {
        let at = (index * 9 + axis) * 4 % windows.len();
        f32::from_le_bytes([windows[at], windows[at + 1], windows[at + 2], windows[at + 3]])
    })
}

/// Returns all scores for the int8 inputs.
pub fn of_network(blob: &[u8], inputs: &[u8]) -> u32 {
    let Ok(model) = Model::parse(blob) else { return 0 };
    let mut sum = 0;
    for row in inputs.chunks_exact(117) {
        let input: [i8; 117] = core::array::from_fn(|i| row[i] as i8);
        let mut scores = [0i8; 7];
        let _ = model.infer(&input, &mut scores);
        sum = mix(sum, &scores.map(|score| score as u8));
    }
    sum
}

/// Like [`of_network`], but the blob is at an odd address, which selects another kernel with the same scores.
pub fn of_unaligned_network(blob: &[u8], inputs: &[u8]) -> u32 {
    let mut memory = [0; 8192];
    let Some(shifted) = memory.get_mut(1..=blob.len()) else { return 0 };
    shifted.copy_from_slice(blob);
    of_network(shifted, inputs)
}

/// Returns checksums of all feature bits, and of the scores that a model gives for these features.
pub fn of_features(blob: &[u8], windows: &[u8]) -> (u32, u32) {
    let Ok(model) = Model::parse(blob) else { return (0, 0) };
    let mut window = FeatureWindow::<9>::new();
    let (mut of_features, mut of_scores) = (0, 0);
    for index in 0..2 * windows.len() / 36 {
        if window.push(&sample(windows, index)) {
            for feature in window.features().as_flattened() {
                of_features = mix(of_features, &feature.to_bits().to_le_bytes());
            }
            let mut scores = [0i8; 7];
            let _ = model.classify(window.features(), &mut scores);
            of_scores = mix(of_scores, &scores.map(|score| score as u8));
        }
    }
    (of_features, of_scores)
}
