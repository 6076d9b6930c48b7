// What hands do to a player: keys, buttons, and pointers on its picture.

/** By key: which part of a command it changes, and to what. */
export const KEYS = {
  KeyW: ["ahead", 1],
  ArrowUp: ["ahead", 1],
  KeyS: ["ahead", -1],
  ArrowDown: ["ahead", -1],
  KeyA: ["left", 1],
  ArrowLeft: ["left", 1],
  KeyD: ["left", -1],
  ArrowRight: ["left", -1],
  KeyQ: ["turn", 1],
  KeyE: ["turn", -1],
  KeyR: ["board", 1],
  KeyF: ["board", -1],
};
/** Buttons for fingers: text, what it is called, and the key that it stands for. */
const PAD = [
  ["⟲", "turn left", "KeyQ"],
  ["▲", "ahead", "KeyW"],
  ["⟳", "turn right", "KeyE"],
  ["⤒", "board up", "KeyR"],
  ["◀", "to the left", "KeyA"],
  ["▼", "back", "KeyS"],
  ["▶", "to the right", "KeyD"],
  ["⤓", "board down", "KeyF"],
];

/** Return buttons for fingers; the keys for which one is pressed are added to those held. */
export function padOf(held) {
  const pad = made("div", "player-pad");
  const buttons = made("div", "player-buttons");
  for (const [text, title, key] of PAD) {
    const button = made("button", "", { type: "button", title, "aria-label": title });
    button.textContent = text;
    button.onpointerdown = (event) => {
      button.setPointerCapture(event.pointerId);
      held.add(key);
    };
    button.onpointerup = () => held.delete(key);
    button.onpointercancel = () => held.delete(key);
    button.oncontextmenu = (event) => event.preventDefault();
    buttons.append(button);
  }
  const help = made("p", "player-help");
  help.textContent =
    "W A S D or arrows drive, Q E turn, R F lift and lower the board, 1 to 9 choose the car. Drag a block to push it.";
  pad.append(buttons, help);
  return pad;
}

/** Turn, shift and zoom the camera of a player, or push what is grabbed in its simulation. */
export function followPointers(canvas, player) {
  const pointers = new Map();
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, place(event));
    const alone = pointers.size === 1 && event.button === 0;
    if (alone) player.simulation?.grab(player.scene.rayThrough(...place(event)));
    else player.simulation?.release();
  };
  canvas.onpointermove = (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const now = place(event);
    const across = now[0] - before[0];
    const down = now[1] - before[1];
    if (player.simulation?.push) {
      player.simulation.pull(player.scene.rayThrough(...now));
    } else if (pointers.size === 2) {
      const [other] = [...pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
      const apart = (at) => Math.hypot(at[0] - other[0], at[1] - other[1]);
      player.scene.zoom(apart(before) / Math.max(apart(now), 1));
      shift(across / 2, down / 2);
    } else if (event.buttons === 1 && !event.shiftKey) {
      player.scene.turn(-0.35 * across, -0.35 * down);
    } else {
      shift(across, down);
    }
    pointers.set(event.pointerId, now);
    player.isDirty = true;
  };
  const shift = (across, down) =>
    player.scene.shift(-across / canvas.clientHeight, down / canvas.clientHeight);
  canvas.onpointerup = (event) => {
    pointers.delete(event.pointerId);
    player.simulation?.release();
  };
  canvas.onpointercancel = canvas.onpointerup;
  canvas.oncontextmenu = (event) => event.preventDefault();
}

/** Return a new element with a class, if it is not "", and attributes. */
export function made(tag, name, attributes = {}) {
  const element = document.createElement(tag);
  if (name) element.className = name;
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}
