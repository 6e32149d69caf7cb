// A small renderer on WebGL 2: lit parts, their shadows on the floor, a grid, lines with a width.

import { apply, lookAt, multiply, perspective } from "./matrix.js";

/** From the light, for shading and shadows. */
const LIGHT = [0.42, -0.32, 1];

const PART_VERTEX = `#version 300 es
uniform mat4 view;
uniform mat4 model;
in vec3 place;
in vec3 normal;
out vec3 world_normal;
out vec3 world;
void main() {
  vec4 at = model * vec4(place, 1.0);
  world = at.xyz;
  // Parts are scaled along their own axes: divide by the scale twice, once for its length.
  vec3 s = vec3(dot(model[0].xyz, model[0].xyz), dot(model[1].xyz, model[1].xyz), dot(model[2].xyz, model[2].xyz));
  world_normal = mat3(model) * (normal / s);
  gl_Position = view * at;
}`;

const PART_FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 colour;
uniform vec3 light;
uniform vec3 eye;
uniform float flat_share;
in vec3 world_normal;
in vec3 world;
out vec4 pixel;
void main() {
  vec3 n = normalize(world_normal);
  vec3 to_eye = normalize(eye - world);
  float day = max(dot(n, light), 0.0);
  float sky = 0.5 + 0.5 * n.z;
  float gleam = pow(max(dot(n, normalize(light + to_eye)), 0.0), 40.0);
  vec3 lit = colour * (0.50 + 0.24 * sky + 0.40 * day) + 0.10 * gleam;
  pixel = vec4(mix(lit, colour, flat_share), 1.0);
}`;

const SHADOW_FRAGMENT = `#version 300 es
precision highp float;
uniform vec4 colour;
out vec4 pixel;
void main() { pixel = colour; }`;

const SHADOW_VERTEX = `#version 300 es
uniform mat4 view;
uniform mat4 model;
uniform vec3 light;
in vec3 place;
void main() {
  vec4 at = model * vec4(place, 1.0);
  at.xyz -= light * (max(at.z, 0.0) / light.z);
  gl_Position = view * vec4(at.xy, 0.002, 1.0);
}`;

const FLOOR_VERTEX = `#version 300 es
uniform mat4 view;
uniform vec2 middle;
uniform float reach;
in vec3 place;
out vec2 world;
void main() {
  world = middle + place.xy * reach;
  gl_Position = view * vec4(world, 0.0, 1.0);
}`;

const FLOOR_FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 floor_colour;
uniform vec3 line_colour;
uniform vec3 sky_colour;
uniform vec2 middle;
uniform float reach;
in vec2 world;
out vec4 pixel;
float lines(vec2 at, float width) {
  vec2 step = fwidth(at);
  vec2 near = abs(fract(at - 0.5) - 0.5) / max(step, vec2(1e-5));
  float line = 1.0 - min(min(near.x, near.y) / width, 1.0);
  // Where lines come closer than pixels there is only their mean.
  return line * clamp(1.0 - max(step.x, step.y) * 2.0, 0.0, 1.0);
}
void main() {
  float far = clamp(length(world - middle) / reach, 0.0, 1.0);
  vec3 colour = mix(floor_colour, line_colour, max(0.30 * lines(world * 4.0, 1.0), lines(world, 1.4)));
  pixel = vec4(mix(colour, sky_colour, smoothstep(0.35, 0.95, far)), 1.0);
}`;

const LINE_VERTEX = `#version 300 es
uniform mat4 view;
uniform vec2 size;
uniform float width;
uniform float count;
in vec2 corner;
in vec3 from;
in vec3 to;
out float age;
void main() {
  vec4 a = view * vec4(from, 1.0);
  vec4 b = view * vec4(to, 1.0);
  vec2 way = (b.xy / b.w - a.xy / a.w) * size;
  vec2 side = normalize(vec2(-way.y, way.x) + vec2(1e-6, 0.0));
  vec4 at = mix(a, b, corner.x);
  at.xy += side * corner.y * width / size * at.w;
  gl_Position = a.w < 0.05 || b.w < 0.05 ? vec4(2.0, 2.0, 2.0, 1.0) : at;
  age = (count - float(gl_InstanceID)) / count;
}`;

const LINE_FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 colour;
uniform float fade;
in float age;
out vec4 pixel;
void main() { pixel = vec4(colour, 1.0 - fade * age); }`;

/** Triangles of the shapes that everything is made of: x, y, z and the normal of each corner. */
function meshes() {
  const box = [];
  for (let axis = 0; axis < 3; axis++) {
    for (const side of [-1, 1]) {
      const corner = (u, v) => {
        const p = [0, 0, 0];
        p[axis] = side;
        p[(axis + 1) % 3] = u * side;
        p[(axis + 2) % 3] = v;
        const n = [0, 0, 0];
        n[axis] = side;
        return [...p, ...n];
      };
      for (const [u, v] of [[-1, -1], [1, -1], [1, 1], [-1, -1], [1, 1], [-1, 1]]) box.push(...corner(u, v));
    }
  }
  const round = (sides, rings) => {
    const ball = [];
    const at = (i, j) => {
      const [p, t] = [(2 * Math.PI * i) / sides, Math.PI * (j / rings - 0.5)];
      const n = [Math.cos(p) * Math.cos(t), Math.sin(p) * Math.cos(t), Math.sin(t)];
      return [...n, ...n];
    };
    for (let i = 0; i < sides; i++) {
      for (let j = 0; j < rings; j++) {
        for (const [u, v] of [[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]]) ball.push(...at(i + u, j + v));
      }
    }
    return ball;
  };
  const tube = [];
  const sides = 24;
  for (let i = 0; i < sides; i++) {
    const [c0, s0, c1, s1] = [i, i + 1].flatMap((k) => {
      const p = (2 * Math.PI * k) / sides;
      return [Math.cos(p), Math.sin(p)];
    });
    for (const [c, s, z] of [[c0, s0, -1], [c1, s1, -1], [c1, s1, 1], [c0, s0, -1], [c1, s1, 1], [c0, s0, 1]]) {
      tube.push(c, s, z, c, s, 0);
    }
    for (const z of [-1, 1]) {
      const [a, b] = z > 0 ? [[c0, s0], [c1, s1]] : [[c1, s1], [c0, s0]];
      for (const [x, y] of [[0, 0], a, b]) tube.push(x, y, z, 0, 0, z);
    }
  }
  const ground = [-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, -1, 0, 1, 1, 0, -1, 1, 0];
  return { box, ball: round(20, 10), tube, ground };
}

/** Corners that are the same are kept once, so that each is worked out once. */
function indexed(values, width) {
  const [known, corners, order] = [new Map(), [], []];
  for (let i = 0; i < values.length; i += width) {
    const corner = values.slice(i, i + width);
    const name = corner.map((v) => v.toFixed(4)).join();
    if (!known.has(name)) {
      known.set(name, known.size);
      corners.push(...corner);
    }
    order.push(known.get(name));
  }
  return { corners: new Float32Array(corners), order: new Uint16Array(order) };
}

/** Points of a line that grows at its end; the graphics card keeps them. */
class Line {
  constructor(gl, program) {
    this.gl = gl;
    this.room = 4096;
    this.points = new Float32Array(3 * this.room);
    this.count = 0;
    this.buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, this.points.byteLength, gl.DYNAMIC_DRAW);
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    const corners = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, corners);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([0, -1, 1, -1, 0, 1, 1, 1]), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(program.corner);
    gl.vertexAttribPointer(program.corner, 2, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    for (const [place, offset] of [[program.from, 0], [program.to, 12]]) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 12, offset);
      gl.vertexAttribDivisor(place, 1);
    }
    gl.bindVertexArray(null);
  }

  push(points) {
    if (points.length === 0) return;
    const { gl } = this;
    let first = this.count;
    if (this.count + points.length > this.room) {
      // The older half goes.
      const keep = Math.min(this.count, this.room / 2);
      this.points.copyWithin(0, 3 * (this.count - keep), 3 * this.count);
      this.count = keep;
      first = 0;
    }
    for (const [x, y, z] of points.slice(-(this.room - this.count))) {
      this.points.set([x, y, z], 3 * this.count);
      this.count += 1;
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferSubData(gl.ARRAY_BUFFER, 12 * first, this.points, 3 * first, 3 * (this.count - first));
  }

  clear() {
    this.count = 0;
  }
}

/** Draws into a canvas. Throws where there is no WebGL 2. */
export class Renderer {
  constructor(canvas) {
    this.canvas = canvas;
    const gl = canvas.getContext("webgl2", { antialias: true, stencil: true, alpha: false });
    if (!gl) throw new Error("no WebGL 2");
    this.gl = gl;
    this.parts = this.program(PART_VERTEX, PART_FRAGMENT);
    this.shadows = this.program(SHADOW_VERTEX, SHADOW_FRAGMENT);
    this.floor = this.program(FLOOR_VERTEX, FLOOR_FRAGMENT);
    this.lines = this.program(LINE_VERTEX, LINE_FRAGMENT);
    this.meshes = {};
    for (const [name, values] of Object.entries(meshes())) {
      const width = name === "ground" ? 3 : 6;
      const array = gl.createVertexArray();
      gl.bindVertexArray(array);
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      const { corners, order } = indexed(values, width);
      gl.bufferData(gl.ARRAY_BUFFER, corners, gl.STATIC_DRAW);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, order, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(0);
      gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 4 * width, 0);
      if (width === 6) {
        gl.enableVertexAttribArray(1);
        gl.vertexAttribPointer(1, 3, gl.FLOAT, false, 24, 12);
      }
      this.meshes[name] = { array, count: order.length };
    }
    gl.bindVertexArray(null);
    this.path = new Line(gl, this.lines);
    this.trace = new Line(gl, this.lines);
    this.light = (() => {
      const far = Math.hypot(...LIGHT);
      return LIGHT.map((v) => v / far);
    })();
  }

  program(vertex, fragment) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    // The same numbers in all programs, so that meshes serve them all.
    gl.bindAttribLocation(program, 0, "place");
    gl.bindAttribLocation(program, 1, "normal");
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(gl.getProgramInfoLog(program));
    }
    const known = { program };
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      known[name] = gl.getUniformLocation(program, name);
    }
    for (const name of ["corner", "from", "to"]) known[name] = gl.getAttribLocation(program, name);
    return known;
  }

  /** Fits the canvas to its place on the screen. True where that changed something. */
  resize() {
    const { canvas } = this;
    const share = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.max(1, Math.round(canvas.clientWidth * share));
    const height = Math.max(1, Math.round(canvas.clientHeight * share));
    if (canvas.width === width && canvas.height === height) return false;
    canvas.width = width;
    canvas.height = height;
    return true;
  }

  /** World to clip space for a camera. */
  view(camera) {
    const { eye, target, up } = camera;
    const aspect = this.canvas.width / this.canvas.height;
    return multiply(perspective(camera.angle, aspect, 0.05, 200), lookAt(eye, target, up));
  }

  /** Draws everything. `scene`: parts, camera, colours, marker (a point shown whatever is before it). */
  draw(scene) {
    const { gl, canvas } = this;
    const { camera, colours } = scene;
    const view = this.view(camera);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...colours.sky, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);

    gl.useProgram(this.floor.program);
    gl.uniformMatrix4fv(this.floor.view, false, view);
    gl.uniform2f(this.floor.middle, camera.target[0], camera.target[1]);
    gl.uniform1f(this.floor.reach, 9 + 1.5 * camera.distance);
    gl.uniform3fv(this.floor.floor_colour, colours.floor);
    gl.uniform3fv(this.floor.line_colour, colours.grid);
    gl.uniform3fv(this.floor.sky_colour, colours.sky);
    gl.bindVertexArray(this.meshes.ground.array);
    gl.drawElements(gl.TRIANGLES, this.meshes.ground.count, gl.UNSIGNED_SHORT, 0);

    this.drawShadows(scene.parts, view, colours);
    this.drawLine(this.path, view, colours.path, 2.2, 0, false);
    gl.disable(gl.CULL_FACE);

    gl.useProgram(this.parts.program);
    gl.uniformMatrix4fv(this.parts.view, false, view);
    gl.uniform3fv(this.parts.light, this.light);
    gl.uniform3fv(this.parts.eye, camera.eye);
    gl.uniform1f(this.parts.flat_share, 0);
    for (const part of scene.parts) this.drawPart(part, colours);
    this.drawLine(this.trace, view, colours.trace, 1.6, 0.85, true);

    if (scene.marker) {
      gl.disable(gl.DEPTH_TEST);
      gl.useProgram(this.parts.program);
      gl.uniform1f(this.parts.flat_share, 1);
      this.drawPart(scene.marker, colours);
    }
    return view;
  }

  drawPart(part, colours) {
    const { gl } = this;
    const mesh = this.meshes[part.mesh];
    gl.uniformMatrix4fv(this.parts.model, false, part.matrix);
    gl.uniform3fv(this.parts.colour, colours[part.colour]);
    gl.bindVertexArray(mesh.array);
    gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_SHORT, 0);
  }

  /** Each pixel of the floor is darkened once, however many parts shade it. */
  drawShadows(parts, view, colours) {
    const { gl } = this;
    gl.useProgram(this.shadows.program);
    gl.uniformMatrix4fv(this.shadows.view, false, view);
    gl.uniform3fv(this.shadows.light, this.light);
    gl.uniform4f(this.shadows.colour, ...colours.shadow, colours.shadowShare);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.enable(gl.STENCIL_TEST);
    gl.stencilFunc(gl.EQUAL, 0, 0xff);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    gl.depthMask(false);
    for (const part of parts) {
      const mesh = this.meshes[part.mesh];
      gl.uniformMatrix4fv(this.shadows.model, false, part.matrix);
      gl.bindVertexArray(mesh.array);
      gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_SHORT, 0);
    }
    gl.depthMask(true);
    gl.disable(gl.STENCIL_TEST);
    gl.disable(gl.BLEND);
  }

  drawLine(line, view, colour, width, fade, depth) {
    if (line.count < 2) return;
    const { gl, canvas } = this;
    gl.useProgram(this.lines.program);
    gl.uniformMatrix4fv(this.lines.view, false, view);
    gl.uniform2f(this.lines.size, canvas.width, canvas.height);
    gl.uniform1f(this.lines.width, width * Math.min(window.devicePixelRatio || 1, 2));
    gl.uniform1f(this.lines.count, line.count);
    gl.uniform1f(this.lines.fade, fade);
    gl.uniform3fv(this.lines.colour, colour);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthMask(false);
    if (!depth) gl.disable(gl.DEPTH_TEST);
    gl.bindVertexArray(line.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, line.count - 1);
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }

  /** Where a point of the world is in the canvas, in pixels from its upper left corner; null behind the eye. */
  pixelOf(view, point) {
    const [x, y] = apply(view, point);
    const w = view[3] * point[0] + view[7] * point[1] + view[11] * point[2] + view[15];
    if (w <= 0) return null;
    return [(0.5 + (0.5 * x) / w) * this.canvas.width, (0.5 - (0.5 * y) / w) * this.canvas.height];
  }
}
