/** Text on pictures: how it is written, and where labels of exits lie. */

import { textOn } from "./palette.js";

const FONT = "system-ui, sans-serif";
const HIGH = 1.3; // [letters' size] a badge
const GAP = 0.25; // [letters' size] between a badge and what it lies beside

/** @typedef {number[]} Box [px] left, top, right, bottom */

function setFont(context, size) {
  context.font = `600 ${size}px ${FONT}`;
  context.textAlign = "center";
  context.textBaseline = "middle";
}

/**
 * Write text with a rim, in smaller letters where it has no room.
 * @param {{colour: string, rim: string, size: number, room: number}} look size and room [px]
 */
export function writeText(context, text, x, y, { colour, rim, size, room }) {
  setFont(context, size);
  const fitting = size * Math.min(1, (0.94 * room) / context.measureText(text).width);
  setFont(context, fitting);
  context.lineWidth = 0.25 * fitting;
  context.strokeStyle = rim;
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}

/** Compute the width and the height [px] of a badge. */
export function badgeSize(context, text, size) {
  setFont(context, size);
  return [context.measureText(text).width + 0.7 * size, HIGH * size];
}

/** Write text on a patch of its colour, about a place. */
export function writeBadge(context, text, [x, y], colour, size) {
  const [width, height] = badgeSize(context, text, size);
  context.fillStyle = colour;
  context.beginPath();
  context.roundRect(x - width / 2, y - height / 2, width, height, 0.3 * size);
  context.fill();
  context.fillStyle = textOn(colour);
  context.fillText(text, x, y + 0.05 * size);
}

/** Compute the box of a badge about a place. */
export function boxAbout([x, y], [width, height]) {
  return [x - width / 2, y - height / 2, x + width / 2, y + height / 2];
}

/** Return whether two boxes overlap. */
export function overlap(one, other) {
  return one[0] < other[2] && other[0] < one[2] && one[1] < other[3] && other[1] < one[3];
}

/**
 * Choose where an area's badge lies: in its middle, or above or below it where it would cover what
 * is to be seen; always within the canvas.
 * @param {Box} area
 * @param {number[]} extent width and height of the badge [px]
 * @param {number} size of its letters [px]
 * @param {number[]} canvas width and height [px]
 * @param {Box[]} seen what it is not to cover
 */
export function placeBadge(area, extent, size, canvas, seen) {
  const within = (value, half, most) =>
    Math.min(Math.max(value, half), Math.max(half, most - half));
  const beyond = extent[1] / 2 + GAP * size;
  const x = within((area[0] + area[2]) / 2, extent[0] / 2, canvas[0]);
  const places = [(area[1] + area[3]) / 2, area[1] - beyond, area[3] + beyond].map((y) => [
    x,
    within(y, extent[1] / 2, canvas[1]),
  ]);
  const isClear = (place) => !seen.some((each) => overlap(boxAbout(place, extent), each));
  return places.find(isClear) ?? places[0];
}
