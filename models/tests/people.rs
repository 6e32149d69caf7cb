//! A person held out stays out: their files are not opened before the model is finished.
//!
//! Recordings here are synthetic; figures on real people come from `models people` (see its help).

use std::path::Path;

use models::people::Trial;
use models::train::{Recipe, Steps, adapt, examples_of};

/// Three people make circles (two axes in quadrature), swings (one axis) and rest; `b` is slower and smaller.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (p, (person, pace, size)) in
        [("a", 1.2, 4.0), ("b", 0.8, 2.5), ("c", 1.0, 3.2)].into_iter().enumerate()
    {
        for (l, label) in ["circle", "leftright", "idle"].into_iter().enumerate() {
            std::fs::create_dir_all(folder.path().join(label)).unwrap();
            for take in 0..4 {
                let mut text = String::from("timestamp_ms,accX,accY,accZ\n");
                for n in 0..500 {
                    let t = n as f64 / 100.0;
                    let phase = std::f64::consts::TAU * pace * t + f64::from(take);
                    let noise = 0.05 * (37.0 * t + (p * 7 + l * 3) as f64).sin();
                    let (x, z) = match label {
                        "circle" => (size * phase.sin(), size * phase.cos()),
                        "leftright" => (size * phase.sin(), 0.0),
                        _ => (0.0, 0.0),
                    };
                    text += &format!("{},{:.4},{:.4},{:.4}\n", n * 10, x + noise, noise, 9.8 + z);
                }
                std::fs::write(folder.path().join(format!("{label}/{person}__{take}.csv")), text).unwrap();
            }
        }
    }
    folder
}

/// The aligned recipe, shorter: what is tested does not depend on how long it trains.
fn recipe() -> Recipe {
    Recipe { steps: Some(Steps { count: 150, ..Steps::TRAIN }), ..Recipe::aligned() }
}

fn trial<'a>(folder: &'a Path, recipe: &'a Recipe) -> Trial<'a> {
    Trial { folder, axes: None, labels: &[], recipe }
}

#[test]
fn no_file_of_a_person_held_out_touches_the_model() {
    let data = folder();
    let recipe = recipe();
    let clean = trial(data.path(), &recipe).without("b", 1).unwrap();
    // Every file of theirs becomes unreadable as a recording: opening a single one would be an error.
    let mut spoiled = 0;
    for label in ["circle", "leftright", "idle"] {
        for take in 0..4 {
            std::fs::write(data.path().join(format!("{label}/b__{take}.csv")), "not a recording").unwrap();
            spoiled += 1;
        }
    }
    assert_eq!(spoiled, 12);
    let same = trial(data.path(), &recipe).without("b", 1).unwrap();
    assert_eq!(same.int8_tflite, clean.int8_tflite, "weights and their quantisation");
    assert_eq!(same.float_tflite, clean.float_tflite, "weights");
    assert_eq!(same.card.scaling, clean.card.scaling, "scaling");
    assert_eq!(same.memory, clean.memory, "what it remembers");
    assert!(!same.card.data.people.contains_key("b"));
    assert!(
        trial(data.path(), &recipe).without("a", 1).is_err(),
        "the spoiled files do stop a model that needs them"
    );
}

#[test]
fn a_stranger_is_recognised_and_the_networks_agree() {
    let data = folder();
    let recipe = recipe();
    for person in ["a", "b", "c"] {
        let accuracy = trial(data.path(), &recipe).stranger(person, 1).unwrap();
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
    let memory = model.memory.as_ref().unwrap();
    let adapted = adapt(&model, memory, &examples, "b", 1).unwrap();
    assert_ne!(adapted.int8_tflite, model.int8_tflite);
    assert_ne!(adapted.card.model_id, model.card.model_id);
    assert_eq!((&adapted.card.labels, &adapted.card.scaling), (&model.card.labels, &model.card.scaling));
    assert_eq!(adapted.card.data.people["b"], 12);
    assert!(models::people::accuracy(&adapted, &theirs).unwrap().int8 >= 90.0);
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
