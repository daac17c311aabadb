// Solids, matrices and quaternions: what the scene needs of geometry.

const SEGMENTS = 12;
const CORNERS_MAX = 16000;
const STRIDE = 9;

// A capsule along Z: per corner a direction (3) and which end it belongs to (0 or 1).
function capsuleMesh(rings) {
  const corners = [];
  const rows = 2 * rings + 2;
  for (let row = 0; row < rows; row++) {
    const end = row > rings ? 1 : 0;
    const latitude = ((row - end) / (2 * rings) - 0.5) * Math.PI;
    for (let column = 0; column < SEGMENTS; column++) {
      const angle = (column / SEGMENTS) * 2 * Math.PI;
      const radius = Math.cos(latitude);
      corners.push(radius * Math.cos(angle), radius * Math.sin(angle), Math.sin(latitude), end);
    }
  }
  return { corners: new Float32Array(corners), triangles: stitch(rows) };
}

// A box with soft edges (a superellipsoid): per corner a position (3), and a zero.
function boxMesh(rings, sharpness) {
  const power = (value) => Math.sign(value) * Math.abs(value) ** sharpness;
  const corners = [];
  const rows = 2 * rings + 1;
  for (let row = 0; row < rows; row++) {
    const latitude = (row / (rows - 1) - 0.5) * Math.PI;
    for (let column = 0; column < SEGMENTS; column++) {
      const angle = ((column + 0.5) / SEGMENTS) * 2 * Math.PI;
      const radius = power(Math.cos(latitude));
      corners.push(radius * power(Math.cos(angle)), radius * power(Math.sin(angle)),
        power(Math.sin(latitude)), 0);
    }
  }
  return { corners: new Float32Array(corners), triangles: stitch(rows) };
}

// Triangles between the rows of corners, against the clock seen from outside.
function stitch(rows) {
  const triangles = [];
  for (let row = 0; row + 1 < rows; row++) {
    for (let column = 0; column < SEGMENTS; column++) {
      const next = (column + 1) % SEGMENTS;
      const a = row * SEGMENTS + column;
      const b = row * SEGMENTS + next;
      triangles.push(a, b, a + SEGMENTS, b, b + SEGMENTS, a + SEGMENTS);
    }
  }
  return new Uint16Array(triangles);
}

const CAPSULE = capsuleMesh(3);
const BOX = boxMesh(5, 0.38);

// Everything solid of one frame: corners of position, normal and colour, and triangles. They are
// computed here and not on the graphics card, so that one call draws them all: a browser that
// draws without a card pays for calls, not for corners. The loops over corners make no garbage.
export class Solids {
  corners = new Float32Array(CORNERS_MAX * STRIDE);
  triangles = new Uint16Array(CORNERS_MAX * 6);
  cornerCount = 0;
  triangleCount = 0;

  clear() {
    this.cornerCount = 0;
    this.triangleCount = 0;
  }

  // From `a` with radius `ra` to `b` with radius `rb`.
  capsule(a, ra, b, rb, colour) {
    const along = subtract(b, a);
    const axis = Math.hypot(...along) > 1e-5 ? unit(along) : [0, 1, 0];
    const side = unit(cross(axis, Math.abs(axis[1]) < 0.9 ? [0, 1, 0] : [1, 0, 0]));
    const up = cross(axis, side);
    const mesh = CAPSULE.corners;
    let at = this.take(CAPSULE);
    if (at < 0) return;
    const to = this.corners;
    for (let from = 0; from < mesh.length; from += 4, at += STRIDE) {
      const x = mesh[from], y = mesh[from + 1], z = mesh[from + 2];
      const [centre, radius] = mesh[from + 3] ? [b, rb] : [a, ra];
      for (let k = 0; k < 3; k++) {
        const normal = side[k] * x + up[k] * y + axis[k] * z;
        to[at + k] = centre[k] + radius * normal;
        to[at + 3 + k] = normal;
        to[at + 6 + k] = colour[k];
      }
    }
  }

  // From `tail` to `tip`, as thick as `radius` at its head.
  arrow(tail, tip, radius, colour) {
    const along = subtract(tip, tail);
    const length = Math.hypot(...along);
    if (length < 1e-3) return;
    const neck = add(tail, scale(along, Math.max(1 - (3 * radius) / length, 0)));
    this.capsule(tail, 0.4 * radius, neck, 0.4 * radius, colour);
    this.capsule(neck, radius, tip, 0.1 * radius, colour);
  }

  box(centre, rotation, half, colour) {
    const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) => turn(rotation, axis));
    const mesh = BOX.corners;
    let at = this.take(BOX);
    if (at < 0) return;
    const to = this.corners;
    for (let from = 0; from < mesh.length; from += 4, at += STRIDE) {
      const x = mesh[from], y = mesh[from + 1], z = mesh[from + 2];
      const nx = x ** 3 / half[0], ny = y ** 3 / half[1], nz = z ** 3 / half[2];
      const shrink = 1 / (Math.sqrt(nx * nx + ny * ny + nz * nz) || 1);
      for (let k = 0; k < 3; k++) {
        to[at + k] = centre[k] + axes[0][k] * x * half[0] + axes[1][k] * y * half[1]
          + axes[2][k] * z * half[2];
        to[at + 3 + k] = (axes[0][k] * nx + axes[1][k] * ny + axes[2][k] * nz) * shrink;
        to[at + 6 + k] = colour[k];
      }
    }
  }

  // Makes room for a mesh, and adds its triangles; answers where its corners go, or -1.
  take({ corners, triangles }) {
    const first = this.cornerCount;
    const count = corners.length / 4;
    if (first + count > CORNERS_MAX) return -1;
    for (let n = 0; n < triangles.length; n++) {
      this.triangles[this.triangleCount + n] = first + triangles[n];
    }
    this.triangleCount += triangles.length;
    this.cornerCount += count;
    return first * STRIDE;
  }
}

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const subtract = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
export const mix = (a, b, t) => a.map((value, i) => value + (b[i] - value) * t);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0]];
const unit = (a) => scale(a, 1 / (Math.hypot(...a) || 1));

// `v`, turned by the quaternion `q` (x, y, z, w).
export function turn(q, v) {
  const t = scale(cross(q, v), 2);
  return add(add(v, scale(t, q[3])), cross(q, t));
}

// Matrices are column by column, as WebGL wants them.
export function perspective(fieldOfView, aspect, near, far) {
  const f = 1 / Math.tan(fieldOfView / 2);
  const depth = 1 / (near - far);
  return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (near + far) * depth, -1,
    0, 0, 2 * near * far * depth, 0];
}

export function lookAt(eye, target) {
  const back = unit(subtract(eye, target));
  const side = unit(cross([0, 1, 0], back));
  const up = cross(back, side);
  return [side[0], up[0], back[0], 0, side[1], up[1], back[1], 0, side[2], up[2], back[2], 0,
    -dot(side, eye), -dot(up, eye), -dot(back, eye), 1];
}

export function multiply(a, b) {
  const product = new Float32Array(16);
  for (let column = 0; column < 4; column++) {
    for (let row = 0; row < 4; row++) {
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += a[4 * k + row] * b[4 * column + k];
      product[4 * column + row] = sum;
    }
  }
  return product;
}
