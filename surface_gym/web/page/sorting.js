/**
 * A trained policy of Sort's modules: each that bears the parcel decides by its place under it, as
 * in `agents/module_policy.py`. The asked side lies at y > 0, in a mirror if need be.
 */

import { cos, hypot, sin } from "./machine.js";
import { perceptron } from "./policy.js";

/**
 * @typedef {object} Card of a policy of Sort's modules
 * @property {"modules"} kind
 * @property {import("./policy.js").Layer[]} layers from what all modules share, and then a place
 * @property {number[]} shared features of the observation, by their columns
 * @property {string[]} features names of the observation's numbers
 * @property {number[]} mirror choices, where the asked side is y < 0
 * @property {number} rest choice of modules that bear nothing
 * @property {number[]} pitch [m]
 * @property {number[]} zone rows and columns
 * @property {number} least rows that a line has
 * @property {number} period [s]
 * @property {number} exact [m] lengths that differ by less are equal
 * @property {number} round pitches that a disc, turned, may look narrower than a square
 * @property {number} margin [m] a module this near to the base may bear it
 *
 * @typedef {object} Seen parcel, as its observation shows it
 * @property {number} ahead x of its centre past the zone's first edge [m]
 * @property {number} offset y of its centre from the line's middle [m]
 * @property {number} theta [rad]
 * @property {number[]} velocity [m/s], [m/s], [rad/s]
 * @property {number[]} half length and width of its base, halved [m]
 * @property {number} rows of its line
 */

/** Let an observation be read by the names of its features; one that is absent reads 0. */
function reader({ features }, observation) {
  return (name) => {
    const column = features.indexOf(name);
    return column < 0 ? 0 : observation[column];
  };
}

export class SortingPolicy {
  /** @param {Card} card @param {Float32Array} weights of all policies */
  constructor(card, weights) {
    this.card = card;
    this.weights = weights;
  }

  /** Write what each module chooses. @param {import("./task.js").TaskRun} run */
  act(run) {
    const { layers, shared, mirror, rest } = this.card;
    const observation = run.machine.view("parcels.observation");
    const isMirrored = reader(this.card, observation)("side") < 0;
    const alike = shared.map((column) => observation[column]);
    run.wanted.fill(rest);
    for (const [part, place] of this.places(this.see(observation), isMirrored)) {
      const inputs = Float32Array.of(...alike, ...place);
      const scores = perceptron(this.weights, layers, inputs, Math.tanh);
      const choice = scores.indexOf(Math.max(...scores));
      run.wanted[part] = isMirrored ? mirror[choice] : choice;
    }
  }

  /** Decode an observation, which lacks the base's width: a wider one has a wider line. */
  see(observation) {
    const { pitch, zone, least, exact, round } = this.card;
    const of = reader(this.card, observation);
    const offset = 0.3 * of("lateral offset");
    const theta = Math.atan2(of("sine of theta"), of("cosine of theta"));
    const length = 0.175 + 0.05 * of("size");
    const cosine = Math.abs(cos(theta));
    const sine = Math.abs(sin(theta));
    const total = offset - 0.2 * of("clearance"); // half the line and the base's half extent
    const across = total - length * sine;
    const pairs = (across / pitch[1] + 1.5 - round) / (1 + cosine);
    const rows = Math.min(zone[0], Math.max(least, 2 * Math.floor(pairs)));
    const line = 0.5 * pitch[1] * (rows - 1);
    const extent = across - line;
    const isAsWide = Math.abs(extent - length * cosine) < exact;
    const isDisc = Math.abs(total - line - length) < exact;
    const wide = cosine > 0 ? extent / cosine : length;
    const width = isAsWide || isDisc ? length : Math.min(2 * length, Math.max(0.5 * length, wide));
    const square = length * (cosine + sine);
    const reach = square + (width - length) * sine;
    return {
      ahead: 0.5 * of("distance into zone") + square + (reach - square),
      offset,
      theta,
      velocity: [1 + of("forward speed"), 0.5 * of("lateral speed"), 3 * of("turning speed")],
      half: [length, width],
      rows,
    };
  }

  /**
   * Find the modules that bear the parcel, now or a period later.
   * @param {Seen} seen
   * @returns {[number, number[]][]} their parts of a command, and what each sees of its place
   */
  places({ ahead, offset, theta, velocity, half, rows }, isMirrored) {
    const { pitch, zone, period, margin } = this.card;
    const [vx, vy, omega] = velocity;
    const moved = period * (Math.abs(vx) + Math.abs(vy));
    const close = hypot(...half) + moved + 2 * margin;
    const found = [];
    for (let row = 0; row < zone[0]; row++) {
      const way = pitch[1] * (row - (zone[0] - 1) / 2);
      const line = isMirrored ? -way : way;
      const y = line - offset;
      if (Math.abs(line) >= 0.5 * pitch[1] * rows || Math.abs(y) >= close) continue;
      for (let column = 0; column < zone[1]; column++) {
        const x = pitch[0] * (column + 0.5) - ahead;
        if (Math.abs(x) >= close) continue;
        const now = turned(x, y, theta);
        const later = turned(x - period * vx, y - period * vy, theta + period * omega);
        const [near, nearLater] = [now, later].map((place) => distance(place, half));
        if (Math.min(near, nearLater) > margin) continue;
        found.push([
          row * zone[1] + column,
          [
            ...[...now, ...later].map((value, k) => value / half[k % 2]),
            near <= 0 ? 1 : 0,
            nearLater <= 0 ? 1 : 0,
            x / 0.3,
            y / 0.3,
            (y + offset) / 0.15,
          ],
        ]);
      }
    }
    return found;
  }
}

/** Rotate x and y to along and across a parcel that is turned. */
function turned(x, y, theta) {
  const [cosine, sine] = [cos(theta), sin(theta)];
  return [cosine * x + sine * y, cosine * y - sine * x];
}

/** How far a place in the base's frame is from the base [m]; negative under it. */
function distance(place, half) {
  return Math.max(...place.map((value, k) => Math.abs(value) - half[k]));
}
