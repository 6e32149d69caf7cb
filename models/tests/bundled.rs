//! The bundled model: its files belong together, say where they come from, and work on new wearers.

use std::path::PathBuf;

use models::dataset::{Dataset, Item};
use models::score::{Classifier, score, scored};
use models::synth::{Group, Take, Wearer, session, takes};
use models::{blob, bundled, labels};
use shared_dsp::decision::is_rest;
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
    // `other` is what a hand does that makes none of the gestures: like `idle` it never makes an event.
    let labels: Vec<_> = model.info().labels().collect();
    assert_eq!(labels, [labels::PAPER.as_slice(), &["other"]].concat());
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

/// Recordings of 20 wearers that no model learns from: each gesture, and each kind of movement that is none. What to
/// make of a gesture that has only just begun is for the decision (`sessions.rs`).
fn recordings(untaught: bool) -> Dataset {
    let mut items = Vec::new();
    for index in 1..=20 {
        let wearer = Wearer::evaluation(77, index);
        let wearer = if untaught { wearer.untaught() } else { wearer };
        let whole = |take: &Take| take.number < Take::FIRST_PART;
        for (number, take) in takes(8.0).iter().enumerate().filter(|(_, take)| whole(take)) {
            items.push(Item {
                file: PathBuf::new(),
                name: format!("{}/{}__{:03}.csv", take.label, wearer.name, take.number),
                label: take.label.to_owned(),
                person: wearer.name.clone(),
                recording: session(&wearer, number as u64, &take.script),
            });
        }
    }
    let labels = labels::PAPER.map(String::from).to_vec();
    Dataset { folder: PathBuf::new(), items, labels, axes: 9, ignored: Vec::new(), narrowed: 0 }
}

#[test]
fn wearers_that_it_never_met_are_understood() {
    let files = bundled::files().unwrap();
    let card = &files.card;
    let made = files.blob().unwrap();
    let network = Classifier::Int8(Model::parse(&made).unwrap());
    let is_rest: Vec<bool> = card.labels.iter().map(|label| is_rest(label)).collect();
    // The floors are decided here; the measured figures stand in the README.
    for (untaught, floor) in [(false, 97.0), (true, 94.0)] {
        let recordings = scored(&recordings(untaught), &card.labels, &card.features);
        // As on a board, where all labels compete and whatever is no gesture is rest.
        let result = score(&network, &recordings, &vec![true; card.labels.len()]);
        let (mut all, mut right) = (0, 0);
        for (truth, given) in result.confusion.iter().enumerate() {
            let count: usize = given.iter().sum();
            assert!(count >= 20 || card.labels[truth] == "other", "{} is tried", card.labels[truth]);
            all += count;
            right += (0..given.len())
                .filter(|&label| label == truth || (is_rest[label] && is_rest[truth]))
                .map(|label| given[label])
                .sum::<usize>();
        }
        let per_cent = 100.0 * right as f64 / all as f64;
        println!("untaught: {untaught}: {right} of {all} recordings, {per_cent:.2} %");
        assert!(per_cent >= floor, "{per_cent:.2} %");
    }
}
