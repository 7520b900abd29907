/** Trained policies: the matrices of a network, from what is observed to orientations. */

import { Agent, CompiledRule, SlopeRule } from "./rule.js";
import { placeOf } from "./view.js";

/**
 * @typedef {number[]} Layer inputs, outputs, and where its weights (outputs, inputs) begin
 *   [floats]; its biases follow them
 *
 * @typedef {object} Card of a policy of one parcel, which acts by halves or quadrants
 * @property {Layer[]} layers
 * @property {"tanh"|"relu"} activation between layers
 * @property {number[]} [columns] of the page's observation that it sees; by default the first
 * @property {number[][]} options orientations that a group of outputs chooses from, of some parts
 * @property {number[]} [parts] the mirror image of each part
 * @property {number} [side] place in the observation of the side that a mirrored start is asked for
 * @property {number[]} [mirror] choices, where that side is right
 */

const relu = (value) => Math.max(0, value);

/** Compute the outputs of a layer, each with an activation. */
function linear(weights, [inputs, outputs, place], values, activation = (value) => value) {
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
function perceptron(weights, layers, values, activation = relu) {
  return layers.reduce(
    (found, layer, k) =>
      linear(weights, layer, found, k < layers.length - 1 ? activation : undefined),
    values,
  );
}

/** Turn logits into probabilities. */
function softmax(logits) {
  const most = Math.max(...logits);
  const found = Float64Array.from(logits, (logit) => Math.exp(logit - most));
  const sum = found.reduce((a, b) => a + b, 0);
  return found.map((value) => value / sum);
}

export class Policy extends Agent {
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
      const place = placeOf(run.about, module);
      const part = axes.reduce((sum, axis) => 2 * sum + (place[axis] < sensed[axis] ? 1 : 0), 0);
      run.wanted[run.partOf(module)] = choices[part];
    }
  }
}

/**
 * @typedef {object} EachCard numbers are columns of a parcel's row in the table
 * @property {number} present
 * @property {number} waits
 * @property {number} side of its exit; where it is 0, a parcel rolls
 * @property {number} own features that the policy sees, from the first on
 * @property {number} roll choice of 90 deg
 */

/** A policy of single parcels that acts for each parcel of a stream, which its modules obey. */
export class EachParcel extends Agent {
  /** Write what is chosen for each module that obeys a parcel. */
  act(run) {
    const { present, waits, side, own, roll } = this.card;
    const [rows] = run.machine.shape("parcels.observation");
    const halves = new Array(2 * rows).fill(roll);
    for (let k = 0; k < rows; k++) {
      const row = run.machine.row("parcels.observation", k);
      if (row[present] > 0.5 && row[waits] < 0.5 && row[side])
        halves.splice(2 * k, 2, ...this.policy.choose(row.subarray(0, own)));
    }
    this.obeying.act(run, halves);
  }
}

/**
 * @typedef {object} SortingCard of a policy of Sort's modules
 * @property {Layer[]} layers from what all modules share, and then a place
 * @property {number[]} shared features of the observation, by their columns
 * @property {number[]} mirror choices, where the asked side is y < 0
 * @property {number} rest choice of modules that bear nothing
 * @property {number} side column of the observation
 */

/**
 * A trained policy of Sort's modules: each that bears the parcel decides by its place under it, as
 * in `agents/module_policy.py`. The asked side lies at y > 0, in a mirror if need be.
 */
export class SortingPolicy extends CompiledRule {
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

/**
 * @typedef {object} ParcelsCard of a policy of parcels, which corrects a rule
 * @property {Layer[]} encoder
 * @property {Layer} attend query, key and value
 * @property {Layer} pair how much two attend to each other by how they lie
 * @property {Layer[]} actor
 * @property {number} heads of attention
 * @property {number} prior logit of what the rule proposes
 * @property {number} most of a feature, one way or the other
 * @property {number[]} apart of two parcels, that differ at most
 * Columns of the table: present, time, end, offset and forward
 */

/** A trained policy of parcels, as `agents/slope_policy.py` follows its probabilities over time. */
export class ParcelPolicy extends SlopeRule {
  get orientations() {
    return this.card.choices.length;
  }

  /** How many choices there are for both halves together. */
  get options() {
    return this.orientations ** 2;
  }

  begin(run) {
    super.begin(run);
    const [, rows] = this.machine.shape("tables");
    this.due = new Float64Array(rows * this.options); // probabilities, less what was chosen
    this.since = new Float32Array(rows); // times since each entered, as seen last
  }

  choose(run) {
    const { present, time } = this.card;
    const { options, orientations, due, since } = this;
    const rule = super.choose(run);
    const [, rows] = this.machine.shape("tables");
    const here = [];
    for (let row = 0; row < rows; row++) {
      const own = this.machine.row("tables", row);
      const stays = own[time] > since[row] && own[present] > 0.5;
      if (!stays) due.fill(0, options * row, options * (row + 1));
      since[row] = own[time];
      const proposed = rule[2 * row] * orientations + rule[2 * row + 1];
      if (own[present] > 0.5) here.push({ row, own, proposed });
    }
    const halves = new Array(2 * rows).fill(0);
    const logits = this.logits(here);
    here.forEach(({ row }, k) => {
      const owed = due.subarray(options * row, options * (row + 1));
      const shares = softmax(logits[k]);
      for (let n = 0; n < options; n++) owed[n] += shares[n];
      const best = owed.indexOf(Math.max(...owed));
      owed[best] -= 1;
      halves[2 * row] = Math.floor(best / orientations);
      halves[2 * row + 1] = best % orientations;
    });
    return halves;
  }

  /** Compute the logits of parcels by their rows and what the rule proposes for them. */
  logits(parcels) {
    const { encoder, actor, attend, most, prior, end, offset, forward } = this.card;
    const seen = parcels.map(({ own, proposed }) => {
      const rule = new Float32Array(this.options);
      rule[proposed] = 1;
      const row = own.map((value) => Math.min(most, Math.max(-most, value)));
      const units = perceptron(this.weights, encoder, [...row, ...rule]).map(relu);
      const where = Float32Array.of(-row[end], 0.5 * row[offset], row[forward]);
      return { rule, units, where, asked: linear(this.weights, attend, units) };
    });
    return seen.map((one) => {
      const both = [...one.units, ...this.lookAround(one, seen)];
      const found = perceptron(this.weights, actor, both);
      return found.map((logit, k) => logit + prior * one.rule[k]);
    });
  }

  /** Gather what a parcel attends to of all that are there, itself too. */
  lookAround(one, seen) {
    const { pair, heads, apart } = this.card;
    const size = one.units.length;
    const bias = seen.map(({ where }) => {
      const lies = where.map((value, k) =>
        Math.min(apart[k], Math.max(-apart[k], value - one.where[k])),
      );
      return linear(this.weights, pair, [...lies, lies[0] ** 2, lies[1] ** 2]);
    });
    const found = new Float32Array(size);
    const units = size / heads;
    for (let head = 0; head < heads; head++) {
      const first = units * head;
      const scores = seen.map(({ asked }, j) => {
        let sum = 0;
        for (let k = first; k < first + units; k++) sum += one.asked[k] * asked[size + k];
        return sum / Math.sqrt(units) + bias[j][head];
      });
      const shares = softmax(scores);
      for (let k = first; k < first + units; k++)
        found[k] = seen.reduce((sum, { asked }, j) => sum + shares[j] * asked[2 * size + k], 0);
    }
    return found;
  }
}

/**
 * @typedef {object} ModulesCard of a policy of modules, as in `agents/slope_policy.py`
 * @property {Layer[]} actor
 * @property {number[]} numbers where those that modules look up begin among the weights, and how many
 * @property {number} hold control periods for which the number of a parcel's modules stays
 * @property {number} apart of two rows, that look numbers up
 * @property {number} most of a feature, one way or the other
 * @property {number} period [s]
 * @property {number} rest choice of modules without a parcel
 * @property {number} time column of the table
 */

/** A trained policy of modules on a slope, each of which decides by what it sees. */
export class ModulesPolicy extends Agent {
  /** Write what each module chooses. */
  act(run) {
    const { machine } = this;
    machine.view("tables").set(run.machine.view("parcels.observation"));
    machine.step();
    const { most } = this.card;
    const numbers = this.numbers();
    run.wanted.fill(this.card.rest);
    machine.view("owner").forEach((parcel, module) => {
      const row = Number(parcel);
      if (row < 0) return;
      const seen = [...machine.row("passed", row), ...machine.row("own", module)].map((value) =>
        Math.min(most, Math.max(-most, value)),
      );
      const shares = softmax(perceptron(this.weights, this.card.actor, seen));
      run.want(module, choose(shares, numbers[row]), false);
    });
  }

  /** Look up, by row, the number that the modules below a parcel agree on; in single precision. */
  numbers() {
    const { numbers, hold, apart, period, time } = this.card;
    const { fround } = Math;
    const [, rows] = this.machine.shape("tables");
    return Array.from({ length: rows }, (_, row) => {
      const entered = this.machine.row("tables", row)[time];
      const since = fround(fround(4 * entered) / fround(period));
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
