/**
 * A compiled environment with its memory: arrays and numbers by the names that they have in Python,
 * starts by seed, and steps. Nothing is written outside of the arrays. Then what a task's machine
 * needs beside it: noise of its sensors, which parcel a module obeys, and the pace of its steps.
 */

import { placeOf } from "./view.js";

const KINDS = {
  bool: Uint8Array,
  float32: Float32Array,
  float64: Float64Array,
  int32: Int32Array,
  int64: BigInt64Array,
};
/** Functions of C that a module may import, but for those of `Math`. */
const FUNCTIONS = { fmod: (a, b) => a % b, exp2: (x) => 2 ** x };
/** These are the C library's to the bit as soon as a module that has them is there. */
export let { sin, cos, hypot } = Math;
const WORD = 8; // [bytes] of an argument
const PAGE = 65536; // [bytes] by which memory grows
const MOST = 256 * 1024 * 1024; // [bytes] of memory that a page may take
const ROUNDING = 1e-5; // [m/s] of a contact below which a rotor holds
const BUDGET = 24; // [ms] of a frame for the physics, at most
const LATE = 0.1; // [s] of the past that a frame catches up with, at most

/** An error that is shown to the reader as it is. */
export class PlainError extends Error {}

/** Tell the reader what is wrong, unless all is well. */
export function ensure(isWell, text) {
  if (!isWell) throw new PlainError(text);
}

/** Write an error for the reader. */
export function explain(error) {
  const isPlain = error instanceof PlainError;
  return isPlain ? error.message : `Something went wrong in the page: ${error.message}`;
}

/**
 * Do steps of `unit` [s] for the time `passed` since the last frame and what was owed before, within
 * a frame's budget, until `step` returns false; return the time [s] that is owed still.
 */
export function catchUp(owed, passed, unit, step) {
  const begun = performance.now();
  let left = owed + passed;
  while (left >= unit && performance.now() - begun < BUDGET) {
    left -= unit;
    if (step() === false) return 0;
  }
  return Math.min(left, LATE);
}

/** The time [s] from one frame to the next [ms], as far as it is caught up with. */
export function passedSince(last, now) {
  return Math.min(Math.max(0, now - last) / 1000, LATE);
}

/** Fetch a file next to the page, or say in plain words why there is none. */
export async function get(address, read) {
  let answer;
  try {
    answer = await fetch(address);
  } catch {
    throw new PlainError(`${address} could not be loaded: is the server still there?`);
  }
  if (!answer.ok)
    throw new PlainError(`${address} could not be loaded: the server says ${answer.status}`);
  return answer[read]();
}

export class Machine {
  /**
   * Load the files of a task; `starts` too where it has any.
   * @param {string} name such as "sort" or "table"
   * @param {string} [code] name of the module, where several machines share one
   */
  static async load(name, code = name) {
    const hasIt = typeof WebAssembly === "object";
    ensure(hasIt, "This browser has no WebAssembly, which the physics runs in.");
    const [layout, block, module] = await Promise.all([
      get(`${name}.json`, "json"),
      get(`${name}.bin`, "arrayBuffer"),
      get(`${code}.wasm`, "arrayBuffer"),
    ]);
    const starts = layout.starts ? await get(`${name}.starts`, "arrayBuffer") : null;
    return Machine.make(name, layout, block, module, starts);
  }

  /** Make a machine of the content of its files. */
  static async make(name, layout, block, code, starts = null) {
    ensure(
      block.byteLength === layout.bytes,
      `${name}.bin has ${block.byteLength} bytes, and ${name}.json says ${layout.bytes}: they are not of one build.`,
    );
    const module = await WebAssembly.compile(code);
    const env = {};
    for (const { name: asked } of WebAssembly.Module.imports(module)) {
      const found = FUNCTIONS[asked] ?? Math[asked];
      ensure(found instanceof Function, `${name} needs the function ${asked}, which a page lacks.`);
      env[asked] = found;
    }
    const instance = await WebAssembly.instantiate(module, { env });
    if (instance.exports.hypot) ({ sin, cos, hypot } = instance.exports);
    return new Machine(name, layout, block, instance.exports, starts);
  }

  constructor(name, layout, block, exports, starts) {
    this.name = name;
    this.layout = layout;
    this.exports = exports;
    this.block = new Uint8Array(block);
    this.starts = starts && new Uint8Array(starts);
    this.end = layout.end;
    this.fields = new Map(); // kind, place of the words, shape, address and room, by name
    let word = layout.base;
    for (const [field, [kind, shape]] of Object.entries(layout.fields)) {
      this.fields.set(field, { kind, word });
      word += WORD * (shape.length ? 5 + 2 * shape.length : 1);
    }
    this._grow(this.end);
    this.reset();
  }

  /** How many starts there are. */
  get seeds() {
    return this.starts ? this.layout.starts.marks.length : 0;
  }

  /** Put all back as it was loaded, the sizes of arrays too. */
  reset() {
    this.end = this.layout.end;
    for (const [name, [, shape, address]] of Object.entries(this.layout.fields)) {
      Object.assign(this.fields.get(name), { shape, address, room: count(shape) });
    }
    new Uint8Array(this.exports.memory.buffer).set(this.block, this.layout.base);
  }

  /** Put the start of a seed into the memory; the next step begins its episode. */
  place(seed) {
    if (!Number.isInteger(seed) || seed < 0 || seed >= this.seeds) {
      throw new PlainError(
        `The seed must be a whole number from 0 to ${this.seeds - 1}, got ${seed}.`,
      );
    }
    this.reset();
    const { fields } = this.layout.starts;
    const size = this.starts.length / this.seeds;
    let from = seed * size;
    const memory = new Uint8Array(this.exports.memory.buffer);
    for (const name of fields) {
      const { address, kind, shape } = this._field(name);
      const bytes = count(shape) * KINDS[kind].BYTES_PER_ELEMENT;
      memory.set(this.starts.subarray(from, from + bytes), address);
      from += bytes;
    }
  }

  /** View an array by its name; a later call of `resize` or `place` makes views invalid. */
  view(name) {
    const { kind, shape, address } = this._field(name);
    return new KINDS[kind](this.exports.memory.buffer, address, count(shape));
  }

  /** View a row of an array: the numbers along its last dimension. */
  row(name, index) {
    const size = this.shape(name).at(-1);
    return this.view(name).subarray(size * index, size * (index + 1));
  }

  /** The lengths of an array. */
  shape(name) {
    return this._field(name).shape;
  }

  /** Read a number, or the only element of an array. */
  get(name) {
    return Number(this.view(name)[0]);
  }

  /** Write numbers or booleans from the beginning of an array, or a number; they must fit in. */
  set(name, ...values) {
    const view = this.view(name);
    if (values.length > view.length)
      throw new PlainError(`${name} has room for ${view.length} numbers, got ${values.length}.`);
    const is64 = view instanceof BigInt64Array;
    values.forEach((value, k) => {
      view[k] = is64 ? BigInt(value) : value;
    });
  }

  /** Make an array another size, its content zero; one that needs more room gets it at the end. */
  resize(name, shape) {
    const field = this._field(name);
    if (shape.length !== field.shape.length)
      throw new PlainError(`${name} has ${field.shape.length} dimensions, got ${shape.length}.`);
    const size = KINDS[field.kind].BYTES_PER_ELEMENT;
    if (count(shape) > field.room) {
      field.address = Math.ceil(this.end / 16) * 16;
      field.room = count(shape);
      this._grow(field.address + size * field.room);
    }
    field.shape = shape;
    const strides = shape.map((_, k) => size * count(shape.slice(k + 1)));
    // As the kernel takes an array: two owners that are nobody, and what follows from its shape.
    const words = [0, 0, count(shape), size, field.address, ...shape, ...strides];
    new BigInt64Array(this.exports.memory.buffer, field.word, words.length).set(words.map(BigInt));
    this.view(name).fill(field.kind === "int64" ? 0n : 0);
  }

  /** Run the kernel once; return what it returns. */
  step() {
    let result;
    try {
      result = this.exports.step(this.layout.base);
    } catch (error) {
      throw new PlainError(`The physics of ${this.name} stopped: ${error.message}.`);
    }
    ensure(result >= 0, `The physics of ${this.name} was given a number beyond an array's end.`);
    return result;
  }

  _field(name) {
    const field = this.fields.get(name);
    if (!field) throw new PlainError(`${this.name} has no array or number ${name}.`);
    return field;
  }

  _grow(end) {
    const { memory } = this.exports;
    if (end > MOST)
      throw new PlainError(
        `The scene takes ${Math.ceil(end / 1e6)} MB of memory, and a page has ${MOST / 1e6}.`,
      );
    const short = end - memory.buffer.byteLength;
    if (short > 0) memory.grow(Math.ceil(short / PAGE));
    this.end = end;
  }
}

function count(shape) {
  return shape.reduce((a, b) => a * b, 1);
}

/**
 * Compute the forces of friction on a parcel, at the velocity that it has now.
 * @param {Machine} machine
 * @param {number} row of the parcel
 * @param {ArrayLike<number>} state of its centre of mass: x, y, theta, vx, vy, omega
 * @param {number} mass [kg]
 * @returns {number[][]} x, y [m] and fx, fy [N] of each contact
 */
export function frictionForces(machine, row, state, mass) {
  const at = machine.layout.contacts;
  const isWorld = machine.fields.has("scratch.tables");
  const rows = isWorld ? "scratch.tables" : "scratch.table";
  const table = machine.view(rows).subarray(row * at.TABLE_SIZE * isWorld);
  const marks = machine.view("scratch.marks").subarray(row * at.MARKS_SIZE * isWorld);
  const forces = [];
  const [x, y, , vx, vy, omega] = state;
  let total = 0;
  for (let k = 0; k < Number(marks[at.SPANS]); k++) {
    total += Number(marks[at.SPAN_LAST + k] - marks[at.SPAN_FIRST + k]) + 1;
  }
  for (let i = 0; i < Math.min(total, at.CAPACITY); i++) {
    const [armX, armY] = [table[at.ARM_X + i], table[at.ARM_Y + i]];
    const [ax, ay] = [table[at.AXIS_X + i], table[at.AXIS_Y + i]];
    const [ux, uy] = [vx - omega * armY, vy + omega * armX];
    let along = (ax * ux + ay * uy) / ROUNDING;
    let across = (ax * uy - ay * ux) / ROUNDING;
    if (marks[at.ROTOR + i]) {
      along = Math.min(1, Math.max(-1, along));
      across = Math.min(1, Math.max(-1, across));
    } else {
      const over = Math.max(1, Math.hypot(along, across));
      along /= over;
      across /= over;
    }
    const load = mass * table[at.NORMAL + i];
    const fa = -load * table[at.MU_ALONG + i] * along;
    const fc = -load * table[at.MU_ACROSS + i] * across;
    forces.push([x + armX, y + armY, fa * ax - fc * ay, fa * ay + fc * ax]);
  }
  return forces;
}

/** The noise of a task's sensors: parcels use it up row by row, and a function draws it as NumPy. */
export class Noise {
  /** Load the function for a machine whose sensors draw noise. */
  static async load(machine) {
    return new Noise(machine, await Machine.load("noise"));
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

/** Which parcel each module obeys: the kernel's own function, compiled into a module by itself. */
export class Obeying {
  /**
   * @param {{code: string, signature: string, reads: string[]}} card with the names of the arrays
   *   that the function reads and an episode changes
   * @param {Machine} machine of the task, whose arguments the function takes
   */
  static async load(card, machine) {
    const code = await get(`${card.code}.wasm`, "arrayBuffer");
    const { name, layout, block } = machine;
    const isOfBuild = card.signature === layout.signature && card.reads;
    ensure(isOfBuild, `${card.code}.wasm and ${name}.json are not of one build.`);
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
      const behind = placeOf(run.about, module)[0] < sensed[6 * row] ? 1 : 0;
      run.want(run.partOf(module), halves[2 * row + behind], false);
    });
  }
}
