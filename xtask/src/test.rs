//! `cargo xtask test`: every check, in the order in which a failure is cheapest to find.

use std::process::{Command, ExitCode};

use anyhow::{Result, bail};

use crate::root;
use crate::steps::{Step, run_all, sh};

/// Runs the steps.
///
/// # Errors
/// An option that is not known.
pub fn run(args: &[&str]) -> Result<ExitCode> {
    let mut full = false;
    let mut list = false;
    let mut only: Option<String> = None;
    let mut args = args.iter();
    while let Some(&arg) = args.next() {
        match (arg, args.as_slice().first()) {
            ("--full", _) => full = true,
            ("--list", _) => list = true,
            ("--only", Some(word)) => {
                only = Some((*word).to_string());
                args.next();
            }
            _ => bail!("`cargo xtask test` takes --full, --list and --only WORD, not `{arg}`"),
        }
    }
    let mut steps = steps(full);
    if let Some(word) = only {
        steps.retain(|s| s.name.contains(&word));
        if steps.is_empty() {
            bail!("no step is named like `{word}`; --list names them");
        }
    }
    if list {
        steps.iter().for_each(|s| println!("{}", s.name));
        return Ok(ExitCode::SUCCESS);
    }
    Ok(run_all(&steps))
}

/// A cargo of the root workspace.
fn cargo(full: bool, args: &[&str]) -> Command {
    let mut command = Command::new("cargo");
    command.current_dir(root()).args(args);
    if full {
        command.env("BIMANUAL_FULL", "1");
    }
    command
}

fn steps(full: bool) -> Vec<Step> {
    vec![
        Step::new("format", move || sh(&mut cargo(full, &["fmt", "--all", "--check"]))),
        Step::new("clippy", move || {
            sh(&mut cargo(
                full,
                &[
                    "clippy",
                    "--workspace",
                    "--exclude",
                    "tests",
                    "--all-targets",
                    "--locked",
                    "--",
                    "-D",
                    "warnings",
                ],
            ))
        }),
        Step::new("documentation", move || {
            sh(cargo(full, &["doc", "--workspace", "--exclude", "tests", "--no-deps", "--locked"])
                .env("RUSTDOCFLAGS", "-D warnings"))
        }),
        Step::new("unit and behaviour tests", move || {
            sh(&mut cargo(full, &["test", "--workspace", "--exclude", "tests", "--locked"]))
        }),
    ]
}
