//! Choosing recordings to hold out, always whole ones.

use rand::seq::SliceRandom;

use crate::dataset::Dataset;
use crate::streams::RandomStream;

/// Names of the recordings that are held out: `fraction` of each label's, rounded, chosen by the
/// seed, sorted. A label with a single recording keeps it.
pub fn held_out(dataset: &Dataset, fraction: f64, seed: u64) -> Vec<String> {
    let mut chosen = Vec::new();
    for (place, label) in dataset.labels.iter().enumerate() {
        let of_label = dataset.items.iter().filter(|item| item.label == *label);
        let mut names: Vec<&String> = of_label.map(|item| &item.name).collect();
        names.shuffle(&mut RandomStream::HeldOut(place).of(seed));
        // At least one must remain to learn from.
        let count = ((names.len() as f64 * fraction).round() as usize).min(names.len().saturating_sub(1));
        chosen.extend(names.into_iter().take(count).cloned());
    }
    chosen.sort();
    chosen
}
