//! Writes results of the planner, the kinematics and the base to files.
//! `tests/mujoco/check.py` checks these files with an independent physics engine.
//! Usage: `cargo run -p host-bridge --example plan-trace -- DIRECTORY`.
//!
//! All files consist of rows of little-endian f64:
//!
//! | file | columns |
//! |---|---|
//! | `SCENE.motions` | the scene's motions at 100 Hz, one after another; every other one is the best of several plans: number of the motion, seven angles in rad |
//! | `SCENE.tools` | with `--tools`: the same with the vision module and the 2F-85 on the flange, for `tests/arms/gen3.py` |
//! | `SCENE.clearances` | seven angles, the flange's x y z in the arm's frame, shortest distance, all in m |
//! | `moves.jerk` | single moves with limited jerk: from, to, limits of speed, acceleration and jerk (seven each), duration, and the time to stop if the move is halted at its midpoint, in s |
//! | `base.path` | every 2 ms: speed of the left and right wheel in rad/s, x, y, heading, path length |
//!
//! With `BIMANUAL_FULL=1` it writes 34 seeds per pair of poses instead of 2.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, anyhow};
use host_bridge::arm::gen3::{COUNT, paper_limits};
use host_bridge::arm::model::SerialArm;
use host_bridge::base::{Base, BaseConfig, Twist};
use host_bridge::plan::{Case, Placement, Planner, Purse};
use host_bridge::robot::Random;
use host_bridge::robot::Trajectory;
use host_bridge::robot::{JOINTS, JointLimits, Joints, joints};
use host_bridge::scene::Scene;

const SCENES: [(&str, &str); 3] = [
    ("posts", include_str!("../scenes/posts.toml")),
    ("shelf", include_str!("../scenes/shelf.toml")),
    ("bins", include_str!("../scenes/bins.toml")),
];

/// Parts on the flange. The checker `tests/arms/gen3.py` uses the makers' meshes for them.
const TOOLS: &str = "\n[[tool]]\nname = \"gen3-vision\"\n[[tool]]\nname = \"2f-85\"\n";

fn main() -> Result<()> {
    let directory = PathBuf::from(std::env::args_os().nth(1).context("name a directory to write to")?);
    std::fs::create_dir_all(&directory).with_context(|| format!("{}", directory.display()))?;
    let seeds = if std::env::var_os("BIMANUAL_FULL").is_some() { 34 } else { 2 };
    for (name, text) in SCENES {
        let planner = Planner::new(SerialArm::gen3(), Scene::parse(text)?)?;
        motions(&planner, seeds, &directory.join(format!("{name}.motions")))?;
        clearances(&planner, &directory.join(format!("{name}.clearances")))?;
    }
    if std::env::args().nth(2).as_deref() == Some("--tools") {
        // The bins are too high for an arm with a gripper.
        for (name, text) in &SCENES[..2] {
            let planner = Planner::new(SerialArm::gen3(), Scene::parse(&format!("{text}{TOOLS}"))?)?;
            motions(&planner, 2, &directory.join(format!("{name}.tools")))?;
        }
    }
    moves(&directory.join("moves.jerk"))?;
    base(&directory.join("base.path"))
}

fn create(file: &Path) -> Result<BufWriter<File>> {
    Ok(BufWriter::new(File::create(file).with_context(|| format!("{}", file.display()))?))
}

fn write(out: &mut impl Write, row: impl IntoIterator<Item = f64>) -> Result<()> {
    for value in row {
        out.write_all(&value.to_le_bytes())?;
    }
    Ok(())
}

fn motions(planner: &Planner, seeds: u64, file: &Path) -> Result<()> {
    let poses: Vec<Joints> = planner.goals().iter().map(|(_, joints_rad)| *joints_rad).collect();
    let mut out = create(file)?;
    let mut number = 0.0;
    for from in &poses {
        for to in poses.iter().filter(|to| *to != from) {
            for seed in 0..seeds {
                // Every other plan is the best of several, as the robot would drive it.
                let purse = Purse::default();
                let (placement, things) = (Placement::default(), planner.world().start());
                let case = Case { placement, things, purse: &purse };
                let plan = if seed % 2 == 0 {
                    planner.plan_among(from, to, case, seed)
                } else {
                    planner.plan_best(from, to, case, seed)
                };
                let plan = plan.map_err(|refusal| anyhow!("{refusal}"))?;
                let samples = (plan.trajectory.duration_s() * 100.0).ceil() as u64;
                for k in 0..=samples {
                    let joints_rad = plan.trajectory.motion(k as f64 / 100.0).joints_rad;
                    write(&mut out, std::iter::once(number).chain(joints_rad.into_iter().take(COUNT)))?;
                }
                number += 1.0;
            }
        }
    }
    Ok(out.flush()?)
}

fn clearances(planner: &Planner, file: &Path) -> Result<()> {
    let world = planner.world();
    let around = world.around(Placement::default());
    let mut random = Random::new(2);
    let mut out = create(file)?;
    for _ in 0..500 {
        let joints_rad: Joints = std::array::from_fn(|i| {
            let limits = world.arm().joints.get(i).map(|joint| joint.limit_rad.unwrap_or((-3.2, 3.2)));
            limits.map_or(0.0, |(low, high)| random.between(low, high))
        });
        let flange_m = world.arm().flange_pose(&joints_rad).position_m;
        let distance_m = around.arm_clearance(&joints_rad).distance_m;
        write(&mut out, joints_rad.into_iter().take(COUNT).chain(flange_m.to_array()).chain([distance_m]))?;
    }
    Ok(out.flush()?)
}

/// Writes short and long moves, with limits from low to high.
fn moves(file: &Path) -> Result<()> {
    let papers = paper_limits();
    let mut random = Random::new(6);
    let mut out = create(file)?;
    for _ in 0..500 {
        let length = 10.0_f64.powf(random.between(-3.0, 0.3));
        let from = joints::<COUNT>(std::array::from_fn(|_| random.between(-2.0, 2.0)));
        let way = joints::<COUNT>(std::array::from_fn(|_| length * random.between(-1.0, 1.0)));
        let to: Joints = std::array::from_fn(|i| from[i] + way[i]);
        let stiffer = 10.0_f64.powf(random.between(0.0, 1.3));
        let limits = JointLimits {
            acceleration_rad_s2: papers.acceleration_rad_s2.map(|a| a * stiffer),
            jerk_rad_s3: [10.0_f64.powf(random.between(-0.3, 2.0)); JOINTS],
            ..papers
        };
        let motion = Trajectory::through(&[from, to], &[], &limits);
        let halted_s = random.between(0.0, 1.0) * motion.duration_s();
        let braking_s = Trajectory::braking(motion.motion(halted_s), &limits).duration_s();
        let all_limits = [limits.velocity_rad_s, limits.acceleration_rad_s2, limits.jerk_rad_s3];
        let row = [from, to].into_iter().chain(all_limits).flat_map(|all| all.into_iter().take(COUNT));
        write(&mut out, row.chain([motion.duration_s(), halted_s, braking_s]))?;
    }
    Ok(out.flush()?)
}

/// Writes 60 s of random speeds. Each speed lasts one to three seconds.
fn base(file: &Path) -> Result<()> {
    let mut base = Base::new(BaseConfig::default());
    let mut random = Random::new(3);
    let mut out = create(file)?;
    let mut change_at = 0;
    for step in 0..60 * 500 {
        if step == change_at {
            base.drive(Twist {
                linear_m_s: random.between(-0.6, 0.6),
                angular_rad_s: random.between(-1.0, 1.0),
            });
            change_at += 500 + random.below(1000);
        }
        base.step(0.001);
        base.step(0.001);
        let (wheels, odometry) = (base.wheels_rad_s(), base.odometry());
        let place = [odometry.x_m, odometry.y_m, odometry.heading_rad, odometry.path_m];
        write(&mut out, wheels.into_iter().chain(place))?;
    }
    Ok(out.flush()?)
}
