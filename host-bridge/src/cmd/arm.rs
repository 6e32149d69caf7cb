//! `host-bridge arm`: writes a scene and a self-contained URDF from the description that a robot publishes on ROS 2.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context as _, Result, bail, ensure};
use host_bridge::arm::model::SerialArm;
use host_bridge::arm::urdf::{Missing, parse};
use host_bridge::arm_file::{self, ArmFile};
use host_bridge::profile;
use host_bridge::ros2::ArmInterface;
use host_bridge::scene::{ArmTable, Scene};

use super::ports::read_config;
use super::ros2::look;

/// Options.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// The scene file: an existing one keeps its text and gets a new description of the arm; otherwise it is created
    #[arg(value_name = "SCENE.toml")]
    scene: PathBuf,
    /// First link of the arm, if the scene is new [default: the first link of the robot]
    #[arg(long, value_name = "LINK")]
    root: Option<String>,
    /// Last link of the arm, if the scene is new and the robot has several ends
    #[arg(long, value_name = "LINK")]
    tip: Option<String>,
    /// The controller, if the scene is new and the graph has several
    #[arg(long, value_name = "NAME")]
    controller: Option<String>,
    /// Configuration file: domain, namespace, name of the description's topic
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

/// Examines the graph, and writes the arm and the scene that it finds.
pub fn run(args: &Args) -> Result<ExitCode> {
    let mut config = read_config(args.config.as_deref())?;
    let is_new = !args.scene.exists();
    let mut table = ArmTable { root: args.root.clone(), tip: args.tip.clone(), ..ArmTable::default() };
    if !is_new {
        ensure!(
            args.root.is_none() && args.tip.is_none() && args.controller.is_none(),
            "{} is there and says all that itself: leave --root, --tip and --controller out, or name a new file",
            args.scene.display()
        );
        table = profile::take(&mut config, &args.scene).map_err(anyhow::Error::msg)?.arm;
    }
    let urdf = table.urdf.clone().unwrap_or_else(|| Path::new(&stem(&args.scene)).with_extension("urdf"));
    let into = args.scene.parent().unwrap_or(Path::new("")).join(&urdf);
    ensure!(
        !config.ros2.robot_description.is_empty(),
        "robot_description under [ros2] is empty: it names the topic of the robot's description"
    );
    let wanted = match (&args.controller, is_new) {
        (Some(name), _) => Some(profile::absolute(name)),
        (None, true) => None,
        (None, false) => Some(config.ros2.resolve(&config.ros2.arm_controller)),
    };
    eprintln!("looking at the graph for a description and a controller …");
    let found = look(&config.ros2, wanted.as_deref())?;
    let topic = config.ros2.resolve(&config.ros2.robot_description);
    let Some(text) = found.description else {
        bail!(
            "nobody publishes {topic}: is robot_state_publisher running, in this domain? Its name is robot_description \
             under [ros2]. Controllers on the graph: {}",
            profile::listed(&found.controllers)
        )
    };
    let file =
        arm_file::published(&text, &args.scene, &table).map_err(anyhow::Error::msg).context(topic.clone())?;
    let arm = parse(&file.text, &Missing::of(&table)).context(topic)?;
    let names: Vec<&str> = arm.joints.iter().map(|joint| joint.name.as_str()).collect();
    let controller = if is_new {
        profile::only(&found.controllers, args.controller.as_deref()).map_err(anyhow::Error::msg)?
    } else {
        ensure!(
            config.ros2.arm == ArmInterface::None || names == config.ros2.joint_names,
            "{} has the joints {}, and the robot's arm from {} to {} has {}: correct joint_names, root or tip",
            args.scene.display(),
            config.ros2.joint_names.join(", "),
            arm.root_link,
            arm.flange_link,
            names.join(", ")
        );
        config.ros2.resolve(&config.ros2.arm_controller)
    };
    if !found.controllers.contains(&controller) {
        eprintln!(
            "{controller} has no follow_joint_trajectory action now; on the graph: {}",
            profile::listed(&found.controllers)
        );
    }
    models::recording::write_whole(&into, file.text.as_bytes())
        .with_context(|| into.display().to_string())?;
    if is_new {
        let scene = profile::written(&args.scene, &urdf, &arm, &controller);
        Scene::parse(&scene).context("the scene that would be written")?;
        models::recording::write_whole(&args.scene, scene.as_bytes())
            .with_context(|| args.scene.display().to_string())?;
    }
    say(args, &into, &file, &arm, &controller);
    Ok(ExitCode::SUCCESS)
}

fn stem(scene: &Path) -> String {
    scene.file_stem().map_or_else(|| "arm".to_owned(), |stem| stem.to_string_lossy().into_owned())
}

fn say(args: &Args, into: &Path, file: &ArmFile, arm: &SerialArm, controller: &str) {
    println!(
        "{}: {} from {} to {}: {} joints, moved by {controller}",
        into.display(),
        arm.name,
        arm.root_link,
        arm.flange_link,
        arm.joints.len()
    );
    for joint in &arm.joints {
        let unit = if joint.slides { "m" } else { "rad" };
        let limits = joint
            .limit_rad
            .map_or("without end".to_owned(), |(low, high)| format!("{low:.3} to {high:.3} {unit}"));
        println!("  {}: {limits}, {:.3} {unit}/s", joint.name, joint.velocity_rad_s);
    }
    for note in file.notes.iter().chain(&arm.notes) {
        println!("  {note}");
    }
    println!("next: host-bridge teach \"a name\" --scene {}", args.scene.display());
}
