/** A run of parcels on a table, stepped by a page, drawn and recorded. */

import { named, thinned } from "./draw.js";
import { cos, ensure, frictionForces, sin } from "./machine.js";
import { MOST_PARCELS, MOST_TIME, packed, unpacked } from "./scene.js";
import { distance, makeBody, outlineOf, toCentre, toFrame, writeBodies } from "./shapes.js";

const GRAVITY = 9.81; // [m/s^2]
const EIGHTH = 0.25 * Math.PI; // [rad]
const LONGER = 20; // [s] that a run goes on after what a player did last
const TOUCHING = 1e-6; // [m] by which parcels may overlap as they come in

/** Cosine and sine of an angle, exact at multiples of 45 deg, as the physics takes them. */
function direction(angle) {
  const eighths = Math.floor(angle / EIGHTH + 0.5);
  if (Math.abs(angle - eighths * EIGHTH) > 1e-15 * Math.abs(angle)) return [cos(angle), sin(angle)];
  const octant = ((eighths % 8) + 8) % 8;
  const at = [1, Math.sqrt(0.5), 0, -Math.sqrt(0.5), -1, -Math.sqrt(0.5), 0, Math.sqrt(0.5)];
  return [at[octant], at[(octant + 6) % 8]];
}

/** Parcels on a table whose layout a player makes. */
export class TableRun {
  /** @param {import("./scene.js").TableScene} scene that is checked; it follows what a player does */
  constructor(machine, scene) {
    this.machine = machine;
    this.scene = scene;
    this.unit = scene.dt;
    this.rows = scene.rows;
    this.columns = scene.columns;
    const modules = scene.rows * scene.columns;
    this.rotor = Uint8Array.from(unpacked("rotor", scene.rotor, modules, 0, 1));
    this.bodies = scene.parcels.map((parcel) => makeBody(parcel));
    this.begin();
  }

  /** Begin again: parcels come and modules turn as they did. */
  begin() {
    const { machine, scene } = this;
    const grid = [scene.rows, scene.columns];
    const modules = scene.rows * scene.columns;
    machine.reset();
    this.first = Float64Array.from(unpacked("axis", scene.axis, modules, -7, 7));
    this.axes = this.first.slice();
    machine.resize("grid.axis", grid);
    machine.view("grid.axis").forEach((_, k, view) => {
      view[k] = k;
    });
    machine.resize("grid.direction", [modules, 2]);
    machine.resize("grid.drive", [modules, 3]);
    machine.resize("grid.rotor", grid);
    machine.view("grid.rotor").set(this.rotor);
    machine.resize("grid.stiffness", grid);
    machine.view("grid.stiffness").fill(1);
    machine.resize("grid.friction", [...grid, 3]);
    machine.resize("angle", grid);
    for (const [k, name] of ["x", "y"].entries()) {
      machine.set(`grid.${name}0`, scene.origin[k]);
      machine.set(`grid.pitch_${name}`, scene.pitch[k]);
    }
    machine.set("material.restitution", scene.sides[0]);
    machine.set("material.friction", scene.sides[1]);
    machine.set("dt", scene.dt);
    this.table = {
      tilt: scene.tilt,
      tilt_direction: scene.tilt_direction,
      friction: scene.friction,
    };
    this.stepped = 0;
    this.change = 0; // the next of the scene's
    this.touches = 0;
    /** @type {import("./draw.js").Track[]} */
    this.tracks = [];
    this.left = [];
    this._writeTable();
    this._writeBodies();
    this.takeEvents();
  }

  get time() {
    return this.stepped * this.scene.dt;
  }

  /** Why nothing moves on, or null. */
  get over() {
    return this.stepped >= this._steps(this.scene.duration) ? "time is up" : null;
  }

  /** What a picture shows behind the parcels. */
  surface() {
    const { rows, columns, pitch, origin } = this.scene;
    return { rows, columns, pitch, origin, rotor: this.rotor, obeys: null, marks: [] };
  }

  /** Do a step; return whether there was one. */
  advance() {
    if (this.over) return false;
    const { machine } = this;
    this.takeEvents();
    this.touches += machine.step() > 0 ? 1 : 0;
    machine.set("turned", 0);
    this.stepped += 1;
    this._record();
    return true;
  }

  /** Let come in and change what the scene says of this step; once. */
  takeEvents() {
    const { scene, machine } = this;
    while ((scene.changes[this.change]?.step ?? Infinity) <= this.stepped)
      this._apply(scene.changes[this.change++]);
    const present = machine.view("world.present");
    scene.parcels.forEach((parcel, k) => {
      if (this.tracks[k] || (parcel.step ?? 0) > this.stepped) return;
      const state = toCentre(this.bodies[k], parcel.pose, parcel.velocity);
      machine.row("world.state", k).set(state);
      present[k] = 1;
      machine.set("turned", 1);
      this.tracks[k] = { number: k + 1, times: [this.time], motion: this._motion(k) };
    });
  }

  /** Throw a parcel in, now. @param {import("./scene.js").Thrown} parcel */
  throw(parcel) {
    const body = makeBody(parcel);
    this._cut();
    const hasRoom = this.scene.parcels.length < MOST_PARCELS;
    ensure(hasRoom, `A table holds at most ${MOST_PARCELS} parcels: clear it to throw more.`);
    const [x, y] = toCentre(body, parcel.pose, parcel.velocity);
    ensure(this._isOver(x, y), "A parcel must come in over the table.");
    const present = this.machine.view("world.present");
    const meets = this.bodies.some(
      (other, k) => present[k] && distance(body, parcel.pose, other, this._motion(k)) < -TOUCHING,
    );
    ensure(!meets, "There is a parcel already: throw it in where there is room.");
    this.scene.parcels.push({ ...parcel, step: this.stepped });
    this.bodies.push(body);
    this._writeBodies();
    this.takeEvents();
  }

  /** Take all parcels and changes away, and keep the table as it is now. */
  clear() {
    const { scene, table } = this;
    Object.assign(scene, table, { axis: packed(this.axes), parcels: [], changes: [] });
    this.bodies = [];
    this.begin();
  }

  /** Change the table from now on. @param {object} change `axis`, `tilt`, `friction` as in a scene */
  set(change) {
    this._cut();
    const { scene } = this;
    if (this.stepped === 0) {
      this._apply(change);
      scene.axis = packed(this.axes);
      Object.assign(scene, this.table);
      return;
    }
    const last = scene.changes[scene.changes.length - 1];
    const { axis = [], ...rest } = change;
    if (last && last.step === this.stepped) {
      const turns = new Map([...(last.axis ?? []), ...axis]);
      Object.assign(last, rest, turns.size ? { axis: [...turns] } : {});
    } else {
      scene.changes.push({ step: this.stepped, ...change });
    }
    this.change = scene.changes.length;
    this._apply(change);
  }

  /** What is seen now. */
  frame({ forces = false, traces = false } = {}) {
    const { machine } = this;
    const present = machine.view("world.present");
    const parcels = [];
    const ways = [];
    this.tracks.forEach((track, k) => {
      if (traces) ways.push({ points: thinned(track.motion) });
      if (!present[k]) return;
      const body = this.bodies[k];
      const outline = outlineOf(body);
      const look = outline ? { outline } : { radius: body.radius };
      const parcel = { ...named(this._motion(k)), ...look, label: String(k + 1) };
      if (forces && this.stepped > track.times[0] / this.scene.dt)
        parcel.forces = frictionForces(machine, k, machine.row("world.state", k), body.mass);
      parcels.push(parcel);
    });
    return { time: this.time, axes: this.axes, parcels, traces: ways };
  }

  /** What is written beside the picture. */
  readings() {
    const present = [...this.machine.view("world.present")].filter(Boolean).length;
    return [
      ["time", `${this.time.toFixed(2)} s`],
      ["parcels on it", `${present}`],
      ["steps with touches", `${this.touches}`],
    ];
  }

  _steps(time) {
    return Math.round(time / this.scene.dt);
  }

  _motion(k) {
    return toFrame(this.bodies[k], this.machine.row("world.state", k));
  }

  _isOver(x, y) {
    const { origin, pitch, rows, columns } = this.scene;
    const [column, row] = [(x - origin[0]) / pitch[0] + 0.5, (y - origin[1]) / pitch[1] + 0.5];
    return column > 0 && column < columns && row > 0 && row < rows;
  }

  /** Forget what was to come, and let the run go on for longer: the player does something else. */
  _cut() {
    const { scene } = this;
    const hasTime = this.stepped < this._steps(MOST_TIME);
    ensure(hasTime, `A run has at most ${MOST_TIME} s: begin it again, or clear the table.`);
    const end = this._steps(Math.min(MOST_TIME, this.time + LONGER));
    if (end > this._steps(scene.duration)) scene.duration = end * scene.dt;
    scene.changes = scene.changes.filter(({ step }) => step <= this.stepped);
    const kept = scene.parcels.map((_, k) => Boolean(this.tracks[k]));
    const keeps = kept.filter(Boolean).length;
    const areInOrder = kept.lastIndexOf(true) + 1 === keeps;
    ensure(areInOrder, "Parcels are to come still: go on until they are there.");
    scene.parcels.length = keeps;
    this.bodies.length = keeps;
  }

  _apply({ axis = [], tilt, tilt_direction, friction }) {
    for (const [module, angle] of axis) this.axes[module] = angle;
    if (tilt !== undefined) this.table.tilt = tilt;
    if (tilt_direction !== undefined) this.table.tilt_direction = tilt_direction;
    if (friction !== undefined) this.table.friction = friction;
    this._writeTable();
  }

  _writeTable() {
    const { machine, table } = this;
    machine.view("angle").set(this.axes);
    const downhill = GRAVITY * sin(table.tilt);
    const [cosine, sine] = direction(table.tilt_direction);
    machine.set("grid.gravity_x", downhill * cosine);
    machine.set("grid.gravity_y", downhill * sine);
    machine.set("grid.gravity_normal", GRAVITY * cos(table.tilt));
    const friction = machine.view("grid.friction");
    friction.set(friction.map((_, k) => table.friction[k % 3]));
    machine.set("turned", 1);
  }

  _writeBodies() {
    const { machine } = this;
    const names = ["world.state", "world.present"];
    const kept = names.map((name) => machine.view(name).slice());
    writeBodies(machine, "world.bodies.", this.bodies, MOST_PARCELS);
    for (const [k, name] of names.entries()) machine.view(name).set(kept[k]);
    machine.set("turned", 1);
  }

  _record() {
    const present = this.machine.view("world.present");
    this.tracks.forEach((track, k) => {
      if (!present[k]) return;
      track.times.push(this.time);
      track.motion.push(...this._motion(k));
    });
  }
}
