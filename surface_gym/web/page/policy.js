/** Trained policies: the few matrices of a network, from an observation to orientations. */

/**
 * @typedef {object} Card of a policy
 * @property {number[][]} layers inputs, outputs, and where its weights begin [floats]; a layer's
 *   biases follow its weights (outputs, inputs)
 * @property {"tanh"|"relu"} activation between layers
 * @property {number} choices orientations, of the modules ahead of the parcel and of those behind it
 * @property {number} [side] place in the observation of the side that a mirrored start is asked for
 * @property {number[]} [mirror] choices, where that side is right
 */

export class Policy {
  /** @param {Card} card @param {ArrayBuffer} weights of all policies */
  constructor(card, weights) {
    this.card = card;
    this.weights = new Float32Array(weights);
  }

  /** Compute the outputs of the network. */
  scores(observation) {
    const { layers, activation } = this.card;
    let values = Float32Array.from(observation);
    layers.forEach(([inputs, outputs, place], layer) => {
      const next = new Float32Array(outputs);
      const biases = place + inputs * outputs;
      for (let k = 0; k < outputs; k++) {
        let sum = this.weights[biases + k];
        const row = place + inputs * k;
        for (let j = 0; j < inputs; j++) sum += this.weights[row + j] * values[j];
        if (layer < layers.length - 1)
          sum = activation === "tanh" ? Math.tanh(sum) : Math.max(0, sum);
        next[k] = sum;
      }
      values = next;
    });
    return values;
  }

  /** Choose orientations for the modules ahead of the parcel and behind it. */
  choose(observation) {
    const scores = this.scores(observation);
    const best = scores.indexOf(Math.max(...scores));
    const { choices, side, mirror } = this.card;
    const halves = [Math.floor(best / choices), best % choices];
    return side !== undefined && observation[side] < 0
      ? halves.map((choice) => mirror[choice])
      : halves;
  }

  /** Write what is chosen for each module. @param {import("./task.js").TaskRun} run */
  act(run) {
    const { machine, about, columns } = run;
    const [ahead, behind] = this.choose(machine.view("parcels.observation"));
    const x = machine.view("parcels.sensed")[0];
    for (const module of run.modules()) {
      const isBehind = about.origin[0] + about.pitch[0] * (module % columns) < x;
      run.wanted[run.partOf(module)] = isBehind ? behind : ahead;
    }
  }
}
