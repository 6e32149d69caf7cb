//! The report about the result of an import.

use std::collections::{BTreeMap, BTreeSet};

use models::edge_impulse::export::Part;
use models::recording::Recording;

/// Gravity in m/s².
const G: f32 = 9.806_65;
/// Ranges of accelerometers, in g.
const RANGES: [f32; 4] = [2.0, 4.0, 8.0, 16.0];

/// Collects it.
#[derive(Default)]
pub(super) struct Report {
    /// Inferences and repairs without their numbers, each with its first note and the names of its sources.
    notes: BTreeMap<String, (String, Vec<String>)>,
    labels: BTreeMap<(Option<Part>, String), Label>,
}

#[derive(Default)]
struct Label {
    recordings: usize,
    people: BTreeSet<String>,
    seconds: f64,
    slowest_hz: f64,
    fastest_hz: f64,
    lengths: Vec<f32>,
    clipped: usize,
    holes: usize,
}

impl Report {
    pub fn note(&mut self, source: &str, notes: Vec<String>) {
        for note in notes {
            let kind = note.chars().filter(|c| !c.is_ascii_digit()).collect();
            self.notes.entry(kind).or_insert((note, Vec::new())).1.push(source.to_owned());
        }
    }

    /// Prints each note once, with the names of its sources.
    pub fn print_notes(&self) {
        for (note, sources) in self.notes.values() {
            match sources.as_slice() {
                [one] => println!("{one}: {note}"),
                [one, others @ ..] => println!("{one}: {note}; the like of {} more", others.len()),
                [] => {}
            }
        }
    }

    pub fn add(&mut self, part: Option<Part>, label: &str, person: &str, recording: &Recording) {
        let entry = self.labels.entry((part, label.to_owned())).or_default();
        let rate_hz = recording.rate_hz();
        let first = entry.recordings == 0;
        entry.slowest_hz = if first { rate_hz } else { entry.slowest_hz.min(rate_hz) };
        entry.fastest_hz = entry.fastest_hz.max(rate_hz);
        entry.recordings += 1;
        entry.people.insert(person.to_owned());
        entry.seconds += recording.seconds();
        entry.lengths.push(typical_length(recording));
        entry.clipped += clipped(recording);
        entry.holes += recording.gaps();
    }

    pub fn print(&self) {
        for ((part, label), entry) in &self.labels {
            let mut lengths = entry.lengths.clone();
            lengths.sort_unstable_by(f32::total_cmp);
            let gravity = lengths[lengths.len() / 2];
            let people: Vec<&str> = entry.people.iter().map(String::as_str).collect();
            let people =
                if people.len() > 4 { format!("{} people", people.len()) } else { people.join(", ") };
            let rate = match (entry.slowest_hz, entry.fastest_hz) {
                (slow, fast) if fast - slow < 0.5 => format!("{slow:.1} Hz"),
                (slow, fast) => format!("{slow:.1} to {fast:.1} Hz"),
            };
            let place = part.map_or(String::new(), |part| format!("{}: ", part.name()));
            println!(
                "{place}{label}: {} recordings of {people}, {:.1} s, {rate}, gravity {gravity:.2} m/s², {} samples clipped, {} gaps",
                entry.recordings, entry.seconds, entry.clipped, entry.holes
            );
        }
    }
}

/// Returns the median magnitude of the acceleration in m/s².
fn typical_length(recording: &Recording) -> f32 {
    let length = |sample: &[f32]| sample[..3].iter().map(|x| x * x).sum::<f32>().sqrt();
    let mut lengths: Vec<f32> = recording.samples().map(length).collect();
    lengths.sort_unstable_by(f32::total_cmp);
    lengths[lengths.len() / 2]
}

/// Returns the number of samples at the limits of the accelerometer's range, if there are at least three.
fn clipped(recording: &Recording) -> usize {
    let largest = |sample: &[f32]| sample[..3].iter().fold(0.0f32, |largest, x| largest.max(x.abs()));
    let limit = recording.samples().map(largest).fold(0.0, f32::max);
    if !RANGES.iter().any(|range| (limit / G / range - 1.0).abs() < 0.02) {
        return 0;
    }
    let count = recording.samples().filter(|sample| largest(sample) > limit * 0.999).count();
    if count > 2 { count } else { 0 }
}
