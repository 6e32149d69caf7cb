//! Tests the bundled model: its files are consistent, state their origin, and give good results for new wearers.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use models::dataset::{Dataset, Item};
use models::evaluate::events::{AnnotatedRecording, Tally, play};
use models::evaluate::score::{Classifier, score, scored};
use models::synth::{Group, Take, Wearer, session, takes};
use models::{blob, bundled, labels};
use shared_dsp::right::network::{Model, crc32};
use shared_words::is_rest;

#[path = "common/shared.rs"]
mod shared;
#[path = "common/tool.rs"]
mod tool;

use shared::shared;
use tool::good;

const BUNDLED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/bundled/right-aligned.tflite");

#[test]
fn the_blob_follows_from_file_and_card_and_its_id_is_the_cards() {
    let files = bundled::files().unwrap();
    let made = bundled::blob().unwrap();
    assert_eq!(made, files.blob().unwrap());
    assert_eq!(format!("{:08x}", crc32(&made)), files.card.model_id);
    assert_eq!(blob::read(Path::new(BUNDLED)).unwrap().0, made);
    let model = Model::parse(&made).unwrap();
    // `other` stands for movements that are not gestures. Like `idle`, it never causes an event.
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

/// Recordings of 20 wearers on whom no model was trained, with each gesture and each type of other movement.
/// Incomplete gestures are tested separately, with the decision (`sessions.rs`).
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
    // These figures are only lower limits. The README contains the measured values.
    for (untaught, floor) in [(false, 97.0), (true, 94.0)] {
        let recordings = scored(&recordings(untaught), &card.labels, &card.features);
        // The scores are computed as on a board, where all labels compete and every other movement counts as rest.
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

/// Tests real recordings of the same board and sensor, by people who are not in the training data.
#[test]
fn real_circles_are_circles_and_three_that_are_shown_make_it_sure() {
    let Some(folder) = shared("data/nano33-lsm9ds1-9axis") else { return };
    let files = bundled::files().unwrap();
    let card = &files.card;
    let made = files.blob().unwrap();
    let model = Model::parse(&made).unwrap();
    let real = Dataset::read_where(&folder, Some(9), |_, _| true).unwrap();
    let circles = real.filtered(|item| item.label == "circle");
    let recordings = scored(&circles, &card.labels, &card.features);
    let result = score(&Classifier::Int8(model), &recordings, &card.answers());
    println!("{:.2} % of {} circles", result.per_recording, recordings.len());
    assert!(recordings.len() >= 100 && result.per_recording >= 90.0, "{:.2} %", result.per_recording);

    // The model is adapted with three circles of one of the two people.
    let shown: Vec<&Item> = circles.items.iter().filter(|item| item.person == "s1").take(3).collect();
    let out = tempfile::tempdir().unwrap();
    let path = |name: &str| out.path().join(name).to_string_lossy().into_owned();
    std::fs::create_dir_all(path("few/circle")).unwrap();
    for item in &shown {
        std::fs::copy(&item.file, out.path().join("few").join(&item.name)).unwrap();
    }
    good(&["adapt", BUNDLED, &path("few"), "--person", "s1", "--out", &path("mine"), "--name", "mine"]);
    let (adapted, _) = blob::read(&out.path().join("mine/mine.tflite")).unwrap();

    let people: BTreeSet<&String> = real.items.iter().map(|item| &item.person).collect();
    for (what, blob, floor) in [("as it is", &made, 50.0), ("with three circles shown", &adapted, 85.0)] {
        let model = Model::parse(blob).unwrap();
        let mut tally = Tally::default();
        for person in &people {
            let is_theirs = |item: &&Item| {
                item.person == **person
                    && ["circle", "other"].contains(&&*item.label)
                    && shown.iter().all(|shown| shown.name != item.name)
            };
            let joined =
                AnnotatedRecording::joined(&real.items.iter().filter(is_theirs).collect::<Vec<_>>(), 9, 1);
            tally.count(&joined, &play(model, &joined).unwrap(), &card.labels);
        }
        println!(
            "{what}: {} of {} circles make one right event, {:.1} %; {} events in {} recordings of other movement",
            tally.right,
            tally.performed,
            tally.right_per_cent(),
            tally.rest_events,
            tally.rests
        );
        assert!(tally.right_per_cent() >= floor && tally.wrong + tally.several <= 3, "{:?}", tally.errors);
        assert!(tally.rest_events <= 3, "{} in {}", tally.rest_events, tally.rests);
    }
}

#[test]
fn it_learns_one_more_person_and_forgets_nobody() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let new = ["--group", "evaluation", "--wearers", "1", "--untaught", "1", "--seconds", "4"];
    good(&[&["synth", "--out", &path("new")][..], &new].concat());
    let text = good(&["adapt", BUNDLED, &path("new"), "--person", "e0001", "--out", &path("mine")]);
    println!("{text}");
    // "...: 93.21 % right before, 96.44 % now"
    for what in ["rehearsed windows of the people it knew", "the shown recordings themselves"] {
        let line = text.lines().find(|line| line.starts_with(what)).unwrap();
        let figures: Vec<f64> = line.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        let [before, now] = figures[..] else { panic!("{line}") };
        assert!(now >= before - 1.0, "{line}");
    }
    assert!(blob::read(&folder.path().join("mine/right-aligned-e0001.tflite")).is_ok());
}
