/** Agents of Flow that decide for each parcel: every module obeys the parcel that it bears. */

import { Policy } from "./policy.js";

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
  /**
   * @param {Card} card
   * @param {Float32Array} weights of all policies
   * @param {import("./obeying.js").Obeying} obeying
   */
  constructor(card, weights, obeying) {
    this.card = card;
    this.policy = card.policy && new Policy(card.policy, weights);
    this.obeying = obeying;
  }

  /** Choose for the modules ahead of a parcel's centre, and behind it, by its row. */
  choose(row) {
    const { axes, present, waits, past, side, own } = this.card;
    const rolls = [axes.roll, axes.roll];
    if (row[present] <= 0.5 || row[waits] >= 0.5) return rolls;
    if (this.policy) return row[side] ? this.policy.choose(row.subarray(0, own)) : rolls;
    if (row[past] <= 0 || !row[side]) return rolls;
    return row[side] > 0 ? [axes.left, axes.left] : [axes.right, axes.right];
  }

  /** Write what is chosen for each module that obeys a parcel. */
  act(run) {
    const [rows, features] = run.machine.shape("parcels.observation");
    const table = run.machine.view("parcels.observation");
    const halves = [];
    for (let row = 0; row < rows; row++)
      halves.push(...this.choose(table.subarray(features * row, features * (row + 1))));
    this.obeying.act(run, halves);
  }
}
