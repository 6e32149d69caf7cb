// The page: takes what the bridge says, draws it once per frame of the display, and can stop the robot.

import { Renderer } from "./draw.js";
import { connect } from "./link.js";
import { multiply, place, scaling, translation } from "./matrix.js";
import { Panels } from "./panels.js";
import { baseFrame, jointFrames, robotParts, sceneParts } from "./robot.js";

const $ = (id) => document.getElementById(id);
const canvas = $("scene");
const panels = new Panels();

let setting = null;
let state = null;
let still = [];
let renderer = null;
let colours = {};
let dirty = false;
let drawn = null;
let contact = "lost";
let stopAsked = false;

// ---- the camera

const VIEWS = {
  follow: { yaw: -0.85, pitch: 0.42, distance: 2.9 },
  above: { yaw: -Math.PI / 2, pitch: 1.5533, distance: 4.6 },
  side: { yaw: -Math.PI / 2, pitch: 0.1, distance: 3.2 },
};
const orbit = { ...VIEWS.follow };

function look(name) {
  Object.assign(orbit, VIEWS[name]);
  for (const button of document.querySelectorAll("[data-camera]")) {
    button.setAttribute("aria-pressed", String(button.dataset.camera === name));
  }
  dirty = true;
}

function turn(yaw, pitch, nearer) {
  orbit.yaw += yaw;
  orbit.pitch = Math.min(Math.max(orbit.pitch + pitch, 0.03), 1.5533);
  orbit.distance = Math.min(Math.max(orbit.distance * nearer, 0.8), 20);
  dirty = true;
}

/** Looks at the robot, wherever it drives. */
function camera() {
  const { x_m, y_m } = state.odometry;
  const target = [x_m, y_m, 0.55];
  const flat = Math.cos(orbit.pitch) * orbit.distance;
  const eye = [
    target[0] + flat * Math.cos(orbit.yaw),
    target[1] + flat * Math.sin(orbit.yaw),
    target[2] + Math.sin(orbit.pitch) * orbit.distance,
  ];
  return { eye, target, up: [0, 0, 1], angle: 0.72, distance: orbit.distance };
}

function listenToCamera() {
  const held = new Map();
  let apart = 0;
  canvas.addEventListener("pointerdown", (event) => {
    held.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.setPointerCapture(event.pointerId);
    apart = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = held.get(event.pointerId);
    if (!before) return;
    held.set(event.pointerId, [event.clientX, event.clientY]);
    if (held.size === 1) {
      turn((before[0] - event.clientX) * 0.008, (event.clientY - before[1]) * 0.008, 1);
      return;
    }
    const [one, two] = [...held.values()];
    const now = Math.hypot(one[0] - two[0], one[1] - two[1]);
    if (apart > 0 && now > 0) turn(0, 0, apart / now);
    apart = now;
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => held.delete(event.pointerId));
  }
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    turn(0, 0, Math.exp(Math.sign(event.deltaY) * 0.1));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const keys = {
      ArrowLeft: [0.1, 0, 1], ArrowRight: [-0.1, 0, 1], ArrowUp: [0, 0.08, 1], ArrowDown: [0, -0.08, 1],
      "+": [0, 0, 0.9], "=": [0, 0, 0.9], "-": [0, 0, 1.1],
    };
    if (keys[event.key] && !event.ctrlKey && !event.metaKey && !event.altKey) {
      event.preventDefault();
      turn(...keys[event.key]);
    }
  });
  for (const button of document.querySelectorAll("[data-camera]")) {
    button.addEventListener("click", () => look(button.dataset.camera));
  }
}

// ---- the stop

function stop() {
  stopAsked = link.stop();
  if (!stopAsked) panels.say("Not connected: this page cannot stop the robot.");
  showContact();
}

$("stop").addEventListener("click", stop);
// The space bar stops whatever has the focus; buttons are pressed with Enter.
const isStopKey = (event) => event.code === "Space" && !event.ctrlKey && !event.metaKey && !event.altKey;
addEventListener("keydown", (event) => {
  if (!isStopKey(event)) return;
  event.preventDefault();
  if (!event.repeat) stop();
}, { capture: true });
addEventListener("keyup", (event) => {
  if (isStopKey(event)) event.preventDefault();
}, { capture: true });

// ---- episodes

for (const button of document.querySelectorAll("[data-mark]")) {
  button.addEventListener("click", () => {
    if (!link.mark(button.dataset.mark)) panels.say("Not connected: this page cannot mark episodes.");
  });
}

// ---- the first minute

$("show").addEventListener("click", () => {
  if (!link.show()) panels.say("Not connected: this page cannot ask the board for anything.");
});

// ---- the link

function told(message) {
  if (message.hello) {
    setting = message.setting;
    state = null;
    still = sceneParts(setting);
    link.begin();
    $("episodes").hidden = !message.marks;
    panels.begin(message);
    renderer?.path.clear();
    renderer?.trace.clear();
    return;
  }
  state = message.state;
  panels.news(message.news);
  renderer?.path.push(message.news.path.map(([x, y]) => [x, y, 0.006]));
  renderer?.trace.push(message.news.trace);
  dirty = true;
}

function showContact() {
  const banner = $("banner");
  const texts = {
    lost: "No connection: what is shown is old, and this page cannot stop the robot. Bend both fingers, or press space in the terminal.",
    over: "The session is over.",
    open: "",
  };
  let text = texts[contact];
  if (contact === "open" && state?.safety === "stopped") {
    text = "Stopped. To go on: hold both hands neutral for a second, then draw up-down.";
    if (state.refusal) text += ` The robot itself refuses, too: ${state.refusal}`;
  } else if (contact === "open" && state?.refusal) {
    text = `The robot refuses to move: ${state.refusal}`;
  } else if (contact === "open" && stopAsked) {
    text = "Stop sent …";
  }
  if (state?.safety === "stopped") stopAsked = false;
  if (banner.textContent !== text) {
    banner.textContent = text;
    banner.dataset.kind = contact;
    banner.hidden = text === "";
  }
  $("safety").hidden = contact === "lost" && !state;
}

const link = connect(told, (change) => {
  contact = change;
  stopAsked = false;
  if (change !== "open") {
    $("safety").dataset.state = "none";
    $("safety-text").textContent = change === "over" ? "over" : "not connected";
    $("safety").shown = undefined;
    $("safety-text").shown = undefined;
  }
  showContact();
});

// ---- drawing

function recolour() {
  const style = getComputedStyle(document.documentElement);
  const probe = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgb = (name) => {
    probe.fillStyle = style.getPropertyValue(`--${name}`).trim();
    probe.fillRect(0, 0, 1, 1);
    return [...probe.getImageData(0, 0, 1, 1).data.slice(0, 3)].map((v) => v / 255);
  };
  const names = ["sky", "floor", "grid", "shadow", "link", "band", "body", "trim", "chassis", "tyre", "hub", "lamp", "box", "path", "trace", "marker"];
  colours = Object.fromEntries(names.map((name) => [name, rgb(name)]));
  colours.shadowShare = Number(style.getPropertyValue("--shadow-share"));
  panels.recolour(style);
  dirty = true;
}

function startRenderer() {
  try {
    renderer = new Renderer(canvas);
  } catch {
    renderer = null;
    canvas.hidden = true;
    $("no-webgl").hidden = false;
  }
}

function draw() {
  const frames = jointFrames(setting, state);
  const flange = place(frames.at(-1));
  const eye = camera();
  const parts = [...still, ...robotParts(setting, state)];
  const marker = { mesh: "ball", matrix: multiply(translation(flange), scaling([0.016, 0.016, 0.016])), colour: "marker" };
  const view = renderer.draw({ parts, camera: eye, colours, marker });
  drawn = { state, view, flange, frames, parts: parts.length };
}

function frame(now) {
  requestAnimationFrame(frame);
  if (!state || !setting) return;
  const resized = renderer?.resize();
  if (!dirty && !resized) return;
  dirty = false;
  if (contact === "open") panels.show(state, now);
  if ($("scene").parentElement.dataset.state !== state.safety) $("scene").parentElement.dataset.state = state.safety;
  if (renderer) draw();
  showContact();
  link.took();
}

canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
canvas.addEventListener("webglcontextrestored", () => {
  startRenderer();
  dirty = true;
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);
new ResizeObserver(() => {
  panels.measure();
  dirty = true;
}).observe($("traces"));

panels.measure();
startRenderer();
recolour();
listenToCamera();
showContact();
requestAnimationFrame(frame);

/** What is on the screen, for tests and for the curious: `bimanual.drawn()` in the console. */
window.bimanual = {
  drawn() {
    if (!drawn) return null;
    const pixel = (point) => renderer.pixelOf(drawn.view, point);
    return {
      ...drawn,
      size: [canvas.width, canvas.height],
      base: place(baseFrame(drawn.state)),
      flangePixel: pixel(drawn.flange),
      boxes: setting.boxes.map((box) => {
        const top = [box.center_m[0], box.center_m[1], box.center_m[2] + box.half_m[2]];
        return { name: box.name, top, pixel: pixel(top) };
      }),
      path: renderer.path.count,
      trace: renderer.trace.count,
      contact,
    };
  },
  look,
};
