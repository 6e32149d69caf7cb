//! Runs named steps, goes on after a failure, and ends with one table.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

/// One thing to check.
pub struct Step {
    /// What is checked, in a few words.
    pub name: &'static str,
    /// Checks it.
    pub check: Box<dyn Fn() -> Result<()>>,
}

impl Step {
    /// A step from a name and a closure.
    pub fn new(name: &'static str, check: impl Fn() -> Result<()> + 'static) -> Self {
        Step { name, check: Box::new(check) }
    }
}

/// Runs a command to its end with its output shown.
///
/// # Errors
/// Where it does not start or does not exit with 0.
pub fn sh(command: &mut Command) -> Result<()> {
    eprintln!("$ {}", shown(command));
    let status = command
        .stdin(Stdio::null())
        .status()
        .with_context(|| format!("{} does not start", shown(command)))?;
    if !status.success() {
        bail!("`{}` ended with {status}", shown(command));
    }
    Ok(())
}

/// Runs a command to its end and returns what it printed on standard output.
///
/// # Errors
/// As [`sh`].
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
        bail!("`{}` ended with {}", shown(command), output.status);
    }
    Ok(text)
}

fn shown(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    words.map(|w| w.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" ")
}

/// Runs all steps and prints the table; whether all passed.
pub fn run_all(steps: &[Step]) -> bool {
    let mut results: Vec<(&str, Duration, Option<String>)> = Vec::new();
    for step in steps {
        println!("\n=== {} ===", step.name);
        let start = Instant::now();
        let error = (step.check)().err().map(|e| format!("{e:#}"));
        if let Some(error) = &error {
            println!("FAILED {}: {error}", step.name);
        }
        results.push((step.name, start.elapsed(), error));
    }
    println!("\n{:<48} {:>8}  result", "step", "seconds");
    for (name, time, error) in &results {
        let result = if error.is_none() { "ok" } else { "FAILED" };
        println!("{name:<48} {:>8.1}  {result}", time.as_secs_f64());
    }
    let failed = results.iter().filter(|r| r.2.is_some()).count();
    for (name, _, error) in &results {
        if let Some(error) = error {
            println!("\nFAILED {name}\n  {error}");
        }
    }
    println!("\nsteps: {} passed, {failed} failed", results.len() - failed);
    failed == 0
}
