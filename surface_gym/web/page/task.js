/** A run of a task's environment, stepped by a page, drawn and recorded. */

import { named, thinned } from "./draw.js";
import { ensure, frictionForces } from "./machine.js";

const CORNERS = 32; // of a parcel, at most

/** An environment of a task, from the start of a seed on. */
export class TaskRun {
  /**
   * @param {import("./scene.js").TaskScene} scene that is checked; its commands follow the run
   * @param {object} agent with `act(run)`, which writes into `run.wanted`
   * @param {import("./machine.js").Noise|null} noise that sensors draw
   */
  constructor(machine, scene, agent, noise = null) {
    this.machine = machine;
    this.scene = scene;
    this.agent = agent;
    this.noise = noise;
    this.about = machine.layout.scene;
    this.unit = this.about.dt * this.about.steps;
    this.rows = this.about.rows;
    this.columns = this.about.columns;
    this.begin();
  }

  /** Begin the episode; "you" does what was done until something else is. */
  begin() {
    const { machine, scene } = this;
    machine.place(scene.seed);
    this.noise?.place(scene.seed);
    this.body = this.about.stream ? 0 : machine.get("parcels.body");
    const modules = this.rows * this.columns;
    const row = machine.shape("bodies.rotor")[0] > 1 ? this.body : 0;
    this.zone = Array.from(machine.row("bodies.zone", row), Number);
    this._stick();
    this.rotor = machine.view("bodies.rotor").slice(modules * row, modules * (row + 1));
    this.obeys = machine.view("bodies.obeys").slice(modules * row, modules * (row + 1));
    this.wanted = new Int32Array(machine.view("surfaces.command").length).fill(this.about.rolling);
    this.commanded = this.wanted.slice();
    this.queue = Array.from({ length: scene.late }, () => this.wanted.slice());
    this.planned = scene.commands;
    scene.commands = [];
    this.period = 0;
    this.rewards = 0;
    /** @type {import("./draw.js").Track[]} */
    this.tracks = [];
    machine.step(); // senses and observes the start
    this.before = this.now = this._motions();
    this._record();
    this.agent.begin?.(this);
  }

  get time() {
    return this._counted("clock");
  }

  get outcome() {
    return this._counted("outcome");
  }

  get over() {
    const { outcome } = this;
    if (outcome > 0) return this.about.outcomes[outcome];
    return this.about.periods && this.period >= this.about.periods ? "out of time" : null;
  }

  surface() {
    const { rows, columns, pitch, origin } = this.about;
    const marks = this.machine.layout.starts.marks[this.scene.seed];
    const half = 0.5 * pitch[1] * this.zone[1] + 4 * pitch[1];
    const middle = origin[1] + pitch[1] * (this.zone[0] + 0.5 * (this.zone[1] - 1));
    const left = origin[0] - 0.5 * pitch[0];
    const low = origin[1] - 0.5 * pitch[1];
    const view = [
      left,
      Math.max(low - 3 * pitch[1], middle - half),
      left + pitch[0] * (columns + 1),
      Math.min(low + pitch[1] * (rows + 3), middle + half),
    ];
    return { rows, columns, pitch, origin, rotor: this.rotor, obeys: this.obeys, marks, view };
  }

  /** Do a control period; return whether there was one. */
  advance() {
    if (this.over) return false;
    const { machine, scene } = this;
    for (const [period, turns] of this.planned) {
      if (period === this.period)
        for (const [part, choice] of turns) this.want(part, choice, false);
    }
    this.agent.act?.(this);
    this.queue.push(this.wanted.slice());
    const command = this.queue.shift();
    const turns = [];
    const view = machine.view("surfaces.command");
    command.forEach((choice, part) => {
      if (choice !== this.commanded[part]) turns.push([part, choice]);
      view[part] = BigInt(choice);
    });
    if (turns.length) scene.commands.push([this.period, turns]);
    this.commanded = command;
    this.noise?.drawAhead();
    ensure(machine.step() === 0, `The task ${machine.name} made a number that is not finite.`);
    this.period += 1;
    this.rewards += this._counted("reward");
    this.before = this.now;
    this.now = this._motions();
    this._record();
    return true;
  }

  /** Which part of a command a module follows; -1: none. */
  partOf(module) {
    if (module < 0 || !this.obeys[module]) return -1;
    const [firstRow, rows, firstColumn, columns] = this.zone;
    const [row, column] = [Math.floor(module / this.columns), module % this.columns];
    const margin = this.about.stream ? 0 : (this.about.zoneRows - rows) / 2;
    return (margin + row - firstRow) * columns + column - firstColumn;
  }

  /** Modules that obey, by index. */
  modules() {
    return [...this.obeys.keys()].filter((module) => this.obeys[module]);
  }

  /** Set what a part of the command is to be; of a player, what was planned is over. */
  want(part, choice, byPlayer = true) {
    if (byPlayer) this.planned = [];
    if (part >= 0 && part < this.wanted.length) this.wanted[part] = choice;
  }

  /** What is seen `share` of the way from the last control period to this. */
  frame({ forces = false, traces = false, share = 1 } = {}) {
    const parcels = [];
    for (const [number, now] of this.now) {
      const before = this.before.get(number) ?? now;
      const between = (was, is) => is.map((value, k) => was[k] + share * (value - was[k]));
      const parcel = { ...named(between(before.motion, now.motion)), ...now.look };
      if (forces) parcel.forces = this._forces(now.row);
      if (now.sensed) parcel.sensed = between(before.sensed, now.sensed);
      parcels.push(parcel);
    }
    const seen = traces ? this.tracks.filter(({ number }) => this.now.has(number - 1)) : [];
    const ways = seen.map(({ motion, colour }) => ({ points: thinned(motion), colour }));
    const drives = this.about.drives.length ? this._drives() : null;
    return { time: this.time, axes: this._axes(), drives, parcels, traces: ways };
  }

  readings() {
    const { machine } = this;
    const found = [
      ["time", `${this.time.toFixed(2)} s`],
      ["reward", this.rewards.toFixed(2)],
    ];
    if (this.about.stream) {
      const tally = machine.view("streams.tally");
      const counted = ["entered", "delivered", "wrong", "touches"];
      found.push(...counted.map((name, k) => [name, `${tally[k]}`]));
    } else {
      const [, , , vx, vy] = machine.view("parcels.truth");
      found.push(["speed", `${Math.hypot(vx, vy).toFixed(2)} m/s`]);
    }
    if (this.over) found.push(["ended", this.over]);
    return found;
  }

  /** Read a number of the episode, which the stream has or the only parcel. */
  _counted(name) {
    return this.machine.get(`${this.about.stream ? "streams" : "parcels"}.${name}`);
  }

  _stick() {
    const { machine } = this;
    const modules = this.rows * this.columns;
    for (const name of ["bodies.obeys", "streams.obeys"]) {
      if (!machine.fields.has(name)) continue;
      const obeys = machine.view(name);
      for (const [row, column] of this.scene.stuck) {
        ensure(
          row < this.rows && column < this.columns,
          `stuck must be modules of ${this.rows} rows and ${this.columns} columns, got ${row}, ${column}.`,
        );
        for (let k = row * this.columns + column; k < obeys.length; k += modules) obeys[k] = 0;
      }
    }
  }

  _axes() {
    const [axis, way] = ["axis", "direction"].map((each) => this.machine.view(`surfaces.${each}`));
    return Float32Array.from(axis, (place) => Math.atan2(way[2 * place + 1], way[2 * place]));
  }

  /** Compute the velocities [m/s] in x and y of driven modules' surfaces; of idle ones NaN. */
  _drives() {
    const [axis, way, drive] = ["axis", "direction", "drive"].map((name) =>
      this.machine.view(`surfaces.${name}`),
    );
    return Array.from(axis, (place) => {
      const [cosine, sine] = [way[2 * place], way[2 * place + 1]];
      const [along, across, isDriven] = drive.subarray(3 * place, 3 * place + 3);
      if (!isDriven) return [Number.NaN, Number.NaN];
      return [cosine * along - sine * across, sine * along + cosine * across];
    });
  }

  /** Collect motion and look of the parcels there are, by number, and where a camera has them. */
  _motions() {
    const { machine } = this;
    const found = new Map();
    const collect = (number, row) =>
      found.set(number, {
        row,
        motion: [...machine.row("parcels.truth", row)],
        sensed: this.noise && [...machine.row("parcels.sensed", row)].slice(0, 3),
        look: this._look(row),
      });
    if (!this.about.stream) return collect(0, 0);
    const [present, numbers] = [machine.view("streams.present"), machine.view("streams.number")];
    present.forEach((there, row) => {
      if (there) collect(Number(numbers[row]), row);
    });
    return found;
  }

  _look(row) {
    const { machine } = this;
    const body = Number(machine.view("parcels.body")[row]);
    const [, sides] = machine.shape("bodies.corners");
    const corners = machine
      .view("bodies.corners")
      .subarray(2 * sides * body, 2 * sides * (body + 1));
    const outline = [];
    for (let k = 0; k < Math.min(sides, CORNERS); k++) {
      if (k && corners[2 * k] === corners[0] && corners[2 * k + 1] === corners[1]) break;
      outline.push([corners[2 * k], corners[2 * k + 1]]);
    }
    const [radius] = machine.row("bodies.body", body);
    const look = outline.length > 2 ? { outline } : { radius };
    if (this.about.stream) [look.colour] = machine.row("parcels.goal", row);
    return look;
  }

  _forces(row) {
    const { machine } = this;
    if (!this.period) return [];
    const body = Number(machine.view("parcels.body")[row]);
    const mass = machine.row("bodies.body", body).at(-1);
    return frictionForces(machine, row, machine.row("parcels.state", row), mass);
  }

  _record() {
    for (const [number, { motion, look }] of this.now) {
      let track = this.tracks.find((each) => each.number === number + 1);
      if (!track) {
        track = { number: number + 1, times: [], motion: [], colour: look.colour };
        this.tracks.push(track);
      }
      track.times.push(this.time);
      track.motion.push(...motion);
    }
  }
}
