//! Tests that the data of a held-out person is not used: the files are not opened before the model is complete.
//!
//! The recordings in this test are synthetic. `models people` calculates results for real people (see its help).

mod common;

use std::path::Path;

use common::folder;
use models::daily::Daily;
use models::evaluate::people::Trial;
use models::train::{ALIGNED, Aligned, Epochs, LOG_POWER, PAPER, PerAxis, Recipe, Steps, adapt, examples_of};

/// The aligned recipe with shorter training, because the duration of training does not affect this test.
fn recipe() -> Aligned {
    let steps = Steps { count: 150, most: 150, rounded: 60, ..Steps::TRAIN };
    Aligned { steps, bystanders: 5, performers: 5, ..ALIGNED }
}

fn trial<'a>(folder: &'a Path, recipe: &'a dyn Recipe) -> Trial<'a> {
    Trial { folder, axes: None, labels: &[], recipe }
}

/// Makes every file of a person unreadable, so that opening any of them causes an error.
fn spoil(folder: &Path, person: &str) {
    let mut spoiled = 0;
    for label in ["circle", "leftright", "idle"] {
        for take in 0..4 {
            std::fs::write(folder.join(format!("{label}/{person}__{take}.csv")), "not a recording").unwrap();
            spoiled += 1;
        }
    }
    assert_eq!(spoiled, 12);
}

#[test]
fn no_file_of_a_person_held_out_touches_the_model_whatever_the_recipe() {
    // Recipes are constants that do not depend on data.
    // All effects of the data are in the model: input scaling, early stopping, weights, quantisation and the data for
    // adaptation.
    let short = |recipe: PerAxis| PerAxis { epochs: Epochs { most: 6, ..recipe.epochs }, ..recipe };
    let (aligned, log_power, paper) = (recipe(), short(LOG_POWER), short(PAPER));
    let recipes: [&dyn Recipe; 3] = [&aligned, &log_power, &paper];
    let data = folder();
    let train = |recipe: &dyn Recipe| trial(data.path(), recipe).without("b", 1).unwrap();
    let clean: Vec<_> = recipes.into_iter().map(train).collect();
    spoil(data.path(), "b");
    for (recipe, clean) in recipes.into_iter().zip(clean) {
        let same = train(recipe);
        assert_eq!(same.int8_tflite, clean.int8_tflite, "{}: weights and their quantisation", recipe.name());
        assert_eq!(same.float_tflite, clean.float_tflite, "{}: weights", recipe.name());
        assert_eq!(same.card, clean.card, "{}: scaling, stopping, data and all else", recipe.name());
        assert_eq!(same.memory, clean.memory, "{}: what it remembers", recipe.name());
        assert!(!same.card.data.people.contains_key("b"));
        assert!(
            trial(data.path(), recipe).without("a", 1).is_err(),
            "the spoiled files do stop a model that needs them"
        );
    }
}

#[test]
fn the_tool_does_not_open_the_files_of_a_person_left_out() {
    let data = folder();
    let out = tempfile::tempdir().unwrap();
    let models = |name: &str, person: &str| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_models"));
        command.arg("train").arg(data.path()).arg("--out").arg(out.path());
        command.args(["--steps", "60", "--name", name, "--exclude-person", person]);
        command.output().unwrap().status.success()
    };
    assert!(models("clean", "b"));
    spoil(data.path(), "b");
    assert!(models("again", "b"));
    let read = |name: &str| std::fs::read(out.path().join(name)).unwrap();
    assert_eq!(read("clean.tflite"), read("again.tflite"));
    assert_eq!(read("clean.memory.bin"), read("again.memory.bin"));
    assert!(!models("needs-them", "a"));
}

#[test]
fn a_stranger_is_recognised_and_the_networks_agree() {
    let data = folder();
    let recipe = recipe();
    for person in ["a", "b", "c"] {
        let accuracy = trial(data.path(), &recipe).stranger(person, 1).unwrap().accuracy();
        assert!(accuracy.float >= 90.0 && accuracy.int8 >= 90.0, "{person}: {accuracy:?}");
    }
}

#[test]
fn a_model_learns_one_more_person_and_keeps_labels_and_scaling() {
    let data = folder();
    let recipe = recipe();
    let trial = trial(data.path(), &recipe);
    let model = trial.without("b", 1).unwrap();
    let theirs = models::dataset::Dataset::read_where(data.path(), None, |_, person| person == "b").unwrap();
    let examples: Vec<_> = theirs
        .items
        .iter()
        .filter(|item| item.name.ends_with("b__0.csv"))
        .flat_map(|item| {
            let label = model.card.labels.iter().position(|label| *label == item.label).unwrap();
            examples_of(&item.recording).into_iter().map(move |window| (window, label))
        })
        .collect();
    assert_eq!(examples.len(), 12, "three recordings of 5 s have four windows each");
    let widths: Vec<usize> = model.float.iter().map(|layer| layer.biases.len()).collect();
    assert_eq!(widths[..2], models::ALIGNED_HIDDEN, "the shape whose cost on the board is tested");
    let memory = model.memory.as_ref().unwrap();
    let adapted = adapt(&model, memory, &examples, "b", &Daily::All, 1).unwrap();
    assert_ne!(adapted.int8_tflite, model.int8_tflite);
    assert_ne!(adapted.card.model_id, model.card.model_id);
    assert_eq!((&adapted.card.labels, &adapted.card.scaling), (&model.card.labels, &model.card.scaling));
    assert_eq!(adapted.card.data.people["b"], 12);
    assert!(models::evaluate::people::grade(&adapted, &theirs).unwrap().accuracy().int8 >= 90.0);
    let limit = model.card.scaling.limit;
    let (before, now) = (memory.accuracy(&model.float, limit), memory.accuracy(&adapted.float, limit));
    assert!(now >= before - 1.0, "the others: {before} % before, {now} % now");
}

#[test]
fn a_memory_survives_its_file_and_damage_is_named() {
    let data = folder();
    let recipe = recipe();
    let model = trial(data.path(), &recipe).without("b", 1).unwrap();
    let memory = model.memory.unwrap();
    let bytes = memory.to_bytes();
    assert_eq!(models::train::Memory::parse(&bytes, &model.card).unwrap(), memory);
    for (damaged, word) in
        [(&bytes[..bytes.len() - 1], "cut short"), (&bytes[..9], "cut short"), (b"BIMAN", "no memory")]
    {
        let text = models::train::Memory::parse(damaged, &model.card).unwrap_err().to_string();
        assert!(text.contains(word), "{text}");
    }
}
