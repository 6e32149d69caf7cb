//! Adapts a model of recipe `aligned` to another person.

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

/// Number of varied copies of each window that a new person shows.
const COPIES_OF_NEW: usize = 60;

/// Adapts a model to another person with a few windows ([`WINDOW`] samples each) and the windows' labels.
/// Labels and scaling remain unchanged, and rehearsal preserves the knowledge about other people.
/// The movement in `daily` still counts as no gesture. Otherwise, after three circles the model would mistake getting up
/// from a chair for a circle.
///
/// # Errors
/// Fails if the result cannot be quantised.
pub fn adapt(
    model: &Trained,
    memory: &Memory,
    examples: &[(Vec<f32>, usize)],
    person: &str,
    daily: &Daily,
    seed: u64,
) -> Result<Trained, TrainError> {
    // A quarter of the daily movement suffices beside 4,096 remembered rows.
    // With all of the daily movement, the model is less certain about the new examples.
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

/// Returns the windows of a recording that [`adapt`] learns from, one per second.
pub fn examples_of(recording: &crate::recording::Recording) -> Vec<Vec<f32>> {
    cut(&prepare(recording).0)
}

/// Returns the labelled inputs for training. Half of them are new, and half come from the memory.
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
        // The number of axes that the recipe reads. It may be smaller than the board's.
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
