//! Solves the inverse kinematics of three arms for 1,000 reachable places each.
//! The program prints the numbers of successes and the times.
//! The program also writes the places, so that `tests/arms/kdl.py` can check the results.
//!
//! ```text
//! cargo run --release -p host-arm --features urdf --example ik-times -- FOLDER
//! ```

use std::fmt::Write as _;
use std::time::Instant;

use host_arm::ik;
use host_arm::model::SerialArm;
use host_arm::urdf::{Missing, parse};
use host_robot::{Joints, Pose, Random};

const PLACES: usize = 1000;

/// Each joint has an origin in m, an orientation as roll, pitch and yaw in rad, and limits in rad.
type Joint = ([f64; 3], [f64; 3], [f64; 2]);
const PI: f64 = std::f64::consts::PI;
const HALF: f64 = std::f64::consts::FRAC_PI_2;
const TURN: f64 = std::f64::consts::TAU;

/// The figures are from Universal Robots' description; each joint turns about its own z axis.
const UR5E: [Joint; 6] = [
    ([0.0, 0.0, 0.1625], [0.0, 0.0, 0.0], [-TURN, TURN]),
    ([0.0, 0.0, 0.0], [HALF, 0.0, 0.0], [-TURN, TURN]),
    ([-0.425, 0.0, 0.0], [0.0, 0.0, 0.0], [-PI, PI]),
    ([-0.3922, 0.0, 0.1333], [0.0, 0.0, 0.0], [-TURN, TURN]),
    ([0.0, -0.0997, 0.0], [HALF, 0.0, 0.0], [-TURN, TURN]),
    ([0.0, 0.0996, 0.0], [HALF, PI, PI], [-TURN, TURN]),
];

/// The same figures for UFACTORY's xArm6.
const XARM6: [Joint; 6] = [
    ([0.0, 0.0, 0.267], [0.0, 0.0, 0.0], [-TURN, TURN]),
    ([0.0, 0.0, 0.0], [-HALF, 0.0, 0.0], [-2.059, 2.0944]),
    ([0.053, -0.2845, 0.0], [0.0, 0.0, 0.0], [-3.927, 0.19198]),
    ([0.0775, 0.3425, 0.0], [-HALF, 0.0, 0.0], [-TURN, TURN]),
    ([0.0, 0.0, 0.0], [HALF, 0.0, 0.0], [-1.69297, PI]),
    ([0.076, 0.097, 0.0], [-HALF, 0.0, 0.0], [-TURN, TURN]),
];

fn arm_of(name: &str, joints: &[Joint]) -> SerialArm {
    let mut text = format!("<robot name=\"{name}\"><link name=\"l0\"/>");
    for (i, ([x, y, z], [roll, pitch, yaw], [low, high])) in joints.iter().enumerate() {
        let child = i + 1;
        write!(
            text,
            "<link name=\"l{child}\"/><joint name=\"j{child}\" type=\"revolute\"><origin xyz=\"{x} {y} {z}\" rpy=\"{roll} {pitch} {yaw}\"/>\
             <parent link=\"l{i}\"/><child link=\"l{child}\"/><axis xyz=\"0 0 1\"/>\
             <limit lower=\"{low}\" upper=\"{high}\" effort=\"9\" velocity=\"3\"/></joint>"
        )
        .expect("a string takes all");
    }
    text += "</robot>";
    let missing =
        Missing { root: None, tip: None, link_radius_m: 0.05, acceleration_rad_s2: 5.0, velocity_rad_s: 1.0 };
    parse(&text, &missing).expect("the figures above")
}

fn numbers(values: impl IntoIterator<Item = f64>) -> String {
    values.into_iter().map(|value| format!("{value:?}")).collect::<Vec<_>>().join(",")
}

fn frame(pose: &Pose) -> impl Iterator<Item = f64> {
    let turn = pose.rotation;
    // Row by row.
    let rows = (0..3).flat_map(move |i| [turn.x_axis[i], turn.y_axis[i], turn.z_axis[i]]);
    pose.position_m.to_array().into_iter().chain(rows)
}

fn main() -> std::io::Result<()> {
    let folder = std::path::PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "target/ik".to_owned()));
    std::fs::create_dir_all(&folder)?;
    for (name, arm) in
        [("gen3", SerialArm::gen3()), ("ur5e", arm_of("ur5e", &UR5E)), ("xarm6", arm_of("xarm6", &XARM6))]
    {
        let mut random = Random::new(77);
        let (mut found, mut times_us, mut steps) = (0, Vec::new(), 0);
        let mut text = String::new();
        for joint in &arm.joints {
            let (low, high) = joint.limit_rad.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
            let origin = Pose { position_m: joint.origin_m, rotation: joint.origin_rotation };
            let row = frame(&origin).chain(joint.axis.to_array()).chain([low, high]);
            writeln!(text, "joint,{}", numbers(row)).expect("a string takes all");
        }
        let flange = Pose { position_m: arm.flange_m, rotation: arm.flange_rotation };
        writeln!(text, "flange,{}", numbers(frame(&flange))).expect("a string takes all");
        writeln!(text, "start,{}", numbers(arm.home_rad[..arm.joints.len()].iter().copied()))
            .expect("a string takes all");
        for seed in 0..PLACES as u64 {
            let mut joints_rad = Joints::default();
            for (value, joint) in joints_rad.iter_mut().zip(&arm.joints) {
                let (low, high) = joint.limit_rad.unwrap_or((-PI, PI));
                *value = random.between(low, high);
            }
            let target = arm.flange_pose(&joints_rad);
            writeln!(text, "place,{}", numbers(frame(&target))).expect("a string takes all");
            let start = Instant::now();
            let answer = ik::solve(&arm, &target, &arm.home_rad, seed, |_| true);
            times_us.push(start.elapsed().as_secs_f64() * 1e6);
            steps += ik::steps(&answer);
            if let Ok(solution) = answer {
                let there = arm.flange_pose(&solution.joints_rad);
                let is_there = there.position_m.abs_diff_eq(target.position_m, 1e-6)
                    && there.rotation.abs_diff_eq(target.rotation, 1e-6);
                found += usize::from(is_there && arm.check(&solution.joints_rad).is_ok());
            }
        }
        times_us.sort_by(f64::total_cmp);
        println!(
            "{name}: {found} of {PLACES} found; median {:.1} us, 99 % {:.1} us, most {:.1} us; {:.1} steps each",
            times_us[PLACES / 2],
            times_us[PLACES * 99 / 100],
            times_us[PLACES - 1],
            steps as f64 / PLACES as f64
        );
        std::fs::write(folder.join(format!("{name}.csv")), text)?;
    }
    Ok(())
}
