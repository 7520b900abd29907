/** Agents without a network: orientations and layouts that stay, and compiled rules. */

/**
 * @typedef {object} Card of a rule
 * @property {string} code name of its module
 * @property {string} machine name of its memory
 * @property {[number, number]} [window] rows and columns around the parcel that it chooses for; by
 *   default all modules of the zone
 * @property {Object<string, number>} [camera] numbers of its memory that are others with a camera
 * @property {number[]} [choices] on a slope, that an action stands for: roll, brake, to the left, to
 *   the right
 * @property {boolean} [modules] on a slope, whether it acts for each module, not for halves of parcels
 */

/** An agent: its card, and what it is made of. */
export class Agent {
  /**
   * @param {Card} card
   * @param {object} parts some of:
   * @param {import("./machine.js").Machine} [parts.machine] of its own function
   * @param {import("./machine.js").Obeying} [parts.obeying] which parcel each module obeys
   * @param {Float32Array} [parts.weights] of its network, and maybe of others
   */
  constructor(card, parts) {
    this.card = card;
    Object.assign(this, parts);
  }
}

/** A compiled function, from the same source as on the CPU, of what `parcels.observation` shows. */
export class CompiledRule extends Agent {
  /** Forget what was in an episode before. */
  begin(run) {
    this.machine.reset();
    if (!run.noise) return;
    for (const [name, value] of Object.entries(this.card.camera ?? {}))
      this.machine.set(name, value);
  }

  /** Call the function on what is observed; return what it writes, and what it returns. */
  call(run, from, to) {
    const seen = this.machine.view(from);
    // The page may observe more than a rule, after what the rule observes.
    seen.set(run.machine.view("parcels.observation").subarray(0, seen.length));
    const found = this.machine.step();
    return [Array.from(this.machine.view(to), Number), found];
  }
}

/** A rule of one parcel. */
export class Rule extends CompiledRule {
  /** Write what is chosen for each module. @param {import("./task.js").TaskRun} run */
  act(run) {
    const [choices] = this.call(run, "observations", "commands");
    if (!this.card.window) {
      run.wanted.set(choices);
      return;
    }
    const [rows, columns] = this.card.window;
    const [corner, first] = this._corner(run, rows, columns);
    choices.forEach((choice, part) => {
      const row = corner + Math.floor(part / columns);
      const column = first + (part % columns);
      const isThere = row >= 0 && row < run.rows && column >= 0 && column < run.columns;
      if (isThere) run.want(run.partOf(row * run.columns + column), choice, false);
    });
  }

  /** Find the row and the column of the window's first module, as the action "window" does. */
  _corner({ machine, about }, rows, columns) {
    const [x, y] = machine.view("parcels.sensed");
    const up = (y - about.origin[1]) / about.pitch[1];
    const along = (x - about.origin[0]) / about.pitch[0];
    const middle = [Math.floor(up + 0.5 + 1e-9), Math.floor(along + 0.5)];
    return [middle[0] - Math.floor(rows / 2), middle[1] - Math.floor(columns / 2)];
  }
}

/** A rule on a slope. */
export class SlopeRule extends CompiledRule {
  /** Choose for both halves of the parcel in each row, one after the other, or for each module. */
  choose(run) {
    const to = this.card.modules ? "commands" : "halves";
    return this.call(run, "tables", to)[0].map((action) => this.card.choices[action]);
  }

  act(run) {
    this.chosen = this.choose(run);
    if (this.card.modules) run.wanted.set(this.chosen);
    else this.obeying.act(run, this.chosen);
  }
}

/** Keeps what the player sets. */
export const PLAYER = { act() {} };

/** Keep every module at one orientation. */
export function keepAll(choice) {
  return { act: (run) => run.wanted.fill(choice) };
}

/** Keep the layout that a rule has chosen for each seed's start: choices, and how many in a row. */
export function keepLayout(layouts) {
  const act = (run) => {
    const layout = layouts[run.scene.seed];
    run.wanted.set(layout.flatMap(([choice, many]) => new Array(many).fill(choice)));
  };
  return { act };
}
