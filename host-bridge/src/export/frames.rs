//! Generates rows at a constant rate.

use super::episodes::Episode;
use super::session::Streams;

/// Maximum age of a value in ms; older values count as unknown.
pub const HELD_MS: u64 = 100;

/// Names of the columns: positions `.pos` in m and rad, speeds `.vel` in m/s and rad/s.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Columns {
    /// Columns of `observation.state`.
    pub state: Vec<String>,
    /// Columns of `action`.
    pub action: Vec<String>,
}

impl Columns {
    /// Returns the columns of a robot with these joints.
    pub fn of(joints: &[String]) -> Self {
        let joints = || joints.iter().map(|name| format!("{name}.pos"));
        let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        Columns {
            state: names(&["x.pos", "y.pos", "theta.pos", "x.vel", "theta.vel"])
                .into_iter()
                .chain(joints())
                .collect(),
            action: names(&["x.vel", "theta.vel"]).into_iter().chain(joints()).collect(),
        }
    }
}

/// The rows of one episode, `1 / fps` s apart.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows {
    /// The task of the episode.
    pub task: String,
    /// Positions of base and joints, and speeds of the base; one entry per row.
    pub state: Vec<Vec<f32>>,
    /// Commanded speed of the base, and the joint positions of the next row. There is one entry per row.
    /// (A session's file contains the arm's path, but not its set points.)
    pub action: Vec<Vec<f32>>,
}

/// Returns the newest entry at a given time, if it is recent enough.
fn newest<'s, T>(stream: &'s [(u64, T)], time_ms: f64, name: &str) -> Result<&'s T, String> {
    let behind = stream.partition_point(|(time, _)| *time as f64 <= time_ms);
    let found = behind.checked_sub(1).map(|at| &stream[at]);
    match found {
        Some((time, value)) if time_ms - *time as f64 <= HELD_MS as f64 => Ok(value),
        Some((time, _)) => Err(format!(
            "at {:.3} s the last message of {name} is {:.0} ms old; at most {HELD_MS} are held",
            time_ms / 1000.0,
            time_ms - *time as f64
        )),
        None => Err(format!("at {:.3} s there is no message of {name} yet", time_ms / 1000.0)),
    }
}

/// Returns the rows of an episode.
///
/// # Errors
/// Fails if a stream has a gap. The error names the stream and the time of the gap.
pub fn rows(streams: &Streams, episode: &Episode, fps: u32) -> Result<Rows, String> {
    let step_ms = 1000.0 / f64::from(fps.max(1));
    let count = ((episode.end_ms - episode.start_ms) as f64 / step_ms + 1e-9).floor() as usize + 1;
    let time = |row: usize| episode.start_ms as f64 + row as f64 * step_ms;
    let joints = |row: usize| newest(&streams.joints, time(row), "/joint_states");
    let narrow = |values: &[f64]| values.iter().map(|value| *value as f32).collect::<Vec<f32>>();
    let mut rows = Rows { task: episode.task.clone(), ..Rows::default() };
    for row in 0..count {
        let base = newest(&streams.base, time(row), "/odom")?;
        let asked = newest(&streams.asked, time(row), "/cmd_vel")?;
        let here = joints(row)?;
        let next = joints((row + 1).min(count - 1))?;
        rows.state.push(narrow(&[&base[..], here].concat()));
        rows.action.push(narrow(&[&asked[..], next].concat()));
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn streams(joint_times: impl Iterator<Item = u64>) -> Streams {
        Streams {
            joint_names: vec!["a".to_owned()],
            joints: joint_times.map(|time| (time, vec![time as f64])).collect(),
            base: (0..100).map(|n| (n * 20, [n as f64; 5])).collect(),
            asked: (0..100).map(|n| (n * 20, [0.5, n as f64])).collect(),
            ..Streams::default()
        }
    }

    const EPISODE: Episode = Episode { start_ms: 100, end_ms: 300, task: String::new() };

    #[test]
    fn rows_hold_what_was_known_at_their_time() {
        let rows = rows(&streams((0..200).map(|n| n * 10)), &EPISODE, 50).unwrap();
        assert_eq!(rows.state.len(), 11);
        assert_eq!(rows.state[1], [6.0, 6.0, 6.0, 6.0, 6.0, 120.0]);
        assert_eq!(rows.action[1], [0.5, 6.0, 140.0]);
        assert_eq!(rows.action[10], [0.5, 15.0, 300.0]);
        let columns = Columns::of(&["a".to_owned()]);
        assert_eq!((columns.state.len(), columns.action.len()), (rows.state[0].len(), rows.action[0].len()));
    }

    #[test]
    fn a_hole_of_more_than_a_tenth_of_a_second_refuses_the_episode() {
        let without = |from: u64, to: u64| (0..200).map(|n| n * 10).filter(move |t| !(from..to).contains(t));
        assert!(rows(&streams(without(150, 240)), &EPISODE, 50).is_ok());
        let error = rows(&streams(without(150, 270)), &EPISODE, 50).unwrap_err();
        assert_eq!(error, "at 0.260 s the last message of /joint_states is 120 ms old; at most 100 are held");
    }
}
