/** A trained policy of modules on a slope, each of which decides by what it sees. */

import { perceptron } from "./policy.js";
import { softmax } from "./slopes.js";

/**
 * @typedef {object} Card of a policy of modules, as in `agents/slope_policy.py`
 * @property {import("./policy.js").Layer[]} actor
 * @property {number[]} numbers where those that modules look up begin among the weights, and how many
 * @property {number} hold control periods for which the number of a parcel's modules stays
 * @property {number} apart of two rows, that look numbers up
 * @property {number} most of a feature, one way or the other
 * @property {number} period [s]
 * @property {number} rest choice of modules without a parcel
 * @property {number} time column of the table
 */

export class ModulesPolicy {
  /**
   * @param {Card} card
   * @param {import("./machine.js").Machine} machine of the function that computes what modules see
   * @param {Float32Array} weights
   */
  constructor(card, machine, weights) {
    this.card = card;
    this.machine = machine;
    this.weights = weights;
  }

  /** Write what each module chooses. */
  act(run) {
    const { machine } = this;
    machine.view("tables").set(run.machine.view("parcels.observation"));
    machine.step();
    const [owner, own, passed] = ["owner", "own", "passed"].map((name) => machine.view(name));
    const [, , ownSize] = machine.shape("own");
    const [, , passedSize] = machine.shape("passed");
    const { most } = this.card;
    const seen = new Float32Array(passedSize + ownSize);
    const numbers = this.numbers();
    run.wanted.fill(this.card.rest);
    owner.forEach((parcel, module) => {
      const row = Number(parcel);
      if (row < 0) return;
      seen.set(passed.subarray(passedSize * row, passedSize * (row + 1)));
      seen.set(own.subarray(ownSize * module, ownSize * (module + 1)), passedSize);
      for (let k = 0; k < seen.length; k++) seen[k] = Math.min(most, Math.max(-most, seen[k]));
      const shares = softmax(perceptron(this.weights, this.card.actor, seen));
      run.want(module, choose(shares, numbers[row]), false);
    });
  }

  /** Look up, by row, the number that the modules below a parcel agree on; in single precision. */
  numbers() {
    const { numbers, hold, apart, period, time } = this.card;
    const { fround } = Math;
    const [, rows, features] = this.machine.shape("tables");
    const tables = this.machine.view("tables");
    return Array.from({ length: rows }, (_, row) => {
      const since = fround(fround(4 * tables[features * row + time]) / fround(period));
      const held = fround(fround(since / hold) + fround(1e-3));
      return this.weights[numbers[0] + ((Math.trunc(held) + apart * row) % numbers[1])];
    });
  }
}

/** Choose among shares by a number in [0, 1). */
function choose(shares, number) {
  let edge = 0;
  let choice = 0;
  for (const share of shares.subarray(0, -1)) {
    edge += share;
    if (number > edge) choice += 1;
  }
  return choice;
}
