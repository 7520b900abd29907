/** Agents of a stream that decide for each parcel: every module obeys the parcel that it bears. */

import { cos, sin } from "./exact.js";
import { Policy } from "./policy.js";

const NEARER = 1e-6; // [s/m^2] of two that a module bears at once, the one with the nearer centre wins

/**
 * @typedef {object} Card of a rule for each parcel; numbers are columns of its row in the table
 * @property {number} present
 * @property {number} waits
 * @property {number} past of how far its rear is past its exit's start
 * @property {number} side of its exit
 * @property {number} own features that the policy sees, from the first on
 * @property {{roll: number, left: number, right: number}} axes
 * @property {import("./policy.js").Card|null} policy that chooses; null: 45 deg past the exit's start
 */

export class ParcelAgent {
  /** @param {Card} card @param {ArrayBuffer} weights of all policies */
  constructor(card, weights) {
    this.card = card;
    this.policy = card.policy && new Policy(card.policy, weights);
  }

  /** Choose for the modules ahead of a parcel's centre, and behind it, by its row. */
  choose(row) {
    const { axes, past, side, own } = this.card;
    if (this.policy)
      return row[side] ? this.policy.choose(row.subarray(0, own)) : [axes.roll, axes.roll];
    const choice =
      row[past] > 0 && row[side] ? (row[side] > 0 ? axes.left : axes.right) : axes.roll;
    return [choice, choice];
  }

  /** Write what is chosen for each module that a parcel has claimed. */
  act(run) {
    const { machine, about } = run;
    const [, features] = machine.shape("parcels.observation");
    const table = machine.view("parcels.observation");
    const sensed = machine.view("parcels.sensed");
    const choices = new Map();
    for (const [module, row] of claim(run)) {
      const own = table.subarray(features * row, features * (row + 1));
      if (!choices.has(row)) {
        const isThere = own[this.card.present] > 0.5 && own[this.card.waits] < 0.5;
        choices.set(row, isThere ? this.choose(own) : [this.card.axes.roll, this.card.axes.roll]);
      }
      const x = about.origin[0] + about.pitch[0] * (module % run.columns);
      run.want(run.partOf(module), choices.get(row)[x < sensed[6 * row] ? 1 : 0], false);
    }
  }
}

/** Let parcels claim modules, as `claim_modules` of `surface_gym/flow/kernel.py`: rows by module. */
export function claim(run) {
  const { machine, about, columns } = run;
  const [x0, y0] = about.origin;
  const [pitchX, pitchY] = about.pitch;
  const ahead = machine.get("stream_params.ahead");
  const sensed = machine.view("parcels.sensed");
  const owner = new Map();
  const soonest = new Map();
  machine.view("streams.present").forEach((there, row) => {
    if (!there) return;
    const [x, y, theta, vx, vy] = sensed.subarray(6 * row, 6 * row + 6);
    const reach = (nx, ny) => reachAlong(machine, row, theta, nx, ny);
    const [front, rear, left, right] = [
      x + reach(1, 0),
      x - reach(-1, 0),
      y + reach(0, 1),
      y - reach(0, -1),
    ];
    const lowX = (rear + Math.min(0, vx * ahead) - x0) / pitchX;
    const highX = (front + Math.max(0, vx * ahead) - x0) / pitchX;
    const lowY = (right + Math.min(0, vy * ahead) - y0) / pitchY;
    const highY = (left + Math.max(0, vy * ahead) - y0) / pitchY;
    for (
      let r = Math.max(0, Math.ceil(lowY));
      r <= Math.min(run.rows - 1, Math.floor(highY));
      r++
    ) {
      const placeY = y0 + pitchY * r;
      for (
        let c = Math.max(0, Math.ceil(lowX));
        c <= Math.min(columns - 1, Math.floor(highX));
        c++
      ) {
        const placeX = x0 + pitchX * c;
        let when = Math.max(until(placeY, right, left, vy), until(placeX, rear, front, vx));
        if (when > Math.min(ahead, after(placeY, right, left, vy), after(placeX, rear, front, vx)))
          continue;
        when += NEARER * ((placeX - x) ** 2 + (placeY - y) ** 2);
        const module = r * columns + c;
        if (!run.obeys[module] || !(when < (soonest.get(module) ?? Infinity))) continue;
        soonest.set(module, when);
        owner.set(module, row);
      }
    }
  });
  return owner;
}

/** How far [m] a base, turned by theta, reaches from its centroid along (nx, ny). */
function reachAlong(machine, row, theta, nx, ny) {
  const body = Number(machine.view("parcels.body")[row]);
  const [, sides] = machine.shape("bodies.corners");
  const corners = machine.view("bodies.corners").subarray(2 * sides * body, 2 * sides * (body + 1));
  const [cosine, sine] = [cos(theta), sin(theta)];
  const [alongX, alongY] = [cosine * nx + sine * ny, cosine * ny - sine * nx];
  let farthest = -1;
  for (let k = 0; k < sides; k++)
    farthest = Math.max(farthest, corners[2 * k] * alongX + corners[2 * k + 1] * alongY);
  return farthest > 0 ? farthest : machine.view("bodies.body")[7 * body];
}

/** [s] until an interval that moves at a speed holds a point; infinite if never. */
function until(point, low, high, speed) {
  if (point > high) return speed > 0 ? (point - high) / speed : Infinity;
  if (point < low) return speed < 0 ? (low - point) / -speed : Infinity;
  return 0;
}

/** [s] until an interval that moves at a speed has passed a point; infinite if never. */
function after(point, low, high, speed) {
  if (speed > 0) return (point - low) / speed;
  return speed < 0 ? (high - point) / -speed : Infinity;
}
