//! The quickest motion along a path of straight segments, with rounded corners.
//!
//! The corners become arcs that stay within [`DEVIATION_RAD`] of the path (Kunz and Stilman 2012), as in MoveIt.
//! On a fine grid, a backward pass then finds the largest speed at each point from which the arm can still brake.
//! A forward pass accelerates as much as these speeds permit (Pham and Pham 2018).
//! The result is the least time on this path, except for the error of the grid.

use host_robot::{JOINTS, JointLimits, Joints};

/// Greatest distance between the path and a rounded corner. This is MoveIt's default.
const DEVIATION_RAD: f64 = 0.1;
/// Cells of the grid per straight segment and per arc.
const CELLS: usize = 40;
/// Steps of the search for the greatest speed. Each step halves the interval.
const HALVINGS: usize = 40;

/// A part of the grid. Within it, the direction and the curvature of the path are constant.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    /// Joint angles at the end of the cell.
    pub joints_rad: Joints,
    direction: Joints,
    curvature: Joints,
    length: f64,
}

fn each(f: impl FnMut(usize) -> f64) -> Joints {
    std::array::from_fn(f)
}

fn length(a: &Joints) -> f64 {
    a.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Divides a path with rounded corners into cells.
pub fn rounded(path_rad: &[Joints]) -> Vec<Cell> {
    let mut points: Vec<Joints> = Vec::new();
    for point in path_rad {
        if points.last().is_none_or(|last| length(&each(|i| point[i] - last[i])) > 1e-9) {
            points.push(*point);
        }
    }
    let ways: Vec<(Joints, f64)> = points
        .windows(2)
        .map(|two| {
            let way = each(|i| two[1][i] - two[0][i]);
            let far = length(&way);
            (way.map(|x| x / far), far)
        })
        .collect();
    let mut cells = Vec::new();
    // Part of the current segment that the previous arc has used.
    let mut used = 0.0;
    for (k, (way, far)) in ways.iter().enumerate() {
        let arc = ways.get(k + 1).and_then(|(next, next_far)| {
            let turn = (0..JOINTS).map(|i| way[i] * next[i]).sum::<f64>().clamp(-1.0, 1.0).acos();
            (turn > 1e-6).then(|| {
                let (s, c) = (0.5 * turn).sin_cos();
                let cut = (0.5 * far).min(0.5 * next_far).min(DEVIATION_RAD * s / (1.0 - c));
                (*next, turn, cut, cut / (0.5 * turn).tan())
            })
        });
        let left = far - used - arc.map_or(0.0, |(_, _, cut, _)| cut);
        for cell in 1..=CELLS {
            let along = used + left * cell as f64 / CELLS as f64;
            let joints_rad = each(|i| points[k][i] + along * way[i]);
            cells.push(Cell {
                joints_rad,
                direction: *way,
                curvature: [0.0; JOINTS],
                length: left / CELLS as f64,
            });
        }
        used = 0.0;
        let Some((next, turn, cut, radius)) = arc else { continue };
        used = cut;
        let corner = &points[k + 1];
        // From the centre of the arc to its start, and to the point that is a quarter turn further.
        let across = each(|i| next[i] - way[i] * turn.cos());
        let inward = length(&across);
        let out = across.map(|x| -x / inward);
        let center = each(|i| corner[i] - cut * way[i] - radius * out[i]);
        for cell in 1..=CELLS {
            let at = |share: f64| (turn * share / CELLS as f64).sin_cos();
            let (s, c) = at(cell as f64);
            let (middle_s, middle_c) = at(cell as f64 - 0.5);
            cells.push(Cell {
                joints_rad: each(|i| center[i] + radius * (out[i] * c + way[i] * s)),
                direction: each(|i| way[i] * middle_c - out[i] * middle_s),
                curvature: each(|i| -(out[i] * middle_c + way[i] * middle_s) / radius),
                length: radius * turn / CELLS as f64,
            });
        }
    }
    cells.retain(|cell| cell.length > 1e-12);
    cells
}

/// Returns the limits of the squared speed at the end of a cell, given the squared speed at its start.
fn onward(cell: &Cell, limits: &JointLimits, before: f64) -> (f64, f64) {
    let (mut low, mut high) = (0.0_f64, fastest(cell, limits));
    for i in 0..JOINTS {
        let most = limits.acceleration_rad_s2[i];
        let (slope, bend) = (cell.direction[i] / (2.0 * cell.length), cell.curvature[i]);
        // The acceleration is slope (after - before) + bend x, where x is the squared speed at either end.
        for (factor, rest) in [(slope, (bend - slope) * before), (slope + bend, -slope * before)] {
            if factor.abs() < 1e-12 {
                if rest.abs() > most {
                    return (f64::INFINITY, f64::NEG_INFINITY);
                }
                continue;
            }
            let (a, b) = ((-most - rest) / factor, (most - rest) / factor);
            low = low.max(a.min(b));
            high = high.min(a.max(b));
        }
    }
    (low, high)
}

/// The greatest squared speed that the joints' speeds permit.
fn fastest(cell: &Cell, limits: &JointLimits) -> f64 {
    let speeds = (0..JOINTS).map(|i| limits.velocity_rad_s[i] / cell.direction[i].abs());
    speeds.fold(f64::INFINITY, f64::min).powi(2)
}

/// Returns the duration of the quickest motion from rest to rest through these cells.
pub fn least_s(cells: &[Cell], limits: &JointLimits) -> f64 {
    // The greatest squared speeds at the starts of the cells, and at the end.
    let mut most = vec![0.0; cells.len() + 1];
    for (k, cell) in cells.iter().enumerate().rev() {
        let can = |before: f64| {
            let (low, high) = onward(cell, limits, before);
            low <= high.min(most[k + 1])
        };
        let (mut low, mut high) = (0.0, fastest(cell, limits));
        if can(high) {
            low = high;
        }
        for _ in 0..HALVINGS {
            if high - low <= 1e-9 * high {
                break;
            }
            let middle = 0.5 * (low + high);
            if can(middle) { low = middle } else { high = middle }
        }
        most[k] = low;
    }
    let (mut speed2, mut duration_s) = (0.0_f64, 0.0);
    for (k, cell) in cells.iter().enumerate() {
        let (_, high) = onward(cell, limits, speed2);
        let next = high.min(most[k + 1]).max(0.0);
        duration_s += 2.0 * cell.length / (speed2.sqrt() + next.sqrt());
        speed2 = next;
    }
    duration_s
}
