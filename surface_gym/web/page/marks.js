/** Marks on pictures: how modules look, arrows of forces, and where and how text is written. */

import { axisColour, mixed, textOn } from "./palette.js";

const ANGLES = 180; // pictures of a module in half a turn
const DRIVE_HEADINGS = 48; // pictures of a driven module's arrow
const DRIVE_LENGTHS = 4; // lengths of it, the longest from FASTEST_DRIVE on
const FASTEST_DRIVE = 2; // [m/s]
const PALE = 0.62; // share of the plate's colour in a module that does not obey
const HEAD = 0.3; // of an arrow's length
const FONT = "system-ui, sans-serif";
const HIGH = 1.3; // [letters' size] a badge
const GAP = 0.25; // [letters' size] between a badge and what it lies beside

/** Fill the path of a context. */
export function fillPath(context, colour) {
  context.fillStyle = colour;
  context.fill();
}

/** Draw a line along the path of a context. */
export function strokePath(context, colour, width) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke();
}

/** Return which picture shows a module's axis [rad], or the velocity of its driven surface. */
export function moduleStep(angle, drive) {
  return (drive && driveStep(drive)) ?? axisStep(angle);
}

function axisStep(angle) {
  return ((Math.round((angle * ANGLES) / Math.PI) % ANGLES) + ANGLES) % ANGLES;
}

/** Return which picture shows a driven module's velocity [m/s]; null: it is idle. */
function driveStep([vx, vy]) {
  if (Number.isNaN(vx)) return null;
  const level = Math.min(
    DRIVE_LENGTHS,
    Math.ceil((DRIVE_LENGTHS * Math.hypot(vx, vy)) / FASTEST_DRIVE - 1e-9),
  );
  if (level === 0) return ANGLES;
  const heading = Math.round((Math.atan2(vy, vx) * DRIVE_HEADINGS) / (2 * Math.PI));
  return ANGLES + level * DRIVE_HEADINGS + ((heading + DRIVE_HEADINGS) % DRIVE_HEADINGS);
}

/** Paint the picture of a step: a disc with a bar along the axis, or with a drive's arrow. */
export function paintModule(step, cell, { plate, bar, driven }, isPale) {
  const picture = document.createElement("canvas");
  picture.width = picture.height = cell;
  const context = picture.getContext("2d");
  const half = cell / 2;
  const angle = (Math.PI * step) / ANGLES;
  const isDriven = step >= ANGLES;
  const paled = (colour) => (isPale ? mixed(colour, plate, PALE) : colour);
  context.translate(half, half);
  context.beginPath();
  context.arc(0, 0, 0.86 * half, 0, 2 * Math.PI);
  fillPath(context, paled(isDriven ? driven : axisColour(angle)));
  context.beginPath();
  if (isDriven) traceDrive(context, step - ANGLES, half);
  else {
    const [x, y] = [0.6 * half * Math.cos(angle), -0.6 * half * Math.sin(angle)];
    context.moveTo(-x, -y);
    context.lineTo(x, y);
  }
  strokePath(context, paled(bar), Math.max((isDriven ? 0.2 : 0.26) * half, 1));
  return picture;
}

/** Trace the arrow of a picture of `driveStep`, round the origin; a ring where the surface stands. */
function traceDrive(context, step, half) {
  const level = Math.floor(step / DRIVE_HEADINGS);
  if (level === 0) {
    context.arc(0, 0, 0.3 * half, 0, 2 * Math.PI);
    return;
  }
  const angle = (2 * Math.PI * (step % DRIVE_HEADINGS)) / DRIVE_HEADINGS;
  const tip = 0.65 * half * (0.4 + (0.6 * level) / DRIVE_LENGTHS);
  const [x, y] = [Math.cos(angle), -Math.sin(angle)];
  context.moveTo(-tip * x, -tip * y);
  context.lineTo(tip * x, tip * y);
  for (const side of [-1, 1]) {
    context.moveTo(tip * x, tip * y);
    context.lineTo(tip * x - 0.4 * half * (x - side * y), tip * y - 0.4 * half * (y + side * x));
  }
}

/**
 * Trace arrows as one path.
 * @param {CanvasRenderingContext2D} context
 * @param {number[][]} forces x, y [m] where each acts, and fx, fy [N]
 * @param {(x: number, y: number) => number[]} place converts x, y [m] to pixels
 * @param {{scale: number, longest: number, least: number, head: number}} size [m/N]; [m] of an
 *   arrow at most, and at least to be one; and [m] of its head at most
 */
export function traceArrows(context, forces, place, { scale, longest, least, head }) {
  context.beginPath();
  for (const [x, y, fx, fy] of forces) {
    const force = Math.hypot(fx, fy);
    const length = Math.min(scale * force, longest);
    if (length < least || length === 0) continue;
    const [alongX, alongY] = [fx / force, fy / force];
    const [tipX, tipY] = [x + length * alongX, y + length * alongY];
    const size = Math.min(HEAD * length, head);
    const [hx, hy] = [size * alongX, size * alongY];
    const tip = place(tipX, tipY);
    context.moveTo(...place(x, y));
    context.lineTo(...tip);
    context.moveTo(...place(tipX - hx - 0.6 * hy, tipY - hy + 0.6 * hx));
    context.lineTo(...tip);
    context.lineTo(...place(tipX - hx + 0.6 * hy, tipY - hy - 0.6 * hx));
  }
}

/** @typedef {number[]} Box [px] left, top, right, bottom */

export function setFont(context, size) {
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
  context.beginPath();
  context.roundRect(x - width / 2, y - height / 2, width, height, 0.3 * size);
  fillPath(context, colour);
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
