/** Who acts in a task: the player, layouts that stay, and the agents of `agents.json`, if any. */

import { get } from "./machine.js";
import { ParcelAgent } from "./parcels.js";
import { Policy } from "./policy.js";

export const YOU = "you";
const UNIFORM = { "all at 90°": 3, "all at 0°": 0, "all at −45°": 2, "all at 45°": 1 };

/** Keeps what the player sets. */
class Player {
  act() {}
}

/** Keeps every module at one orientation. */
class Uniform {
  constructor(choice) {
    this.choice = choice;
  }

  act(run) {
    run.wanted.fill(this.choice);
  }
}

/** Keeps the layout that a rule has chosen for each seed's start. */
class Layout {
  constructor(layouts) {
    this.layouts = layouts;
  }

  act(run) {
    const layout = this.layouts[run.scene.seed];
    let part = 0;
    for (const [choice, many] of layout) for (let k = 0; k < many; k++) run.wanted[part++] = choice;
  }
}

/** Which agents there are of the tasks, by name. */
export class Agents {
  /** @param {object|null} file the content of agents.json @param {ArrayBuffer|null} weights */
  constructor(file, weights) {
    this.file = file ?? {};
    this.weights = weights;
  }

  /** Load them from beside the page. */
  static async load(folder = "") {
    const [file, weights] = await Promise.all([
      get(`${folder}agents.json`, "json"),
      get(`${folder}agents.bin`, "arrayBuffer"),
    ]);
    return new Agents(file, weights);
  }

  /** List the names of a task's agents. */
  names(task) {
    const { layouts = {}, policies = {}, parcels = {} } = this.file[task] ?? {};
    return [
      YOU,
      ...Object.keys(parcels),
      ...Object.keys(policies),
      ...Object.keys(layouts),
      ...Object.keys(UNIFORM),
    ];
  }

  /** Make an agent; one of no such name keeps what there is. */
  make(task, name) {
    const { layouts = {}, policies = {}, parcels = {} } = this.file[task] ?? {};
    if (Object.hasOwn(parcels, name)) return new ParcelAgent(parcels[name], this.weights);
    if (Object.hasOwn(policies, name)) return new Policy(policies[name], this.weights);
    if (Object.hasOwn(layouts, name)) return new Layout(layouts[name]);
    return Object.hasOwn(UNIFORM, name) ? new Uniform(UNIFORM[name]) : new Player();
  }
}
