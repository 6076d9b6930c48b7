// Vectors, quaternions with w first, matrices as WebGL takes them, and simple shapes.

const NEAREST_M = 0.05;
const FURTHEST_M = 60;
const FLOOR_M = 60; // how far the floor goes on

export function add(a, b) {
  return [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
}

export function subtract(a, b) {
  return [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
}

export function scaled(a, factor) {
  return [a[0] * factor, a[1] * factor, a[2] * factor];
}

export function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

export function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

export function normalized(vector) {
  const length = Math.hypot(...vector);
  return vector.map((part) => part / length);
}

/** Return the product of two quaternions, w first. */
export function product(a, b) {
  return [
    a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
    a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
    a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
    a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
  ];
}

/** Return a vector turned by a unit quaternion. */
export function rotated(quat, vector) {
  const axis = quat.slice(1);
  const twice = scaled(cross(axis, vector), 2);
  return add(add(vector, scaled(twice, quat[0])), cross(axis, twice));
}

// Matrices are columns one after another, as WebGL takes them.

export function placing(pos, quat, size = [1, 1, 1]) {
  const [w, x, y, z] = quat;
  const [a, b, c] = size;
  return new Float32Array([
    a * (1 - 2 * (y * y + z * z)),
    a * 2 * (x * y + w * z),
    a * 2 * (x * z - w * y),
    0,
    b * 2 * (x * y - w * z),
    b * (1 - 2 * (x * x + z * z)),
    b * 2 * (y * z + w * x),
    0,
    c * 2 * (x * z + w * y),
    c * 2 * (y * z - w * x),
    c * (1 - 2 * (x * x + y * y)),
    0,
    pos[0],
    pos[1],
    pos[2],
    1,
  ]);
}

export function looking(eye, right, up, forward) {
  const back = scaled(forward, -1);
  return new Float32Array([
    right[0],
    up[0],
    back[0],
    0,
    right[1],
    up[1],
    back[1],
    0,
    right[2],
    up[2],
    back[2],
    0,
    -dot(right, eye),
    -dot(up, eye),
    -dot(back, eye),
    1,
  ]);
}

export function perspective(tangent, aspect) {
  const depth = NEAREST_M - FURTHEST_M;
  return new Float32Array([
    1 / (tangent * aspect),
    0,
    0,
    0,
    0,
    1 / tangent,
    0,
    0,
    0,
    0,
    (FURTHEST_M + NEAREST_M) / depth,
    -1,
    0,
    0,
    (2 * FURTHEST_M * NEAREST_M) / depth,
    0,
  ]);
}

export function orthographic(radius, depth) {
  return new Float32Array([
    1 / radius,
    0,
    0,
    0,
    0,
    1 / radius,
    0,
    0,
    0,
    0,
    -2 / depth,
    0,
    0,
    0,
    -1,
    1,
  ]);
}

export function multiplied(a, b) {
  const product = new Float32Array(16);
  for (let column = 0; column < 4; column++) {
    for (let row = 0; row < 4; row++) {
      for (let k = 0; k < 4; k++) product[4 * column + row] += a[4 * k + row] * b[4 * column + k];
    }
  }
  return product;
}

export function transformed(matrix, vector) {
  return [0, 1, 2, 3].map((row) =>
    vector.reduce((sum, part, column) => sum + matrix[4 * column + row] * part, 0),
  );
}

export function floorShape() {
  const points = [];
  for (const [x, y] of [
    [-1, -1],
    [1, -1],
    [1, 1],
    [-1, 1],
  ]) {
    points.push(x * FLOOR_M, y * FLOOR_M, 0);
  }
  return {
    points_m: points,
    normals: [0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1],
    faces: [0, 1, 2, 0, 2, 3],
    palette: [[255, 255, 255, 255]],
    colours: [0, 0],
  };
}

/** Return a box from -1 to 1 along each axis. */
export function boxShape() {
  const shape = {
    points_m: [],
    normals: [],
    faces: [],
    palette: [[255, 255, 255, 255]],
    colours: [],
  };
  for (let axis = 0; axis < 3; axis++) {
    for (const side of [-1, 1]) {
      const first = shape.points_m.length / 3;
      for (const [a, b] of [
        [-1, -1],
        [1, -1],
        [1, 1],
        [-1, 1],
      ]) {
        const point = [0, 0, 0];
        point[axis] = side;
        point[(axis + 1) % 3] = a;
        point[(axis + 2) % 3] = b;
        const normal = [0, 0, 0];
        normal[axis] = side;
        shape.points_m.push(...point);
        shape.normals.push(...normal);
      }
      for (const corner of [0, 1, 2, 0, 2, 3]) shape.faces.push(first + corner);
      shape.colours.push(0, 0);
    }
  }
  return shape;
}
