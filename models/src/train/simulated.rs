//! Windows of simulated wearers, which recipe `aligned` learns beside those of the recordings.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use super::recipe::Shared;
use super::vary::{Kind, vary};
use crate::streams::RandomStream;
use crate::synth::{IdleKind, Motion, Segment, Wearer, session};
use crate::windows::{aligned_features, cut};

/// Length of what a simulated person does.
const SIMULATED_S: f64 = 8.0;
/// Varied copies of each window of a simulated person's gesture.
const COPIES_OF_SIMULATED: usize = 2;

/// Movements of simulated wearers without a gesture, one after the other.
const AIMLESS: [IdleKind; 10] = [
    IdleKind::Still,
    IdleKind::Fidget,
    IdleKind::Reach,
    IdleKind::Walk,
    IdleKind::Turn,
    IdleKind::Scatter,
    IdleKind::Scatter,
    IdleKind::Scatter,
    IdleKind::Shake,
    IdleKind::Shake,
];

/// Features of windows in which `wearers` simulated people move but make no gesture, the same for every training.
///
/// Few recordings show what a hand does when it makes no gesture, and those of one person little of it.
pub(super) fn aimless(axes: usize, wearers: u32) -> Shared {
    once(axes, wearers, "idle", || {
        let of_wearer = |index: u32| {
            let wearer = Wearer::training(0, index);
            let takes = AIMLESS.into_iter().enumerate();
            takes.flat_map(move |(take, kind)| {
                let script = [Segment::new(Motion::Idle(kind), SIMULATED_S)];
                let recording = session(&wearer, take as u64, &script).with_axes(axes);
                cut(&recording).into_iter().map(move |window| aligned_features(axes, &window))
            })
        };
        (1..=wearers).flat_map(of_wearer).collect()
    })
}

/// Features of windows in which `wearers` other simulated people make a gesture, and of varied copies, the same for every
/// training; for each of the labels that the simulator knows, with its place among them.
///
/// The people of a few recordings differ less from each other than the next one may from all of them.
pub(super) fn performed(axes: usize, wearers: u32, labels: &[String]) -> Vec<(Shared, usize)> {
    let of_gesture = |motion: Motion| {
        let label = labels.iter().position(|label| label == motion.label())?;
        let make = || {
            let of_wearer = |index: u32| {
                let wearer = Wearer::training(1, index).untaught();
                let script = [Segment::new(motion, SIMULATED_S)];
                let recording = session(&wearer, 0, &script).with_axes(axes);
                let mut rng = RandomStream::OfWearer.of(u64::from(index));
                cut(&recording).into_iter().flat_map(move |window| {
                    let varied =
                        [0; COPIES_OF_SIMULATED].map(|_| vary(&window, axes, Kind::Gesture, &mut rng));
                    let all = std::iter::once(window).chain(varied);
                    all.map(|window| aligned_features(axes, &window)).collect::<Vec<_>>()
                })
            };
            (1..=wearers).flat_map(of_wearer).collect()
        };
        Some((once(axes, wearers, motion.label(), make), label))
    };
    Motion::GESTURES.into_iter().filter_map(of_gesture).collect()
}

/// Windows that are the same for every training are made once.
fn once(axes: usize, wearers: u32, label: &'static str, make: impl FnOnce() -> Vec<Vec<f32>>) -> Shared {
    static MADE: Mutex<BTreeMap<(usize, u32, &str), Shared>> = Mutex::new(BTreeMap::new());
    let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
    Arc::clone(made.entry((axes, wearers, label)).or_insert_with(|| Arc::new(make())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn simulated_people_show_the_gestures_they_know_and_no_others() {
        let labels = ["circle", "idle", "left-right", "other", "wave"].map(String::from);
        let shown = performed(6, 3, &labels);
        let of: Vec<(usize, usize)> = shown.iter().map(|(windows, label)| (windows.len(), *label)).collect();
        // Seven windows in 8 s, and two copies of each, from each of three people.
        assert_eq!(of, [(63, 2), (63, 0)]);
        let count = shared_dsp::right::aligned::feature_count(6);
        assert!(shown.iter().all(|(windows, _)| windows.iter().all(|window| window.len() == count)));
        assert_eq!(shown, performed(6, 3, &labels), "every training sees the same");
    }
}
