//! Runs the command-line tool `models`.

use std::process::{Command, Output};

/// Returns the exit status and the output.
pub fn models(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_models")).args(args).output().expect("the tool starts")
}

/// Returns the tool's output. The command must succeed.
pub fn good(args: &[&str]) -> String {
    let output = models(args);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{args:?}: {errors}");
    String::from_utf8(output.stdout).unwrap()
}
