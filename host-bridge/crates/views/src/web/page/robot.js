// From what the bridge says (setting, state) to parts with a place in the world. Pure: nothing is drawn here.

import { along, apply, multiply, pose, rotation, scaling, translation } from "./matrix.js";

/** Links are drawn this much thinner than the shapes that the planner keeps clear of things. */
const LINK_SHARE = 0.84;
const BAND_M = 0.022;
/** A lag of less than this is not worth a second picture. */
const GHOST_RAD = 0.03;
const WHEEL_HALF_WIDTH_M = 0.022;

/** Where the base stands. */
export function baseFrame(state) {
  const { x_m, y_m, heading_rad } = state.odometry;
  return multiply(translation([x_m, y_m, 0]), rotation([0, 0, 1], heading_rad));
}

/** Frames of the joints in the world, and of the flange last: forward kinematics from the joints' angles, or from how far they slide. */
export function jointFrames(setting, state, joints = state.arm.joints_rad) {
  const frames = [];
  let frame = multiply(baseFrame(state), translation(setting.mount_m));
  setting.joints.forEach((joint, i) => {
    frame = multiply(frame, pose(joint.origin_m, joint.origin_rotation));
    const value = joints[i] ?? 0;
    const moved = joint.slides ? translation(joint.axis.map((part) => part * value)) : rotation(joint.axis, value);
    frame = multiply(frame, moved);
    frames.push(frame);
  });
  frames.push(multiply(frame, pose(setting.flange_m, setting.flange_rotation)));
  return frames;
}

/** A box given by its middle, half sizes and turn. */
function uprightBox(frame, box) {
  const turned = multiply(translation(box.center_m), rotation([0, 0, 1], box.yaw_rad));
  return multiply(multiply(frame, turned), scaling(box.half_m));
}

/** The parts of a line with round ends. */
function capsule(parts, frame, { a_m, b_m, radius_m }, share, colour) {
  const r = radius_m * share;
  const [from, to] = [apply(frame, a_m), apply(frame, b_m)];
  const [line, far] = along(from, to);
  if (far > 0) {
    const middle = multiply(line, translation([0, 0, far / 2]));
    parts.push({ mesh: "tube", matrix: multiply(middle, scaling([r, r, far / 2])), colour });
  }
  for (const end of [from, to]) {
    parts.push({ mesh: "ball", matrix: multiply(translation(end), scaling([r, r, r])), colour });
  }
}

function disc(parts, frame, radius, half, colour) {
  parts.push({ mesh: "tube", matrix: multiply(frame, scaling([radius, radius, half])), colour });
}

/** What stands around; it never moves. */
export function sceneParts(setting) {
  const still = translation([0, 0, 0]);
  return setting.boxes.map((box) => ({ mesh: "box", matrix: uprightBox(still, box), colour: "box", name: box.name }));
}

/** Where the arm should be by now, as a thin skeleton, while the arm itself is elsewhere. */
function ghost(parts, setting, state) {
  const asked = state.reference_rad;
  if (!asked || asked.every((angle, i) => Math.abs(angle - (state.arm.joints_rad[i] ?? 0)) < GHOST_RAD)) return;
  const points = jointFrames(setting, state, asked).map((frame) => apply(frame, [0, 0, 0]));
  const world = translation([0, 0, 0]);
  for (let i = 1; i < points.length; i += 1) {
    capsule(parts, world, { a_m: points[i - 1], b_m: points[i], radius_m: 0.012 }, 1, "lamp");
  }
}

/** What can be gripped, where it is now. */
function objectParts(parts, state) {
  for (const object of state.objects ?? []) {
    const half = object.height_m / 2;
    const middle = multiply(pose(object.position_m, object.rotation), translation([0, 0, half]));
    const [length, width] = object.half_m;
    const mesh = object.radius_m === null ? "box" : "tube";
    parts.push({ mesh, matrix: multiply(middle, scaling([length, width, half])), colour: "lamp", name: object.name });
  }
}

/** Everything that moves: the base, its wheels, the arm, what it carries. */
export function robotParts(setting, state) {
  const parts = [];
  objectParts(parts, state);
  const base = baseFrame(state);
  const { center_m, half_m } = setting.body;
  const [length, width] = half_m;
  const top = center_m[2] + half_m[2];
  const floor = center_m[2] - half_m[2];
  const { wheel_radius_m: wheel, track_m: track } = setting.base;

  // The body's outline is the one that the planner keeps clear; below its deck there is room for the wheels.
  const deck = Math.min(Math.max(2 * wheel, floor), top - 0.02);
  const slab = (low, high, l, w, colour) => {
    const shape = { center_m: [center_m[0], center_m[1], (low + high) / 2], half_m: [l, w, (high - low) / 2], yaw_rad: 0 };
    parts.push({ mesh: "box", matrix: uprightBox(base, shape), colour });
  };
  slab(deck + 0.012, top - 0.012, length, width, "body");
  slab(top - 0.012, top, length - 0.012, width - 0.012, "trim");
  slab(deck, deck + 0.012, length - 0.006, width - 0.006, "trim");
  slab(floor, deck, length - 0.02, Math.max(track / 2 - WHEEL_HALF_WIDTH_M - 0.015, 0.05), "chassis");
  // Which way is forward.
  const lamp = multiply(base, translation([center_m[0] + length, center_m[1], (deck + top) / 2]));
  parts.push({ mesh: "box", matrix: multiply(lamp, scaling([0.004, width * 0.6, 0.02])), colour: "lamp" });

  [1, -1].forEach((side, i) => {
    const hub = multiply(base, translation([0, (side * track) / 2, wheel]));
    const turned = multiply(hub, rotation([0, 1, 0], state.wheels_rad[i]));
    const axle = multiply(turned, rotation([1, 0, 0], Math.PI / 2));
    disc(parts, axle, wheel, WHEEL_HALF_WIDTH_M, "tyre");
    disc(parts, axle, wheel * 0.62, WHEEL_HALF_WIDTH_M + 0.003, "hub");
    const spoke = multiply(axle, scaling([wheel * 0.58, wheel * 0.1, WHEEL_HALF_WIDTH_M + 0.006]));
    parts.push({ mesh: "box", matrix: spoke, colour: "tyre" });
  });
  const caster = 0.045;
  const behind = multiply(base, translation([center_m[0] - length + 0.09, center_m[1], caster]));
  parts.push({ mesh: "ball", matrix: multiply(behind, scaling([caster, caster, caster])), colour: "tyre" });

  const mount = multiply(base, translation(setting.mount_m));
  disc(parts, multiply(mount, translation([0, 0, 0.01])), 0.085, 0.01, "band");
  for (const shape of setting.foot) {
    const grounded = { ...shape, a_m: [shape.a_m[0], shape.a_m[1], 0] };
    capsule(parts, mount, grounded, LINK_SHARE, "link");
  }
  // An arm that reports nothing is not drawn: nobody knows where it is.
  if (state.arm_age_ms === null) return parts;
  ghost(parts, setting, state);
  const frames = jointFrames(setting, state);
  setting.joints.forEach((joint, i) => {
    const radius = joint.shapes[0]?.radius_m ?? 0.04;
    for (const shape of joint.shapes) capsule(parts, frames[i], shape, LINK_SHARE, "link");
    // A band around the axis shows which way each joint turns.
    const [onAxis] = along(apply(frames[i], [0, 0, 0]), apply(frames[i], joint.axis));
    disc(parts, onAxis, radius * 0.93, BAND_M, "band");
  });
  const flange = frames[frames.length - 1];
  disc(parts, flange, 0.034, 0.012, "band");
  for (const shape of state.tool ?? []) capsule(parts, flange, shape, LINK_SHARE, "trim");
  return parts;
}
