// Solids, matrices and quaternions: what the scene needs of geometry.

const SEGMENTS = 16;
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
      corners.push([radius * Math.cos(angle), radius * Math.sin(angle), Math.sin(latitude), end]);
    }
  }
  return { corners, triangles: stitch(rows) };
}

// A box with soft edges (a superellipsoid): per corner a position.
function boxMesh(rings, sharpness) {
  const power = (value) => Math.sign(value) * Math.abs(value) ** sharpness;
  const corners = [];
  const rows = 2 * rings + 1;
  for (let row = 0; row < rows; row++) {
    const latitude = (row / (rows - 1) - 0.5) * Math.PI;
    for (let column = 0; column < SEGMENTS; column++) {
      const angle = ((column + 0.5) / SEGMENTS) * 2 * Math.PI;
      const radius = power(Math.cos(latitude));
      corners.push([radius * power(Math.cos(angle)), radius * power(Math.sin(angle)),
        power(Math.sin(latitude))]);
    }
  }
  return { corners, triangles: stitch(rows) };
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
  return triangles;
}

const CAPSULE = capsuleMesh(3);
const BOX = boxMesh(5, 0.38);

// Everything solid of one frame: corners of position, normal and colour, and triangles. They are
// computed here and not on the graphics card, so that one call draws them all: a browser that
// draws without a card pays for calls, not for corners.
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
    this.mesh(CAPSULE, ([x, y, z, end]) => {
      const normal = [0, 1, 2].map((k) => side[k] * x + up[k] * y + axis[k] * z);
      const [centre, radius] = end ? [b, rb] : [a, ra];
      return [add(centre, scale(normal, radius)), normal];
    }, colour);
  }

  box(centre, rotation, half, colour) {
    this.mesh(BOX, (corner) => {
      const place = corner.map((value, k) => value * half[k]);
      const normal = unit(corner.map((value, k) => value ** 3 / half[k]));
      return [add(centre, turn(rotation, place)), turn(rotation, normal)];
    }, colour);
  }

  mesh({ corners, triangles }, place, colour) {
    if (this.cornerCount + corners.length > CORNERS_MAX) return;
    const first = this.cornerCount;
    let at = first * STRIDE;
    for (const corner of corners) {
      const [position, normal] = place(corner);
      this.corners.set(position, at);
      this.corners.set(normal, at + 3);
      this.corners.set(colour, at + 6);
      at += STRIDE;
    }
    for (const corner of triangles) this.triangles[this.triangleCount++] = first + corner;
    this.cornerCount += corners.length;
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
