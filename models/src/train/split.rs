//! Chooses the recordings to hold out, which are always complete.

use rand::seq::SliceRandom;

use crate::dataset::Dataset;
use crate::streams::RandomStream;

/// Returns the sorted names of the held-out recordings. The seed chooses a rounded `fraction` of each label.
/// A label with a single recording is not held out.
pub fn held_out(dataset: &Dataset, fraction: f64, seed: u64) -> Vec<String> {
    let mut chosen = Vec::new();
    for (place, label) in dataset.labels.iter().enumerate() {
        let of_label = dataset.items.iter().filter(|item| item.label == *label);
        let mut names: Vec<&String> = of_label.map(|item| &item.name).collect();
        names.shuffle(&mut RandomStream::HeldOut(place).of(seed));
        // At least one recording must remain for training.
        let count = ((names.len() as f64 * fraction).round() as usize).min(names.len().saturating_sub(1));
        chosen.extend(names.into_iter().take(count).cloned());
    }
    chosen.sort();
    chosen
}
