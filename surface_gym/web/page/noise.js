/** Noise of sensors, drawn as NumPy draws it: PCG64, and normal numbers by the ziggurat method. */

import { get } from "./machine.js";

const MASK = (1n << 128n) - 1n;
const WORD = (1n << 64n) - 1n;
const MULTIPLIER = 0x2360ed051fc65da44385df649fccf645n;
const UNIT = 2 ** -53;

/**
 * @typedef {object} Tables of the ziggurat method, for 256 layers
 * @property {number[]} within [2^-52 of a layer] surely under the curve
 * @property {number[]} width of a layer's unit
 * @property {number[]} height of the curve at a layer's edge
 * @property {number} edge at which the tail begins
 * @property {number} inverse of the edge
 */

/** NumPy's `Generator` over PCG64, from a state on. */
export class Generator {
  /** @param {Tables} tables @param {string[]} state and increment, in hexadecimal digits */
  constructor(tables, [state, increment]) {
    this.tables = tables;
    this.state = BigInt(`0x${state}`);
    this.increment = BigInt(`0x${increment}`);
  }

  /** Draw 64 random bits. */
  bits() {
    this.state = (this.state * MULTIPLIER + this.increment) & MASK;
    const mixed = ((this.state >> 64n) ^ this.state) & WORD;
    const turn = this.state >> 122n;
    return ((mixed >> turn) | (mixed << (64n - turn))) & WORD;
  }

  /** Draw a number from 0 to 1, without 1. */
  uniform() {
    return Number(this.bits() >> 11n) * UNIT;
  }

  /** Draw a number of the standard normal distribution. */
  normal() {
    const { within, width, height } = this.tables;
    for (;;) {
      const bits = this.bits();
      const layer = Number(bits & 0xffn);
      const far = Number((bits >> 9n) & 0xfffffffffffffn);
      const x = (bits & 0x100n ? -1 : 1) * far * width[layer];
      if (far < within[layer]) return x;
      if (layer === 0) return this._tail((bits >> 17n) & 1n);
      const fraction = (height[layer - 1] - height[layer]) * this.uniform() + height[layer];
      if (fraction < Math.exp(-0.5 * x * x)) return x;
    }
  }

  _tail(isNegative) {
    const { edge, inverse } = this.tables;
    for (;;) {
      const beyond = -inverse * Math.log1p(-this.uniform());
      const height = -Math.log1p(-this.uniform());
      if (height + height > beyond * beyond) return isNegative ? -(edge + beyond) : edge + beyond;
    }
  }
}

/** The noise of a task's sensors, which its parcels use up row by row. */
export class Noise {
  /** Load the tables for a machine whose sensors draw noise. */
  static async load(machine, folder = "") {
    return new Noise(machine, await get(`${folder}ziggurat.json`, "json"));
  }

  constructor(machine, tables) {
    this.machine = machine;
    this.tables = tables;
    [, this.rows, this.size] = machine.shape("parcels.noise");
  }

  /** Draw the noise of a seed's start, which is placed. */
  place(seed) {
    const { first, then, drawn } = this.machine.layout.starts.noise.states[seed];
    this.generator = new Generator(this.tables, first);
    for (let row = 0; row < drawn; row++) this._draw(row);
    this.generator = new Generator(this.tables, then);
  }

  /** Draw noise for parcels that may use up theirs in the next control period. */
  drawAhead() {
    const { used } = this.machine.layout.starts.noise;
    this.machine.view("parcels.noise_row").forEach((next, row) => {
      if (Number(next) + used > this.rows) this._draw(row);
    });
  }

  _draw(row) {
    const { rows, size, machine, generator } = this;
    const room = rows * size;
    const noise = machine.view("parcels.noise").subarray(room * row, room * (row + 1));
    for (let k = 0; k < rows; k++)
      for (let j = 0; j < size - 1; j++) noise[size * k + j] = generator.normal();
    for (let k = 0; k < rows; k++) noise[size * k + size - 1] = generator.uniform();
    machine.view("parcels.noise_row")[row] = 0n;
  }
}
