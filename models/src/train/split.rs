//! Choosing recordings to hold out, always whole ones.

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::dataset::Dataset;

/// Names of the recordings that are held out: `fraction` of each label's, rounded, chosen by the
/// seed, sorted. A label with a single recording keeps it.
pub fn held_out(dataset: &Dataset, fraction: f64, seed: u64) -> Vec<String> {
    let mut chosen = Vec::new();
    for (stream, label) in dataset.labels.iter().enumerate() {
        let of_label = dataset.items.iter().filter(|item| item.label == *label);
        let mut names: Vec<&String> = of_label.map(|item| &item.name).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream((1 << 40) + stream as u64);
        names.shuffle(&mut rng);
        // At least one must stay to learn from.
        let count = ((names.len() as f64 * fraction).round() as usize).min(names.len().saturating_sub(1));
        chosen.extend(names.into_iter().take(count).cloned());
    }
    chosen.sort();
    chosen
}
