/**
 * A trained policy of Sort's modules: each that bears the parcel decides by its place under it, as
 * in `agents/module_policy.py`. The asked side lies at y > 0, in a mirror if need be.
 */

import { perceptron } from "./policy.js";
import { CompiledRule } from "./rule.js";

/**
 * @typedef {object} Card of a policy of Sort's modules
 * @property {import("./policy.js").Layer[]} layers from what all modules share, and then a place
 * @property {number[]} shared features of the observation, by their columns
 * @property {number[]} mirror choices, where the asked side is y < 0
 * @property {number} rest choice of modules that bear nothing
 * @property {number} side column of the observation
 */

export class SortingPolicy extends CompiledRule {
  /**
   * @param {Card} card
   * @param {import("./machine.js").Machine} machine of the function that finds modules' places
   * @param {Float32Array} weights of all policies
   */
  constructor(card, machine, weights) {
    super(card, machine);
    this.weights = weights;
  }

  /** Write what each module chooses. @param {import("./task.js").TaskRun} run */
  act(run) {
    const { layers, shared, mirror, rest, side } = this.card;
    const observation = run.machine.view("parcels.observation");
    const alike = shared.map((column) => observation[column]);
    const [places, count] = this.call(run, "observations", "place");
    const index = this.machine.view("index");
    const [, size] = this.machine.shape("place");
    run.wanted.fill(rest);
    for (let k = 0; k < count; k++) {
      const inputs = Float32Array.of(...alike, ...places.slice(size * k, size * (k + 1)));
      const scores = perceptron(this.weights, layers, inputs, Math.tanh);
      const choice = scores.indexOf(Math.max(...scores));
      run.wanted[Number(index[k])] = observation[side] < 0 ? mirror[choice] : choice;
    }
  }
}
