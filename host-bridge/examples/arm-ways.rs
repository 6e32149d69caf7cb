//! Plans paths between random poses of an arm from a URDF.
//! The checker `tests/arms/check.py` reads the output.
//!
//! ```text
//! cargo run -p host-bridge --features urdf --example arm-ways -- OUT.json FILE.urdf PACKAGES ROOT TIP PAIRS [MARGIN_MM]
//! ```
//! If ROOT or TIP is `-`, the URDF's own link is used.
//! The arm stands on a post between two boxes of the arm's size.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use host_bridge::arm::urdf::{Missing, parse};
use host_bridge::arm_file;
use host_bridge::plan::{Case, Placement, Planner, Purse};
use host_bridge::robot::{Joints, Random};
use host_bridge::scene::{ArmTable, Scene};
use serde_json::json;

/// Default distance that plans keep from obstacles.
const MARGIN_MM: f64 = 10.0;
/// Each requested pose is further from obstacles than the margin, by at least this distance.
const SPARE_M: f64 = 0.001;
/// Requested joint angles are at most half a turn from zero. For a slide, the unit is metres.
const HALF_TURN: f64 = 3.1;
/// Samples per second of a path.
const RATE: f64 = 200.0;

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [out, urdf, packages, root, tip, pairs, rest @ ..] = args.as_slice() else {
        bail!("usage: arm-ways OUT.json FILE.urdf PACKAGES ROOT TIP PAIRS [MARGIN_MM]");
    };
    let margin_mm: f64 =
        rest.first().map_or(Ok(MARGIN_MM), |mm| mm.parse()).context("MARGIN_MM is a number")?;
    let margin_m = 0.001 * margin_mm;
    let named = |name: &String| (name != "-").then(|| name.clone());
    let table = ArmTable {
        root: named(root),
        tip: named(tip),
        packages: vec![PathBuf::from(packages)],
        ..ArmTable::default()
    };
    let pairs: usize = pairs.parse().context("PAIRS is a number")?;
    let file = arm_file::read(urdf.as_ref(), "".as_ref(), &table).map_err(anyhow::Error::msg)?;
    let arm = parse(&file.text, &Missing::of(&table))?;
    let notes = [file.notes, arm.notes.clone()].concat();
    let reach_m: f64 =
        arm.joints.iter().map(|joint| joint.origin_m.length()).sum::<f64>() + arm.flange_m.length();
    let size_m = 0.2 * reach_m;
    let boxes =
        [[0.6 * reach_m, 0.25 * reach_m, 0.3 * reach_m], [-0.3 * reach_m, -0.6 * reach_m, 0.5 * reach_m]];
    let mut scene = format!(
        "[base]\nsize_m = [0.02, 0.02, 0.02]\nmount_m = [0.0, 0.0, 2.0]\n\
         [arm]\nvelocity_scaling = 1.0\nacceleration_scaling = 1.0\nmargin_m = {margin_m:?}\n"
    );
    for (i, [x, y, z]) in boxes.iter().enumerate() {
        scene += &format!(
            "[[box]]\nname = \"box {i}\"\ncenter_m = [{x:?}, {y:?}, {:?}]\nsize_m = [{size_m:?}, {size_m:?}, {size_m:?}]\n",
            z + 2.0
        );
    }
    let planner = Planner::new(arm, Scene::parse(&scene)?)?;
    let world = planner.world();
    let around = world.around(Placement::default());
    let mut random = Random::new(12);
    let mut near: BTreeMap<String, usize> = BTreeMap::new();
    let mut pose = || -> Option<Joints> {
        (0..3000).find_map(|_| {
            let mut joints_rad = Joints::default();
            for (value, joint) in joints_rad.iter_mut().zip(&world.arm().joints) {
                let (low, high) = joint.limit_rad.unwrap_or((-HALF_TURN, HALF_TURN));
                // For a joint with a larger range, half a turn each way already gives every orientation once.
                // The path itself may use the entire range.
                *value = random.between(low.max(-HALF_TURN), high.min(HALF_TURN));
            }
            let found = around.arm_clearance(&joints_rad);
            if found.distance_m < margin_m + SPARE_M {
                let (one, two) = found.parts;
                *near.entry(format!("{} and {}", world.name(one), world.name(two))).or_default() += 1;
                return None;
            }
            Some(joints_rad)
        })
    };
    let count = world.arm().joints.len();
    let (mut ways, mut refused, mut told) = (Vec::new(), 0, Vec::new());
    for k in 0..pairs {
        let (Some(from), Some(to)) = (pose(), pose()) else { break };
        let purse = Purse::default();
        let case = Case { placement: Placement::default(), things: world.start(), purse: &purse };
        match planner.plan_among(&from, &to, case, k as u64) {
            Ok(plan) => {
                let steps = (plan.trajectory.duration_s() * RATE).ceil() as u32;
                let at = |k: u32| plan.trajectory.motion(f64::from(k) / RATE).joints_rad[..count].to_vec();
                ways.push((0..=steps).map(at).collect::<Vec<_>>());
            }
            Err(why) => {
                refused += 1;
                told.push(why.to_string());
            }
        }
    }
    let arm = world.arm();
    let capsules: usize = arm.foot.len() + arm.joints.iter().map(|joint| joint.shapes.len()).sum::<usize>();
    println!(
        "{}: {count} joints, {capsules} capsules; {} ways planned, {refused} refused",
        arm.name,
        ways.len()
    );
    println!("  poses left out, for parts that are near: {near:?}");
    for note in notes.iter().chain(world.notes()).chain(&told) {
        println!("  {note}");
    }
    let judged = json!({
        "arm": arm.name, "root": arm.root_link, "tip": arm.flange_link, "urdf": urdf, "packages": packages,
        "joints": arm.joints.iter().map(|joint| &joint.name).collect::<Vec<_>>(),
        "boxes": boxes, "size_m": size_m, "pairs": pairs, "refused": refused, "ways": ways,
        "unread": notes.iter().filter(|note| note.contains("not read")).collect::<Vec<_>>(),
    });
    std::fs::write(out, serde_json::to_vec(&judged)?).with_context(|| out.clone())
}
