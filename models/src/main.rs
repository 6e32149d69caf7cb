//! `models`: trains, tests and converts models of gestures. `cmd/` contains one file per command.

#[macro_use]
extern crate models;

mod cmd;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(version, about = "Recordings, training, quantisation, TFLite files and model cards.")]
struct Cli {
    /// Number of threads; it does not affect the results
    #[arg(long, global = true, value_name = "N")]
    threads: Option<usize>,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Subcommand)]
enum Verb {
    Train(cmd::train::Cmd),
    Eval(cmd::eval::Cmd),
    Synth(cmd::synth::Cmd),
    Sizes(cmd::sizes::Cmd),
    Splits(cmd::splits::Cmd),
    Infer(cmd::infer::Cmd),
    Card(cmd::card::Cmd),
    Daily(cmd::daily::Cmd),
    Tempo(cmd::tempo::Cmd),
    People(cmd::people::Cmd),
    Adapt(cmd::adapt::Cmd),
    Events(cmd::events::Cmd),
    Report(cmd::report::Cmd),
    Simulated(cmd::simulated::Cmd),
    Import(cmd::import::Cmd),
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {}", models::errors::in_full(&*error));
            ExitCode::FAILURE
        }
    }
}

fn run() -> anyhow::Result<()> {
    let cli = Cli::parse();
    // With `None`, rayon chooses the number of threads.
    rayon::ThreadPoolBuilder::new().num_threads(cli.threads.unwrap_or(0)).build_global()?;
    // Without this variable, candle counts the processors for every matrix product.
    // The counting takes a fifth of the training time.
    // The matrix products of this program are too small for several threads.
    // SAFETY: no thread that reads the environment is running yet.
    unsafe { std::env::set_var("RAYON_NUM_THREADS", "1") };
    match cli.verb {
        Verb::Train(cmd) => cmd.run(),
        Verb::Eval(cmd) => cmd.run(),
        Verb::Synth(cmd) => cmd.run(),
        Verb::Sizes(cmd) => cmd.run(),
        Verb::Splits(cmd) => cmd.run(),
        Verb::Infer(cmd) => cmd.run(),
        Verb::Card(cmd) => cmd.run(),
        Verb::Daily(cmd) => cmd.run(),
        Verb::Tempo(cmd) => cmd.run(),
        Verb::People(cmd) => cmd.run(),
        Verb::Adapt(cmd) => cmd.run(),
        Verb::Events(cmd) => cmd.run(),
        Verb::Report(cmd) => cmd.run(),
        Verb::Simulated(cmd) => cmd.run(),
        Verb::Import(cmd) => cmd.run(),
    }
}
