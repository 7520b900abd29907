/**
 * The scheduler of streams at run time, as `agents/scheduling` has it: it books a maneuver and a
 * moment of entry for each parcel that waits, and leads those on the line.
 *
 * What it books and chooses is equal to the Python's to the bit.
 */

const NOBODY = -1;
const SHUT = 0;

/**
 * @typedef {object} Table of what all schedulers share
 * @property {number} present columns of a parcel's row: it is there, time since it came,
 * @property {number} time
 * @property {number} past how far its rear is past its exit's start, speed and length
 * @property {number} speed
 * @property {number} length
 * @property {number[]} seen columns by which its kind is known
 * @property {number} horizon [s] units of these columns, as Python has them
 * @property {number} unit [m]
 * @property {number} half [m]
 * @property {number} fifth [m]
 * @property {number} booked latest entries that a new one is held against
 * @property {number} width sequences that a search keeps
 * @property {number} longAgo [s]
 *
 * @typedef {object} Card of a scheduler, with an entry for each of its maneuvers
 * @property {number[][]} gaps [s] between entries, of each (column) behind each (row)
 * @property {number[]} delay [s] that is expected behind each
 * @property {number[]} kind of the parcel that each is for
 * @property {(number|null)[]} place [m] of the rear past the exit's start; null: it goes straight
 * @property {number[]} choice orientation from there on
 * @property {number[][]} options maneuvers of each kind
 * @property {number[][]} signature of each kind: what is seen of it
 * @property {number} roll orientation of 90 deg
 * @property {Groups|null} groups of columns that turn together; null: each module obeys by itself
 *
 * @typedef {object} Groups
 * @property {number[][]} turned first and last group that each maneuver turns
 * @property {number[]} origin [m] x from which a row counts its rear, of each kind
 * @property {number[]} first [m] x of each group's first column, and of its last
 * @property {number[]} last
 * @property {number[]} columns of each group
 * @property {number} ahead [s] that a group is turned before it is used
 */

export class Scheduler {
  /** @param {Table} table @param {Card} card @param {import("./obeying.js").Obeying} obeying */
  constructor(table, card, obeying) {
    this.table = table;
    this.obeying = obeying;
    this.card = { ...card, place: card.place.map((each) => each ?? Infinity) };
  }

  /** Forget what was booked; a run begins. */
  begin(run) {
    const { machine } = run;
    const { table, card } = this;
    const [rows, features] = machine.shape("parcels.observation");
    this.features = features;
    this.parcels = rows - machine.get("stream_params.queue"); // that may be on the line
    this.queue = rows - this.parcels;
    this.dt = run.about.dt;
    this.steps = run.about.steps;
    this.period = this.dt * this.steps;
    this.clock = 0;
    // Maneuvers and moments [s] of the latest entries, the last first.
    this.booked = new Array(table.booked).fill(0);
    this.entered = new Array(table.booked).fill(table.longAgo);
    this.due = Number.NaN; // [s] when the one that was let in last had come
    this.pending = false; // whether that one has yet to be seen to have entered
    this.rows = new Array(this.parcels).fill(NOBODY); // maneuver of the parcel in each row
    this.stands = card.groups?.columns.map(() => card.roll);
  }

  /** Write what modules and the gate are to do for a control period. */
  act(run) {
    const seen = run.machine.view("parcels.observation");
    const at = (row, column) => seen[this.features * row + column];
    this._follow(at);
    const opens = this._open(at);
    if (this.card.groups) this._leadByGroups(run, at);
    else this._leadByModules(run, at);
    run.wanted[run.wanted.length - 1] = opens;
    this.clock += this.period;
  }

  /** Find the row of the parcel that entered, or take back its entry where it still waits. */
  _follow(at) {
    const { present, time, horizon, longAgo } = this.table;
    const due = this.clock + horizon * at(this.parcels, time);
    const waits = at(this.parcels, present) > 0.5;
    const stayed = this.pending && waits && Math.abs(due - this.due) < 1e-3;
    if (stayed) {
      this.booked.push(this.booked.shift());
      this.entered.shift();
      this.entered.push(longAgo);
    }
    const came = this.pending && !stayed;
    for (let row = 0; row < this.parcels; row++) {
      if (at(row, present) <= 0.5) this.rows[row] = NOBODY;
      else if (this.rows[row] === NOBODY)
        this.rows[row] = came ? this.booked[0] : this.card.options[this._recognise(at, row)][0];
    }
  }

  /** Choose in which step the gate opens, and book it. */
  _open(at) {
    const { present, time, horizon } = this.table;
    const queue = [];
    for (let row = this.parcels; row < this.parcels + this.queue; row++)
      if (at(row, present) > 0.5) queue.push(this._recognise(at, row));
    this.pending = false;
    if (queue.length === 0) return SHUT;
    const [maneuver, when] = this._search(queue, this.clock + this.dt);
    const step = Math.ceil((when - this.clock) / this.dt - 1e-6);
    if (step > this.steps) return SHUT;
    this.booked.pop();
    this.booked.unshift(maneuver);
    this.entered.pop();
    this.entered.unshift(this.clock + this.dt * step);
    this.due = this.clock + horizon * at(this.parcels, time);
    this.pending = true;
    return step;
  }

  /** Recognise the kind of a row's parcel, by what is seen of it. */
  _recognise(at, row) {
    const apart = this.card.signature.map((values) =>
      Math.max(...values.map((value, k) => Math.abs(at(row, this.table.seen[k]) - value))),
    );
    return apart.indexOf(Math.min(...apart));
  }

  /** Find the maneuver of the next parcel to enter, and when [s] it enters: a beam search. */
  _search(queue, now) {
    const { gaps, delay, options } = this.card;
    let level = [{ before: null }];
    for (const kind of queue) {
      const kept = []; // sequences of maneuvers, those of the least cost first
      for (const before of level) {
        for (const maneuver of options[kind]) {
          let time = now;
          for (let k = 0; k < this.booked.length; k++)
            time = Math.max(time, this.entered[k] + gaps[this.booked[k]][maneuver]);
          for (let one = before; one.before; one = one.before)
            time = Math.max(time, one.time + gaps[one.maneuver][maneuver]);
          const cost = time + delay[maneuver];
          let place = kept.length;
          while (place > 0 && cost < kept[place - 1].cost) place--;
          kept.splice(place, 0, { maneuver, time, before, cost });
          if (kept.length > this.table.width) kept.pop();
        }
      }
      level = kept;
    }
    let first = level[0];
    while (first.before.before) first = first.before;
    return [first.maneuver, first.time];
  }

  /** How far [m] the rear of a row's parcel is past its exit's start. */
  _past(at, row) {
    return this.table.unit * at(row, this.table.past);
  }

  /** What a row's parcel asks of the modules under it. */
  _choice(at, row) {
    const { place, choice, roll } = this.card;
    const maneuver = this.rows[row];
    return maneuver !== NOBODY && this._past(at, row) > place[maneuver] ? choice[maneuver] : roll;
  }

  /** Let every module obey the parcel that it bears. */
  _leadByModules(run, at) {
    const halves = this.rows.flatMap((_, row) => Array(2).fill(this._choice(at, row)));
    this.obeying.act(run, halves);
  }

  /** Let all columns of a group obey the parcel over it that is farthest along. */
  _leadByGroups(run, at) {
    const { groups, kind, roll } = this.card;
    const { speed, length, half, fifth } = this.table;
    const single = Math.fround; // Python computes the length and the way ahead in single precision
    const over = groups.first.map(() => ({ row: NOBODY, rear: -Infinity }));
    this.rows.forEach((maneuver, row) => {
      if (maneuver === NOBODY) return;
      const rear = this._past(at, row) + groups.origin[kind[maneuver]];
      const halfLength = single(single(half) + single(single(fifth) * at(row, length)));
      const ahead = single(single(groups.ahead) * single(1 + at(row, speed)));
      const soon = rear + 2 * halfLength + ahead;
      over.forEach((most, group) => {
        const isOver = rear <= groups.last[group] && soon >= groups.first[group];
        if (isOver && rear > most.rear) Object.assign(most, { row, rear });
      });
    });
    let column = 0;
    over.forEach(({ row }, group) => {
      if (row !== NOBODY) {
        const [first, last] = groups.turned[this.rows[row]];
        this.stands[group] = first <= group && group <= last ? this._choice(at, row) : roll;
      }
      for (const end = column + groups.columns[group]; column < end; column++)
        for (let r = 0; r < run.about.zoneRows; r++)
          run.wanted[r * run.about.zoneColumns + column] = this.stands[group];
    });
  }
}
