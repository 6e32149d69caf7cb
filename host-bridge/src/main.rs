//! Command line of the bridge: one file per verb in `cmd/`.

mod cmd;
mod describe;
mod play;
mod view;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Two hands steer a robot: the left one drives the base, the right one names arm motions.
#[derive(Parser)]
#[command(version, args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    verb: Option<Verb>,
    #[command(flatten)]
    demo: cmd::demo::Args,
}

#[derive(Subcommand)]
enum Verb {
    /// Plays the bundled session of both hands (the default)
    Demo(cmd::demo::Args),
    /// Plays recordings of your own
    Replay(cmd::replay::Args),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let done = match cli.verb {
        None => cmd::demo::run(&cli.demo),
        Some(Verb::Demo(args)) => cmd::demo::run(&args),
        Some(Verb::Replay(args)) => cmd::replay::run(&args),
    };
    match done {
        Ok(code) => code,
        // As a shell reports a program that was ended by Ctrl-C.
        Err(error) if error.is::<play::Interrupted>() => ExitCode::from(130),
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
