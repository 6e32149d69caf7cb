// Everything on the page but the picture: texts, bars, tables, traces. Writes only what has changed.

const $ = (id) => document.getElementById(id);
const degrees = (rad) => (rad * 180) / Math.PI;
const svgMove = (x, y) => `translate(${x.toFixed(1)} ${y.toFixed(1)})`;

/** Sets a text, an attribute or a style only where it differs: the browser then has nothing to do. */
function put(element, name, value) {
  element.shown ??= {};
  if (element.shown[name] === value) return;
  element.shown[name] = value;
  if (name === "text") element.textContent = value;
  else if (name === "bar") element.style.transform = value;
  else if (name === "left") element.style.left = value;
  else if (name === "class") element.className = value;
  else element.setAttribute(name, value);
}

const SAFETY = {
  waiting: "waiting for neutral hands",
  armed: "armed",
  stale: "a hand is silent",
  refused: "the robot refuses",
  stopped: "STOPPED",
};

const HEADINGS = { neutral: "neutral", between: "between", forward: "forward ↑", backward: "backward ↓", left: "turn left ↺", right: "turn right ↻" };

/** The bubble touches the rim at this tilt. */
const TILT_MAX_RAD = Math.PI / 4;
const RIM = 48;

function bar(name, kind) {
  const row = document.createElement("div");
  row.className = "bar";
  const label = document.createElement("span");
  label.id = `bar-${name.replaceAll(" ", "-")}`;
  label.textContent = name;
  const track = document.createElement("span");
  track.className = `track ${kind}`;
  track.setAttribute("role", "meter");
  track.setAttribute("aria-labelledby", label.id);
  const fill = document.createElement("i");
  track.append(fill);
  const text = document.createElement("output");
  row.append(label, track, text);
  return { row, track, fill, text };
}

export class Panels {
  constructor() {
    this.labels = null;
    this.scores = [];
    this.joints = [];
    this.samples = [];
    this.lines = [];
    this.traces = $("traces");
    this.slow = 0;
    this.traced = 0;
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
    this.spoken = "";
  }

  /** A session begins. */
  begin({ title, setting }) {
    this.setting = setting;
    this.samples = [];
    $("event-list").replaceChildren();
    const [first, ...rest] = title.split("\n");
    put($("title"), "text", [first.replace(/^bimanual:? ?/, ""), setting.scene, ...rest].filter(Boolean).join(" · "));
    this.joints = setting.joints.map((joint) => {
      const made = bar(joint.name.replace("_", " "), "needle");
      const [low, high] = joint.limit_rad ?? [-Math.PI, Math.PI];
      // Degrees, or millimetres of a joint that slides.
      const shown = joint.slides ? (m) => (m * 1000).toFixed(0) : (rad) => degrees(rad).toFixed(0);
      const unit = joint.slides ? " mm" : "°";
      put(made.track, "aria-valuemin", shown(low));
      put(made.track, "aria-valuemax", shown(high));
      made.row.title = joint.limit_rad ? `limits ${shown(low)}${unit} to ${shown(high)}${unit}` : "turns without end";
      return { ...made, low, high, shown, unit, endless: !joint.limit_rad };
    });
    $("joints").replaceChildren(...this.joints.map((made) => made.row));
  }

  /** What a frame says for the first time. */
  news({ imu, events, bends_permille }) {
    this.bends = bends_permille;
    this.samples.push(...imu);
    if (this.samples.length > 900) this.samples.splice(0, this.samples.length - 800);
    if (events.length > 0) this.addEvents(events);
  }

  addEvents(events) {
    const [list, box] = [$("event-list"), $("events")];
    const atEnd = box.scrollHeight - box.scrollTop - box.clientHeight < 30;
    for (const { time_ms, class: kind, text } of events) {
      const item = document.createElement("li");
      const time = document.createElement("time");
      time.textContent = `${(time_ms / 1000).toFixed(2)} s`;
      const what = document.createElement("span");
      what.className = kind;
      what.textContent = text;
      item.append(time, what);
      list.append(item);
    }
    while (list.childElementCount > 200) list.firstElementChild.remove();
    if (atEnd) box.scrollTop = box.scrollHeight;
    // Read out only what a person must know now: the newest halt or motion of these.
    const urgent = events.filter((event) => event.class !== "").at(-1);
    if (urgent) this.say(urgent.text);
  }

  /** Read out by screen readers. */
  say(text) {
    $("spoken").textContent = text;
  }

  /** The state. `now` is the browser's clock in ms. */
  show(state, now) {
    this.showQuick(state);
    if (now - this.slow >= 100) {
      this.slow = now;
      this.showTexts(state);
    }
    // Scrolling traces are motion too: for those who want little of it they move on once a second.
    if (now - this.traced >= (this.still.matches ? 1000 : 33)) {
      this.traced = now;
      this.drawTraces(state.time_ms);
    }
  }

  showQuick({ safety, left, right, arm, odometry, caps }) {
    put($("safety"), "data-state", safety);
    put($("safety-text"), "text", SAFETY[safety]);
    const far = Math.max(1, Math.hypot(left.pitch_rad, left.roll_rad) / TILT_MAX_RAD);
    const scale = (RIM - 7) / TILT_MAX_RAD / far;
    put($("bubble"), "transform", svgMove(-left.roll_rad * scale, -left.pitch_rad * scale));
    const known = this.bends !== null && this.bends !== undefined;
    ["index", "middle"].forEach((finger, i) => {
      const share = known ? Math.min(Math.max(this.bends[i] / 1000, 0), 1) : 0;
      put($(finger).firstElementChild, "bar", `scaleX(${share.toFixed(2)})`);
      put($(finger), "aria-valuenow", String(Math.round(share * 100)));
      put($(finger), "class", known ? "track" : "track unknown");
    });
    this.showScores(right);
    put($("nearly"), "text", right.nearly ? `almost: ${right.nearly.label} ${right.nearly.confidence.toFixed(1)}` : "");
    this.showWearer(right.prompt);
    arm.joints_rad.slice(0, this.joints.length).forEach((reported, i) => {
      const angle = reported ?? 0;
      const { fill, track, low, high, shown, endless } = this.joints[i];
      const turn = endless ? Math.atan2(Math.sin(angle), Math.cos(angle)) : angle;
      const share = (turn - low) / (high - low);
      put(fill, "left", `${(share * 100).toFixed(1)}%`);
      put(track, "aria-valuenow", shown(turn));
      put(track, "class", !endless && (share < 0.05 || share > 0.95) ? "track needle near" : "track needle");
    });
    for (const [name, speed, cap] of [
      ["linear", odometry.twist.linear_m_s, caps.linear_m_s],
      ["angular", odometry.twist.angular_rad_s, caps.angular_rad_s],
    ]) {
      const share = Math.min(Math.max(speed / cap, -1), 1);
      put($(name).firstElementChild, "bar", `scaleX(${(share / 2).toFixed(3)})`);
      put($(name), "aria-valuenow", String(Math.round(share * 100)));
    }
  }

  showScores({ labels, scores }) {
    const names = labels.join();
    if (names !== this.labels) {
      this.labels = names;
      this.scores = labels.map((label) => bar(label, ""));
      const none = document.createElement("p");
      none.className = "quiet";
      none.textContent = "no model yet";
      $("scores").replaceChildren(...(labels.length > 0 ? this.scores.map((made) => made.row) : [none]));
      for (const { track } of this.scores) {
        put(track, "aria-valuemin", "0");
        put(track, "aria-valuemax", "100");
      }
    }
    const top = Math.max(...scores);
    this.scores.forEach(({ row, fill, track, text }, i) => {
      const score = scores[i] ?? 0;
      put(fill, "bar", `scaleX(${score.toFixed(2)})`);
      put(track, "aria-valuenow", String(Math.round(score * 100)));
      put(text, "text", score.toFixed(2));
      put(row, "class", score === top && score > 0 ? "bar top" : "bar");
    });
  }

  /** What the wearer of the right hand is asked, and what the button does now. */
  showWearer(prompt) {
    $("wearer").hidden = !prompt;
    if (!prompt) return;
    put($("wearer-text"), "text", prompt.text);
    $("show").hidden = !prompt.button;
    put($("show"), "text", prompt.button ?? "");
  }

  /** Figures that nobody reads sixty times a second. */
  showTexts(state) {
    const { left, right, arm, odometry, caps } = state;
    put($("clock"), "text", `${(state.time_ms / 1000).toFixed(1)} s`);
    const hand = state.one_handed ? "right" : "left";
    put($("driving"), "text", state.one_handed ? "Right hand's tilt" : "Left hand");
    $("fingers").hidden = state.one_handed;
    put($("heading"), "text", state[hand].link.connected ? HEADINGS[left.heading] : `no ${hand} hand`);
    const tilt = (rad, one, other) => `${Math.abs(degrees(rad)).toFixed(0)}° ${rad < 0 ? other : one}`;
    put($("tilt-text"), "text", `${tilt(left.pitch_rad, "forward", "backward")}, ${tilt(left.roll_rad, "left", "right")}`);
    put($("caps"), "text", `at most ${caps.linear_m_s.toFixed(2)} m/s, ${degrees(caps.angular_rad_s).toFixed(0)} °/s`);
    for (const [finger, count] of [["index", left.index_bends], ["middle", left.middle_bends]]) {
      put($(`${finger}-text`), "text", left.stop ? "stop" : `${count} bend${count === 1 ? "" : "s"}`);
    }
    this.joints.forEach(({ text, shown, unit }, i) => put(text, "text", arm.joints_rad[i] === null ? "–" : `${shown(arm.joints_rad[i])}${unit}`));
    put($("linear-text"), "text", `${odometry.twist.linear_m_s.toFixed(2)} m/s`);
    put($("angular-text"), "text", `${degrees(odometry.twist.angular_rad_s).toFixed(0)} °/s`);
    const legs = { planning: "planning", "to-home": "home first", "to-goal": "on its way", jogging: "moved by hand", halting: "halting" };
    const doing = arm.running ? `${arm.running[0].replaceAll("-", " ")}: ${legs[arm.running[1]]}` : "arm at rest";
    const heard = state.arm_age_ms === null ? "the arm reports nothing" : doing;
    const late = state.arm_age_ms > 100 ? ` (${state.arm_age_ms} ms old)` : "";
    put($("doing"), "text", heard + late);
    const where = `x ${odometry.x_m.toFixed(2)} m, y ${odometry.y_m.toFixed(2)} m, ${degrees(odometry.heading_rad).toFixed(0)}°`;
    const jog = state.jogging && `jogging: the ${hand} hand moves the tool${state.jog_held ? ` (held: ${state.jog_held})` : ""}`;
    const held = [jog, state.held && `held back: ${state.held}`, state.restriction].filter(Boolean).map((text) => `; ${text}`).join("");
    const known = state.base_age_ms === null ? "reports nothing" : `${where}; ${odometry.path_m.toFixed(1)} m driven`;
    put($("base-text"), "text", `base: ${known}${held}`);
    put($("scene-text"), "text", `Base at ${where}. ${doing}. ${this.setting.boxes.length} boxes around.`);
    this.showLinks(left.link, right.link, state.accepted);
  }

  showLinks(left, right, accepted) {
    const life = (link) => (!link.connected ? "none" : link.live ? "live" : "silent");
    const ms = (value) => (value === null ? "–" : `${value} ms`);
    const rows = [
      ["state", life],
      ["newest sample", (link) => (link.connected ? ms(link.age_ms) : "–")],
      ["round trip", (link) => ms(link.round_trip_ms)],
      ["sample to robot", (_, taken) => (taken === null ? "–" : `${taken.age_ms} ms, worst ${taken.worst_ms}`)],
      ["frames", (link) => link.counters.frames],
      ["lost", (link) => link.counters.lost],
      ["damaged", (link) => link.counters.damaged + link.counters.unreadable],
      ["battery", (link) => (!link.connected ? "–" : link.battery_mv === null ? "unknown" : `${(link.battery_mv / 1000).toFixed(2)} V`)],
      ["health", (link) => (link.health === 0 ? "good" : `flags ${link.health.toString(2)}`)],
    ];
    if (this.lines.length === 0) {
      this.lines = rows.map(([name]) => {
        const row = document.createElement("tr");
        const head = document.createElement("th");
        head.scope = "row";
        head.textContent = name;
        const cells = [document.createElement("td"), document.createElement("td")];
        row.append(head, ...cells);
        $("links").append(row);
        return cells;
      });
    }
    rows.forEach(([name, value], i) => {
      [left, right].forEach((link, hand) => {
        const cell = this.lines[i][hand];
        const shown = value(link, hand === 0 ? accepted.base : accepted.arm);
        put(cell, "text", String(shown));
        if (name === "state") put(cell, "class", link.live ? "ok" : link.connected ? "doubt" : "");
        if (name === "lost" || name === "damaged") put(cell, "class", shown > 0 ? "doubt" : "");
      });
    });
  }

  /** Colours have changed with the theme. */
  recolour(style) {
    this.colours = ["x", "y", "z"].map((axis) => style.getPropertyValue(`--${axis}`).trim());
    this.quiet = style.getPropertyValue("--quiet").trim();
    this.edge = style.getPropertyValue("--edge").trim();
    this.traced = 0;
  }

  /** Accelerometer, gyroscope and magnetometer, each with its own scale. */
  drawTraces(time_ms) {
    const canvas = this.traces;
    const share = Math.min(devicePixelRatio || 1, 2);
    const [width, height] = [Math.round(this.width * share), Math.round(this.height * share)];
    if (!(width > 0 && height > 0)) return;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const pen = (this.pen ??= canvas.getContext("2d", { willReadFrequently: true }));
    pen.setTransform(share, 0, 0, share, 0, 0);
    pen.clearRect(0, 0, this.width, this.height);
    pen.font = "11px system-ui, sans-serif";
    const from_ms = time_ms - 6000;
    const samples = this.samples;
    const axes = samples.length > 0 ? samples.at(-1).length - 1 : 0;
    $("no-samples").hidden = axes > 0;
    if (axes === 0) return;
    let first = samples.findIndex((sample) => sample[0] >= from_ms);
    if (first < 0) first = samples.length;
    const groups = [["acceleration", "m/s²", 20], ["turning", "°/s", 250], ["magnetic", "µT", 80]].slice(0, axes / 3);
    const band = this.height / groups.length;
    groups.forEach(([name, unit, most], group) => {
      const middle = band * (group + 0.5);
      pen.strokeStyle = this.edge;
      pen.lineWidth = 1;
      pen.beginPath();
      pen.moveTo(0, middle);
      pen.lineTo(this.width, middle);
      pen.stroke();
      pen.lineWidth = 1.3;
      for (let axis = 0; axis < 3; axis++) {
        pen.strokeStyle = this.colours[axis];
        pen.beginPath();
        // Every second sample: more than the eye sees at this size.
        for (let i = first + (first % 2); i < samples.length; i += 2) {
          const value = Math.min(Math.max(samples[i][1 + 3 * group + axis] / most, -1), 1);
          pen.lineTo(((samples[i][0] - from_ms) / 6000) * this.width, middle - value * band * 0.46);
        }
        pen.stroke();
      }
      pen.fillStyle = this.quiet;
      pen.fillText(`${name} ±${most} ${unit}`, 0, band * group + 10);
    });
  }

  /** How large the traces are on the screen. */
  measure() {
    this.width = this.traces.clientWidth;
    this.height = this.traces.clientHeight;
  }
}
