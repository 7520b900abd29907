/** Trained policies: the few matrices of a network, from an observation to orientations. */

/**
 * @typedef {number[]} Layer inputs, outputs, and where its weights (outputs, inputs) begin
 *   [floats]; its biases follow them
 *
 * @typedef {object} Card of a policy
 * @property {Layer[]} layers
 * @property {"tanh"|"relu"} activation between layers
 * @property {number} choices orientations, of the modules ahead of the parcel and of those behind it
 * @property {number} [side] place in the observation of the side that a mirrored start is asked for
 * @property {number[]} [mirror] choices, where that side is right
 */

export const relu = (value) => Math.max(0, value);

/** Compute the outputs of a layer, each with an activation. */
export function linear(weights, [inputs, outputs, place], values, activation = (value) => value) {
  const found = new Float32Array(outputs);
  const biases = place + inputs * outputs;
  for (let k = 0; k < outputs; k++) {
    let sum = weights[biases + k];
    const row = place + inputs * k;
    for (let j = 0; j < inputs; j++) sum += weights[row + j] * values[j];
    found[k] = activation(sum);
  }
  return found;
}

/** Compute the outputs of layers with an activation between them. */
export function perceptron(weights, layers, values, activation = relu) {
  return layers.reduce(
    (found, layer, k) =>
      linear(weights, layer, found, k < layers.length - 1 ? activation : undefined),
    values,
  );
}

export class Policy {
  /** @param {Card} card @param {Float32Array} weights of all policies */
  constructor(card, weights) {
    this.card = card;
    this.weights = weights;
  }

  /** Choose orientations for the modules ahead of the parcel and behind it. */
  choose(observation) {
    const { layers, activation, choices, side, mirror } = this.card;
    const between = activation === "tanh" ? Math.tanh : relu;
    const scores = perceptron(this.weights, layers, observation, between);
    const best = scores.indexOf(Math.max(...scores));
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
