// A recording that craftsim/rendering/player.py has written: positions of a run, and where these put its bodies.

import { add, normalized, product, rotated } from "./geometry.js";

const FORMAT = 1;
const GZIP = [0x1f, 0x8b];

/** Return the recording in the bytes of a file, which a server may have unpacked already. */
export async function readRecording(bytes) {
  let stream = new Blob([bytes]).stream();
  if (bytes[0] === GZIP[0] && bytes[1] === GZIP[1]) {
    stream = stream.pipeThrough(new DecompressionStream("gzip"));
  }
  const document = JSON.parse(await new Response(stream).text());
  if (document.format !== FORMAT) {
    throw new Error(`the recording has format ${document.format}; this player reads ${FORMAT}`);
  }
  return new Recording(document);
}

/** A run: what it shows, and the positions of everything at its samples. */
export class Recording {
  constructor(document) {
    Object.assign(this, document);
    this.times = summed(document.time_s, document.time_s.length, document.units.time_s);
    // Zeros at the end of differences are left out; the last time is never one of them.
    this.columns = document.qpos.map((column) =>
      summed(column.steps, this.times.length, column.unit),
    );
    this.start = this.times[0];
    this.end = this.times[this.times.length - 1];
  }

  /** Return the positions of everything at a time, between samples on a straight line. */
  positionsAt(time) {
    const next = this.firstAfter(time);
    const before = Math.max(0, next - 1);
    const after = Math.min(next, this.times.length - 1);
    const span = this.times[after] - this.times[before];
    const share = span > 0 ? (time - this.times[before]) / span : 0;
    return this.columns.map((column) => column[before] + share * (column[after] - column[before]));
  }

  /** Return the number of the first sample after a time. */
  firstAfter(time) {
    let low = 0;
    let high = this.times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] <= time) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** Return the pose {pos, quat} of every body in the world for the positions of everything. */
  posesOf(positions) {
    const poses = [{ pos: [0, 0, 0], quat: [1, 0, 0, 0] }];
    for (const body of this.bodies.slice(1)) {
      const parent = poses[body.parent];
      if (body.joint?.kind === "free") {
        const numbers = positions.slice(body.joint.column, body.joint.column + 7);
        poses.push({ pos: numbers.slice(0, 3), quat: normalized(numbers.slice(3)) });
        continue;
      }
      const pose = {
        pos: add(parent.pos, rotated(parent.quat, body.pos)),
        quat: product(parent.quat, body.quat),
      };
      if (body.joint) moveByJoint(pose, body.joint, positions[body.joint.column]);
      poses.push(pose);
    }
    return poses;
  }

  /** Return what is tried at a time, and what was tried last where nothing is. */
  attemptsAt(time) {
    const current = this.attempts.filter((one) => one.start_s <= time && time <= one.end_s);
    if (current.length > 0) return current;
    const past = this.attempts.filter((one) => one.end_s < time);
    const last = Math.max(...past.map((one) => one.end_s));
    return past.filter((one) => one.end_s === last);
  }
}

function moveByJoint(pose, joint, position) {
  const axis = rotated(pose.quat, joint.axis);
  if (joint.kind === "slide") {
    pose.pos = add(
      pose.pos,
      axis.map((part) => part * position),
    );
    return;
  }
  // A hinge leaves its own place where it is.
  const anchor = add(pose.pos, rotated(pose.quat, joint.pos));
  const half = position / 2;
  const turn = [Math.cos(half), ...joint.axis.map((part) => part * Math.sin(half))];
  pose.quat = product(pose.quat, turn);
  const arm = rotated(pose.quat, joint.pos);
  pose.pos = anchor.map((part, i) => part - arm[i]);
}

function summed(differences, length, unit) {
  const values = new Float64Array(length);
  let sum = 0;
  for (let i = 0; i < length; i++) {
    sum += differences[i] ?? 0;
    values[i] = sum * unit;
  }
  return values;
}
