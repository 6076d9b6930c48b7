// A player of recordings: picture, time line with verdicts, and, where a page has it, a simulation to take over.

import { KEYS, followPointers, made, padOf } from "./controls.js";
import { add, normalized, subtract } from "./geometry.js";
import { Scene } from "./scene.js";

const SPEEDS = [0.25, 0.5, 1, 2, 4];
const LONGEST_FRAME_S = 0.5; // two pictures a second keep real time; after a longer pause a run goes on where it was
const CONTACT_COLOUR = [1.0, 0.45, 0.05, 0.9];
const PUSH_COLOUR = [0.85, 0.15, 0.55, 0.9];
const GOAL_COLOUR = [0.1, 0.62, 0.42, 0.22];
const NEAR_M = 0.03; // what stands nearer than this to its place fills it
const CONTACT_M = 0.006;
const METRES_A_NEWTON = 0.004;
const LONGEST_ARROW_M = 0.3;
const NEAR_BY_M = 2.4;
const TONES = {
  "as predicted": "good",
  "as predicted, retried": "good",
  failed: "bad",
  "side effect": "caution",
  unsafe: "bad",
  numerics: "muted",
};
export class Player {
  /**
   * Make a player in an element, which is emptied.
   *
   * @param {HTMLElement} element where it goes.
   * @param {Function} [startSimulation] returns a promise of a simulation of a recording; see docs/player/simulation.js.
   */
  constructor(element, startSimulation) {
    this.element = element;
    this.startSimulation = startSimulation;
    this.parts = {};
    this.held = new Set();
    this.build();
    element.player = this;
    requestAnimationFrame((now) => this.frame(now));
  }

  /** Show a recording from its start. Throws Error where there is no WebGL 2. */
  show(recording) {
    this.recording = recording;
    this.stopSimulation();
    this.scene?.close();
    this.scene = new Scene(this.freshCanvas(), recording);
    this.time = recording.start;
    this.until = recording.end;
    this.isPlaying = false;
    this.isDirty = true;
    this.parts.picture.setAttribute("aria-label", recording.title);
    this.listVerdicts();
    this.makeLabels();
    this.parts.slider.min = recording.start;
    this.parts.slider.max = recording.end;
    this.draw();
    this.element.dataset.shown = recording.title;
  }

  play() {
    if (this.time >= this.recording.end - 1e-6) this.time = this.recording.start;
    if (this.until <= this.time) this.until = this.recording.end;
    this.isPlaying = true;
    this.isDirty = true;
  }

  pause() {
    this.isPlaying = false;
    this.isDirty = true;
  }

  /** Go to a time, and stop there. */
  seek(time) {
    this.stopSimulation();
    this.time = Math.min(Math.max(time, this.recording.start), this.recording.end);
    this.until = this.recording.end;
    this.pause();
  }

  /** Play one attempt, from its start to its end. */
  replay(attempt) {
    this.seek(attempt.start_s);
    this.until = Math.min(attempt.end_s, this.recording.end);
    this.play();
  }

  /** Simulate from what is shown on. */
  async drive() {
    this.pause();
    const simulation = await this.loadedSimulation();
    if (!simulation) return;
    simulation.begin(this.recording.positionsAt(this.time));
    this.simulation = simulation;
    this.parts.canvas.focus({ preventScroll: true });
    this.showMode();
  }

  stopSimulation() {
    this.simulation = undefined;
    this.held.clear();
    this.isDirty = true;
    this.showMode();
  }

  /** Return the simulation of the recording, undefined where it cannot be loaded; the page then says why. */
  async loadedSimulation() {
    if (this.loadedFor === this.recording) return this.loaded;
    const { said } = this.parts;
    said.textContent = "loading MuJoCo …";
    try {
      this.loaded = await this.startSimulation(this.recording);
      this.loadedFor = this.recording;
      said.textContent = "";
      return this.loaded;
    } catch (error) {
      said.textContent = `MuJoCo does not run here: ${error.message}`;
      return undefined;
    }
  }

  /** Look at a car from near by, as it is now. */
  lookAt(car) {
    const poses = this.recording.posesOf(this.recording.positionsAt(this.time));
    this.scene.camera.target = poses[this.boardOf(car)].pos;
    this.scene.camera.distance_m = NEAR_BY_M;
    this.isDirty = true;
  }

  boardOf(car) {
    return this.recording.bodies.findIndex((body) => body.name === `car${car}/board`);
  }

  /** Take the picture away, for browsers keep few at a time. */
  close() {
    this.isClosed = true;
    this.scene.close();
    this.element.replaceChildren();
  }

  frame(now) {
    if (this.isClosed) return;
    const passed = Math.min((now - (this.before ?? now)) / 1000, LONGEST_FRAME_S);
    this.before = now;
    if (this.recording) {
      if (this.simulation) this.simulate(passed);
      else if (this.isPlaying) this.advance(passed);
      if (this.isDirty || this.simulation) this.draw();
    }
    requestAnimationFrame((later) => this.frame(later));
  }

  advance(passed) {
    this.time += passed * Number(this.parts.speed.value);
    if (this.time >= this.until) {
      this.time = this.until;
      this.isPlaying = false;
    }
    this.isDirty = true;
  }

  simulate(passed) {
    const command = { ahead: 0, left: 0, turn: 0, board: 0 };
    for (const key of this.held) {
      const [part, value] = KEYS[key];
      command[part] += value;
    }
    const car = Number(this.parts.car.value);
    const board = this.boardOf(car);
    const from = this.simulation.poses()[board].pos;
    this.simulation.advance(passed, car, command);
    if (this.held.size === 0) return;
    // A car that is driven stays in the picture.
    const way = subtract(this.simulation.poses()[board].pos, from);
    const { camera } = this.scene;
    camera.target = add(camera.target, way);
  }

  draw() {
    this.isDirty = false;
    const poses = this.simulation
      ? this.simulation.poses()
      : this.recording.posesOf(this.recording.positionsAt(this.time));
    const marks = this.goalMarks(poses);
    if (this.parts.contacts.checked) marks.push(...this.contactMarks());
    const push = this.simulation?.push;
    if (push) marks.push(arrow(push.from, push.to, PUSH_COLOUR));
    this.scene.draw(poses, marks, isDark(this.element) ? "dark" : "light");
    this.placeLabels(poses);
    this.showTime();
  }

  /** Return boxes where something of the design is missing; the foot of a ramp is part of the ramp. */
  goalMarks(poses) {
    const [length, width, height] = this.recording.cell_m;
    const marks = [];
    for (const { kind, cell } of this.recording.design) {
      if (kind === "foot") continue;
      const floor = [(cell[0] + 0.5) * length, (cell[1] + 0.5) * width, (cell[2] - 1) * height];
      const wanted = kind === "block" ? /^block\d+\/block$/ : /^slope\d+\/slope$/;
      const isFilled = this.recording.bodies.some((body, number) => {
        if (!wanted.test(body.name)) return false;
        const [x, y, z] = poses[number].pos;
        const isAbove = z > floor[2] - NEAR_M && z < floor[2] + height - NEAR_M;
        return isAbove && Math.hypot(x - floor[0], y - floor[1]) < NEAR_M;
      });
      if (isFilled) continue;
      marks.push({
        pos: [floor[0], floor[1], floor[2] + 0.5 * height],
        quat: [1, 0, 0, 0],
        half: [0.48 * length, 0.48 * width, 0.48 * height],
        colour: GOAL_COLOUR,
      });
    }
    return marks;
  }

  contactMarks() {
    let contacts = [];
    if (this.simulation) contacts = this.simulation.contacts();
    else if (this.loadedFor === this.recording) {
      contacts = this.loaded.contactsAt(this.recording.positionsAt(this.time));
    }
    return contacts.map((contact) => {
      const length = Math.min(contact.force_n * METRES_A_NEWTON, LONGEST_ARROW_M);
      const end = contact.pos.map((part, i) => part + contact.normal[i] * (length + CONTACT_M));
      return { ...arrow(contact.pos, end, CONTACT_COLOUR), through: true };
    });
  }

  showTime() {
    const { slider, clock, now, play } = this.parts;
    const time = this.simulation ? this.simulation.time : this.time;
    slider.value = this.time;
    clock.textContent = `${time.toFixed(1)} s`;
    play.textContent = this.isPlaying ? "❚❚" : "▶";
    play.setAttribute("aria-label", this.isPlaying ? "pause" : "play");
    if (this.simulation) {
      const pace = this.simulation.pace;
      const slow = pace < 0.95 ? ` This computer is slow: ${pace.toFixed(2)} of real time.` : "";
      now.textContent = `A toy: your keys command motors, your push is a force from nowhere. Nothing here is judged.${slow}`;
      return;
    }
    const attempts = this.recording.attemptsAt(this.time);
    now.replaceChildren(...attempts.map((attempt) => sentenceOf(attempt)));
  }

  build() {
    const { parts } = this;
    parts.picture = made("div", "player-picture", { role: "group" });
    parts.labels = made("div", "player-labels", { "aria-hidden": "true" });
    parts.picture.append(parts.labels);
    parts.play = made("button", "player-play", { type: "button" });
    parts.play.onclick = () => {
      if (this.simulation) this.stopSimulation();
      if (this.isPlaying) this.pause();
      else this.play();
    };
    parts.slider = made("input", "", { type: "range", step: "any", "aria-label": "time" });
    parts.slider.oninput = () => this.seek(Number(parts.slider.value));
    parts.marks = made("div", "player-marks", { "aria-hidden": "true" });
    const line = made("div", "player-line");
    line.append(parts.slider, parts.marks);
    parts.clock = made("output", "player-clock");
    parts.speed = made("select", "", { "aria-label": "speed" });
    for (const speed of SPEEDS) parts.speed.append(new Option(`${speed}×`, speed));
    parts.speed.value = 1;
    const bar = made("div", "player-bar");
    bar.append(parts.play, line, parts.clock, parts.speed);
    parts.now = made("p", "player-now");
    parts.contacts = made("input", "", { type: "checkbox" });
    const contacts = made("label", "");
    contacts.append(parts.contacts, " contacts");
    parts.contacts.onchange = () => this.showContacts();
    parts.drive = made("button", "", { type: "button" });
    parts.drive.onclick = () => (this.simulation ? this.stopSimulation() : this.drive());
    parts.car = made("select", "", { "aria-label": "car" });
    parts.said = made("span", "player-said", { role: "status" });
    parts.tools = made("div", "player-tools");
    parts.tools.append(parts.drive, parts.car, contacts, parts.said);
    parts.tools.hidden = !this.startSimulation;
    parts.pad = padOf(this.held);
    parts.verdicts = made("details", "player-verdicts");
    this.element.classList.add("player");
    this.element.onkeydown = (event) => this.press(event);
    this.element.onkeyup = (event) => this.held.delete(event.code);
    this.element.onfocusout = () => this.held.clear();
    this.element.replaceChildren(
      parts.picture,
      bar,
      parts.now,
      parts.tools,
      parts.pad,
      parts.verdicts,
    );
  }

  showMode() {
    const { drive, pad, car, element } = { ...this.parts, element: this.element };
    drive.textContent = this.simulation ? "Back to the recording" : "Drive from here";
    pad.hidden = !this.simulation;
    car.hidden = !this.simulation;
    element.classList.toggle("player-simulates", Boolean(this.simulation));
  }

  async showContacts() {
    if (this.parts.contacts.checked) {
      const simulation = await this.loadedSimulation();
      if (!simulation) this.parts.contacts.checked = false;
    }
    this.isDirty = true;
  }

  /** A canvas keeps its context, which belongs to the recording before. */
  freshCanvas() {
    const canvas = made("canvas", "", { tabindex: "0" });
    this.parts.canvas?.remove();
    this.parts.canvas = canvas;
    this.parts.picture.prepend(canvas);
    canvas.onwheel = (event) => {
      if (!event.ctrlKey && document.activeElement !== canvas) return; // the page scrolls
      event.preventDefault();
      this.scene.zoom(Math.exp(event.deltaY / 600));
      this.isDirty = true;
    };
    followPointers(canvas, this);
    new ResizeObserver(() => (this.isDirty = true)).observe(canvas);
    return canvas;
  }

  press(event) {
    if (event.target === this.parts.canvas && event.code === "Space") {
      event.preventDefault();
      this.parts.play.click();
    }
    const hasOwnKeys = [this.parts.slider, this.parts.car, this.parts.speed].includes(event.target);
    if (!this.simulation || hasOwnKeys) return;
    const digit = /^Digit([1-9])$/.exec(event.code);
    if (digit && Number(digit[1]) <= this.recording.cars.length) {
      this.parts.car.value = Number(digit[1]) - 1;
    }
    if (event.code in KEYS && !event.ctrlKey && !event.metaKey && !event.altKey) {
      event.preventDefault();
      this.held.add(event.code);
    }
  }

  listVerdicts() {
    const { verdicts, marks, car } = this.parts;
    const { attempts, start, end, cars } = this.recording;
    car.replaceChildren(...cars.map((_, number) => new Option(`car ${number}`, number)));
    const summary = made("summary", "");
    const agreeing = attempts.filter((one) => one.agrees).length;
    summary.textContent = `Verdicts: ${agreeing} of ${attempts.length} as predicted`;
    const list = made("ol", "");
    for (const attempt of attempts) {
      const button = made("button", `player-verdict ${toneOf(attempt)}`, { type: "button" });
      button.textContent = `${attempt.start_s.toFixed(1)} s, car ${attempt.car} ${attempt.action}: ${attempt.result}`;
      button.onclick = () => this.replay(attempt);
      const item = made("li", "");
      item.append(button);
      list.append(item);
    }
    verdicts.replaceChildren(summary, list);
    verdicts.hidden = attempts.length === 0;
    const length = end - start || 1;
    marks.replaceChildren(
      ...attempts.map((attempt) => {
        const mark = made("i", toneOf(attempt));
        mark.style.left = `${(100 * (attempt.start_s - start)) / length}%`;
        mark.style.width = `${(100 * (attempt.end_s - attempt.start_s)) / length}%`;
        return mark;
      }),
    );
  }

  makeLabels() {
    this.parts.labels.replaceChildren(
      ...this.recording.cars.map((_, number) => {
        const label = made("span", "");
        label.textContent = number;
        return label;
      }),
    );
  }

  placeLabels(poses) {
    for (const { car, x, y } of this.scene.labels(poses)) {
      const label = this.parts.labels.children[car];
      label.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px) translate(-50%, -50%)`;
    }
  }
}

function sentenceOf(attempt) {
  const line = made("span", `player-verdict ${toneOf(attempt)}`);
  const reason = attempt.reason ? ` (${attempt.reason})` : "";
  line.textContent = `car ${attempt.car} ${attempt.action}: ${attempt.result}${reason}`;
  return line;
}

function toneOf(attempt) {
  return TONES[attempt.result] ?? "muted";
}

/** Return a thin box from one point to another. */
function arrow(from, to, colour) {
  const along = from.map((part, i) => to[i] - part);
  const length = Math.hypot(...along);
  const middle = from.map((part, i) => (part + to[i]) / 2);
  const half = [CONTACT_M / 2, CONTACT_M / 2, Math.max(length / 2, CONTACT_M / 2)];
  return { pos: middle, quat: turnOfZ(along), half, colour, through: true };
}

/** Return the quaternion that turns the z axis into a direction. */
function turnOfZ([x, y, z]) {
  const length = Math.hypot(x, y, z);
  if (length < 1e-9 || z < -0.999999 * length) return [0, 1, 0, 0];
  return normalized([length + z, -y, x, 0]);
}

/** Return whether a page is dark where an element is, by the brightness of its text. */
function isDark(element) {
  const [red, green, blue] = getComputedStyle(element)
    .color.match(/[\d.]+/g)
    .map(Number);
  return 0.3 * red + 0.6 * green + 0.1 * blue > 128;
}
