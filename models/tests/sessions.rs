//! Whole sessions of unseen simulated wearers through the bundled model and the decision that the
//! board makes, sample by sample.

use std::path::PathBuf;

use models::synth::{IdleKind, Motion, Segment, Wearer, session};
use shared_dsp::decision::DecisionConfig;
use shared_dsp::mlp::Model;
use shared_dsp::right::RightHand;

#[derive(Debug, Default)]
struct Tally {
    performed: usize,
    right_once: usize,
    wrong: usize,
    outside: usize,
    delays_s: Vec<f64>,
}

/// The six gestures, 5 s each, with 7 s of various idle movement between.
fn play(model: Model<'_>, wearer: &Wearer, take: u64, config: DecisionConfig, tally: &mut Tally) {
    let mut script = vec![Segment::new(Motion::IDLE, 5.0)];
    for (n, gesture) in Motion::GESTURES.into_iter().enumerate() {
        let idle = if n % 2 == 0 { IdleKind::Still } else { IdleKind::ALL[(n + take as usize) % 5] };
        script.push(Segment::new(gesture, 5.0));
        script.push(Segment::new(Motion::Idle(idle), 7.0));
    }
    let recording = session(wearer, take, &script);
    let mut hand = RightHand::<9>::new(model, config).expect("9 axes");
    let mut events = Vec::new();
    for (n, sample) in recording.samples().enumerate() {
        let sample = sample.first_chunk().expect("9 axes");
        if let Some(output) = hand.push(sample, n as u32 * 10)
            && output.is_event
        {
            events.push((n as f64 / 100.0, usize::from(output.label)));
        }
    }
    let labels: Vec<&str> = model.info().labels().collect();
    let mut during = 0;
    for (n, gesture) in Motion::GESTURES.into_iter().enumerate() {
        let onset_s = 5.0 + 12.0 * n as f64;
        // A gesture just ended still fills part of the window.
        let of_this: Vec<_> =
            events.iter().filter(|(at_s, _)| (onset_s..onset_s + 6.0).contains(at_s)).collect();
        during += of_this.len();
        tally.performed += 1;
        match of_this.as_slice() {
            [(at_s, label)] if labels[*label] == gesture.label() => {
                tally.right_once += 1;
                tally.delays_s.push(at_s - onset_s);
            }
            others => {
                tally.wrong += 1;
                let got: Vec<_> = others.iter().map(|(at_s, l)| (at_s - onset_s, labels[*l])).collect();
                println!("{} take {take}: {} gave {got:?}", wearer.name, gesture.label());
            }
        }
    }
    if events.len() > during {
        println!("{} take {take}: outside gestures {events:?}", wearer.name);
    }
    tally.outside += events.len() - during;
}

fn bundled() -> Vec<u8> {
    let file = std::env::var_os("BIMANUAL_MODEL")
        .map(PathBuf::from)
        .unwrap_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("bundled/right-9axis.tflite"));
    models::blob::read(&file).expect("the bundled model").0
}

/// The floor for events; measured is more (README). The rest are mostly gestures taken for another one in
/// their first second, before the window is full of them.
const FLOOR_PER_CENT: usize = 94;

#[test]
fn demo_wearer_2_gets_one_right_event_for_every_gesture() {
    let blob = bundled();
    let mut tally = Tally::default();
    play(Model::parse(&blob).unwrap(), &Wearer::demo(2), 0, DecisionConfig::default(), &mut tally);
    assert_eq!((tally.right_once, tally.wrong, tally.outside), (6, 0, 0));
}

#[test]
fn demo_wearers_get_one_right_event_for_almost_every_gesture() {
    let blob = bundled();
    let model = Model::parse(&blob).unwrap();
    let mut tally = Tally::default();
    for index in 1..=20 {
        play(model, &Wearer::demo(index), 0, DecisionConfig::default(), &mut tally);
    }
    println!("{} of {} right, {} outside", tally.right_once, tally.performed, tally.outside);
    assert!(tally.right_once * 100 >= tally.performed * FLOOR_PER_CENT);
    assert!(tally.outside <= 4, "{} events outside gestures", tally.outside);
}

#[test]
fn unseen_wearers_get_one_right_event_for_almost_every_gesture() {
    let blob = bundled();
    let model = Model::parse(&blob).unwrap();
    let mut tally = Tally::default();
    for index in 1..=60 {
        play(model, &Wearer::evaluation(9, index), u64::from(index), DecisionConfig::default(), &mut tally);
    }
    tally.delays_s.sort_by(f64::total_cmp);
    let median_s = tally.delays_s[tally.delays_s.len() / 2];
    println!(
        "{} of {} right, {} outside, median {median_s:.2} s",
        tally.right_once, tally.performed, tally.outside
    );
    assert!(
        tally.right_once * 100 >= tally.performed * FLOOR_PER_CENT,
        "{} of {}",
        tally.right_once,
        tally.performed
    );
    assert!(tally.outside <= 8, "{} events outside gestures", tally.outside);
    assert!(median_s <= 2.5, "{median_s} s from onset to event");
}
