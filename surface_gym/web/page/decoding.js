/**
 * Observations of tasks of one parcel in SI units, as the tasks' own `decode` reads them, and where
 * modules lie about the parcel.
 */

import { cos, sin } from "./machine.js";

/**
 * @typedef {object} Seen of what a rule knows of its environment, in its card
 * @property {string[]} features names of the observation's numbers
 * @property {[number, number]} pitch [m] between modules
 * @property {number} zoneLength [m] along x of the widest zone
 * @property {number} rows of the action
 * @property {number} columns of the action
 */

/** Let an observation be read by the names of its features; one that is absent reads 0. */
export function reader({ features }, observation) {
  return (name) => {
    const column = features.indexOf(name);
    return column < 0 ? 0 : observation[column];
  };
}

function squareReach(halfLength, theta) {
  return halfLength * (Math.abs(cos(theta)) + Math.abs(sin(theta)));
}

/** Decode a parcel on a line. @param {Seen} card */
export function decodeLine(card, observation) {
  const seen = reader(card, observation);
  const side = seen("side");
  const mirror = side < 0 ? -1 : 1; // a parcel that is to go to y < 0 is shown in a mirror
  const theta = mirror * Math.atan2(seen("sine of theta"), seen("cosine of theta"));
  const halfLength = 0.175 + 0.05 * seen("size");
  const reach = squareReach(halfLength, theta);
  let intoZone, frontInZone, rearToGo;
  if (card.features.includes("distance into zone")) {
    intoZone = 0.5 * seen("distance into zone") + reach;
    frontInZone = intoZone + reach;
    rearToGo = card.zoneLength - intoZone + reach;
  } else {
    [frontInZone, rearToGo] = [0.5 * seen("front in zone"), 0.5 * seen("rear to go")];
    intoZone = frontInZone - reach;
  }
  return {
    intoZone,
    offset: mirror * 0.3 * seen("lateral offset"),
    theta,
    vx: 1 + seen("forward speed"),
    vy: mirror * 0.5 * seen("lateral speed"),
    omega: mirror * 3 * seen("turning speed"),
    halfLength,
    reach,
    side,
    ratio: seen("asked ratio"),
    entrySpeed: seen("asked ratio") > 0 ? 1.5 + seen("entry speed") : 0,
    toGo: 0.5 * seen("to go"),
    angle: seen("asked angle"),
    frontInZone,
    rearToGo,
    isWhollyInZone: intoZone - reach > -card.pitch[0] / 2,
  };
}

/** Decode a parcel beside its path. @param {Seen} card */
export function decodePath(card, observation) {
  const seen = reader(card, observation);
  const inPitch = (axis, pitch) =>
    (pitch * Math.atan2(seen(`sine of phase ${axis}`), seen(`cosine of phase ${axis}`))) /
    (2 * Math.PI);
  const slope = card.slopes.map(seen);
  const askedSpeed = 0.8 + seen("asked speed");
  const crossSpeed = 0.1 * seen("lateral speed");
  const along = askedSpeed + 0.2 * seen("speed error");
  const cosine = 1 / Math.sqrt(1 + slope[0] * slope[0]);
  const sine = slope[0] * cosine;
  return {
    crossError: 0.05 * seen("cross error"),
    crossSpeed,
    askedSpeed,
    slope,
    tilt: Math.asin(0.2 * seen("tilt")),
    theta: Math.atan2(seen("sine of theta"), seen("cosine of theta")),
    vx: along * cosine - crossSpeed * sine,
    vy: along * sine + crossSpeed * cosine,
    omega: 3 * seen("turning speed"),
    halfLength: 0.175 + 0.05 * seen("size"),
    xInPitch: inPitch("x", card.pitch[0]),
    yInPitch: inPitch("y", card.pitch[1]),
  };
}

/**
 * @typedef {object} Positions of an action's modules, seen from the parcel's centre
 * @property {Float64Array} x [m]
 * @property {Float64Array} y [m]
 * @property {boolean[]} under whether a module lies under the parcel, taken as a square
 */

/** @returns {Positions} */
function positions(columns, rows, { theta, halfLength }) {
  const size = columns.length * rows.length;
  const [x, y, under] = [new Float64Array(size), new Float64Array(size), new Array(size)];
  const [cosine, sine] = [cos(theta), sin(theta)];
  for (let part = 0; part < size; part++) {
    x[part] = columns[part % columns.length];
    y[part] = rows[Math.floor(part / columns.length)];
    const along = cosine * x[part] + sine * y[part];
    const across = cosine * y[part] - sine * x[part];
    under[part] = Math.max(Math.abs(along), Math.abs(across)) <= halfLength;
  }
  return { x, y, under };
}

/** Locate the zone's modules. @returns {Positions} */
export function linePositions({ rows, columns, pitch }, seen) {
  const column = (k) => pitch[0] * (k + 0.5) - seen.intoZone;
  const row = (k) => pitch[1] * (k - (rows - 1) / 2) - seen.offset;
  return positions(places(columns, column), places(rows, row), seen);
}

/** Locate the modules of the window around the parcel. @returns {Positions} */
export function windowPositions({ rows, columns, pitch, midway }, seen) {
  // Midway between two modules, the window's middle is the one ahead, or to the left.
  const past = (in_, each) => (in_ > each / 2 - midway ? in_ - each : in_);
  const [ahead, left] = [past(seen.xInPitch, pitch[0]), past(seen.yInPitch, pitch[1])];
  const column = (k) => pitch[0] * (k - Math.floor(columns / 2)) - ahead;
  const row = (k) => pitch[1] * (k - Math.floor(rows / 2)) - left;
  return positions(places(columns, column), places(rows, row), seen);
}

function places(count, place) {
  return Array.from({ length: count }, (_, k) => place(k));
}
