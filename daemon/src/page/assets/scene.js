// The wearer in 3-D, drawn with WebGL 2.
//
// World: right-handed, Y up, metres, the wearer looks along -Z at rest.

import { Solids, add, lookAt, mix, multiply, perspective, scale, subtract, turn } from "./shapes.js";

const J = { pelvis: 0, hips: [1, 2], spine1: 3, knees: [4, 5], spine2: 6, ankles: [7, 8],
  spine3: 9, toes: [10, 11], neck: 12, collars: [13, 14], head: 15, shoulders: [16, 17],
  elbows: [18, 19], wrists: [20, 21] };
const LIGHT = [0.35, 1, -0.45];
const START = { yaw: 0.55, pitch: 0.17, distance: 3.6 };
const HEADSET = 1;
const CONTROLLERS = [2, 3];
// Metres of arrow for each newton.
const ARROW_M_PER_N = 1 / 1200;
// Pixels drawn for each pixel shown, along an edge: less where drawing is slow.
const FINENESS = { least: 0.5, most: 2 };
const SLOW_MS = 19;
const FAST_MS = 17.5;

const SOLID_VERTEX = `#version 300 es
layout(location=0) in vec3 position;
layout(location=1) in vec3 direction;
layout(location=2) in vec3 colour;
uniform mat4 camera;
uniform bool is_shadow;
uniform vec3 light;
out vec3 normal, place, tint;
void main() {
  place = position;
  normal = direction;
  tint = colour;
  if (is_shadow) place = vec3(place.xz - light.xz / light.y * place.y, 0.002).xzy;
  gl_Position = camera * vec4(place, 1.0);
}`;

const SOLID_FRAGMENT = `#version 300 es
precision highp float;
in vec3 normal, place, tint;
uniform vec3 light, eye, sky, ground;
uniform vec4 shadow;
uniform bool is_shadow;
out vec4 colour;
void main() {
  if (is_shadow) {
    float high = clamp(1.0 - length(place.xz - eye.xz) / 12.0, 0.0, 1.0);
    colour = vec4(shadow.rgb, shadow.a * high);
    return;
  }
  vec3 n = normalize(normal), to_eye = normalize(eye - place), to_light = normalize(light);
  float lit = clamp(dot(n, to_light) * 0.6 + 0.4, 0.0, 1.0);
  vec3 around = mix(ground, sky, n.y * 0.5 + 0.5);
  float rim = pow(1.0 - max(dot(n, to_eye), 0.0), 3.0);
  float shine = pow(max(dot(n, normalize(to_light + to_eye)), 0.0), 40.0);
  vec3 shade = tint * (0.28 + 0.72 * lit) + around * (0.10 + 0.30 * rim) + 0.10 * shine;
  colour = vec4(shade, 1.0);
}`;

// A grid of lines around the wearer. Drawn as lines, it costs a browser without a graphics card
// next to nothing; a shader over the whole floor would cost more than everything else.
const FLOOR_VERTEX = `#version 300 es
layout(location=0) in vec4 line;
uniform mat4 camera;
uniform vec3 centre;
out vec2 place;
out float strength;
void main() {
  place = line.xy + floor(centre.xz + 0.5);
  float across = line.w > 0.5 ? place.y : place.x;
  strength = abs(across) < 0.01 ? 1.0 : line.z;
  gl_Position = camera * vec4(place.x, 0.0, place.y, 1.0);
}`;

const FLOOR_FRAGMENT = `#version 300 es
precision highp float;
in vec2 place;
in float strength;
uniform vec3 colour_of_lines, centre;
out vec4 colour;
void main() {
  float fade = strength * (1.0 - smoothstep(2.0, 9.0, length(place - centre.xz)));
  colour = vec4(colour_of_lines * fade, fade);
}`;

// Ends of the grid's lines: x, z, strength, and which of the two stays the same.
function gridLines() {
  const ends = [];
  for (let quarter = -36; quarter <= 36; quarter++) {
    const isMetre = quarter % 4 === 0;
    if (!isMetre && Math.abs(quarter) > 14) continue;
    const [far, strength] = isMetre ? [9, 0.75] : [3.5, 0.22];
    const place = quarter / 4;
    ends.push(place, -far, strength, 0, place, far, strength, 0,
      -far, place, strength, 1, far, place, strength, 1);
  }
  return new Float32Array(ends);
}

export class Scene {
  // Throws where the browser has no WebGL 2.
  constructor(canvas) {
    const wishes = { alpha: true, stencil: true, premultipliedAlpha: true };
    // Smooth edges cost a browser without a graphics card more than everything else.
    const gl = canvas.getContext("webgl2", { ...wishes, antialias: hasCard() });
    if (!gl) throw new Error("this browser has no WebGL 2");
    this.canvas = canvas;
    this.gl = gl;
    this.solid = program(gl, SOLID_VERTEX, SOLID_FRAGMENT);
    this.floor = program(gl, FLOOR_VERTEX, FLOOR_FRAGMENT);
    this.solids = new Solids();
    this.solidArray = gl.createVertexArray();
    gl.bindVertexArray(this.solidArray);
    this.cornerBuffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.cornerBuffer);
    for (const place of [0, 1, 2]) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 36, 12 * place);
    }
    this.triangleBuffer = gl.createBuffer();
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.triangleBuffer);
    this.floorArray = gl.createVertexArray();
    gl.bindVertexArray(this.floorArray);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    const lines = gridLines();
    this.lineEnds = lines.length / 4;
    gl.bufferData(gl.ARRAY_BUFFER, lines, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 4, gl.FLOAT, false, 0, 0);
    this.target = [0, 0.95, 0];
    this.facing = 0;
    this.stations = [];
    this.objects = [];
    this.fineness = 1;
    this.interval = 1000 / 60;
    this.patience = 40;
    // Told, not asked for: asking makes the browser lay the page out at once.
    this.size = [canvas.clientWidth, canvas.clientHeight];
    new ResizeObserver(([{ contentRect }]) => {
      this.size = [contentRect.width, contentRect.height];
    }).observe(canvas);
    this.startOver();
    this.listen();
    this.paint();
  }

  startOver() {
    this.isDirty = true;
    this.yaw = START.yaw + this.facing;
    this.pitch = START.pitch;
    this.distance = START.distance;
  }

  // Reads the colours of the page.
  paint() {
    this.isDirty = true;
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => {
      const hex = style.getPropertyValue(`--${name}`).trim();
      return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
    };
    const names = ["ground", "sky", "floor", "body", "left", "right", "device", "shadow",
      "fair", "bad", "accent"];
    this.colours = Object.fromEntries(names.map((name) => [name, colour(name)]));
  }

  // "front", "side", "back" or "top", as the wearer faces now.
  look(from) {
    const turns = { front: 0, side: Math.PI / 2, back: Math.PI, top: 0 };
    this.isDirty = true;
    this.yaw = this.facing + turns[from];
    this.pitch = from === "top" ? 1.5 : 0.1;
    this.distance = START.distance;
  }

  listen() {
    const fingers = new Map();
    const { canvas } = this;
    const spread = () => {
      const [a, b] = [...fingers.values()];
      return Math.hypot(a[0] - b[0], a[1] - b[1]);
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", (event) => {
      const last = fingers.get(event.pointerId);
      if (!last) return;
      const before = fingers.size === 2 ? spread() : 0;
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
      if (fingers.size === 2) this.zoom(before / spread());
      else this.drag(event.clientX - last[0], event.clientY - last[1]);
    });
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
    }
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(event.deltaY * 0.001));
    }, { passive: false });
    canvas.addEventListener("dblclick", () => this.startOver());
    canvas.addEventListener("keydown", (event) => {
      const moves = { ArrowLeft: [-24, 0], ArrowRight: [24, 0], ArrowUp: [0, -24],
        ArrowDown: [0, 24] };
      if (event.key in moves) {
        event.preventDefault();
        this.drag(...moves[event.key]);
      }
      if (event.key === "+") this.zoom(0.9);
      if (event.key === "-") this.zoom(1.1);
    });
  }

  drag(dx, dy) {
    this.isDirty = true;
    this.yaw -= dx * 0.006;
    this.pitch = Math.min(Math.max(this.pitch + dy * 0.006, -0.15), 1.5);
  }

  zoom(factor) {
    this.isDirty = true;
    this.distance = Math.min(Math.max(this.distance * factor, 0.8), 12);
  }

  // Keeps up with the display: fewer pixels when frames come late, more again when they do not.
  // `interval` is the time since the frame before, ms.
  pace(interval) {
    if (interval > 250) return;
    this.interval += (interval - this.interval) * 0.05;
    this.patience -= 1;
    if (this.patience > 0) return;
    if (this.interval > SLOW_MS && this.fineness > FINENESS.least) {
      this.fineness = Math.max(this.fineness * 0.8, FINENESS.least);
      this.patience = 40;
    } else if (this.interval < FAST_MS && this.fineness < 1) {
      this.fineness = Math.min(this.fineness * 1.1, 1);
      this.patience = 600;
    }
  }

  // Draws a pose: `joints` of 22 { position, rotation }, `devices` of { role, lookup, tracking,
  // position, rotation }, `contacts` of { position, force }, `things` of { position, rotation,
  // isTouched }, which look as `objects` say in the configuration's words, and its quality, 0 (held) to 3.
  // Nothing is done where it would look as before.
  draw(pose) {
    const { gl, canvas } = this;
    const ratio = this.fineness * Math.min(devicePixelRatio || 1, FINENESS.most);
    const [width, height] = this.size.map((length) => Math.max(length * ratio | 0, 1));
    const isSame = canvas.width === width && canvas.height === height;
    if (isSame && pose === this.drawn && !this.isDirty) return;
    this.drawn = pose;
    this.isDirty = false;
    if (!isSame) {
      canvas.width = width;
      canvas.height = height;
    }
    gl.viewport(0, 0, width, height);
    this.follow(pose);
    const across = Math.cos(this.pitch) * this.distance;
    const eye = add(this.target, [Math.sin(this.yaw) * -across,
      Math.sin(this.pitch) * this.distance, Math.cos(this.yaw) * -across]);
    // A tall, narrow window needs a wider view for the arms.
    const field = width < height ? 0.85 : 0.62;
    const camera = multiply(perspective(field, width / Math.max(height, 1), 0.05, 60),
      lookAt(eye, this.target));
    this.build(pose);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.enable(gl.CULL_FACE);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.drawFloor(camera);
    this.drawSolids(camera, eye);
  }

  // Keeps the wearer in the middle without shaking with every step.
  follow(pose) {
    if (!pose) return;
    const { position, rotation } = pose.joints[J.pelvis];
    const goal = [position[0], 0.55 * position[1] + 0.42, position[2]];
    const far = Math.hypot(...subtract(goal, this.target)) > 1.5;
    this.target = far ? goal : mix(this.target, goal, 1 - Math.exp(-this.interval / 250));
    const forward = turn(rotation, [0, 0, -1]);
    if (Math.hypot(forward[0], forward[2]) > 0.2) {
      this.facing = Math.atan2(-forward[0], -forward[2]);
    }
    if (!this.hasStarted) {
      this.hasStarted = true;
      this.startOver();
    }
  }

  drawFloor(camera) {
    const { gl, floor } = this;
    gl.useProgram(floor.handle);
    gl.disable(gl.DEPTH_TEST);
    gl.uniformMatrix4fv(floor.at("camera"), false, camera);
    gl.uniform3fv(floor.at("centre"), this.target);
    gl.uniform3fv(floor.at("colour_of_lines"), this.colours.floor);
    gl.bindVertexArray(this.floorArray);
    gl.drawArrays(gl.LINES, 0, this.lineEnds);
  }

  drawSolids(camera, eye) {
    const { gl, solid, solids } = this;
    gl.useProgram(solid.handle);
    gl.uniformMatrix4fv(solid.at("camera"), false, camera);
    gl.uniform3fv(solid.at("eye"), eye);
    gl.uniform3fv(solid.at("light"), LIGHT);
    gl.uniform3fv(solid.at("sky"), this.colours.sky);
    gl.uniform3fv(solid.at("ground"), this.colours.ground);
    gl.uniform4fv(solid.at("shadow"), [...scale(this.colours.shadow, 0.42), 0.42]);
    gl.bindVertexArray(this.solidArray);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.cornerBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, solids.corners.subarray(0, 9 * solids.cornerCount),
      gl.DYNAMIC_DRAW);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, solids.triangles.subarray(0, solids.triangleCount),
      gl.DYNAMIC_DRAW);
    const draw = (from, to) => {
      gl.drawElements(gl.TRIANGLES, to - from, gl.UNSIGNED_SHORT, 2 * from);
    };
    // Shadows first, each point of the floor darkened once.
    gl.uniform1i(solid.at("is_shadow"), 1);
    gl.enable(gl.STENCIL_TEST);
    gl.stencilFunc(gl.EQUAL, 0, 0xff);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    draw(0, this.bodyEnd);
    gl.disable(gl.STENCIL_TEST);
    gl.enable(gl.DEPTH_TEST);
    gl.uniform1i(solid.at("is_shadow"), 0);
    draw(0, this.bodyEnd);
    if (solids.triangleCount === this.bodyEnd) return;
    // Forces run through the legs: they are seen through them.
    gl.clear(gl.DEPTH_BUFFER_BIT);
    draw(this.bodyEnd, solids.triangleCount);
  }

  // Fills `solids` with everything that there is.
  build(pose) {
    const { solids } = this;
    solids.clear();
    for (const { position, rotation } of this.stations) {
      solids.box(position, rotation, [0.035, 0.04, 0.03], this.colours.device);
      const glass = add(position, turn(rotation, [0, 0, -0.026]));
      solids.box(glass, rotation, [0.026, 0.03, 0.008], this.colours.accent);
    }
    if (pose) {
      this.body(solids, pose);
      for (const device of pose.devices) this.device(solids, device);
      pose.things.forEach((thing, index) => this.thing(solids, thing, this.objects[index]));
    }
    this.bodyEnd = solids.triangleCount;
    if (pose) {
      for (const contact of pose.contacts) this.contact(solids, contact);
    }
  }

  body(solids, pose) {
    const { body, left, right, bad, fair } = this.colours;
    // A pose that is only held, or leans on an old headset pose, shows it.
    const doubt = [mix(body, bad, 0.55), mix(body, fair, 0.35), body, body][pose.quality];
    const sides = [left, right].map((colour) => mix(doubt, colour, 0.85));
    const at = (joint) => pose.joints[joint].position;
    const in_ = (joint, offset) => add(at(joint), turn(pose.joints[joint].rotation, offset));
    // Thickness goes with the length of the shanks.
    const size = Math.hypot(...subtract(at(J.knees[0]), at(J.ankles[0]))) / 0.437 || 1;
    const bone = (a, b, ra, rb, colour) => {
      solids.capsule(a, ra * size, b, rb * size, colour);
    };
    const top = in_(J.spine3, [0, 0.09 * size, 0]);
    bone(at(J.hips[0]), at(J.hips[1]), 0.088, 0.088, doubt);
    bone(at(J.pelvis), at(J.spine2), 0.104, 0.1, doubt);
    bone(at(J.spine2), top, 0.1, 0.095, doubt);
    for (const across of [-1, 1]) {
      bone(in_(J.spine2, [across * 0.032 * size, 0.01, 0]),
        in_(J.spine3, [across * 0.085 * size, 0.085 * size, 0]), 0.082, 0.074, doubt);
    }
    bone(top, at(J.neck), 0.07, 0.052, doubt);
    bone(at(J.neck), in_(J.head, [0, 0.04 * size, 0]), 0.05, 0.05, doubt);
    solids.capsule(in_(J.head, [0, 0.055 * size, -0.03 * size]), 0.07 * size,
      in_(J.head, [0, 0.125 * size, -0.012 * size]), 0.09 * size, doubt);
    for (const side of [0, 1]) {
      const outward = side === 0 ? -1 : 1;
      const colour = sides[side];
      bone(at(J.collars[side]), at(J.shoulders[side]), 0.052, 0.058, doubt);
      bone(at(J.shoulders[side]), at(J.elbows[side]), 0.052, 0.04, colour);
      bone(at(J.elbows[side]), at(J.wrists[side]), 0.041, 0.029, colour);
      const palm = in_(J.wrists[side], [outward * 0.055 * size, -0.004, 0]);
      solids.box(palm, pose.joints[J.wrists[side]].rotation,
        [0.06 * size, 0.019 * size, 0.042 * size], colour);
      const fingers = in_(J.wrists[side], [outward * 0.135 * size, -0.008, 0]);
      solids.box(fingers, pose.joints[J.wrists[side]].rotation,
        [0.04 * size, 0.014 * size, 0.038 * size], colour);
      bone(at(J.hips[side]), at(J.knees[side]), 0.082, 0.056, colour);
      bone(at(J.knees[side]), at(J.ankles[side]), 0.056, 0.038, colour);
      bone(in_(J.ankles[side], [0, -0.012, 0.04 * size]), at(J.toes[side]), 0.04, 0.03, colour);
      bone(at(J.toes[side]), in_(J.toes[side], [0, 0, -0.06 * size]), 0.03, 0.024, colour);
    }
  }

  // Where the body touches something, and the force on it there, newtons.
  contact(solids, { position, force }) {
    const { accent } = this.colours;
    solids.box(position, [0, 0, 0, 1], [0.045, 0.006, 0.045], accent);
    solids.arrow(position, add(position, scale(force, ARROW_M_PER_N)), 0.022, accent);
  }

  // A thing in the character's scene.
  thing(solids, { position, rotation, isTouched }, shape) {
    if (!shape) return;
    const { device, accent, floor } = this.colours;
    const colour = mix(mix(device, floor, 0.5), accent, isTouched ? 0.7 : 0);
    const part = (centre, half) => {
      solids.box(add(position, turn(rotation, centre)), rotation, half, colour);
    };
    if (shape.kind === "ball") {
      const up = [0, 0.01 * shape.radius, 0];
      solids.capsule(subtract(position, up), shape.radius, add(position, up), shape.radius, colour);
    } else if (shape.kind === "box") {
      part([0, 0, 0], shape.size.map((edge) => edge / 2));
    } else {
      const { seat } = shape;
      part([0, seat - 0.02, 0], [0.22, 0.02, 0.22]);
      part([0, seat + 0.225, 0.21], [0.22, 0.225, 0.015]);
      for (const [x, z] of [[-0.2, -0.2], [0.2, -0.2], [-0.2, 0.2], [0.2, 0.2]]) {
        part([x, seat / 2 - 0.02, z], [0.02, seat / 2 - 0.02, 0.02]);
      }
    }
  }

  device(solids, { role, lookup, tracking, position, rotation }) {
    const { device, fair, bad, accent, ground } = this.colours;
    const isStale = lookup === 3 || tracking === 0;
    const colour = isStale ? mix(device, bad, 0.7) : tracking === 1 ? mix(device, fair, 0.6) : device;
    const there = (offset) => add(position, turn(rotation, offset));
    if (role === HEADSET) {
      solids.box(there([0, 0, -0.02]), rotation, [0.092, 0.048, 0.05], colour);
      solids.box(there([0, 0, -0.058]), rotation, [0.075, 0.033, 0.018],
        mix(ground, accent, 0.5));
      for (const side of [-1, 1]) {
        solids.capsule(there([side * 0.088, 0.012, 0]), 0.013,
          there([side * 0.082, 0.012, 0.12]), 0.013, colour);
      }
    } else if (CONTROLLERS.includes(role)) {
      solids.capsule(there([0, -0.012, 0.05]), 0.022, there([0, -0.02, 0.15]), 0.018,
        colour);
      solids.box(there([0, 0, 0.03]), rotation, [0.034, 0.014, 0.034],
        mix(colour, accent, 0.4));
    } else {
      solids.box(position, rotation, [0.035, 0.035, 0.022], colour);
      solids.box(there([0, 0, -0.02]), rotation, [0.014, 0.014, 0.008], accent);
    }
  }
}

// Whether a graphics card draws, as far as the browser says.
function hasCard() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const names = gl?.getExtension("WEBGL_debug_renderer_info");
  const renderer = names ? gl.getParameter(names.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return !/swiftshader|llvmpipe|softpipe|software/i.test(renderer);
}

function program(gl, vertex, fragment) {
  const handle = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(handle, shader);
  }
  gl.linkProgram(handle);
  if (!gl.getProgramParameter(handle, gl.LINK_STATUS)) {
    const logs = gl.getAttachedShaders(handle).map((shader) => gl.getShaderInfoLog(shader));
    throw new Error(`shader: ${logs.join(" ")} ${gl.getProgramInfoLog(handle)}`);
  }
  const places = new Map();
  const at = (name) => {
    if (!places.has(name)) places.set(name, gl.getUniformLocation(handle, name));
    return places.get(name);
  };
  return { handle, at };
}
