//! Writes episodes as a LeRobotDataset v3: `meta/info.json`, `meta/stats.json`, `meta/tasks.parquet`,
//! `meta/episodes/chunk-000/file-000.parquet` and `data/chunk-000/file-000.parquet`.
//!
//! Timestamps are `frame_index / fps`.
//! Statistics are stored for each episode, and for all episodes together.
//! They are the minimum, maximum, mean, standard deviation and count of every feature.

use std::path::Path;

use serde_json::{Map, Value, json};

use super::csv::{fresh, put};
use super::frames::{Columns, Rows};
use super::session::ExportError;
use super::tables::{Column, pandas_index, write_table};

/// Version of the data set's format.
const VERSION: &str = "v3.0";

/// Writes the data set to a new or empty folder.
///
/// # Errors
/// [`ExportError::Write`].
pub fn write(
    folder: &Path,
    columns: &Columns,
    episodes: &[Rows],
    fps: u32,
    robot: &str,
) -> Result<(), ExportError> {
    fresh(folder)?;
    let mut tasks: Vec<&str> = Vec::new();
    for rows in episodes {
        if !tasks.contains(&rows.task.as_str()) {
            tasks.push(&rows.task);
        }
    }
    let features: Vec<Features> = episodes
        .iter()
        .enumerate()
        .scan(0, |first, (episode, rows)| {
            let task = tasks.iter().position(|task| *task == rows.task).unwrap_or_default();
            let features = Features::of(rows, fps, episode, *first, task);
            *first += rows.state.len();
            Some(features)
        })
        .collect();
    let frames: usize = episodes.iter().map(|rows| rows.state.len()).sum();

    let all = Features::joined(&features);
    data(&folder.join("data/chunk-000/file-000.parquet"), &all)?;
    episodes_table(&folder.join("meta/episodes/chunk-000/file-000.parquet"), episodes, &features)?;
    let numbers = Column::Int64((0..tasks.len() as i64).collect());
    let names = Column::Text(tasks.iter().map(|task| (*task).to_owned()).collect());
    write_table(
        &folder.join("meta/tasks.parquet"),
        &[("task_index".to_owned(), numbers), ("__index_level_0__".to_owned(), names)],
        Some(&pandas_index("task_index")),
    )?;
    let stats: Map<String, Value> =
        all.stats().into_iter().map(|(name, stats)| (name, stats.json())).collect();
    put(&folder.join("meta/stats.json"), pretty(&Value::Object(stats)).as_bytes())?;
    let vector = |names: &[String]| json!({"dtype": "float32", "shape": [names.len()], "names": names});
    let one = |dtype: &str| json!({"dtype": dtype, "shape": [1], "names": null});
    let info = json!({
        "codebase_version": VERSION,
        "robot_type": robot,
        "total_episodes": episodes.len(),
        "total_frames": frames,
        "total_tasks": tasks.len(),
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": format!("0:{}", episodes.len())},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": null,
        "features": {
            "observation.state": vector(&columns.state),
            "action": vector(&columns.action),
            "timestamp": one("float32"),
            "frame_index": one("int64"),
            "episode_index": one("int64"),
            "index": one("int64"),
            "task_index": one("int64"),
        },
    });
    put(&folder.join("meta/info.json"), pretty(&info).as_bytes())
}

fn pretty(value: &Value) -> String {
    serde_json::to_string_pretty(value).unwrap_or_default() + "\n"
}

/// The values of all rows of the data.
#[derive(Clone, Debug, Default)]
struct Features {
    state: Vec<Vec<f32>>,
    action: Vec<Vec<f32>>,
    timestamp: Vec<f32>,
    frame: Vec<i64>,
    episode: Vec<i64>,
    index: Vec<i64>,
    task: Vec<i64>,
}

impl Features {
    fn of(rows: &Rows, fps: u32, episode: usize, first: usize, task: usize) -> Self {
        let count = rows.state.len();
        Features {
            state: rows.state.clone(),
            action: rows.action.clone(),
            timestamp: (0..count).map(|frame| (frame as f64 / f64::from(fps)) as f32).collect(),
            frame: (0..count as i64).collect(),
            episode: vec![episode as i64; count],
            index: (first as i64..(first + count) as i64).collect(),
            task: vec![task as i64; count],
        }
    }

    fn joined(parts: &[Features]) -> Self {
        let mut all = Features::default();
        for part in parts {
            all.state.extend_from_slice(&part.state);
            all.action.extend_from_slice(&part.action);
            all.timestamp.extend_from_slice(&part.timestamp);
            all.frame.extend_from_slice(&part.frame);
            all.episode.extend_from_slice(&part.episode);
            all.index.extend_from_slice(&part.index);
            all.task.extend_from_slice(&part.task);
        }
        all
    }

    fn stats(&self) -> Vec<(String, Stats)> {
        let wide =
            |rows: &[Vec<f32>]| Stats::of(rows.iter().map(|row| row.iter().map(|v| f64::from(*v)).collect()));
        let whole = |values: &[i64]| Stats::of(values.iter().map(|value| vec![*value as f64]));
        [
            ("observation.state", wide(&self.state)),
            ("action", wide(&self.action)),
            ("timestamp", Stats::of(self.timestamp.iter().map(|value| vec![f64::from(*value)]))),
            ("frame_index", whole(&self.frame)),
            ("episode_index", whole(&self.episode)),
            ("index", whole(&self.index)),
            ("task_index", whole(&self.task)),
        ]
        .map(|(name, stats)| (name.to_owned(), stats))
        .to_vec()
    }
}

/// The statistics of each value of a feature.
#[derive(Clone, Debug, Default)]
struct Stats {
    min: Vec<f64>,
    max: Vec<f64>,
    mean: Vec<f64>,
    std: Vec<f64>,
    count: usize,
}

impl Stats {
    fn of(rows: impl Iterator<Item = Vec<f64>> + Clone) -> Self {
        let count = rows.clone().count();
        let width = rows.clone().next().map_or(0, |row| row.len());
        let n = count.max(1) as f64;
        let fold = |start: f64, one: &dyn Fn(f64, f64) -> f64| -> Vec<f64> {
            rows.clone()
                .fold(vec![start; width], |sums, row| sums.iter().zip(row).map(|(a, b)| one(*a, b)).collect())
        };
        let mean: Vec<f64> = fold(0.0, &|sum, value| sum + value).iter().map(|sum| sum / n).collect();
        let squares = rows.clone().fold(vec![0.0; width], |sums: Vec<f64>, row| {
            let pairs = sums.iter().zip(row).zip(&mean);
            pairs.map(|((sum, value), mean)| sum + (value - mean).powi(2)).collect()
        });
        Stats {
            min: fold(f64::INFINITY, &f64::min),
            max: fold(f64::NEG_INFINITY, &f64::max),
            std: squares.iter().map(|sum| (sum / n).sqrt()).collect(),
            mean,
            count,
        }
    }

    fn json(&self) -> Value {
        json!({"min": self.min, "max": self.max, "mean": self.mean, "std": self.std, "count": [self.count]})
    }
}

fn data(file: &Path, all: &Features) -> Result<(), ExportError> {
    let columns = [
        ("observation.state", Column::FloatLists(all.state.clone())),
        ("action", Column::FloatLists(all.action.clone())),
        ("timestamp", Column::Float(all.timestamp.clone())),
        ("frame_index", Column::Int64(all.frame.clone())),
        ("episode_index", Column::Int64(all.episode.clone())),
        ("index", Column::Int64(all.index.clone())),
        ("task_index", Column::Int64(all.task.clone())),
    ];
    write_table(file, &columns.map(|(name, column)| (name.to_owned(), column)), None)
}

fn episodes_table(file: &Path, episodes: &[Rows], features: &[Features]) -> Result<(), ExportError> {
    let count = episodes.len();
    let starts: Vec<i64> = features.iter().map(|f| f.index.first().copied().unwrap_or_default()).collect();
    let ends = features.iter().map(|f| f.index.last().map_or(0, |last| last + 1)).collect();
    let zeros = || Column::Int64(vec![0; count]);
    let mut columns = vec![
        ("episode_index".to_owned(), Column::Int64((0..count as i64).collect())),
        (
            "tasks".to_owned(),
            Column::TextLists(episodes.iter().map(|rows| vec![rows.task.clone()]).collect()),
        ),
        ("length".to_owned(), Column::Int64(episodes.iter().map(|rows| rows.state.len() as i64).collect())),
        ("data/chunk_index".to_owned(), zeros()),
        ("data/file_index".to_owned(), zeros()),
        ("dataset_from_index".to_owned(), Column::Int64(starts)),
        ("dataset_to_index".to_owned(), Column::Int64(ends)),
    ];
    let stats: Vec<Vec<(String, Stats)>> = features.iter().map(Features::stats).collect();
    let names: Vec<String> =
        stats.first().map_or(Vec::new(), |s| s.iter().map(|(name, _)| name.clone()).collect());
    for (at, name) in names.iter().enumerate() {
        let list = |value: &dyn Fn(&Stats) -> Vec<f64>| -> Column {
            Column::DoubleLists(stats.iter().map(|of_episode| value(&of_episode[at].1)).collect())
        };
        columns.push((format!("stats/{name}/min"), list(&|s| s.min.clone())));
        columns.push((format!("stats/{name}/max"), list(&|s| s.max.clone())));
        columns.push((format!("stats/{name}/mean"), list(&|s| s.mean.clone())));
        columns.push((format!("stats/{name}/std"), list(&|s| s.std.clone())));
        let counts = stats.iter().map(|of_episode| vec![of_episode[at].1.count as i64]).collect();
        columns.push((format!("stats/{name}/count"), Column::Int64Lists(counts)));
    }
    columns.push(("meta/episodes/chunk_index".to_owned(), zeros()));
    columns.push(("meta/episodes/file_index".to_owned(), zeros()));
    write_table(file, &columns, None)
}
