//! A model's memory of its training people, which prevents forgetting during adaptation.

use rand::Rng;
use rand_chacha::ChaCha8Rng;

use crate::card::Card;
use crate::tflite::FloatLayer;

/// Number of rows in a model's memory.
#[cfg(feature = "train")]
const MEMORY_ROWS: usize = 4096;

/// Inputs from a model's training people, with the same number of rows for each label.
#[derive(Clone, Debug, PartialEq)]
pub struct Memory {
    /// Int8 inputs, each of which is round(input / limit · 127), and their label.
    rows: Vec<(Vec<i8>, u8)>,
}

/// The reason why a memory file cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct MemoryError(String);

const MAGIC: &[u8; 8] = b"BIMANMEM";

impl Memory {
    #[cfg(feature = "train")]
    pub(super) fn new(rows: &[(Vec<f32>, usize)], labels: usize, limit: f32, seed: u64) -> Self {
        let mut rng = crate::streams::RandomStream::Memory.of(seed);
        let chosen = balanced(rows.iter().map(|(_, label)| *label), labels, MEMORY_ROWS, &mut rng);
        let int8 = |value: &f32| (value / limit * 127.0).round().clamp(-127.0, 127.0) as i8;
        let row = |index: usize| (rows[index].0.iter().map(int8).collect(), rows[index].1 as u8);
        Self { rows: chosen.into_iter().map(row).collect() }
    }

    /// Rows of inputs, and their labels.
    pub(super) fn inputs(&self, limit: f32) -> Vec<(Vec<f32>, usize)> {
        let float = |value: &i8| f32::from(*value) * limit / 127.0;
        self.rows.iter().map(|(row, label)| (row.iter().map(float).collect(), usize::from(*label))).collect()
    }

    /// Returns the bytes of `NAME.memory.bin`.
    /// The bytes start with `BIMANMEM` and the numbers of rows and of inputs per row (u32 little-endian).
    /// After these, each row has its label and its inputs.
    pub fn to_bytes(&self) -> Vec<u8> {
        let width = self.rows.first().map_or(0, |(row, _)| row.len());
        let mut bytes = MAGIC.to_vec();
        bytes.extend((self.rows.len() as u32).to_le_bytes());
        bytes.extend((width as u32).to_le_bytes());
        for (row, label) in &self.rows {
            bytes.push(*label);
            bytes.extend(row.iter().map(|value| *value as u8));
        }
        bytes
    }

    /// Parses the bytes of a memory file that belongs to a model with this card.
    ///
    /// # Errors
    /// Fails if the bytes are not a memory file, are damaged, or belong to another model.
    pub fn parse(bytes: &[u8], card: &Card) -> Result<Self, MemoryError> {
        let error =
            |what: &str| MemoryError(format!("{what}; copy the .memory.bin again or train the model again"));
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| error("this is no memory of a model"))?;
        let (sizes, rest) = rest.split_first_chunk::<8>().ok_or_else(|| error("the memory is cut short"))?;
        let [a, b, c, d, e, f, g, h] = *sizes;
        let (rows, width) =
            (u32::from_le_bytes([a, b, c, d]) as usize, u32::from_le_bytes([e, f, g, h]) as usize);
        if width != card.scaling.mean.len() {
            return Err(error(&format!(
                "the memory has {width} inputs, the model {}",
                card.scaling.mean.len()
            )));
        }
        if rows == 0 || Some(rest.len()) != rows.checked_mul(width + 1) {
            return Err(error("the memory is cut short"));
        }
        let rows: Vec<(Vec<i8>, u8)> = rest
            .chunks_exact(width + 1)
            .map(|row| (row[1..].iter().map(|value| *value as i8).collect(), row[0]))
            .collect();
        if rows.iter().any(|(_, label)| usize::from(*label) >= card.labels.len()) {
            return Err(error("the memory names a label that the model does not have"));
        }
        Ok(Self { rows })
    }

    /// Returns the percentage of rows that a network classifies correctly.
    pub fn accuracy(&self, layers: &[FloatLayer], limit: f32) -> f64 {
        let rows = self.inputs(limit);
        let right = rows.iter().filter(|(input, label)| {
            let scores = crate::tflite::infer_float(layers, input);
            (0..scores.len()).all(|n| n == *label || scores[n] < scores[*label])
        });
        100.0 * right.count() as f64 / rows.len().max(1) as f64
    }
}

/// Draws the indices of `count` rows with replacement, equally many rows for each label.
pub(super) fn balanced(
    labels: impl Iterator<Item = usize>,
    kinds: usize,
    count: usize,
    rng: &mut ChaCha8Rng,
) -> Vec<usize> {
    let mut of_label = vec![Vec::new(); kinds];
    for (index, label) in labels.enumerate() {
        of_label[label].push(index);
    }
    of_label.retain(|indices| !indices.is_empty());
    if of_label.is_empty() {
        return Vec::new();
    }
    (0..count)
        .map(|n| {
            let indices = &of_label[n % of_label.len()];
            indices[rng.random_range(0..indices.len())]
        })
        .collect()
}
