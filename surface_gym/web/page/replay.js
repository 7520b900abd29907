/** A page that replays the recordings it holds. */

import { Player } from "./player.js";
import { readRecording } from "./recording.js";
import { AskedTheme } from "./theme.js";

const asked = new AskedTheme(); // the page around may ask before recordings are read
const room = document.getElementById("replay");
try {
  const held = [...document.querySelectorAll("script.recording")];
  const runs = await Promise.all(
    held.map(async (each) => ({
      name: each.dataset.name,
      recording: await readRecording(each.textContent),
    })),
  );
  new Player(room, runs, asked);
} catch (error) {
  room.setAttribute("role", "alert");
  room.textContent = `This replay cannot be shown: ${error.message}. It needs a browser of 2023 or later.`;
}
