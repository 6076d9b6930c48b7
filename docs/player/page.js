// The page of the documentation that shows recordings: what there is to choose, and the film where a browser cannot.

import { Player } from "./player.js";
import { readRecording } from "./recording.js";

const HERE = new URL(".", import.meta.url);

/** Show what can be shown in an element; the name after # in the page's address chooses. */
export async function showPage(element) {
  const catalogue = await (await fetch(new URL("catalogue.json", HERE))).json();
  const chooser = document.createElement("select");
  chooser.setAttribute("aria-label", "recording");
  chooser.className = "player-chooser";
  for (const name of new Set(catalogue.shown.map((entry) => entry.group))) {
    const group = document.createElement("optgroup");
    group.label = name;
    for (const entry of catalogue.shown.filter((one) => one.group === name)) {
      group.append(new Option(entry.title, entry.name));
    }
    chooser.append(group);
  }
  const sentence = document.createElement("p");
  sentence.className = "player-sentence";
  const stage = document.createElement("div");
  element.replaceChildren(chooser, sentence, stage);
  let start;
  if (catalogue.simulates) {
    start = async (recording) => (await import("./simulation.js")).startSimulation(recording);
  }
  let player;
  const choose = async () => {
    const named = catalogue.shown.find((entry) => `#${entry.name}` === location.hash);
    const entry = named ?? catalogue.shown[0];
    chooser.value = entry.name;
    sentence.textContent = entry.sentence;
    sentence.hidden = entry.sentence === "";
    try {
      const bytes = await (await fetch(new URL(entry.recording, HERE))).arrayBuffer();
      const recording = await readRecording(new Uint8Array(bytes));
      player ??= new Player(stage, start);
      player.show(recording);
    } catch (error) {
      player = undefined;
      stage.replaceChildren(film(entry, error));
    }
  };
  chooser.onchange = () => history.replaceState(null, "", `#${chooser.value}`) ?? choose();
  window.onhashchange = choose;
  await choose();
}

function film(entry, error) {
  const figure = document.createElement("figure");
  const isVideo = entry.film.endsWith(".mp4");
  const picture = document.createElement(isVideo ? "video" : "img");
  picture.className = "player-films";
  picture.src = new URL(entry.film, HERE);
  if (isVideo) picture.controls = true;
  else picture.alt = entry.title;
  const caption = document.createElement("figcaption");
  caption.textContent = `The film instead: ${error.message}.`;
  figure.append(picture, caption);
  return figure;
}

showPage(document.getElementById("player"));
