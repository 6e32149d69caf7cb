//! The command line of the bridge, with one file per command in `cmd/`.

#[macro_use]
extern crate models;

mod cmd;
mod play;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Two hands steer a robot: the left one drives the base, the right one selects arm motions.
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
    /// Lists the serial ports and the hand that answers on each
    List(cmd::list::Args),
    /// Steers the robot with the boards, or with keys in their place
    Run(cmd::run::Args),
    /// Measures versions, rates, clock, losses and latency of the links, and gives advice
    Doctor(cmd::doctor::Args),
    /// Calibrates the left hand's board with your neutral pose and your bends
    Calibrate(cmd::calibrate::Args),
    /// Records your own gestures for `models train`
    Record(cmd::record::Args),
    /// Converts recorded sessions to data sets for training robots
    Export(cmd::export::Args),
    /// Fetches the description of a robot's arm from its ROS 2 graph, into a scene for `teach` and `run`
    #[cfg(all(feature = "ros2", feature = "urdf"))]
    Arm(cmd::arm::Args),
    /// Saves the arm's current position as a pose, or moves to a pose
    Teach(cmd::teach::Args),
    /// Sends your own model to the right hand's board
    SendModel(cmd::send_model::Args),
    /// Replaces the firmware of a board with an nRF52840, over USB or Bluetooth
    Update(cmd::update::Args),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let done = match cli.verb {
        None => cmd::demo::run(&cli.demo),
        Some(Verb::Demo(args)) => cmd::demo::run(&args),
        Some(Verb::Replay(args)) => cmd::replay::run(&args),
        Some(Verb::List(args)) => cmd::list::run(&args),
        Some(Verb::Run(args)) => cmd::run::run(&args),
        Some(Verb::Doctor(args)) => cmd::doctor::run(&args),
        Some(Verb::Calibrate(args)) => cmd::calibrate::run(&args),
        Some(Verb::Record(args)) => cmd::record::run(&args),
        Some(Verb::Export(args)) => cmd::export::run(&args),
        #[cfg(all(feature = "ros2", feature = "urdf"))]
        Some(Verb::Arm(args)) => cmd::arm::run(&args),
        Some(Verb::Teach(args)) => cmd::teach::run(&args),
        Some(Verb::SendModel(args)) => cmd::send_model::run(&args),
        Some(Verb::Update(args)) => cmd::update::run(&args),
    };
    match done {
        Ok(_) if models::say::lost() => ExitCode::FAILURE,
        Ok(code) => code,
        // The code that a shell reports for a program ended by Ctrl-C.
        Err(error) if error.is::<play::Interrupted>() => ExitCode::from(130),
        Err(error) => {
            eprintln!("error: {}", models::errors::in_full(&*error));
            ExitCode::FAILURE
        }
    }
}
