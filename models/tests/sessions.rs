//! Tests the bundled model and the board's decision on complete sessions of new simulated wearers, sample by sample.

use std::path::PathBuf;

use models::evaluate::events::{self, AnnotatedRecording};
use models::synth::{IdleKind, Motion, Segment, Wearer, session};
use shared_dsp::right::network::Model;

#[derive(Debug, Default)]
struct Tally {
    performed: usize,
    right_once: usize,
    wrong: usize,
    outside: usize,
    delays_s: Vec<f64>,
}

/// Duration of the rest before and after each movement between two gestures, in s. A movement ends when the hand rests.
const REST_S: f64 = 1.0;

/// Plays the six gestures for 5 s each. Between them are 5 s of various idle movement and two rests.
fn play(model: Model<'_>, wearer: &Wearer, take: u64, tally: &mut Tally) {
    let mut script = vec![Segment::new(Motion::IDLE, 5.0)];
    for (n, gesture) in Motion::GESTURES.into_iter().enumerate() {
        let idle = if n % 2 == 0 { IdleKind::Still } else { IdleKind::ALL[(n + take as usize) % 5] };
        script.push(Segment::new(gesture, 5.0));
        script.push(Segment::new(Motion::IDLE, REST_S));
        script.push(Segment::new(Motion::Idle(idle), 5.0));
        script.push(Segment::new(Motion::IDLE, REST_S));
    }
    let recording = session(wearer, take, &script);
    let values = recording.samples().flatten().copied().collect();
    let joined = AnnotatedRecording { axes: recording.axes(), values, annotations: Vec::new() };
    let events = events::play(model, &joined).expect("9 axes");
    let events: Vec<_> = events.into_iter().map(|(n, label)| (n as f64 / 100.0, label)).collect();
    let labels: Vec<&str> = model.info().labels().collect();
    let mut during = 0;
    for (n, gesture) in Motion::GESTURES.into_iter().enumerate() {
        let onset_s = 5.0 + 12.0 * n as f64;
        // A gesture that has just ended is still in a part of the window.
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
        .unwrap_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("bundled/right-aligned.tflite"));
    models::blob::read(&file).expect("the bundled model").0
}

#[test]
fn demo_wearer_2_gets_one_right_event_for_every_gesture() {
    let blob = bundled();
    let mut tally = Tally::default();
    play(Model::parse(&blob).unwrap(), &Wearer::demo(2), 0, &mut tally);
    assert_eq!((tally.right_once, tally.wrong, tally.outside), (6, 0, 0));
}

/// Plays wearers and compares the result with a lower limit.
/// The README contains the measured value, which exceeds the limit.
fn at_least(per_cent: usize, wearers: impl Iterator<Item = (Wearer, u64)>) {
    let blob = bundled();
    let model = Model::parse(&blob).unwrap();
    let mut tally = Tally::default();
    for (wearer, take) in wearers {
        play(model, &wearer, take, &mut tally);
    }
    let Tally { performed, right_once, outside, delays_s, .. } = &mut tally;
    delays_s.sort_by(f64::total_cmp);
    let median_s = delays_s[delays_s.len() / 2];
    println!("{right_once} of {performed} right, {outside} outside, median {median_s:.2} s");
    assert!(*right_once * 100 >= *performed * per_cent, "{right_once} of {performed}");
    assert!(*outside * 60 <= *performed, "{outside} events outside of {performed} gestures");
    assert!(median_s <= 2.5, "{median_s} s from onset to event");
}

#[test]
fn demo_wearers_get_one_right_event_for_almost_every_gesture() {
    at_least(94, (1..=20).map(|index| (Wearer::demo(index), 0)));
}

#[test]
fn unseen_wearers_get_one_right_event_for_almost_every_gesture() {
    at_least(94, (1..=60).map(|index| (Wearer::evaluation(9, index), u64::from(index))));
}

#[test]
fn wearers_whom_nobody_told_how_to_move_get_one_for_most() {
    at_least(90, (1..=60).map(|index| (Wearer::evaluation(9, index).untaught(), u64::from(index))));
}

#[test]
fn two_hours_of_movement_without_a_gesture_make_few_events() {
    let blob = bundled();
    let model = Model::parse(&blob).unwrap();
    let count = |index| events::play(model, &AnnotatedRecording::aimless(5, index, 600.0)).unwrap().len();
    let events: usize = (1..=12).map(count).sum();
    println!("{events} events in two hours without a gesture");
    // Simulated wearers handle objects all the time, which real people do not. Real daily movement causes no events (`models daily events`).
    // The limit is twice the previous limit (see README).
    // With the previous limit, a third of the real circles were not recognised.
    assert!(events <= 24, "{events}");
}
