/** Which parcel each module obeys: the kernel's own function, compiled into a module by itself. */

import { Machine, PlainError } from "./machine.js";

export class Obeying {
  /**
   * @param {{code: string, signature: string, reads: string[]}} card with the names of the arrays
   *   that the function reads and an episode changes
   * @param {ArrayBuffer} code
   * @param {Machine} machine of the task, whose arguments the function takes
   */
  static async make(card, code, machine) {
    const { name, layout, block } = machine;
    if (card.signature !== layout.signature || !card.reads)
      throw new PlainError(`${card.code}.wasm and ${name}.json are not of one build.`);
    return new Obeying(await Machine.make(card.code, layout, block, code), card.reads);
  }

  constructor(machine, reads) {
    this.machine = machine;
    this.reads = reads;
  }

  /**
   * Let modules follow the parcels that they will bear; those of none stay as they are.
   * @param {import("./task.js").TaskRun} run
   * @param {ArrayLike<number>} halves choices for the modules ahead of the centre of the parcel in
   *   each row, and for those behind it
   */
  act(run, halves) {
    const { machine } = run;
    for (const name of this.reads) this.machine.view(name).set(machine.view(name));
    this.machine.step();
    const sensed = machine.view("parcels.sensed");
    this.machine.view("streams.owner").forEach((row, module) => {
      if (row < 0) return;
      const behind = run.placeOf(module)[0] < sensed[6 * row] ? 1 : 0;
      run.want(run.partOf(module), halves[2 * row + behind], false);
    });
  }
}
