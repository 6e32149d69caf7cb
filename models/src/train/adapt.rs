//! Teaching a model of recipe `aligned` one more person.

use super::fit::{Steps, refit};
use super::memory::{Memory, balanced};
use super::vary::{Kind, vary};
use super::{TrainError, Trained};
use crate::WINDOW;
use crate::card::Card;
use crate::daily::Daily;
use crate::labels::OTHER;
use crate::streams::RandomStream;
use crate::windows::{aligned_features, cut, prepare};

/// Varied copies of each window of a new person.
const COPIES_OF_NEW: usize = 60;

/// Teaches a model one more person from a few windows of them, [`WINDOW`] samples one after the other, with their
/// labels. Everything else stays: labels, scaling, and by rehearsal what it knows of the others; and what `daily` shows
/// stays no gesture: without it, getting up from a chair becomes a circle once three circles have been shown.
///
/// # Errors
/// If the result cannot be quantised.
pub fn adapt(
    model: &Trained,
    memory: &Memory,
    examples: &[(Vec<f32>, usize)],
    person: &str,
    daily: &Daily,
    seed: u64,
) -> Result<Trained, TrainError> {
    // Next to 4,096 rows of what the model remembers, a quarter is enough; with all of it the model doubts the new examples.
    let daily: Vec<Vec<f32>> = daily.rows(model.card.axes).into_iter().step_by(4).collect();
    let rows = rows(&model.card, memory, examples, &daily, seed);
    let (labels, limit) = (model.card.labels.len(), model.card.scaling.limit);
    let layers = refit(&rows, labels, &model.float, &Steps::ADAPT, limit, seed);
    let mut card = Card {
        about: format!("{}; adapted to {person} with {} windows", model.card.about, examples.len()),
        test: None,
        validation: None,
        ..model.card.clone()
    };
    *card.data.people.entry(person.to_owned()).or_default() += examples.len();
    let calibration: Vec<&[f32]> = rows.iter().map(|(input, _)| input.as_slice()).collect();
    Trained::of(card, layers, &calibration, Some(memory.clone()))
}

/// The windows of a recording that [`adapt`] learns from: one each second.
pub fn examples_of(recording: &crate::recording::Recording) -> Vec<Vec<f32>> {
    cut(&prepare(recording).0)
}

/// The inputs that a network is fitted to for one more person, with their labels: half of what it sees is new, half is what
/// it remembers.
fn rows(
    card: &Card,
    memory: &Memory,
    examples: &[(Vec<f32>, usize)],
    daily: &[Vec<f32>],
    seed: u64,
) -> Vec<(Vec<f32>, usize)> {
    let mut rng = RandomStream::Adapting.of(seed);
    let mut new = Vec::new();
    for (window, label) in examples {
        let kind = Kind::of(&card.labels[*label]);
        // As many axes as the recipe reads, which may be fewer than the model's board has.
        let axes = window.len() / WINDOW;
        let mut add = |window: &[f32]| {
            new.push((crate::evaluate::score::standardise(card, &aligned_features(axes, window)), *label));
        };
        add(window);
        for _ in 0..COPIES_OF_NEW {
            add(&vary(window, axes, kind, &mut rng));
        }
    }
    let mut rows = memory.inputs(card.scaling.limit);
    let chosen = balanced(new.iter().map(|(_, label)| *label), card.labels.len(), rows.len(), &mut rng);
    rows.extend(chosen.into_iter().map(|index| new[index].clone()));
    if let Some(other) = card.labels.iter().position(|label| label == OTHER) {
        rows.extend(daily.iter().map(|row| (crate::evaluate::score::standardise(card, row), other)));
    }
    rows
}
