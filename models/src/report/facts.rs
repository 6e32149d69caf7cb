//! Facts about a data set: people, classes, time, rates, clipping, and differences of features between classes.

use std::collections::BTreeMap;

use rayon::prelude::*;
use shared_dsp::right::aligned::feature_count;
use shared_words::is_rest;

use crate::dataset::Dataset;
use crate::evaluate::tempo::strokes_per_second;
use crate::windows::{aligned_features, cut, prepare};

/// Facts about a data set.
#[derive(Clone, Debug, PartialEq)]
pub struct Facts {
    /// Per person, in order.
    pub people: Vec<(String, PersonFacts)>,
    /// Labels in the order of a network's outputs.
    pub labels: Vec<String>,
    /// Values per sample.
    pub axes: usize,
    /// Names of the features of recipe `aligned`.
    pub feature_names: Vec<String>,
    /// The mean of each feature over the windows of a label, in standard deviations of all windows.
    pub features: Vec<(String, Vec<f64>)>,
}

/// Facts about the recordings of one person.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PersonFacts {
    /// Number of recordings and seconds per label.
    pub labels: BTreeMap<String, (usize, f64)>,
    /// Minimum and maximum sampling rates in Hz.
    pub rates_hz: Option<(f64, f64)>,
    /// Maximum acceleration along any axis in m/s².
    pub largest: f64,
    /// Tempo of the gestures in strokes per second.
    /// Of all gestures, 10 % are slower than the first figure, and half are slower than the second figure.
    /// Of all gestures, 90 % are slower than the third figure.
    pub strokes_hz: Option<[f64; 3]>,
    /// Share of the accelerometer's values within 0.1 % of the maximum, which is far above 0 if the sensor clips.
    pub at_largest: f64,
}

impl Facts {
    /// Of a data set.
    pub fn of(dataset: &Dataset) -> Self {
        let mut people: BTreeMap<String, PersonFacts> = BTreeMap::new();
        for item in &dataset.items {
            let person = people.entry(item.person.clone()).or_default();
            let count = person.labels.entry(item.label.clone()).or_default();
            count.0 += 1;
            count.1 += item.recording.seconds();
            let rate = item.recording.rate_hz();
            let (low, high) = person.rates_hz.unwrap_or((rate, rate));
            person.rates_hz = Some((low.min(rate), high.max(rate)));
            for sample in item.recording.samples() {
                let most = sample[..3].iter().fold(0.0f32, |most, value| most.max(value.abs()));
                person.largest = person.largest.max(f64::from(most));
            }
        }
        for (name, person) in &mut people {
            let (mut near, mut all) = (0usize, 0usize);
            for item in dataset.items.iter().filter(|item| item.person == *name) {
                for value in item.recording.samples().flat_map(|sample| &sample[..3]) {
                    all += 1;
                    near += usize::from(f64::from(value.abs()) >= 0.999 * person.largest);
                }
            }
            person.at_largest = near as f64 / all.max(1) as f64;
            let theirs =
                dataset.items.par_iter().filter(|item| item.person == *name && !is_rest(&item.label));
            let mut tempos: Vec<f64> =
                theirs.filter_map(|item| strokes_per_second(&item.recording)).collect();
            tempos.sort_by(f64::total_cmp);
            let at = |part: f64| tempos[((tempos.len() - 1) as f64 * part) as usize];
            person.strokes_hz = (!tempos.is_empty()).then(|| [0.1, 0.5, 0.9].map(at));
        }
        Self {
            people: people.into_iter().collect(),
            labels: dataset.labels.clone(),
            axes: dataset.axes,
            feature_names: feature_names(dataset.axes),
            features: features(dataset),
        }
    }

    /// Returns the number of recordings and of minutes in total.
    pub fn total(&self) -> (usize, f64) {
        let each = self.people.iter().flat_map(|(_, person)| person.labels.values());
        each.fold((0, 0.0), |(count, minutes), (n, seconds)| (count + n, minutes + seconds / 60.0))
    }
}

/// Returns the standardised mean of the features of each label.
fn features(dataset: &Dataset) -> Vec<(String, Vec<f64>)> {
    let windows: Vec<(&String, Vec<f32>)> = dataset
        .items
        .par_iter()
        .flat_map_iter(|item| {
            let (ready, _) = prepare(&item.recording);
            cut(&ready).into_iter().map(|window| (&item.label, aligned_features(dataset.axes, &window)))
        })
        .collect();
    let width = feature_count(dataset.axes);
    let mean_of = |of: &dyn Fn(&str) -> bool, feature: usize| -> (f64, f64) {
        let values = || windows.iter().filter(|(label, _)| of(label)).map(|(_, w)| f64::from(w[feature]));
        let count = values().count().max(1) as f64;
        let mean = values().sum::<f64>() / count;
        (mean, (values().map(|v| (v - mean).powi(2)).sum::<f64>() / count).sqrt())
    };
    let all: Vec<(f64, f64)> = (0..width).map(|feature| mean_of(&|_| true, feature)).collect();
    let row = |label: &String| {
        let value = |feature: usize| {
            let (mean, _) = mean_of(&|other| other == label, feature);
            (mean - all[feature].0) / all[feature].1.max(1e-6)
        };
        (label.clone(), (0..width).map(value).collect())
    };
    dataset.labels.iter().map(row).collect()
}

/// Returns the names of the features of recipe `aligned` in order ([`shared_dsp::right::aligned`]).
pub fn feature_names(axes: usize) -> Vec<String> {
    let triads: &[&str] = if axes >= 6 { &["acceleration", "rotation"] } else { &["acceleration"] };
    let directions = ["up", "along", "across"];
    let mut names = Vec::new();
    for triad in triads {
        names.push(format!("{triad}: amount"));
        names.extend(directions.map(|direction| format!("{triad}: share {direction}")));
        for line in 1..=10 {
            let hz = f64::from(line) * 100.0 / 8.0 / 32.0;
            names.extend(directions.map(|direction| format!("{triad}: {hz:.2} Hz {direction}")));
        }
        for pair in ["along/up", "across/up", "across/along"] {
            names.extend(["in phase", "in quadrature"].map(|how| format!("{triad}: {pair} {how}")));
        }
    }
    names.extend(triads.iter().map(|triad| format!("{triad}: tremor")));
    for triad in triads {
        names.extend(directions.map(|direction| format!("{triad}: log size {direction}")));
    }
    names.push("weight felt".to_owned());
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_feature_has_a_name_of_its_own() {
        for axes in [3, 6, 9] {
            let names = feature_names(axes);
            assert_eq!(names.len(), feature_count(axes));
            let different: std::collections::HashSet<_> = names.iter().collect();
            assert_eq!(different.len(), names.len());
        }
    }
}
