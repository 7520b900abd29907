/** What rules of one parcel have in common: they see an observation, and choose for each module. */

/**
 * @typedef {import("./decoding.js").Seen & object} Card of a rule; its other numbers are its own
 * @property {string} kind of rule
 * @property {string} actions what it chooses for: "window" is the modules around the parcel
 * @property {{roll: number, brake: number, left: number, right: number}} axes choices
 * @property {number} period [s] between decisions
 */

export class Rule {
  /** @param {Card} card */
  constructor(card) {
    this.card = card;
  }

  /** Forget what was in an episode before. */
  begin() {}

  /** Write what is chosen for each module. @param {import("./task.js").TaskRun} run */
  act(run) {
    const choices = this.choose(run.machine.view("parcels.observation"), run);
    if (this.card.actions !== "window") {
      run.wanted.set(choices);
      return;
    }
    const { columns } = this.card;
    const [corner, first] = this._corner(run);
    choices.forEach((choice, part) => {
      const row = corner + Math.floor(part / columns);
      const column = first + (part % columns);
      const isThere = row >= 0 && row < run.rows && column >= 0 && column < run.columns;
      if (isThere) run.want(run.partOf(row * run.columns + column), choice, false);
    });
  }

  /** Find the row and the column of the window's first module, as the action "window" does. */
  _corner({ machine, about }) {
    const { rows, columns, justOver } = this.card;
    const [x, y] = machine.view("parcels.sensed");
    const up = (y - about.origin[1]) / about.pitch[1];
    const along = (x - about.origin[0]) / about.pitch[0];
    return [
      Math.floor(up + justOver) - Math.floor(rows / 2),
      Math.floor(along + 0.5) - Math.floor(columns / 2),
    ];
  }
}
