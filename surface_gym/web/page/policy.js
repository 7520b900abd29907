/** Trained policies: the few matrices of a network, from an observation to orientations. */

/**
 * @typedef {number[]} Layer inputs, outputs, and where its weights (outputs, inputs) begin
 *   [floats]; its biases follow them
 *
 * @typedef {object} Card of a policy
 * @property {Layer[]} layers
 * @property {"tanh"|"relu"} activation between layers
 * @property {number[]} [columns] of the page's observation that it sees; by default the first
 * @property {number[][]} options orientations that a group of outputs chooses from, of some parts
 * @property {number[]} [parts] the mirror image of each part
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

  /** Choose an orientation for each part: halves, or quadrants, ahead first, then left first. */
  choose(observation) {
    const { layers, activation, columns, options, parts, side, mirror } = this.card;
    const between = activation === "tanh" ? Math.tanh : relu;
    const seen = columns ? columns.map((column) => observation[column]) : observation;
    const scores = perceptron(this.weights, layers, seen, between);
    const found = [];
    for (let first = 0; first < scores.length; first += options.length) {
      const group = scores.subarray(first, first + options.length);
      found.push(...options[group.indexOf(Math.max(...group))]);
    }
    return side !== undefined && observation[side] < 0
      ? parts.map((part) => mirror[found[part]])
      : found;
  }

  /** Write what is chosen for each module. @param {import("./task.js").TaskRun} run */
  act(run) {
    const choices = this.choose(run.machine.view("parcels.observation"));
    const sensed = run.machine.view("parcels.sensed");
    const axes = choices.length > 2 ? [0, 1] : [0];
    for (const module of run.modules()) {
      const place = run.placeOf(module);
      const part = axes.reduce((sum, axis) => 2 * sum + (place[axis] < sensed[axis] ? 1 : 0), 0);
      run.wanted[run.partOf(module)] = choices[part];
    }
  }
}
