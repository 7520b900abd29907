/**
 * Agents on a slope, which decide for each parcel: rules, whose compiled functions come from the
 * same source as on the CPU, and policies that correct a rule.
 */

import { linear, perceptron, relu } from "./policy.js";
import { CompiledRule } from "./rule.js";

/**
 * @typedef {import("./rule.js").Card & object} RuleCard
 * @property {number[]} choices that a half's action stands for: roll, brake, to the left, to the right
 */

export class SlopeRule extends CompiledRule {
  /**
   * @param {RuleCard} card
   * @param {import("./machine.js").Machine} machine of the rule, with its memory
   * @param {import("./obeying.js").Obeying} obeying
   */
  constructor(card, machine, obeying) {
    super(card, machine);
    this.obeying = obeying;
  }

  /** Choose for both halves of the parcel in each row, one after the other. */
  choose(run) {
    return this.call(run, "tables", "halves")[0].map((half) => this.card.choices[half]);
  }

  act(run) {
    this.chosen = this.choose(run);
    this.obeying.act(run, this.chosen);
  }
}

/**
 * @typedef {object} ParcelsCard of a policy of parcels; layers as in `policy.js`
 * @property {import("./policy.js").Layer[]} encoder
 * @property {import("./policy.js").Layer} attend query, key and value
 * @property {import("./policy.js").Layer} pair how much two attend to each other by how they lie
 * @property {import("./policy.js").Layer[]} actor
 * @property {number} heads of attention
 * @property {number} prior logit of what the rule proposes
 * @property {number} most of a feature, one way or the other
 * @property {number[]} apart of two parcels, that differ at most
 * @property {number} present column of the table, as are those below
 * @property {number} time
 * @property {number} end
 * @property {number} offset
 * @property {number} forward
 */

/** A trained policy of parcels, as `agents/slope_policy.py` follows its probabilities over time. */
export class ParcelPolicy extends SlopeRule {
  /** @param {RuleCard & ParcelsCard} card @param {Float32Array} weights */
  constructor(card, machine, obeying, weights) {
    super(card, machine, obeying);
    this.weights = weights;
    this.orientations = card.choices.length;
    this.options = this.orientations ** 2; // of both halves together
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
    const [, rows, features] = this.machine.shape("tables");
    const tables = this.machine.view("tables");
    const here = [];
    for (let row = 0; row < rows; row++) {
      const own = tables.subarray(features * row, features * (row + 1));
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

/** Turn logits into probabilities. */
export function softmax(logits) {
  const most = Math.max(...logits);
  const found = Float64Array.from(logits, (logit) => Math.exp(logit - most));
  const sum = found.reduce((a, b) => a + b, 0);
  return found.map((value) => value / sum);
}
