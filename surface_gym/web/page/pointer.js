/** What pointer and keys do on a picture: a tool used at places, a drag, zoom by wheel and pinch. */

import { followPointers } from "./gestures.js";
import { ARROWS, nextModule, placeOf } from "./view.js";

const STILL = 6; // [px] that a pointer may move in a click
const STEP = 1.25; // zoom of a key

/**
 * Listen to a picture's canvas.
 * @param {import("./draw.js").Picture} picture
 * @param {object} does
 * @param {() => string} does.tool that is chosen
 * @param {(module: number, begins: boolean) => void} does.paint with the pointer on a module
 * @param {(from: number[], to: number[]|null) => void} does.throw from a place [m], dragged to one
 * @param {(from: number[]|null, to?: number[]) => void} does.aim while it is dragged; null: no more
 * @param {() => void} does.changed the picture is to be drawn again
 */
export function listen(picture, does) {
  const { canvas } = picture;
  let from = null;
  let painted = -1;

  followPointers(canvas, {
    press: (place, isSecond) => {
      from = isSecond ? null : place;
      if (isSecond) does.aim(null);
      else if (["turn", "stick"].includes(does.tool())) {
        painted = picture.moduleAt(...place);
        if (painted >= 0) does.paint(painted, true);
      }
    },
    move: (place, before) => {
      if (!before || !from) return;
      const tool = does.tool();
      if (tool === "pan") {
        picture.pan(place[0] - before[0], place[1] - before[1]);
        does.changed();
      } else if (tool === "throw") {
        does.aim(picture.toSurface(...from), picture.toSurface(...place));
      } else {
        const module = picture.moduleAt(...place);
        if (module >= 0 && module !== painted) does.paint(module, false);
        painted = module;
      }
    },
    release: (to, isLast) => {
      does.aim(null);
      if (to && from && does.tool() === "throw") {
        const isDrag = Math.hypot(to[0] - from[0], to[1] - from[1]) > STILL;
        does.throw(picture.toSurface(...from), isDrag ? picture.toSurface(...to) : null);
      }
      if (isLast) from = null;
    },
    zoom: (factor, place, shift) => {
      picture.zoom(factor, ...place);
      picture.pan(...shift);
      does.changed();
    },
  });

  canvas.addEventListener("keydown", (event) => {
    const { surface, chosen } = picture;
    if (event.key in ARROWS) {
      chosen.module = nextModule(surface, chosen.module, ARROWS[event.key], 0.25);
    } else if (event.key === "Enter" && chosen.module >= 0) {
      const tool = does.tool();
      if (tool === "throw") does.throw(placeOf(surface, chosen.module), null);
      else if (tool !== "pan") does.paint(chosen.module, true);
    } else if (event.key === "+" || event.key === "-") {
      picture.zoom(event.key === "+" ? STEP : 1 / STEP);
    } else {
      return;
    }
    event.preventDefault();
    event.stopPropagation();
    does.changed();
  });
}
