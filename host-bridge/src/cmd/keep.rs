//! The option for recording a session, used by all commands that move a robot.

use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Result;
use host_bridge::observe::Tap;
use host_bridge::topics::Origin;

#[cfg(feature = "mcap")]
use host_bridge::journal::{Disk, SceneText, Setup, WhenFull};

/// Whether and where to write the session file.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct KeepArgs {
    /// Record the session to a new file, for `replay FILE.mcap`, Foxglove and ROS tools
    #[arg(long, value_name = "FILE.mcap")]
    pub record: Option<PathBuf>,
    /// Description of the session's task, for `export`
    #[arg(long, value_name = "TEXT", requires = "record")]
    pub task: Option<String>,
}

/// The initial conditions of a session.
#[cfg_attr(not(feature = "mcap"), expect(dead_code, reason = "nobody writes it down"))]
pub struct Start<'a> {
    /// A one-line title for the user.
    pub title: &'a str,
    /// The configuration: limits, times, base, arm and motions.
    pub config: &'a host_bridge::config::Config,
    /// Additional `LABEL=MOTION` mappings.
    pub maps: &'a [String],
    /// The robot's surroundings.
    pub scene: Option<&'a std::path::Path>,
    /// Time at which the session's clock was zero.
    pub origin: Origin,
    /// Whether a real robot moves, so that nothing may delay the session.
    pub live: bool,
    /// Whether something other than the simulator is the robot.
    pub robot_elsewhere: bool,
}

/// Returns the time of day at which a session's clock was zero, if it shows `now_ms` now.
pub fn origin(now_ms: u64) -> Origin {
    let day = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Origin { nanoseconds: (day.as_nanos() as u64).saturating_sub(now_ms * 1_000_000) }
}

/// The session file, if one is written.
#[derive(Default)]
pub struct Keeper {
    #[cfg(feature = "mcap")]
    disk: Option<Disk>,
}

impl KeepArgs {
    /// Creates the file and attaches its observer to the session.
    #[cfg(feature = "mcap")]
    pub fn start(&self, tap: &mut Tap, start: &Start<'_>) -> Result<Keeper> {
        let Some(file) = &self.record else { return Ok(Keeper::default()) };
        // Adds the missing index to recordings that were killed.
        for done in host_bridge::journal::index::complete_beside(file) {
            match done {
                Ok(file) => {
                    eprintln!("{}: its recording was cut short; it has its index now", file.display())
                }
                Err(problem) => eprintln!("{problem}; it has no index"),
            }
        }
        let setup = Setup {
            title: start.title.to_owned(),
            config: start.config.clone(),
            maps: start.maps.to_vec(),
            scene: start.scene.map(SceneText::read).transpose()?,
            origin_ns: start.origin.nanoseconds,
            robot_elsewhere: start.robot_elsewhere,
            plans_aside: start.live && start.scene.is_some(),
            task: self.task.clone(),
        };
        let when_full = if start.live { WhenFull::Drop } else { WhenFull::Wait };
        let (disk, recorder) =
            Disk::create(file, setup.to_metadata(), start.origin, when_full).map_err(anyhow::Error::msg)?;
        tap.add(Box::new(recorder));
        Ok(Keeper { disk: Some(disk) })
    }

    /// Reports that this build cannot record sessions.
    #[cfg(not(feature = "mcap"))]
    pub fn start(&self, _tap: &mut Tap, _start: &Start<'_>) -> Result<Keeper> {
        anyhow::ensure!(
            self.record.is_none(),
            "--record: this program was built without sessions on disk; build it with `--features mcap`"
        );
        Ok(Keeper::default())
    }
}

#[cfg(feature = "mcap")]
impl Keeper {
    /// Returns the reason why writing has stopped, but only once.
    pub fn take_problem(&mut self) -> Option<String> {
        self.disk.as_mut()?.take_problem()
    }

    /// Writes all remaining data. Returns a line about the file, if there is one.
    pub fn end(&mut self, tap: &mut Tap) -> Option<String> {
        tap.clear();
        let disk = self.disk.take()?;
        let (file, told) = (disk.file().display().to_string(), disk.is_told());
        let kept = disk.close();
        let lost = match kept.lost {
            0 => String::new(),
            lost => format!("; the disk was too slow for {lost} messages"),
        };
        let line = format!("{file}: {} messages{lost}", kept.messages);
        Some(kept.problem.filter(|_| !told).unwrap_or(line))
    }
}

#[cfg(not(feature = "mcap"))]
impl Keeper {
    /// This build never writes a file.
    pub fn take_problem(&mut self) -> Option<String> {
        None
    }

    /// This build never writes a file.
    pub fn end(&mut self, tap: &mut Tap) -> Option<String> {
        tap.clear();
        None
    }
}
