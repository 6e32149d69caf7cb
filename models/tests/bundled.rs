//! The bundled model: its files belong together, say where they come from, and work on new wearers.

use std::collections::BTreeMap;
use std::path::PathBuf;

use models::dataset::{Dataset, Item};
use models::score::{Classifier, score, scored};
use models::synth::{Group, Wearer, session, takes};
use models::{blob, bundled, labels};
use shared_dsp::mlp::{Model, crc32};

#[test]
fn the_blob_follows_from_file_and_card_and_its_id_is_the_cards() {
    let files = bundled::files().unwrap();
    let made = bundled::blob().unwrap();
    assert_eq!(made, files.blob().unwrap());
    assert_eq!(format!("{:08x}", crc32(&made)), files.card.model_id);
    let on_disk = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("bundled/right-9axis.tflite");
    assert_eq!(blob::read(&on_disk).unwrap().0, made);
    let model = Model::parse(&made).unwrap();
    assert_eq!(model.info().labels().collect::<Vec<_>>(), labels::PAPER);
    assert_eq!(
        (model.info().axes, model.info().sample_hz, model.info().window, model.info().hop),
        (9, 100, 200, 8)
    );
}

#[test]
fn the_card_says_that_the_wearers_are_simulated_and_none_is_a_demo_wearer() {
    let card = bundled::files().unwrap().card;
    assert!(card.about.starts_with("simulated wearers, not real people: models synth --group training"));
    assert!(card.data.people.keys().all(|name| name.starts_with(Group::Training.letter())));
    let demo = Wearer::demo(1).name;
    assert!(!card.data.people.contains_key(&demo));
}

#[test]
fn wearers_that_it_never_met_are_understood() {
    // The floor is decided here; the measured figure stands in the README.
    const FLOOR: f64 = 97.0;
    let mut items = Vec::new();
    for index in 1..=20 {
        let wearer = Wearer::evaluation(77, index);
        for (number, take) in takes(8.0).iter().enumerate() {
            items.push(Item {
                file: PathBuf::new(),
                name: format!("{}/{}__{:03}.csv", take.label, wearer.name, take.number),
                label: take.label.to_owned(),
                person: wearer.name.clone(),
                recording: session(&wearer, number as u64, &take.script),
            });
        }
    }
    let files = bundled::files().unwrap();
    let labels = files.card.labels.clone();
    let dataset = Dataset {
        folder: PathBuf::new(),
        items,
        labels: labels.clone(),
        axes: 9,
        ignored: Vec::new(),
        narrowed: 0,
    };
    let made = files.blob().unwrap();
    let recordings = scored(&dataset, &labels, &files.card.features);
    let result = score(&Classifier::Int8(Model::parse(&made).unwrap()), &recordings, &files.card.answers());
    println!("per window {:.2} %, per recording {:.2} %", result.per_window, result.per_recording);
    assert!(result.per_window >= FLOOR, "{:.2} % of windows", result.per_window);
    assert!(result.per_recording >= FLOOR, "{:.2} % of recordings", result.per_recording);
    let gestures: BTreeMap<&String, usize> =
        labels.iter().zip(&result.confusion).map(|(label, row)| (label, row.iter().sum())).collect();
    assert!(gestures.values().all(|count| *count >= 20), "every class is tried: {gestures:?}");
}
