/** Noise of sensors, which a compiled function draws as NumPy does. */

import { Machine } from "./machine.js";

/** The noise of a task's sensors, which its parcels use up row by row. */
export class Noise {
  /** Load the function for a machine whose sensors draw noise. */
  static async load(machine, folder = "") {
    return new Noise(machine, await Machine.load("noise", folder));
  }

  constructor(machine, generator) {
    this.machine = machine;
    this.generator = generator;
    [, this.rows, this.size] = machine.shape("parcels.noise");
  }

  /** Draw the noise of a seed's start, which is placed. */
  place(seed) {
    const { first, then, drawn } = this.machine.layout.starts.noise.states[seed];
    this._seed(first);
    for (let row = 0; row < drawn; row++) this._draw(row);
    this._seed(then);
  }

  /** Draw noise for parcels that may use up theirs in the next control period. */
  drawAhead() {
    const { used } = this.machine.layout.starts.noise;
    this.machine.view("parcels.noise_row").forEach((next, row) => {
      if (Number(next) + used > this.rows) this._draw(row);
    });
  }

  /** Set the generator's state, whose words have hexadecimal digits. */
  _seed(words) {
    this.generator.view("words").set(words.map((word) => BigInt(`0x${word}`)));
  }

  _draw(row) {
    const { generator, machine } = this;
    generator.step();
    machine.view("parcels.noise").set(generator.view("noise"), this.rows * this.size * row);
    machine.view("parcels.noise_row")[row] = 0n;
  }
}
