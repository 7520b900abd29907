/** Who acts in a task: the player, layouts that stay, and the agents of `agents.json`, if any. */

import { get, Machine, Obeying } from "./machine.js";
import { EachParcel, ModulesPolicy, ParcelPolicy, Policy, SortingPolicy } from "./policy.js";
import { keepAll, keepLayout, PLAYER, Rule, SlopeRule } from "./rule.js";

export const YOU = "you";
/** Kinds of agents of a task in agents.json, in the order in which they are listed. */
const KINDS = ["streams", "policies", "rules", "layouts"];
const UNIFORM = { "all at 90°": 3, "all at 0°": 0, "all at −45°": 2, "all at 45°": 1 };

/** Which agents there are of the tasks, by name. */
export class Agents {
  /**
   * @param {object|null} file the content of agents.json
   * @param {ArrayBuffer|null} weights of policies of single parcels
   */
  constructor(file, weights) {
    this.file = file ?? {};
    this.weights = weights && new Float32Array(weights);
  }

  /** Load them from beside the page. */
  static async load() {
    const files = [get("agents.json", "json"), get("agents.bin", "arrayBuffer")];
    return new Agents(...(await Promise.all(files)));
  }

  /** List the names of a task's agents. */
  names(task) {
    const there = this.file[task] ?? {};
    return [
      YOU,
      ...KINDS.flatMap((kind) => Object.keys(there[kind] ?? {})),
      ...Object.keys(UNIFORM),
    ];
  }

  /** Make an agent for a task's machine, and load what it is made of; of no such name, a player. */
  async make(task, name, machine) {
    const there = this.file[task] ?? {};
    const kind = KINDS.find((each) => Object.hasOwn(there[each] ?? {}, name));
    if (!kind) return Object.hasOwn(UNIFORM, name) ? keepAll(UNIFORM[name]) : PLAYER;
    const card = there[kind][name];
    if (kind === "layouts") return keepLayout(card);
    if (kind === "streams") return this._ofStream(card, there.obeying, machine);
    if (kind === "rules") return new Rule(card, await this._parts(card));
    if (card.kind !== "modules") return new Policy(card, { weights: await this._weights(card) });
    return new SortingPolicy(card, await this._parts(card));
  }

  async _ofStream(card, obeying, machine) {
    if (card.kind === "modules") return new ModulesPolicy(card, await this._parts(card));
    const follows = { obeying: await Obeying.load(obeying, machine) };
    if (card.kind === "each") {
      const { task, name } = card.policy;
      const policy = new Policy(this.file[task].policies[name], { weights: this.weights });
      return new EachParcel(card, { ...follows, policy });
    }
    const kind = card.kind === "rule" ? SlopeRule : ParcelPolicy;
    return new kind(card, { ...follows, ...(await this._parts(card)) });
  }

  /** Load the machine of an agent's own function, and its weights. */
  async _parts(card) {
    const own = Machine.load(card.machine, card.code);
    const [machine, weights] = await Promise.all([own, this._weights(card)]);
    return { machine, weights };
  }

  /** Load the weights of an agent that has a file of them; others share one. */
  async _weights(card) {
    if (!card.weights) return this.weights;
    return new Float32Array(await get(card.weights, "arrayBuffer"));
  }
}
