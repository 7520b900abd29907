/** Reading a recording, as `surface_gym/recording.py` encodes it, and its frames. */

import { placeOf } from "./view.js";

const GLIDE = 0.5; // [s] for which a parcel that has left is shown
const LARGE = 0.99; // of contacts have less friction than a large one
const TRAIL = 1.2; // [s] shown of the way of a stream's parcel

/** Decode a recording from base64. @returns {Promise<Recording>} */
export async function readRecording(text) {
  const packed = Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Recording(new Uint8Array(await new Response(stream).arrayBuffer()));
}

/** What a run was; `frameAt` gives what a picture shows. */
export class Recording {
  /** @param {Uint8Array} content of an unpacked file */
  constructor(content) {
    let place = 0;
    const take = (size) => {
      place += size;
      return content.subarray(place - size, place);
    };
    const size = new DataView(content.buffer, content.byteOffset).getUint32(0, true);
    place = 4;
    const head = JSON.parse(new TextDecoder().decode(take(size)));
    const { rows, columns, frames, units } = head;
    const table = (count, unit) => unpack(take(5 * count * unit.length), unit);
    this.head = head;
    this.modules = rows * columns;
    this.surface = {
      rows,
      columns,
      pitch: head.pitch,
      origin: head.origin,
      marks: head.marks,
      rotor: take(this.modules),
      obeys: take(this.modules),
      view: head.view ?? undefined,
    };
    this.axis = take(frames * this.modules);
    this.drive = take(head.velocities ? frames * this.modules : 0);
    for (const index of [this.axis, this.drive])
      for (let k = this.modules; k < index.length; k++) index[k] += index[k - this.modules];
    [this.time] = table(frames, units.time);
    const motion = table(sum(head.parcels.map((each) => each.rows)), units.motion);
    let first = 0;
    this.parcels = head.parcels.map((each, number) => {
      const found = {
        ...each,
        number,
        motion: motion.map((column) => column.subarray(first, first + each.rows)),
      };
      first += each.rows;
      return found;
    });
    this.firstContact = starts(table(head.counted ? frames : 0, [1])[0]);
    [this.bearer] = table(head.contacts, units.bearer);
    this.contacts = table(head.contacts, units.contact);
    this.firstPush = starts(table(head.counted_pushes ? frames : 0, [1])[0]);
    this.pushes = table(head.pushes, units.push);
    this.delivered = table(head.exits ? frames : 0, new Array(head.exits).fill(1));
    const numbers = new Float32Array(content.slice(place).buffer);
    this.metrics = head.metrics.map((name, k) => [
      name,
      numbers.subarray(k * frames, (k + 1) * frames),
    ]);
    this.axes = new Float32Array(this.modules);
    /** @type {(number[]|null)[]|null} [m/s] of driven modules; of idle ones null */
    this.drives = null;
    this.axesOf = -1;
  }

  /** Time [s] of the last frame. */
  get duration() {
    return this.time[this.time.length - 1];
  }

  /** Whether forces are known. */
  get hasForces() {
    return this.head.counted;
  }

  /** Find the last frame at or before a time [s]. */
  indexAt(time) {
    let [low, high] = [0, this.time.length - 1];
    while (low < high) {
      const middle = Math.ceil((low + high) / 2);
      if (this.time[middle] <= time + 1e-9) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  /** Return the axis [rad] of a module in a frame. */
  axisOf(index, module) {
    return this.head.angles[this.axis[index * this.modules + module]];
  }

  /** Return the velocities [m/s] of modules in a frame; null: all are idle. */
  _drivesOf(index) {
    const { velocities } = this.head;
    if (!velocities) return null;
    const first = index * this.modules;
    return Array.from(this.drive.subarray(first, first + this.modules), (k) => velocities[k]);
  }

  /**
   * Describe the picture at a time [s], between frames too.
   * @param {number} time
   * @param {{traces?: boolean, forces?: boolean}} [shown]
   * @returns {import("./draw.js").Frame}
   */
  frameAt(time, { traces = false, forces = false } = {}) {
    const index = this.indexAt(time);
    const next = Math.min(index + 1, this.time.length - 1);
    const share =
      next > index
        ? Math.max(0, (time - this.time[index]) / (this.time[next] - this.time[index]))
        : 0;
    const axesOf = share > 1e-6 ? next : index; // commands hold from a frame's start to the next
    if (axesOf !== this.axesOf) {
      this.axesOf = axesOf;
      for (let k = 0; k < this.modules; k++) this.axes[k] = this.axisOf(axesOf, k);
      this.drives = this._drivesOf(axesOf);
    }
    const { axes, drives } = this;
    const frame = { time, index, axes, drives, parcels: [], traces: [] };
    for (const parcel of this.parcels) {
      const row = index - parcel.first;
      if (row < 0 || time - this.time[parcel.first + parcel.rows - 1] > GLIDE) continue;
      frame.parcels.push(this._parcelAt(parcel, row, share, time));
      if (traces) frame.traces.push(this._traceTo(parcel, row, frame.parcels.at(-1)));
    }
    if (forces) {
      for (const parcel of frame.parcels) parcel.forces = [];
      const room = new Map(frame.parcels.map((parcel) => [parcel.number, parcel.forces]));
      for (const [number, ...force] of [...this.contactsAt(index), ...this.pushesAt(index)])
        room.get(number)?.push(force);
    }
    if (this.delivered.length) frame.counts = this.delivered.map((column) => String(column[index]));
    return frame;
  }

  /** Find the friction [N] at a contact that few others exceed; 0 where there are none. */
  findLargeFriction() {
    const [, , fx, fy] = this.contacts;
    const sorted = fx.map((x, k) => Math.hypot(x, fy[k])).sort();
    return sorted[Math.floor(LARGE * sorted.length)] ?? 0;
  }

  /** Collect contacts in a frame: the parcel, x, y [m], the friction [N] and the normal force [N]. */
  contactsAt(index) {
    const [elements, normal, fx, fy] = this.contacts;
    const found = [];
    for (let k = this.firstContact[index]; k < this.firstContact[index + 1]; k++) {
      const place = placeOf(this.surface, elements[k]);
      found.push([this.bearer[k], ...place, fx[k], fy[k], normal[k]]);
    }
    return found;
  }

  /** Collect pushes in a frame: the parcel that is pushed, x, y [m] and the force [N]. */
  pushesAt(index) {
    const found = [];
    for (let k = this.firstPush[index]; k < this.firstPush[index + 1]; k++) {
      const [first, second, x, y, px, py] = this.pushes.map((column) => column[k]);
      found.push([first, x, y, -px, -py], [second, x, y, px, py]);
    }
    return found;
  }

  /** Sum the normal forces [N], and the friction and the pushes (x, y) on a parcel in a frame. */
  loadAt(index, number) {
    const total = (rows, column) =>
      sum(rows.filter(([each]) => each === number).map((row) => row[column]));
    const [contacts, pushes] = [this.contactsAt(index), this.pushesAt(index)];
    return {
      normal: total(contacts, 5),
      friction: [total(contacts, 3), total(contacts, 4)],
      push: [total(pushes, 3), total(pushes, 4)],
    };
  }

  _parcelAt(parcel, row, share, time) {
    const { motion, outline, label, colour, number } = parcel;
    const last = parcel.rows - 1;
    const [from, to] = [Math.min(row, last), Math.min(row + 1, last)];
    let [x, y, theta, vx, vy, omega] = motion.map(
      (column) => column[from] + share * (column[to] - column[from]),
    );
    const turn = motion[2][to] - motion[2][from];
    theta = motion[2][from] + share * (turn - 2 * Math.PI * Math.round(turn / (2 * Math.PI)));
    const found = { outline, label, colour: colour ?? undefined, number, opacity: 1 };
    if (this.head.heading !== null) found.asked = this.head.heading;
    const gone = time - this.time[parcel.first + last];
    if (gone > 0 && row >= last && parcel.first + last < this.time.length - 1) {
      [x, y, theta] = [x + gone * vx, y + gone * vy, theta + gone * omega]; // no physics holds there
      found.opacity = 1 - gone / GLIDE;
    }
    return Object.assign(found, { x, y, theta, vx, vy, omega });
  }

  _traceTo(parcel, row, at) {
    const end = Math.min(row, parcel.rows - 1);
    const back = this.parcels.length > 1 ? Math.round(TRAIL / this.head.control_period) : end;
    const [x, y] = parcel.motion;
    const points = [];
    for (let k = Math.max(0, end - back); k <= end; k++) points.push([x[k], y[k]]);
    points.push([at.x, at.y]);
    return { points, colour: at.colour };
  }
}

/** Sum counts of frames to where each one's rows begin; of no counts that is nowhere. */
function starts(counts) {
  const found = [0];
  for (const count of counts) found.push(found.at(-1) + count);
  return found;
}

function sum(values) {
  return values.reduce((total, value) => total + value, 0);
}

/** Compute a table's columns from their bytes: what `_pack` in recording.py wrote. */
function unpack(planes, units) {
  const count = planes.length / 5;
  const rows = count / (units.length || 1);
  return units.map((unit, column) => {
    const values = new Float64Array(rows);
    let [value, change] = [0, 0];
    for (let k = 0; k < rows; k++) {
      const at = column * rows + k;
      const folded =
        planes[at] +
        256 * planes[at + count] +
        65536 * planes[at + 2 * count] +
        16777216 * planes[at + 3 * count] +
        4294967296 * planes[at + 4 * count];
      change += folded % 2 ? -(folded + 1) / 2 : folded / 2;
      value += change;
      values[k] = value * unit;
    }
    return values;
  });
}
