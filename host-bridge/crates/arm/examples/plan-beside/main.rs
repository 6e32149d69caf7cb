//! The project's planner, as a peer for other planners: `tests/arms/beside_ompl.py` starts this program.
//!
//! The program prints the scenes, each with pairs of poses, as one line of JSON. Then it serves its input and output.
//! Each request and each answer consists of little-endian f64. A request has nine values: what, scene, and seven more.
//!
//! | what | values | answer |
//! |---|---|---|
//! | 0 | joint angles | 1 if nothing is nearer than the scene's margin, otherwise 0, with the planner's own check |
//! | 1 | pair, seed | for each scaling: single plan and best of several; of each, success (0 or 1), time in s, duration in s |
//! | 2 | - | number of checks since the last such request, and the time in s that they take |
//! | 3 | n; then n rows of seven angles | for each scaling: the time in s to time this path, the duration in s; then the nearest distance in m on the rounded path |
//!
//! All times are processor times of this thread, so that other programs do not count.
//! The checks of request 2 are timed once more, all in one loop, because reading a clock takes as long as a check.

mod timing;

use std::io::{Read as _, Write as _, stdin, stdout};

use host_arm::model::SerialArm;
use host_arm::plan::{Case, Placement, Planner, Purse};
use host_arm::scene::Scene;
use host_robot::{JointLimits, Joints, Trajectory};

const SCENES: [(&str, &str); 3] = [
    ("posts", include_str!("../../../../scenes/posts.toml")),
    ("shelf", include_str!("../../../../scenes/shelf.toml")),
    ("bins", include_str!("../../../../scenes/bins.toml")),
];
/// Shares of the arm's own limits of speed and acceleration: the paper's, and all.
const SCALINGS: [(f64, f64); 2] = [(0.1, 0.05), (1.0, 1.0)];
/// Search range of continuous joints beyond both ends, as in the planner's own search.
const BEYOND_RAD: f64 = 2.0;
const COUNT: usize = 7;

type Failure = Box<dyn std::error::Error>;

/// Processor time of this thread in s.
#[cfg(unix)]
fn now_s() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Elsewhere, the time of the clock in s.
#[cfg(not(unix))]
fn now_s() -> f64 {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    START.get_or_init(std::time::Instant::now).elapsed().as_secs_f64()
}

/// A scene with one planner for each scaling.
struct Place {
    name: &'static str,
    planners: Vec<Planner>,
    /// Pairs of different poses. The second pose is unwound, so that continuous joints take the short way.
    pairs: Vec<(Joints, Joints)>,
}

impl Place {
    fn new((name, text): (&'static str, &str)) -> Result<Self, Failure> {
        let planner = |(velocity_scaling, acceleration_scaling)| -> Result<Planner, Failure> {
            let mut scene = Scene::parse(text)?;
            scene.arm.velocity_scaling = velocity_scaling;
            scene.arm.acceleration_scaling = acceleration_scaling;
            Ok(Planner::new(SerialArm::gen3(), scene)?)
        };
        let planners = SCALINGS.map(planner).into_iter().collect::<Result<Vec<_>, _>>()?;
        let poses: Vec<Joints> = planners[0].goals().iter().map(|(_, joints_rad)| *joints_rad).collect();
        let arm = planners[0].world().arm();
        let pairs = poses.iter().flat_map(|from| {
            poses.iter().filter(move |to| *to != from).map(move |to| (*from, arm.unwound(to, from)))
        });
        Ok(Place { name, pairs: pairs.collect(), planners })
    }

    /// This place as JSON.
    fn told(&self) -> String {
        let world = self.planners[0].world();
        let values = |joints: &[f64]| format!("{:?}", &joints[..COUNT]);
        let pair = |(from, to): &(Joints, Joints)| {
            let range = |i: usize| {
                let beyond = (from[i].min(to[i]) - BEYOND_RAD, from[i].max(to[i]) + BEYOND_RAD);
                world.arm().joints[i].limit_rad.unwrap_or(beyond)
            };
            let low: Vec<f64> = (0..COUNT).map(|i| range(i).0).collect();
            let high: Vec<f64> = (0..COUNT).map(|i| range(i).1).collect();
            format!(
                "{{\"from\":{},\"to\":{},\"low\":{},\"high\":{},\"turns\":{:?},\"least_s\":{:?}}}",
                values(from),
                values(to),
                values(&low),
                values(&high),
                (0..COUNT).map(|i| world.arm().joints[i].limit_rad.is_none()).collect::<Vec<_>>(),
                self.planners.iter().map(|planner| planner.least_s(from, to)).collect::<Vec<_>>(),
            )
        };
        let pairs: Vec<String> = self.pairs.iter().map(pair).collect();
        let margin_m = world.scene().arm.margin_m;
        format!("{{\"name\":\"{}\",\"margin_m\":{margin_m:?},\"pairs\":[{}]}}", self.name, pairs.join(","))
    }

    /// Plans a pair with each scaling, once and as the best of several.
    fn plan(&self, pair: usize, seed: u64) -> Vec<f64> {
        let (from, to) = &self.pairs[pair];
        let mut answer = Vec::new();
        for planner in &self.planners {
            let things = planner.world().start();
            for best in [false, true] {
                let purse = Purse::default();
                let case = Case { placement: Placement::default(), things, purse: &purse };
                let start_s = now_s();
                let plan = if best {
                    planner.plan_best(from, to, case, seed)
                } else {
                    planner.plan_among(from, to, case, seed)
                };
                let took_s = now_s() - start_s;
                let duration_s = plan.as_ref().map_or(0.0, |plan| plan.trajectory.duration_s());
                answer.extend([f64::from(u8::from(plan.is_ok())), took_s, duration_s]);
            }
        }
        answer
    }

    /// Computes the quickest motion with each scaling along a path of another planner, and its nearest distance.
    fn time(&self, path_rad: &[Joints]) -> Vec<f64> {
        let mut answer = Vec::new();
        let mut cells = Vec::new();
        for planner in &self.planners {
            let start_s = now_s();
            cells = timing::rounded(path_rad);
            let duration_s = timing::least_s(&cells, planner.limits());
            answer.extend([now_s() - start_s, duration_s]);
        }
        let around = self.planners[0].world().around(Placement::default());
        let nearest_m = cells.iter().map(|cell| around.arm_clearance(&cell.joints_rad).distance_m);
        answer.push(nearest_m.fold(f64::INFINITY, f64::min));
        answer
    }
}

/// On a straight path, the least time is known: both ways of timing must agree.
fn compare_timing(limits: &JointLimits, from: &Joints, to: &Joints) -> Result<(), Failure> {
    let known_s = Trajectory::through(&[*from, *to], &[], limits).duration_s();
    let found_s = timing::least_s(&timing::rounded(&[*from, *to]), limits);
    if (found_s / known_s - 1.0).abs() > 0.01 {
        return Err(format!("a straight motion takes {known_s} s, but its timing gives {found_s} s").into());
    }
    Ok(())
}

fn joints(values: &[f64]) -> Joints {
    std::array::from_fn(|i| if i < COUNT { values[i] } else { 0.0 })
}

/// Reads values until the input ends.
fn read<const N: usize>() -> Option<[f64; N]> {
    let mut values = [0.0; N];
    let mut bytes = [0; 8];
    let mut input = stdin().lock();
    for value in &mut values {
        input.read_exact(&mut bytes).ok()?;
        *value = f64::from_le_bytes(bytes);
    }
    Some(values)
}

fn main() -> Result<(), Failure> {
    let places = SCENES.map(Place::new).into_iter().collect::<Result<Vec<_>, _>>()?;
    for place in &places {
        for planner in &place.planners {
            let (from, to) = &place.pairs[0];
            compare_timing(planner.limits(), from, to)?;
        }
    }
    let told: Vec<String> = places.iter().map(Place::told).collect();
    println!("[{}]", told.join(","));
    let surroundings: Vec<_> =
        places.iter().map(|place| place.planners[0].world().around(Placement::default())).collect();
    let is_clear = |scene: usize, joints_rad: &Joints| {
        surroundings[scene].is_clear(joints_rad, places[scene].planners[0].world().scene().arm.margin_m)
    };
    let mut checked: Vec<(usize, Joints)> = Vec::new();
    while let Some([what, scene, values @ ..]) = read::<9>() {
        let scene = scene as usize;
        let answer = match what as u8 {
            0 => {
                let joints_rad = joints(&values);
                checked.push((scene, joints_rad));
                vec![f64::from(u8::from(is_clear(scene, &joints_rad)))]
            }
            1 => places[scene].plan(values[0] as usize, values[1] as u64),
            2 => {
                let start_s = now_s();
                let clear = checked.iter().filter(|(scene, at)| is_clear(*scene, at)).count();
                std::hint::black_box(clear);
                let took_s = now_s() - start_s;
                let count = std::mem::take(&mut checked).len();
                vec![count as f64, took_s]
            }
            3 => {
                let rows = (0..values[0] as usize).map(|_| read::<COUNT>().map(|row| joints(&row)));
                let Some(path_rad) = rows.collect::<Option<Vec<_>>>() else { break };
                places[scene].time(&path_rad)
            }
            other => return Err(format!("there is no request {other}").into()),
        };
        let bytes: Vec<u8> = answer.iter().flat_map(|value| value.to_le_bytes()).collect();
        stdout().write_all(&bytes)?;
        stdout().flush()?;
    }
    Ok(())
}
