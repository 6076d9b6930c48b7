// Contacts of mecanum wheels that have one tyre, as craftsim/models/wheel_contacts.py has them: friction acts along the
// roller that touches, and hardly across it. Plain MuJoCo gives such a wheel equal friction both ways.
//
// MuJoCo finds the contacts, and these are changed before it makes constraints of them, between exported stages of its
// step and in their order. Contacts lie at the beginning of its arena, one mjContact after another.

import { add, cross, dot, normalized, scaled, subtract } from "./geometry.js";

const TYRE = 0.4747; // marks a tyre; TYRE, SIDE, ACROSS, HALF_WIDTH and N_USER of craftsim/mjcf/car.py
const SIDE = 1;
const ACROSS = 2;
const HALF_WIDTH = 3;
const N_USER = 4;
const LIFT = 0.25; // _LIFT of wheel_contacts.py
const GRAVITY = 9.81;
const LEAST_FRICTION = 1e-5;

// Places in an mjContact, in doubles and, from its beginning, in integers.
const SIZE = 73;
const POSITION = 1;
const FRAME = 4;
const FRICTION = 14;
const SOLREF = 19;
const SOLREF_FRICTION = 21;
const SOLIMP = 23;
const GEOMS = 135;
const EXCLUDE = 143;
const EXCLUDED = 1;

/** The wheels of a model: they change its contacts. */
export class Wheels {
  constructor(mujoco, model, data) {
    this.mujoco = mujoco;
    this.model = model;
    this.data = data;
    this.tyres = new Map();
    const nUser = model.nuser_geom;
    if (nUser < N_USER) return;
    const user = model.geom_user;
    for (let geom = 0; geom < model.ngeom; geom++) {
      if (user[geom * nUser] === TYRE) {
        this.tyres.set(geom, [...user.slice(geom * nUser, geom * nUser + N_USER)]);
      }
    }
    this.solref = [...model.geom_solref];
    this.bodies = [...model.geom_bodyid];
    this.parents = [...model.body_parentid];
    this.roots = [...model.body_rootid];
    this.nDofs = [...model.body_dofnum];
    this.firstDofs = [...model.body_dofadr];
    this.dofsBefore = [...model.dof_parentid];
  }

  /** Views of MuJoCo's memory; where it has grown, those from before are empty. */
  get views() {
    if (!this.seen || this.seen.numbers.length === 0) {
      const { arena, geom_xpos, geom_xmat, subtree_com, cdof, qvel } = this.data;
      const length = 2 * Math.floor(arena.length / 16);
      const numbers = new Float64Array(arena.buffer, arena.byteOffset, length);
      const integers = new Int32Array(arena.buffer, arena.byteOffset, 2 * length);
      this.seen = { numbers, integers, geom_xpos, geom_xmat, subtree_com, cdof, qvel };
    }
    return this.seen;
  }

  /** Step the world once, as mj_step does, its wheels' contacts changed. */
  step() {
    const { mujoco, model, data } = this;
    if (this.tyres.size === 0) {
      mujoco.mj_step(model, data);
      return;
    }
    mujoco.mj_checkPos(model, data);
    mujoco.mj_checkVel(model, data);
    mujoco.mj_fwdPosition(model, data);
    if (this.changeContacts() > 0) {
      mujoco.mj_makeConstraint(model, data);
      mujoco.mj_island(model, data);
      mujoco.mj_projectConstraint(model, data);
    }
    mujoco.mj_fwdVelocity(model, data);
    mujoco.mj_step2(model, data);
  }

  /** Change the contacts of tyres; return how many. Throws Error where MuJoCo lays contacts out otherwise. */
  changeContacts() {
    const n = this.data.ncon;
    if (n === 0) return 0;
    const { numbers, integers } = this.views;
    if (!this.isChecked) this.check(numbers, integers, n);
    let changed = 0;
    for (let contact = 0; contact < n; contact++) {
      const at = contact * SIZE;
      const first = integers[2 * at + GEOMS];
      const second = integers[2 * at + GEOMS + 1];
      let tyre = second;
      if (this.tyres.has(first)) tyre = first;
      else if (!this.tyres.has(second)) continue;
      const own = numbers.subarray(at, at + SIZE);
      const stays = this.changeContact(own, [first, second], tyre);
      if (!stays) integers[2 * at + EXCLUDE] = EXCLUDED;
      changed++;
    }
    return changed;
  }

  /** Change one contact; return whether it stays: a tyre is a sphere, which is wider than its wheel. */
  changeContact(contact, geoms, tyre) {
    const { geom_xpos, geom_xmat } = this.views;
    const user = this.tyres.get(tyre);
    const axle = [geom_xmat[9 * tyre + 1], geom_xmat[9 * tyre + 4], geom_xmat[9 * tyre + 7]];
    const place = vectorAt(contact, POSITION);
    const out = subtract(place, vectorAt(geom_xpos, 3 * tyre));
    if (Math.abs(dot(out, axle)) > user[HALF_WIDTH]) return false;
    const along = cross(out, axle);
    const length = Math.hypot(...along);
    if (length === 0) return true;
    const normal = vectorAt(contact, FRAME);
    // The roller's axis, in the plane of the contact.
    const axis = add(scaled(along, 1 / length), scaled(axle, user[SIDE]));
    const tangent = normalized(subtract(axis, scaled(normal, dot(axis, normal))));
    const second = cross(normal, tangent);
    contact.set(tangent, FRAME + 3);
    contact.set(second, FRAME + 6);
    // A soft tyre grips as a hard one does.
    const harder = this.solref[2 * geoms[1]] < this.solref[2 * geoms[0]] ? geoms[1] : geoms[0];
    contact[SOLREF_FRICTION] = this.solref[2 * harder];
    contact[SOLREF_FRICTION + 1] = this.solref[2 * harder + 1];
    const speed = Math.abs(
      this.speed(geoms[0], place, second) - this.speed(geoms[1], place, second),
    );
    const most = Math.min(user[ACROSS], contact[FRICTION], mostAcross(contact, speed));
    contact[FRICTION + 1] = Math.max(most, LEAST_FRICTION);
    return true;
  }

  /** Return the speed along an axis with which a geom's body moves at a point. */
  speed(geom, point, axis) {
    let body = this.bodies[geom];
    while (body > 0 && this.nDofs[body] === 0) body = this.parents[body];
    if (body === 0) return 0;
    const { subtree_com, cdof, qvel } = this.views;
    const arm = subtract(point, vectorAt(subtree_com, 3 * this.roots[body]));
    let speed = 0;
    let dof = this.firstDofs[body] + this.nDofs[body] - 1;
    while (dof >= 0) {
      // Rotation and translation of the centre by a unit of the joint's speed.
      const turned = cross(vectorAt(cdof, 6 * dof), arm);
      speed += qvel[dof] * dot(add(vectorAt(cdof, 6 * dof + 3), turned), axis);
      dof = this.dofsBefore[dof];
    }
    return speed;
  }

  check(numbers, integers, n) {
    for (const number of new Set([0, n - 1])) {
      const contact = this.data.contact.get(number);
      const at = number * SIZE;
      const same = [
        [numbers[at], contact.dist],
        ...[0, 1, 2].map((i) => [numbers[at + POSITION + i], contact.pos[i]]),
        ...[0, 1, 2].map((i) => [numbers[at + FRAME + i], contact.frame[i]]),
        ...[0, 1, 2].map((i) => [numbers[at + FRICTION + i], contact.friction[i]]),
        ...[0, 1].map((i) => [numbers[at + SOLREF + i], contact.solref[i]]),
        ...[0, 1].map((i) => [numbers[at + SOLIMP + i], contact.solimp[i]]),
        ...[0, 1].map((i) => [integers[2 * at + GEOMS + i], contact.geom[i]]),
        [integers[2 * at + EXCLUDE], contact.exclude],
      ].every(([here, there]) => here === there);
      contact.delete();
      if (!same) throw new Error("this MuJoCo lays contacts out otherwise; take rollers");
    }
    this.isChecked = true;
  }
}

/** Return the largest friction across a roller that hardly lifts a wheel which slides. */
function mostAcross(contact, speed) {
  const least = contact[SOLIMP];
  const largest = contact[SOLIMP + 1];
  const reference = contact[SOLREF_FRICTION] === 0 ? SOLREF : SOLREF_FRICTION;
  const isTime = contact[reference] > 0;
  const damping = isTime ? 2 / (largest * contact[reference]) : -contact[reference + 1] / largest;
  const lifting = damping * speed;
  const mayLift = (LIFT * GRAVITY * (1 - least)) / least;
  return lifting <= mayLift ? 1 : mayLift / lifting;
}

function vectorAt(numbers, place) {
  return [numbers[place], numbers[place + 1], numbers[place + 2]];
}
