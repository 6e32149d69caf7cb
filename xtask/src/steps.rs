//! Runs named steps, continues after a failure, and prints a table that contains the reason of every failure.

use std::fs::File;
use std::io::{Read, Write};
use std::process::{Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

use crate::target_dir;

/// Number of last lines of a failed command that are printed after the table, where readers look first.
const LAST_LINES: usize = 50;

/// One thing to check.
pub struct Step {
    /// A short description of the check.
    pub name: &'static str,
    /// Checks it.
    pub check: Box<dyn Fn() -> Result<()>>,
}

impl Step {
    /// Creates a step from a name and a closure.
    pub fn new(name: &'static str, check: impl Fn() -> Result<()> + 'static) -> Self {
        Step { name, check: Box::new(check) }
    }
}

/// Result of a step.
pub struct Outcome {
    name: &'static str,
    time: Duration,
    /// Seconds that all processors together spent on the step's commands, where the system tells.
    processor_s: Option<f64>,
    /// The error with which a step failed.
    error: Option<String>,
}

impl Outcome {
    /// The step's name.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Did the step fail?
    pub fn failed(&self) -> bool {
        self.error.is_some()
    }
}

/// Returns the rows that tests have printed for a table. These are the cells after this mark, separated by bars.
pub fn rows(said: &str, mark: &str) -> Vec<Vec<String>> {
    let rows = said.lines().filter_map(|line| Some(line.split_once(mark)?.1));
    rows.map(|row| row.split('|').map(|cell| cell.trim().to_owned()).collect()).collect()
}

/// Runs a command to its end and shows its output.
///
/// # Errors
/// Fails if the command does not start or its exit code is not 0. The error contains the last lines of output.
pub fn sh(command: &mut Command) -> Result<()> {
    eprintln!("$ {}", shown(command));
    // Uses a file instead of a pipe, because background processes would keep a pipe open.
    std::fs::create_dir_all(target_dir())?;
    let path = target_dir().join(format!("xtask-{}.log", std::process::id()));
    let log = File::create(&path).with_context(|| path.display().to_string())?;
    let mut said = File::open(&path)?;
    std::fs::remove_file(&path)?;
    let mut child = command
        .stdin(Stdio::null())
        .stdout(log.try_clone()?)
        .stderr(log)
        .spawn()
        .with_context(|| format!("{} does not start", shown(command)))?;
    let mut text = Vec::new();
    let status: ExitStatus = loop {
        let ended = child.try_wait()?;
        let printed = text.len();
        said.read_to_end(&mut text)?;
        std::io::stdout().write_all(&text[printed..])?;
        std::io::stdout().flush()?;
        match ended {
            Some(status) => break status,
            None => std::thread::sleep(Duration::from_millis(50)),
        }
    };
    well_ended(command, status, &String::from_utf8_lossy(&text))
}

/// Runs a command to its end and returns its standard output.
///
/// # Errors
/// Fails in the same cases as [`sh`].
pub fn output(command: &mut Command) -> Result<String> {
    eprintln!("$ {}", shown(command));
    let output = command
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output()
        .with_context(|| format!("{} does not start", shown(command)))?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    if !output.status.success() {
        print!("{text}");
    }
    well_ended(command, output.status, &text)?;
    Ok(text)
}

/// Checks that a command ended with exit code 0. Otherwise, the error contains the last lines of its output.
fn well_ended(command: &Command, status: ExitStatus, text: &str) -> Result<()> {
    if !status.success() {
        let lines: Vec<&str> = text.lines().collect();
        let last = lines[lines.len().saturating_sub(LAST_LINES)..].join("\n  | ");
        bail!("`{}` ended with {status}\n  | {last}", shown(command));
    }
    Ok(())
}

fn shown(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    words.map(|w| w.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" ")
}

/// Runs all steps.
pub fn run_all(steps: &[Step]) -> Vec<Outcome> {
    steps.iter().map(run).collect()
}

fn run(step: &Step) -> Outcome {
    println!("\n=== {} ===", step.name);
    let (start, before_s) = (Instant::now(), processor_s());
    let error = (step.check)().err().map(|e| format!("{e:#}"));
    let time = start.elapsed();
    let processor_s = processor_s().zip(before_s).map(|(after_s, before_s)| after_s - before_s);
    let result = if error.is_some() { "FAILED" } else { "ok" };
    println!("--- {result} after {:.1} s: {}", time.as_secs_f64(), step.name);
    Outcome { name: step.name, time, processor_s, error }
}

/// Returns the processor time of all commands that have ended, with the commands that they waited for.
/// Only Linux tells it in a file: proc(5), fields 16 and 17 of `stat`, in units of 10 ms.
fn processor_s() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The second field is the program's name in brackets, and may contain spaces.
    let fields = stat.rsplit_once(')')?.1.split_whitespace();
    let ticks: Vec<f64> = fields.skip(13).take(2).map_while(|field| field.parse().ok()).collect();
    (ticks.len() == 2).then(|| ticks.iter().sum::<f64>() / 100.0)
}

/// Prints the table and the reasons of all failures. Returns whether all steps passed.
pub fn report(outcomes: &[Outcome]) -> bool {
    println!("\n{:<48} {:>8} {:>9}  result", "step", "seconds", "processor");
    for outcome in outcomes {
        let result = if outcome.failed() { "FAILED" } else { "ok" };
        let processor = outcome.processor_s.map_or_else(|| "-".into(), |s| format!("{s:.1}"));
        println!("{:<48} {:>8.1} {processor:>9}  {result}", outcome.name, outcome.time.as_secs_f64());
    }
    for outcome in outcomes {
        if let Some(error) = &outcome.error {
            println!("\nFAILED {}\n  {error}", outcome.name);
        }
    }
    let failed = outcomes.iter().filter(|o| o.failed()).count();
    println!("\nsteps: {} passed, {failed} failed", outcomes.len() - failed);
    failed == 0
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::rc::Rc;

    use super::*;

    #[test]
    fn a_step_that_fails_is_run_once_and_the_others_go_on() {
        let runs = Rc::new(Cell::new(0));
        let counted = Rc::clone(&runs);
        let fails = Step::new("fails", move || {
            counted.set(counted.get() + 1);
            bail!("late")
        });
        let outcomes = run_all(&[fails, Step::new("well", || Ok(()))]);
        assert_eq!(runs.get(), 1);
        assert_eq!(outcomes.iter().map(Outcome::failed).collect::<Vec<_>>(), [true, false]);
        assert!(!report(&outcomes));
        assert!(report(&outcomes[1..]));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_processor_time_of_a_steps_commands_is_counted() {
        let busy = Step::new("busy", || {
            // Without `sh`, whose log belongs to one test of this process at a time.
            let script = "i=0; while [ $i -lt 200000 ]; do i=$((i+1)); done";
            Ok(Command::new("sh").args(["-c", script]).status().map(drop)?)
        });
        // Other tests in this process also start commands, so nothing is said here of an upper limit.
        assert!(run(&busy).processor_s.unwrap() >= 0.01);
    }

    #[test]
    fn a_command_that_fails_gives_its_last_lines() {
        let script = "for n in $(seq 200); do echo line $n; done; exit 3";
        let error = sh(Command::new("sh").args(["-c", script])).unwrap_err().to_string();
        assert!(error.contains("exit status: 3") && error.ends_with("| line 200"), "{error}");
        assert_eq!(error.lines().count(), 1 + LAST_LINES);
    }
}
