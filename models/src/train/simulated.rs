//! Windows of simulated wearers, which recipe `aligned` adds to those of the recordings.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use super::recipe::Shared;
use super::vary::{Kind, vary};
use crate::streams::RandomStream;
use crate::synth::{IdleKind, Motion, Segment, Wearer, session};
use crate::windows::{aligned_features, cut};

/// Duration of a simulated person's movement in seconds.
const SIMULATED_S: f64 = 8.0;
/// Number of varied copies of each window of a simulated gesture.
const COPIES_OF_SIMULATED: usize = 2;

/// The movements of simulated wearers who make no gestures, in sequence.
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

/// Returns features of windows in which `wearers` simulated people make no gesture.
/// Every training uses the same windows.
///
/// Recordings contain few movements without gestures, and the recordings of one person contain even fewer.
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

/// Returns features of windows in which `wearers` other simulated people make gestures, and of varied copies.
/// Every training uses the same windows. They cover the labels that the simulator supports.
/// Each window has the index of its label.
///
/// A few recorded people differ less from each other than the next person may differ from all of them.
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

/// Caches windows that are the same for every training.
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
        // Three people each have seven windows in 8 s, and two copies of each window.
        assert_eq!(of, [(63, 2), (63, 0)]);
        let count = shared_dsp::right::aligned::feature_count(6);
        assert!(shown.iter().all(|(windows, _)| windows.iter().all(|window| window.len() == count)));
        assert_eq!(shown, performed(6, 3, &labels), "every training sees the same");
    }
}
