// A world of a recording, run by MuJoCo in the browser: a toy to drive and push, which judges nothing.

import { add, cross, scaled, subtract } from "./geometry.js";
import { Wheels } from "./wheels.js";

const MUJOCO = "./mujoco.js";
const WHEELS = ["wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr"];
/** Most of a command: m/s ahead and to the left, rad/s, m/s of the board; and how fast it comes to that. */
const FASTEST = { ahead: 0.35, left: 0.35, turn: 1.5, board: 0.04 };
const GROWTH = { ahead: 0.8, left: 0.8, turn: 4, board: 1 };
const LONGEST_WORK_S = 0.04; // of one frame, so that a slow computer still shows pictures
const WORK_SHARE = 0.3; // of a longer frame, which drawing takes
const PUSH_N_M = 150;
const MOST_PUSH_N = 40;
const LEAST_CONTACT_N = 0.2;
const PACE_SHARE = 0.1; // of the last frame in the mean pace

let loading;

/** Return a simulation of a recording's world, at its start. MuJoCo is loaded the first time. */
export async function startSimulation(recording) {
  loading ??= import(MUJOCO).then((module) => module.default());
  const mujoco = await loading;
  return new Simulation(mujoco, recording);
}

/** Return the speeds in rad/s of front left, front right, rear left and rear right wheel. */
export function wheelSpeeds(car, ahead, left, turn) {
  const spin = car.lever_m * turn;
  return [
    (ahead - left - spin) / car.radius_m,
    (ahead + left + spin) / car.radius_m,
    (ahead + left - spin) / car.radius_m,
    (ahead - left + spin) / car.radius_m,
  ];
}

export class Simulation {
  constructor(mujoco, recording) {
    this.mujoco = mujoco;
    this.recording = recording;
    // All that rests stays awake: a push must be felt.
    const world = recording.world.replace('sleep="enable"', 'sleep="disable"');
    this.model = mujoco.MjModel.from_xml_string(world);
    this.data = new mujoco.MjData(this.model);
    this.timestep = this.model.opt.timestep;
    this.wheels = new Wheels(mujoco, this.model, this.data);
    const names = recording.bodies.map((body) => body.name);
    this.bodies = names.map((name) => this.id("mjOBJ_BODY", name));
    this.motors = recording.cars.map((_, car) => ({
      wheels: WHEELS.map((wheel) => this.id("mjOBJ_ACTUATOR", `car${car}/${wheel}`)),
      board: this.id("mjOBJ_ACTUATOR", `car${car}/board`),
    }));
    this.begin(recording.positionsAt(recording.start));
  }

  id(kind, name) {
    return this.mujoco.mj_name2id(this.model, this.mujoco.mjtObj[kind].value, name);
  }

  /** Put everything where positions say, at rest. */
  begin(positions) {
    const { mujoco, model, data } = this;
    mujoco.mj_resetData(model, data);
    data.qpos.set(positions);
    // A motor that holds a position holds this one.
    for (let motor = 0; motor < model.nu; motor++) {
      const activation = model.actuator_actadr[motor];
      const joint = model.actuator_trnid[2 * motor];
      if (activation >= 0) data.act[activation] = positions[model.jnt_qposadr[joint]];
    }
    mujoco.mj_forward(model, data);
    this.owed = 0;
    this.pace = 1;
    this.speed = { ahead: 0, left: 0, turn: 0, board: 0 };
    this.push = undefined;
  }

  /** Views of MuJoCo's memory; where it has grown, those from before are empty. */
  get views() {
    if (!this.seen || this.seen.ctrl.length === 0) {
      const { ctrl, xfrc_applied, xpos, xquat, xmat, xipos } = this.data;
      this.seen = { ctrl, xfrc_applied, xpos, xquat, xmat, xipos };
    }
    return this.seen;
  }

  get time() {
    return this.data.time;
  }

  /** Simulate a span of time; a car takes a command of -1 to 1 in each part, the others stand. */
  advance(passed, car, command) {
    const step = this.timestep;
    this.owed += passed;
    const began = performance.now();
    const longest = Math.max(LONGEST_WORK_S, WORK_SHARE * passed);
    let done = 0;
    while (this.owed >= step) {
      this.setMotors(car, command, step);
      this.applyPush();
      this.wheels.step();
      this.owed -= step;
      done += step;
      if (performance.now() - began > 1000 * longest) break;
    }
    if (passed > 0 && done > 0) {
      // What could not be simulated in time is left out.
      const missed = Math.max(0, this.owed - step);
      this.owed -= missed;
      this.pace += PACE_SHARE * (done / (done + missed) - this.pace);
    }
  }

  setMotors(car, command, step) {
    const control = this.views.ctrl;
    control.fill(0);
    for (const part of Object.keys(FASTEST)) {
      const wanted = command[part] * FASTEST[part];
      const most = GROWTH[part] * step;
      const change = Math.min(most, Math.max(-most, wanted - this.speed[part]));
      this.speed[part] += change;
    }
    const { ahead, left, turn, board } = this.speed;
    const speeds = wheelSpeeds(this.recording.cars[car], ahead, left, turn);
    this.motors[car].wheels.forEach((motor, i) => (control[motor] = speeds[i]));
    control[this.motors[car].board] = board;
  }

  /** Return the pose of every body of the recording. */
  poses() {
    const { xpos, xquat } = this.views;
    return this.bodies.map((body) => ({
      pos: [...xpos.subarray(3 * body, 3 * body + 3)],
      quat: [...xquat.subarray(4 * body, 4 * body + 4)],
    }));
  }

  /** Return contacts with their forces: {pos, normal, force_n}. */
  contacts() {
    const { mujoco, model, data } = this;
    const found = [];
    const all = data.contact;
    const wrench = new mujoco.DoubleBuffer(6);
    for (let number = 0; number < all.size(); number++) {
      const contact = all.get(number);
      mujoco.mj_contactForce(model, data, number, wrench);
      const force = wrench.GetView()[0];
      if (force > LEAST_CONTACT_N) {
        const frame = contact.frame;
        found.push({
          pos: [...contact.pos],
          normal: [frame[0], frame[1], frame[2]],
          force_n: force,
        });
      }
      contact.delete();
    }
    wrench.delete();
    all.delete();
    return found;
  }

  /** Return where things touch at positions of a recording; it holds no forces. */
  contactsAt(positions) {
    const { mujoco, model, data } = this;
    data.qpos.set(positions);
    mujoco.mj_fwdPosition(model, data);
    const all = data.contact;
    const found = [];
    for (let number = 0; number < all.size(); number++) {
      const contact = all.get(number);
      const frame = contact.frame;
      if (contact.dist <= 0) {
        found.push({ pos: [...contact.pos], normal: [frame[0], frame[1], frame[2]], force_n: 0 });
      }
      contact.delete();
    }
    all.delete();
    return found;
  }

  /** Take hold of what a ray {eye, direction} meets; return whether it moves. */
  grab(ray) {
    const { mujoco, model, data } = this;
    const geom = new mujoco.IntBuffer(1);
    const groups = null;
    const distance = mujoco.mj_ray(
      model,
      data,
      ray.eye,
      ray.direction,
      groups,
      false,
      -1,
      geom,
      null,
    );
    const hit = geom.GetView()[0];
    geom.delete();
    if (hit < 0) return false;
    const body = model.geom_bodyid[hit];
    if (model.body_weldid[body] === 0) return false;
    const at = add(ray.eye, scaled(ray.direction, distance));
    this.push = { body, distance, from: at, to: at, own: this.inBody(body, at) };
    return true;
  }

  /** Pull what is held towards a ray. */
  pull(ray) {
    if (this.push) this.push.to = add(ray.eye, scaled(ray.direction, this.push.distance));
  }

  release() {
    this.push = undefined;
  }

  applyPush() {
    const { xfrc_applied, xipos } = this.views;
    const { push } = this;
    xfrc_applied.fill(0);
    if (!push) return;
    push.from = this.inWorld(push.body, push.own);
    const way = subtract(push.to, push.from);
    const force = Math.min(PUSH_N_M * Math.hypot(...way), MOST_PUSH_N);
    const newtons = scaled(way, force / Math.max(Math.hypot(...way), 1e-9));
    const centre = [...xipos.subarray(3 * push.body, 3 * push.body + 3)];
    const torque = cross(subtract(push.from, centre), newtons);
    xfrc_applied.set([...newtons, ...torque], 6 * push.body);
  }

  inBody(body, point) {
    const away = subtract(point, [...this.views.xpos.subarray(3 * body, 3 * body + 3)]);
    const m = this.views.xmat.subarray(9 * body, 9 * body + 9);
    return [0, 1, 2].map((i) => m[i] * away[0] + m[3 + i] * away[1] + m[6 + i] * away[2]);
  }

  inWorld(body, own) {
    const m = this.views.xmat.subarray(9 * body, 9 * body + 9);
    const turned = [0, 1, 2].map(
      (i) => m[3 * i] * own[0] + m[3 * i + 1] * own[1] + m[3 * i + 2] * own[2],
    );
    return add([...this.views.xpos.subarray(3 * body, 3 * body + 3)], turned);
  }
}
