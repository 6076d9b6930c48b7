// Recordings in a report, one on its card at a time: browsers keep few pictures.

import { Player } from "./player.js";
import { readRecording } from "./recording.js";

for (const card of document.querySelectorAll("details.recording")) {
  let player;
  card.ontoggle = async () => {
    if (!card.open) {
      player?.close();
      player = undefined;
      return;
    }
    const stage = card.querySelector("[data-recording]");
    const bytes = Uint8Array.from(atob(stage.dataset.recording), (byte) => byte.charCodeAt(0));
    try {
      const recording = await readRecording(bytes);
      player = new Player(stage);
      player.show(recording);
      if (recording.attempts.length > 0) player.lookAt(recording.attempts[0].car);
      player.play();
    } catch (error) {
      stage.textContent = `Not shown: ${error.message}.`;
    }
  };
}
