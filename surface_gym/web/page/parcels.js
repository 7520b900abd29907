/** A policy of single parcels that acts for each parcel of a stream, which its modules obey. */

/**
 * @typedef {object} Card numbers are columns of a parcel's row in the table
 * @property {number} present
 * @property {number} waits
 * @property {number} side of its exit; where it is 0, a parcel rolls
 * @property {number} own features that the policy sees, from the first on
 * @property {number} roll choice of 90 deg
 */

export class EachParcel {
  /**
   * @param {Card} card
   * @param {import("./policy.js").Policy} policy
   * @param {import("./obeying.js").Obeying} obeying
   */
  constructor(card, policy, obeying) {
    this.card = card;
    this.policy = policy;
    this.obeying = obeying;
  }

  /** Write what is chosen for each module that obeys a parcel. */
  act(run) {
    const { present, waits, side, own, roll } = this.card;
    const [rows, features] = run.machine.shape("parcels.observation");
    const table = run.machine.view("parcels.observation");
    const halves = new Array(2 * rows).fill(roll);
    for (let k = 0; k < rows; k++) {
      const row = table.subarray(features * k, features * (k + 1));
      if (row[present] > 0.5 && row[waits] < 0.5 && row[side])
        halves.splice(2 * k, 2, ...this.policy.choose(row.subarray(0, own)));
    }
    this.obeying.act(run, halves);
  }
}
