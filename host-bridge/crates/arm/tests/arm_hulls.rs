//! Checks that the Gen3's capsules and the bundled tools enclose the makers' meshes.
//!
//! The test contains a few vertices that are far from each capsule's line.
//! Hulls of the complete meshes may be available in `../shared/data/arm-hulls`.
//! The folder `../shared` is not part of this project.
//! If these hulls are available, the test checks all their vertices.

use std::path::Path;

use host_arm::model::SerialArm;
use host_arm::tool::{Tool, ToolTable};
use host_robot::shape::Capsule;
use host_robot::{DMat3, DVec3};

/// Vertices of kortex_description's meshes with the largest distances from the capsules' lines.
/// Coordinates are in the links' frames, in m.
const GEN3: [(&str, [[f64; 3]; 5]); 8] = [
    (
        "base_link",
        [
            [0.046, 0.0, 0.0],
            [-0.0457, -0.0048, 0.1703],
            [-0.0456, -0.0295, 0.0893],
            [-0.0456, 0.0295, 0.0893],
            [-0.0341, 0.0308, 0.1703],
        ],
    ),
    (
        "shoulder_link",
        [
            [0.0, -0.0391, -0.1716],
            [-0.0452, -0.0341, -0.1024],
            [0.0452, -0.0341, -0.1024],
            [0.0458, 0.0192, -0.1322],
            [-0.0458, 0.0192, -0.1322],
        ],
    ),
    (
        "half_arm_1_link",
        [
            [0.0, -0.1838, 0.0395],
            [-0.042, -0.007, -0.0406],
            [0.042, -0.007, -0.0406],
            [-0.0038, -0.2242, -0.0522],
            [0.0, 0.0426, -0.0465],
        ],
    ),
    (
        "half_arm_2_link",
        [
            [-0.0053, -0.0437, -0.0024],
            [0.0053, 0.0437, -0.0024],
            [-0.044, 0.0, -0.0024],
            [0.044, 0.0, -0.0024],
            [-0.0329, 0.0292, -0.0024],
        ],
    ),
    (
        "forearm_link",
        [
            [-0.044, 0.0, -0.0024],
            [-0.0042, 0.0433, -0.0452],
            [0.0141, -0.2203, 0.0257],
            [-0.0191, -0.2203, 0.0229],
            [0.0438, 0.0037, -0.0024],
        ],
    ),
    (
        "spherical_wrist_1_link",
        [
            [0.0074, -0.0324, -0.0025],
            [-0.0324, -0.0074, -0.0025],
            [0.0324, 0.0074, -0.0025],
            [-0.0074, 0.0324, -0.0025],
            [0.0312, -0.0401, -0.0893],
        ],
    ),
    (
        "spherical_wrist_2_link",
        [
            [0.0, -0.0716, 0.0339],
            [0.0, -0.1178, 0.0348],
            [0.0, 0.0318, -0.0409],
            [0.0274, -0.1178, 0.0216],
            [-0.0274, -0.1178, 0.0216],
        ],
    ),
    (
        "bracelet_no_vision_link",
        [
            [0.02, -0.0265, -0.0025],
            [0.02, 0.0265, -0.0025],
            [-0.02, -0.0265, -0.0025],
            [-0.02, 0.0265, -0.0025],
            [0.0287, 0.0241, -0.0644],
        ],
    ),
];

/// Vertices of the bracelet with the vision module.
const VISION: [[f64; 3]; 3] =
    [[0.0451, -0.0654, -0.0621], [-0.0287, 0.0241, -0.0644], [-0.02, 0.0265, -0.0025]];

/// Returns the distance of a point from a capsule's surface; negative inside.
fn out_m(capsule: &Capsule, point: DVec3) -> f64 {
    capsule.distance_m(&Capsule { a_m: point, b_m: point, radius_m: 0.0 })
}

fn furthest_out_m(capsules: &[Capsule], points: &[DVec3]) -> f64 {
    let out = |point: &DVec3| capsules.iter().map(|c| out_m(c, *point)).fold(f64::INFINITY, f64::min);
    points.iter().map(out).fold(f64::NEG_INFINITY, f64::max)
}

/// Returns the vertices of a hull, if it is available.
fn hull(name: &str) -> Option<Vec<DVec3>> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../../shared/data/arm-hulls")
        .join(format!("{name}.csv"));
    let Ok(text) = std::fs::read_to_string(&file) else {
        println!("SKIPPED: {} is not there", file.display());
        return None;
    };
    let points: Vec<DVec3> = text
        .lines()
        .filter_map(|line| {
            let values: Vec<f64> = line.split(',').map(|v| v.trim().parse().ok()).collect::<Option<_>>()?;
            Some(DVec3::new(*values.first()?, *values.get(1)?, *values.get(2)?))
        })
        .collect();
    assert!(points.len() > 20, "{name}: {} vertices", points.len());
    Some(points)
}

fn links() -> Vec<Capsule> {
    let arm = SerialArm::gen3();
    arm.foot.iter().chain(arm.joints.iter().flat_map(|joint| &joint.shapes)).copied().collect()
}

fn tool(name: &str) -> Tool {
    Tool::new(&[ToolTable { name: name.to_owned(), ..ToolTable::default() }]).unwrap()
}

#[test]
fn the_gen3s_links_are_within_their_capsules() {
    for ((name, points), capsule) in GEN3.iter().zip(links()) {
        let figures = points.map(DVec3::from);
        assert!(furthest_out_m(&[capsule], &figures) < -0.0002, "{name}");
        if let Some(points) = hull(&format!("gen3_{name}")) {
            let out_mm = 1000.0 * furthest_out_m(&[capsule], &points);
            println!("{name}: {} vertices, the outermost {:.2} mm within", points.len(), -out_mm);
            assert!(out_mm < -0.2, "{name}: {out_mm} mm");
        }
    }
}

#[test]
fn the_vision_module_is_within_its_tool() {
    let shapes = tool("gen3-vision").shapes(None);
    // The flange's z axis is that of the bracelet.
    let arm = SerialArm::gen3();
    let on_flange = |p: DVec3| arm.flange_rotation.transpose() * (p - arm.flange_m);
    let points: Vec<DVec3> = VISION.iter().map(|p| on_flange((*p).into())).collect();
    assert!(furthest_out_m(&shapes, &points) < -0.0002);
    if let Some(points) = hull("gen3_bracelet_with_vision_link") {
        let points: Vec<DVec3> = points.into_iter().map(on_flange).collect();
        assert!(furthest_out_m(&shapes, &points) < -0.0002);
    }
}

/// Returns the rotation and the origin of the gripper's parts on the side of +x.
/// The gripper's driven joint is at this angle.
fn finger_parts(angle_rad: f64) -> [(&'static str, DMat3, DVec3); 4] {
    // About 0 -1 0.
    let turn = DMat3::from_rotation_y(-angle_rad);
    let knuckle = DVec3::new(0.030_601_14, 0.0, 0.054_904_52);
    let finger = knuckle + turn * DVec3::new(0.031_526_16, 0.0, -0.003_763_47);
    let tip = finger + turn * DVec3::new(0.005_631_34, 0.0, 0.047_185_15);
    [
        ("knuckle", turn, knuckle),
        ("finger", turn, finger),
        ("inner_knuckle", turn, DVec3::new(0.0127, 0.0, 0.061_42)),
        ("finger_tip", DMat3::IDENTITY, tip),
    ]
}

#[test]
fn the_grippers_parts_are_within_its_shapes_however_far_it_is_open() {
    let tool = tool("2f-85");
    if let Some(points) = hull("2f85_robotiq_base") {
        // The fingers of the gripper enclose a part of its base.
        let points: Vec<DVec3> = points.into_iter().filter(|p| p.z < 0.05).collect();
        let out_mm = 1000.0 * furthest_out_m(&tool.shapes(Some(0.085)), &points);
        assert!(out_mm < 0.0, "base: {out_mm} mm");
    }
    // The inner side of the pad in the fingertip's frame. The two pads meet when the gripper is closed.
    const PAD_M: f64 = 0.0253;
    for step in 0..=20 {
        let angle_rad = 0.8 * f64::from(step) / 20.0;
        let parts = finger_parts(angle_rad);
        let opening_m = (2.0 * (parts[3].2.x - PAD_M)).max(0.0);
        if step == 0 {
            assert!((opening_m - 0.085).abs() < 0.0002, "{opening_m}");
        }
        let shapes = tool.shapes(Some(opening_m));
        for (part, turn, origin) in parts {
            let Some(points) = hull(&format!("2f85_left_{part}")) else { return };
            let points: Vec<DVec3> = points.into_iter().map(|p| origin + turn * p).collect();
            let out_mm = 1000.0 * furthest_out_m(&shapes, &points);
            assert!(out_mm < 0.1, "{part} at {opening_m:.3} m: {out_mm} mm");
        }
    }
}
