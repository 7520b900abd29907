/** Drawing a surface and its parcels on a canvas; x runs to the right and y up, in metres. */

import {
  badgeSize,
  boxAbout,
  moduleStep,
  overlap,
  paintModule,
  placeBadge,
  traceArrows,
  writeBadge,
  writeText,
} from "./marks.js";
import { exitColour, mixed, THEMES, textOn, themeName } from "./palette.js";
import { View } from "./view.js";

/**
 * @typedef {object} Mark what is drawn under the modules and stays
 * @property {"line"|"path"|"zone"|"exit"|"inlet"} kind of it: exits, inlets and zones are areas
 * @property {number[][]} points [m] corners of the area, or along the line
 * @property {string} [label]
 * @property {number|string|null} [colour] index of an exit's, name of the palette's, "#rrggbb"
 *
 * @typedef {object} Surface
 * @property {number} rows
 * @property {number} columns
 * @property {number|number[]} pitch [m] between neighbours: one, or in x and in y
 * @property {number[]} origin [m] centre of the module in row 0, column 0
 * @property {Uint8Array|null} rotor 1: a module, 0: a support; row by row; null: all are modules
 * @property {Uint8Array|null} [obeys] 0: a module that no controller turns; null: all obey
 * @property {number[]} [view] [m] least x and y, greatest x and y to show; default: all
 * @property {Mark[]} [marks]
 *
 * @typedef {object} ParcelInFrame
 * @property {number[][]} [outline] [m] corners in its own frame, or
 * @property {number} [radius] [m]
 * @property {number} x [m] of its frame
 * @property {number} y [m]
 * @property {number} theta [rad]
 * @property {number} [vx] [m/s]
 * @property {number} [vy] [m/s]
 * @property {number} [omega] [rad/s]
 * @property {number|string} [colour] index of an exit's colour, or "#rrggbb"; default: grey
 * @property {string} [label]
 * @property {number} [opacity] of all of it, 0 to 1
 * @property {number} [asked] theta [rad] that it is to turn to
 * @property {number[]} [sensed] x, y [m] and theta [rad] that sensors say
 * @property {number[][]} [forces] x, y [m] where it acts, and fx, fy [N] of each
 *
 * @typedef {object} Frame
 * @property {number} time [s]
 * @property {ArrayLike<number>} axes [rad] of each module, row by row
 * @property {number[][]|null} [drives] [m/s] velocity in x and y of each module's surface; NaN: idle
 * @property {ParcelInFrame[]} parcels the last is drawn above the others
 * @property {(number[][]|{points: number[][], colour?: number|string})[]} [traces] [m] of ways
 * @property {string[]} [counts] written after the labels of the exits, in their order
 *
 * @typedef {object} Track of a parcel
 * @property {number} number 1, 2 ...
 * @property {number[]} times [s]
 * @property {number[]} motion x, y, theta, vx, vy, omega of the base at each time, in a row
 */

const LEAST_FORCE = 2; // [CSS px] of an arrow: a shorter one would be a dot
const TRACE_STEP = 6; // [device px] between the points of a trace
const MOST_POINTS = 400; // of a way that are drawn

/** A picture of a surface on a canvas; what stays is kept on layers between frames. */
export class Picture extends View {
  /**
   * @param {HTMLCanvasElement} canvas as large as its style says, on any screen
   * @param {Surface} surface
   * @param {{theme?: "light"|"dark"|"auto", forceScale?: number, longestForce?: number}} [options]
   *   forces are drawn `forceScale` [m/N] long, and at most `longestForce` [m]
   */
  constructor(
    canvas,
    surface,
    { theme = "auto", forceScale = 0.005, longestForce = Infinity } = {},
  ) {
    super(canvas, surface);
    this.context = canvas.getContext("2d");
    this.ground = document.createElement("canvas"); // what stays
    this.modules = document.createElement("canvas"); // the same under the modules
    this.sprites = new Map();
    this.forceScale = forceScale;
    this.longestForce = longestForce;
    /** Index of the module and of the parcel drawn with a ring; -1: none. */
    this.chosen = { module: -1, parcel: -1 };
    this.frame = null;
    this.setTheme(theme);
    this.observer = new ResizeObserver(() => {
      if (this.resize() && this.frame) this.draw(this.frame);
    });
    this.observer.observe(canvas);
  }

  /** Draw in the colours of a theme from the next frame on. */
  setTheme(theme) {
    this.theme = theme;
    this.colours = THEMES[themeName(theme)];
    this.sprites.clear();
    this.stale = true;
  }

  /** Free what watches the canvas. */
  dispose() {
    this.observer.disconnect();
  }

  /** Find the uppermost parcel of the last frame at a place [CSS px]: its index; -1: none. */
  parcelAt(px, py) {
    const [x, y] = this.toSurface(px, py);
    const parcels = this.frame?.parcels ?? [];
    for (let k = parcels.length - 1; k >= 0; k--) {
      const parcel = parcels[k];
      const [dx, dy] = [x - parcel.x, y - parcel.y];
      const [cosine, sine] = [Math.cos(parcel.theta), Math.sin(parcel.theta)];
      if (isWithin(parcel, cosine * dx + sine * dy, cosine * dy - sine * dx)) return k;
    }
    return -1;
  }

  /** Draw a frame. @param {Frame} frame */
  draw(frame) {
    this.frame = frame;
    if (this.stale) this._paintGround();
    this._turnModules(frame.axes, frame.drives);
    const { context } = this;
    context.drawImage(this.modules, 0, 0);
    context.lineJoin = "round";
    context.lineCap = "round";
    this._writeExits(frame.counts);
    for (const [k, trace] of (frame.traces ?? []).entries()) {
      this._drawTrace(trace.points ?? trace, trace.colour ?? frame.parcels[k]?.colour);
    }
    for (const [k, parcel] of frame.parcels.entries()) {
      this._drawParcel(parcel, k === this.chosen.parcel);
    }
    for (const parcel of frame.parcels) this._drawForces(parcel.forces ?? []);
    if (this.chosen.module >= 0) this._drawRing(this.chosen.module);
  }

  _colour(colour, otherwise) {
    if (typeof colour === "number") return exitColour(colour);
    return this.colours[colour] ?? colour ?? otherwise;
  }

  _trace(context, points, close = false) {
    context.beginPath();
    for (const [k, [x, y]] of points.entries()) {
      if (k) context.lineTo(...this._place(x, y));
      else context.moveTo(...this._place(x, y));
    }
    if (close) context.closePath();
  }

  /** Paint what stays: plate, supports and marks. */
  _paintGround() {
    for (const layer of [this.ground, this.modules]) {
      layer.width = this.canvas.width;
      layer.height = this.canvas.height;
    }
    const context = this.ground.getContext("2d");
    const { colours, surface } = this;
    context.fillStyle = colours.paper;
    context.fillRect(0, 0, this.ground.width, this.ground.height);
    const [left, top] = this._place(this.edges[0], this.edges[3]);
    const [right, bottom] = this._place(this.edges[2], this.edges[1]);
    context.fillStyle = colours.plate;
    context.fillRect(left, top, right - left, bottom - top);
    context.lineWidth = this.ratio;
    context.strokeStyle = colours.plateEdge;
    context.strokeRect(left, top, right - left, bottom - top);
    const marks = surface.marks ?? [];
    for (const mark of marks) if (mark.kind === "zone") this._paintMark(context, mark);
    if (surface.rotor) this._paintSupports(context);
    for (const mark of marks) if (mark.kind !== "zone") this._paintMark(context, mark);
    this.modules.getContext("2d").drawImage(this.ground, 0, 0);
    this.drawn = new Int16Array(surface.rows * surface.columns).fill(-1);
    if (this.spriteSize !== this._cell) this.sprites.clear();
    this.spriteSize = this._cell;
    this.stale = false;
  }

  _paintSupports(context) {
    const { rotor } = this.surface;
    const radius = Math.max(0.07 * this._cell, 0.6);
    context.fillStyle = this.colours.support;
    for (let k = 0; k < rotor.length; k++) {
      if (rotor[k]) continue;
      const [x, y] = this._place(...this.placeOf(k));
      if (x < 0 || y < 0 || x > this.ground.width || y > this.ground.height) continue;
      context.beginPath();
      context.arc(x, y, radius, 0, 2 * Math.PI);
      context.fill();
    }
  }

  _paintMark(context, mark) {
    const { colours } = this;
    const stroke = this._stroke();
    const colour = this._colour(mark.colour, colours.goal);
    const isArea = mark.kind !== "line" && mark.kind !== "path";
    this._trace(context, mark.points, isArea);
    context.lineWidth = 0.75 * stroke;
    if (mark.kind === "zone") {
      context.fillStyle = colours.zone;
      context.fill();
      context.strokeStyle = colours.zoneEdge;
      context.stroke();
    } else if (isArea) {
      context.fillStyle = mixed(
        colour,
        colours.plate,
        mark.kind === "inlet" ? 0.75 : mark.colour === null ? 0.8 : 0.55,
      );
      context.fill();
      context.strokeStyle = colour;
      context.stroke();
    } else {
      context.lineWidth = 1.4 * stroke;
      context.setLineDash([4 * stroke, 3 * stroke]);
      context.strokeStyle = colour;
      context.stroke();
      context.setLineDash([]);
    }
    if (mark.label && mark.kind !== "exit") {
      const at = isArea ? middle(mark.points) : mark.points[mark.points.length - 1];
      const [x, y] = this._place(...at);
      const size = this._letters();
      const look = { colour: isArea ? colours.ink : colour, rim: colours.paper, size };
      const room = isArea ? this._room(mark.points) : Infinity;
      writeText(context, mark.label, x, isArea ? y : y - 0.8 * size, { ...look, room });
    }
  }

  /** Compute the width [device px] of an area. */
  _room(points) {
    const [left, , right] = boundsOf(points);
    return (right - left) * this.scale;
  }

  /** Write the labels of exits and what has left there, clear of modules where there is room. */
  _writeExits(counts) {
    const size = this._letters();
    const canvas = [this.canvas.width, this.canvas.height];
    const seen = [this._box(this.rotorEdges)];
    let k = 0;
    for (const mark of this.surface.marks ?? []) {
      if (mark.kind !== "exit") continue;
      const count = counts?.[k++];
      const text = [mark.label, count].filter((part) => part).join(" ");
      const area = this._box(boundsOf(mark.points));
      if (!text || !overlap(area, [0, 0, ...canvas])) continue; // an exit that is not in sight
      const extent = badgeSize(this.context, text, size);
      const place = placeBadge(area, extent, size, canvas, seen);
      seen.push(boxAbout(place, extent));
      const colour = this._colour(mark.colour, this.colours.goal);
      writeBadge(this.context, text, place, colour, size);
    }
  }

  /** Convert least x and y and greatest x and y [m] to a box [device px]. */
  _box([left, low, right, high]) {
    return [...this._place(left, high), ...this._place(right, low)];
  }

  /** Draw again the modules whose axes or drives have changed, on their layer. */
  _turnModules(axes, drives) {
    const { columns, rotor, obeys, origin } = this.surface;
    const context = this.modules.getContext("2d");
    const size = this._cell;
    const [left, top] = this._place(...origin);
    const [across, up] = [this.pitch[0] * this.scale, this.pitch[1] * this.scale];
    const [width, height] = [this.modules.width, this.modules.height];
    for (let k = 0; k < this.drawn.length; k++) {
      if (rotor && !rotor[k]) continue;
      const step = moduleStep(axes[k], drives?.[k]);
      if (step === this.drawn[k]) continue;
      const x = Math.round(left + (k % columns) * across - size / 2);
      const y = Math.round(top - Math.floor(k / columns) * up - size / 2);
      this.drawn[k] = step;
      if (x + size < 0 || y + size < 0 || x > width || y > height) continue;
      context.drawImage(this.ground, x, y, size, size, x, y, size, size);
      context.drawImage(this._sprite(step, Boolean(obeys && !obeys[k])), x, y);
    }
  }

  /** Return the picture of a module, which is painted once. */
  _sprite(step, isPale) {
    const key = isPale ? -1 - step : step;
    if (!this.sprites.has(key))
      this.sprites.set(key, paintModule(step, this._cell, this.colours, isPale));
    return this.sprites.get(key);
  }

  _drawTrace(points, colour) {
    if (points.length < 2) return;
    const { context, colours } = this;
    const own = this._colour(colour, colours.ink);
    const stroke = this._stroke();
    let [fromX, fromY] = this._place(...points[0]);
    context.beginPath();
    context.moveTo(fromX, fromY);
    points.forEach((point, k) => {
      const [x, y] = this._place(...point);
      if (k < points.length - 1 && Math.abs(x - fromX) + Math.abs(y - fromY) < TRACE_STEP) return;
      context.lineTo(x, y);
      [fromX, fromY] = [x, y];
    });
    context.lineJoin = "bevel"; // round ones take twice the time
    if (own === colours.ink) {
      context.strokeStyle = colours.paper;
      context.lineWidth = 2 * stroke;
      context.stroke();
    }
    context.strokeStyle = own;
    context.lineWidth = own === colours.ink ? stroke : 1.5 * stroke;
    context.stroke();
    context.lineJoin = "round";
  }

  _drawParcel(parcel, isChosen) {
    const { context, colours } = this;
    const [cosine, sine] = [Math.cos(parcel.theta), Math.sin(parcel.theta)];
    const at = ([x, y]) =>
      this._place(parcel.x + cosine * x - sine * y, parcel.y + sine * x + cosine * y);
    const isCoded = parcel.colour !== undefined && parcel.colour !== null;
    const colour = this._colour(parcel.colour, colours.parcel);
    const stroke = this._stroke();
    context.lineJoin = "miter";
    const front = parcel.outline ? Math.max(...parcel.outline.map(([x]) => x)) : parcel.radius;
    const trace = (share) => {
      context.beginPath();
      if (parcel.outline) {
        for (const [x, y] of parcel.outline) context.lineTo(...at([share * x, share * y]));
        context.closePath();
      } else {
        context.arc(...at([0, 0]), share * parcel.radius * this.scale, 0, 2 * Math.PI);
      }
    };
    context.globalAlpha = (isCoded ? 0.6 : 0.45) * (parcel.opacity ?? 1);
    context.fillStyle = colour;
    trace(1);
    context.fill();
    context.globalAlpha = parcel.opacity ?? 1;
    if (isCoded) {
      trace(Math.max(0, 1 - (1.4 * stroke) / (front * this.scale)));
      context.strokeStyle = colour;
      context.lineWidth = 2 * stroke;
      context.stroke();
      trace(1);
    }
    context.strokeStyle = isChosen ? colours.goal : colours.ink;
    context.lineWidth = (isChosen ? 2 : 1) * stroke;
    context.stroke();
    const tip = 0.86 * front;
    context.beginPath();
    context.moveTo(...at([tip, 0]));
    context.lineTo(...at([tip - 0.3 * front, 0.22 * front]));
    context.lineTo(...at([tip - 0.3 * front, -0.22 * front]));
    context.closePath();
    context.fillStyle = isCoded ? textOn(colour) : colours.ink;
    context.fill();
    if (parcel.asked !== undefined)
      this._drawDashed(parcel, [parcel.x, parcel.y, parcel.asked], colours.goal);
    if (parcel.sensed) this._drawDashed(parcel, parcel.sensed, colours.sensed);
    const size = Math.min(this._letters(), 0.8 * front * this.scale);
    if (parcel.label && size > 6 * this.ratio) {
      writeBadge(context, parcel.label, at([0, 0]), colour, size);
    }
    context.globalAlpha = 1;
  }

  /** Draw the base dashed, at a pose: as it is asked to turn, or as it is sensed. */
  _drawDashed(parcel, [left, up, theta], colour) {
    const { context } = this;
    const stroke = this._stroke();
    const [cosine, sine] = [Math.cos(theta), Math.sin(theta)];
    const radius = parcel.radius ?? 0;
    const outline = parcel.outline ?? [
      [-radius, 0],
      [radius, 0],
    ];
    const turned = outline.map(([x, y]) => [
      left + cosine * x - sine * y,
      up + sine * x + cosine * y,
    ]);
    this._trace(context, turned, true);
    context.setLineDash([4 * stroke, 3 * stroke]);
    context.strokeStyle = colour;
    context.lineWidth = stroke;
    context.stroke();
    context.setLineDash([]);
  }

  /** Draw forces as arrows, all of them in two strokes. */
  _drawForces(forces) {
    if (forces.length === 0) return;
    const { context } = this;
    context.lineJoin = "round";
    traceArrows(context, forces, (x, y) => this._place(x, y), {
      scale: this.forceScale,
      longest: this.longestForce,
      least: (LEAST_FORCE * this.ratio) / this.scale,
      head: 0.35 * this.pitch[0],
    });
    context.strokeStyle = this.colours.paper;
    context.lineWidth = 1.9 * this._stroke();
    context.stroke();
    context.strokeStyle = this.colours.force;
    context.lineWidth = 0.9 * this._stroke();
    context.stroke();
  }

  _drawRing(module) {
    this.context.beginPath();
    this.context.arc(...this._place(...this.placeOf(module)), 0.5 * this._cell, 0, 2 * Math.PI);
    this.context.strokeStyle = this.colours.goal;
    this.context.lineWidth = 1.5 * this._stroke();
    this.context.stroke();
  }
}

/** Find the least x and y and the greatest of some points. */
function boundsOf(points) {
  const [across, up] = [0, 1].map((k) => points.map((point) => point[k]));
  return [Math.min(...across), Math.min(...up), Math.max(...across), Math.max(...up)];
}

/** Compute the middle of the box round some points. */
function middle(points) {
  const [left, low, right, high] = boundsOf(points);
  return [(left + right) / 2, (low + high) / 2];
}

/** Return whether a point in a parcel's own frame lies within its base. */
function isWithin(parcel, x, y) {
  if (!parcel.outline) return Math.hypot(x, y) <= parcel.radius;
  let inside = false;
  parcel.outline.forEach(([x1, y1], k) => {
    const [x2, y2] = parcel.outline[(k + 1) % parcel.outline.length];
    if (y1 > y !== y2 > y && x < x1 + ((y - y1) * (x2 - x1)) / (y2 - y1)) inside = !inside;
  });
  return inside;
}

/** Choose points of a way to draw, not too many, from its motion. */
export function thinned(motion) {
  const count = motion.length / 6;
  const every = Math.max(1, Math.ceil(count / MOST_POINTS));
  const points = [];
  for (let k = 0; k < count; k += every) points.push([motion[6 * k], motion[6 * k + 1]]);
  points.push([motion[motion.length - 6], motion[motion.length - 5]]);
  return points;
}

/** Name the numbers of a parcel's motion, as a frame has them. */
export function named([x, y, theta, vx, vy, omega]) {
  return { x, y, theta, vx, vy, omega };
}
