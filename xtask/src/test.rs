//! `cargo xtask test`: every check, in the order in which a failure is cheapest to find.

use std::process::{Command, ExitCode};

use anyhow::{Result, bail, ensure};

use crate::steps::{Step, output, run_all, sh};
use crate::tools::{BROWSER, CROSS_LINK, CROSS_RUST, EMULATORS, NETWORK, QEMU};
use crate::{firmware_avr, firmware_nano33, python, real_data, root, target_dir, toolchain};

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
    if full {
        // SAFETY: no other thread runs yet; every test below inherits it.
        unsafe { std::env::set_var("BIMANUAL_FULL", "1") };
    }
    let mut steps = steps();
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

/// The laptop's cargo, in the root.
pub fn cargo(args: &[&str]) -> Command {
    let mut command = Command::new("cargo");
    command.current_dir(root()).args(args);
    command
}

/// The laptop's cargo over the whole workspace with every feature that this machine can build.
///
/// Always the same choice: cargo sets the features of shared dependencies by the packages that are built
/// together, and would compile most of them again for any other choice.
fn cargo_for_all(subcommand: &str) -> Command {
    let mut command = cargo(&[subcommand, "--workspace", "--locked"]);
    if EMULATORS.is_complete() {
        command.args([
            "--features",
            "tests/avr,tests/nrf,tests/ble,host-bridge/urdf,host-bridge/ros2,host-bridge/mcap",
        ]);
    } else {
        command.args([
            "--exclude",
            "tests",
            "--features",
            "host-bridge/urdf,host-bridge/ros2,host-bridge/mcap",
        ]);
    }
    command
}

/// A program or example of the workspace as the tests built it; `name` is its path below the build folder.
///
/// # Errors
/// Where the workspace does not build.
pub fn built(name: &str) -> Result<Command> {
    sh(cargo_for_all("test").args(["--quiet", "--no-run"]))?;
    let mut command = Command::new(target_dir().join("debug").join(name));
    command.current_dir(root());
    Ok(command)
}

fn steps() -> Vec<Step> {
    vec![
        Step::new("tools for the boards", || {
            if !toolchain::is_complete() {
                CROSS_RUST.ensure()?;
            }
            CROSS_LINK.ensure()?;
            EMULATORS.ensure()?;
            QEMU.ensure()
        }),
        Step::new("format", || {
            sh(&mut cargo(&["fmt", "--all", "--check"]))?;
            for folder in ["firmware-nano-avr", "firmware-nano33"] {
                // Not --all, which would format the shared crates again.
                sh(cargo(&["fmt", "--check"]).current_dir(root().join(folder)))?;
            }
            Ok(())
        }),
        Step::new("clippy", || sh(cargo_for_all("clippy").args(["--all-targets", "--", "-D", "warnings"]))),
        Step::new("documentation", || {
            sh(cargo_for_all("doc").arg("--no-deps").env("RUSTDOCFLAGS", "-D warnings"))
        }),
        // The stack is measured, and held to its limit, by the tests below.
        Step::new("left hand: image and size", || firmware_avr::run(&["--no-stack"])),
        Step::new("right hand: images and size", || firmware_nano33::run(&[])),
        Step::new("tests, with both boards emulated", || {
            // The tests at the desk run the programs that are built along with them.
            sh(cargo_for_all("test")
                .args(["--no-fail-fast", "--", "--show-output"])
                .env("BIMANUAL_PROGRAMS", target_dir().join("debug")))
        }),
        Step::new("ROS 2 against Cyclone DDS", || {
            NETWORK.ensure()?;
            let python = python::environment("ros2", &["tests/ros2/requirements.txt"])?;
            sh(cargo_for_all("test")
                .args(["--no-fail-fast", "--test", "ros2", "--", "--nocapture"])
                .env("BIMANUAL_PROGRAMS", target_dir().join("debug"))
                .env("BIMANUAL_ROS2_PYTHON", python))
        }),
        Step::new("laptop and Cortex-M4F agree on all bits", || {
            sh(Command::new("sh").current_dir(root()).arg("shared-dsp/bench-m4f/run.sh"))
        }),
        Step::new("the demo, as a new user runs it", || {
            let demo =
                ["run", "--release", "--locked", "--", "demo", "--headless", "--speed", "20", "--json"];
            let summary = output(&mut cargo(&demo))?;
            println!("{}", summary.trim());
            ensure!(summary.trim_start().starts_with('{'), "the summary is not one JSON object");
            // The lean build names what it takes to have Bluetooth.
            let lean = ["run", "--quiet", "--release", "--locked", "--", "doctor", "--right", "ble"];
            let refused = String::from_utf8_lossy(&cargo(&lean).output()?.stderr).into_owned();
            ensure!(
                ["--features ble", "libdbus-1-dev"].iter().all(|word| refused.contains(word)),
                "{refused}"
            );
            Ok(())
        }),
        Step::new("features against numpy", || {
            let python = python::environment("numpy", &["shared-dsp/tests/reference/requirements.txt"])?;
            sh(Command::new(python)
                .current_dir(root())
                .arg("shared-dsp/tests/reference/features_ref.py")
                .arg("--dump")
                .arg(built("examples/features_dump")?.get_program()))
        }),
        Step::new("trained models in TensorFlow Lite", || {
            let python = python::environment("tflite", &["models/tests/requirements.txt"])?;
            sh(Command::new(python)
                .current_dir(root())
                .arg("models/tests/tflite_check.py")
                .arg(built("models")?.get_program()))
        }),
        Step::new("real recordings, five random splits", real_data::splits),
        Step::new("real people that a model has never met", real_data::strangers),
        Step::new("real recordings into the simulator", real_data::replay),
        Step::new("planned motions in MuJoCo", || {
            let traces = target_dir().join("plan-traces");
            std::fs::create_dir_all(&traces)?;
            sh(built("examples/plan-trace")?.arg(&traces))?;
            let python = python::environment("mujoco", &["tests/mujoco/requirements.txt"])?;
            sh(Command::new(python).current_dir(root()).arg("tests/mujoco/check.py").arg(&traces))
        }),
        Step::new("the page in headless Chromium", || {
            BROWSER.ensure()?;
            built("examples/state-at")?;
            let python = python::environment("web", &["tests/web/requirements.txt"])?;
            sh(Command::new(python)
                .current_dir(root())
                .arg("tests/web/check.py")
                .arg(target_dir().join("debug")))
        }),
        Step::new("a live session as Foxglove sees it", || {
            built("examples/state-at")?;
            let python = python::environment("foxglove", &["tests/foxglove/requirements.txt"])?;
            sh(Command::new(python)
                .current_dir(root())
                .arg("tests/foxglove/check.py")
                .arg(target_dir().join("debug")))
        }),
        Step::new("a session's file read by others", || {
            let folder = target_dir().join("session-file");
            // Files of sessions are never written over.
            let _ = std::fs::remove_dir_all(&folder);
            std::fs::create_dir_all(&folder)?;
            let (file, summary) = (folder.join("demo.mcap"), folder.join("demo.json"));
            let mut demo = built("host-bridge")?;
            demo.args(["demo", "--headless", "--speed", "0", "--json", "--record"]).arg(&file);
            std::fs::write(&summary, output(&mut demo)?)?;
            let python = python::environment("mcap", &["tests/mcap/requirements.txt"])?;
            sh(Command::new(python).current_dir(root()).arg("tests/mcap/check.py").arg(&file).arg(&summary))?;
            sh(built("host-bridge")?.arg("replay").arg(&file))
        }),
    ]
}
