//! `models daily simulated`: judges the everyday movement of simulated wearers by that of real people.

use std::path::PathBuf;
use std::time::Instant;

use clap::Args;
use models::daily::Daily;
use models::dataset::{Dataset, Item};
use models::evaluate::events::{AnnotatedRecording, play};
use models::evaluate::people::Trial;
use models::evaluate::spectrum::{BANDS_HZ, Strength, strengths};
use models::synth::IdleKind;
use models::train::{Aligned, train};
use rayon::prelude::*;
use shared_dsp::right::network::Model;

use super::daily::interval;
use super::people::Set;

/// Compare simulated everyday movement with real one: its strength, and the false events of models that learned neither
#[derive(Args)]
pub struct Cmd {
    /// Folder with other/<person>__<n>.csv of people who make no gesture, accelerometer and gyroscope
    daily: PathBuf,
    /// Folder of gestures to train the models on; FOLDER:LABEL,LABEL,... uses only these labels
    #[arg(value_name = "FOLDER[:LABEL,...]")]
    folder: Set,
    /// Number of models, with the seeds 1, 2, ...
    #[arg(long, default_value_t = 5)]
    seeds: u64,
    /// Simulated wearers per kind of movement
    #[arg(long, default_value_t = 12)]
    wearers: u32,
    /// Seconds per simulated wearer and kind
    #[arg(long, default_value_t = 120.0)]
    seconds: f64,
    #[command(flatten)]
    short: super::Short,
}

/// Seed of the simulated wearers. No other command uses it.
const CROWD: u64 = 77;

/// The kinds that the watch wearers' recordings contain, and then all.
const MIXES: [(&str, &[IdleKind]); 8] = [
    ("stroll, sit", &[IdleKind::Stroll, IdleKind::SitAndStand]),
    ("stroll", &[IdleKind::Stroll]),
    ("sit and stand", &[IdleKind::SitAndStand]),
    ("cup", &[IdleKind::Cup]),
    ("type", &[IdleKind::Type]),
    ("talk", &[IdleKind::Talk]),
    ("lift", &[IdleKind::Lift]),
    ("as before", &IdleKind::EVERY),
];

impl Cmd {
    pub fn run(self) -> anyhow::Result<()> {
        anyhow::ensure!(self.seeds > 0 && self.wearers > 0, "--seeds and --wearers take a number above 0");
        anyhow::ensure!((10.0..=3600.0).contains(&self.seconds), "--seconds takes 10 to 3600");
        let start = Instant::now();
        let learned = self.folder.read(None)?;
        let axes = learned.axes;
        let daily = Dataset::read(&self.daily, None)?;
        anyhow::ensure!(daily.axes >= 6, "{}: a gyroscope is needed", self.daily.display());
        let real = daily.people().into_iter().map(|person| {
            let items: Vec<&Item> = daily.items.iter().filter(|item| item.person == person).collect();
            AnnotatedRecording::joined(&items, axes.min(daily.axes), 1)
        });
        let mut groups = vec![("real people", real.collect::<Vec<_>>())];
        for (name, kinds) in MIXES {
            let crowd = (1..=self.wearers)
                .map(|index| AnnotatedRecording::moving(kinds, CROWD, index, self.seconds).with_axes(axes));
            groups.push((name, crowd.collect()));
        }
        let recipe = Aligned { daily: Daily::None, ..self.short.aligned() };
        let blobs = (1..=self.seeds)
            .into_par_iter()
            .map(|seed| Ok(train(&learned, &[], &recipe, &Trial::job(seed))?.blob()?))
            .collect::<anyhow::Result<Vec<Vec<u8>>>>()?;
        let bands: Vec<String> =
            BANDS_HZ.windows(2).map(|pair| format!("{}-{} Hz", pair[0], pair[1])).collect();
        println!(
            "{}: {} models that learned no daily movement; root mean square of a window of 2 s, median (90 %)",
            self.folder.folder.display(),
            self.seeds
        );
        println!("{:<14} acceleration in m/s², turning in deg/s: {}", "", bands.join(", "));
        for (name, recordings) in &groups {
            let mut all = Vec::new();
            for recording in recordings {
                for annotation in &recording.annotations {
                    let part = annotation.start * recording.axes..annotation.end * recording.axes;
                    all.extend(strengths(recording.values.get(part).unwrap_or_default(), recording.axes));
                }
            }
            let counts = blobs
                .par_iter()
                .map(|blob| {
                    let model = Model::parse(blob)?;
                    let mut events = 0;
                    for recording in recordings {
                        events += play(model, recording)?.len();
                    }
                    Ok(events)
                })
                .collect::<anyhow::Result<Vec<usize>>>()?;
            let samples: usize = recordings.iter().map(AnnotatedRecording::len).sum();
            let hours = (samples * blobs.len()) as f64 / models::RATE_HZ / 3600.0;
            let count: usize = counts.iter().sum();
            let (low, high) = interval(count);
            println!("{name:<14} acceleration {}", quantiles(&all, |strength| strength.acceleration));
            println!("{:<14} turning      {}", "", quantiles(&all, |strength| strength.turning));
            println!(
                "{:<14} {count} false events in {hours:.2} h: {:.1} per hour (95 %: {:.1} to {:.1})",
                "",
                count as f64 / hours,
                low / hours,
                high / hours
            );
        }
        println!("{:.0} s", start.elapsed().as_secs_f64());
        Ok(())
    }
}

/// The median and the 90 % quantile of each band.
fn quantiles(all: &[Strength], of: impl Fn(&Strength) -> [f64; BANDS_HZ.len() - 1]) -> String {
    let band = |band: usize| {
        let mut values: Vec<f64> = all.iter().map(|strength| of(strength)[band]).collect();
        values.sort_by(f64::total_cmp);
        let at = |part: f64| values.get((part * values.len() as f64) as usize).copied().unwrap_or_default();
        format!("{:.2} ({:.2})", at(0.5), at(0.9))
    };
    (0..BANDS_HZ.len() - 1).map(band).collect::<Vec<_>>().join(", ")
}
