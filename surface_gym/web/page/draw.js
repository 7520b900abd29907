/** Drawing a surface and its parcels on a canvas; x runs to the right and y up, in metres. */

import {
  badgeSize,
  boxAbout,
  fillPath,
  moduleStep,
  overlap,
  paintModule,
  placeBadge,
  setFont,
  strokePath,
  traceArrows,
  writeBadge,
  writeText,
} from "./marks.js";
import { exitColour, mixed, THEMES, textOn, themeName } from "./palette.js";
import { boundsOf, placeOf, View } from "./view.js";

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
 * @property {number[]} pitch [m] between neighbours in x and in y
 * @property {number[]} origin [m] centre of the module in row 0, column 0
 * @property {Uint8Array} rotor 1: a module, 0: a support; row by row
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
 * @property {{points: number[][], colour?: number|string}[]} [traces] [m] of ways
 * @property {string[]} [counts] written after the labels of the exits, in their order
 *
 * @typedef {object} Track of a parcel
 * @property {number} number 1, 2 ...
 * @property {number[]} times [s]
 * @property {number[]} motion x, y, theta, vx, vy, omega of the base at each time, in a row
 */

const LEAST_ARROW = 2; // [CSS px] a shorter arrow would be a dot
const AIM = 14; // [CSS px] of an aim's letters, and of its arrow's head at most
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
    const { context, ratio } = this;
    return (this.frame?.parcels ?? []).findLastIndex((parcel) => {
      this._traceBase(parcel);
      return context.isPointInPath(px * ratio, py * ratio);
    });
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
      this._drawTrace(trace.points, trace.colour ?? frame.parcels[k]?.colour);
    }
    for (const [k, parcel] of frame.parcels.entries()) {
      this._drawParcel(parcel, k === this.chosen.parcel);
    }
    for (const parcel of frame.parcels) this._drawForces(parcel.forces ?? []);
    if (this.chosen.module >= 0) this._drawRing(this.chosen.module);
  }

  /** Draw the arrow of a throw, from a place [m] to another, with text at its tip. */
  drawAim([x, y], [toX, toY], text) {
    const { context, ratio, colours } = this;
    const [tipX, tipY] = this._place(toX, toY);
    const size = { scale: 1, longest: Infinity, head: (AIM * ratio) / this.scale };
    this._traceArrows([[x, y, toX - x, toY - y]], size);
    strokePath(context, colours.goal, 3 * ratio);
    setFont(context, AIM * ratio);
    context.textAlign = "left";
    context.textBaseline = "bottom";
    context.fillStyle = colours.goal;
    context.fillText(text, tipX + 8 * ratio, tipY - 4 * ratio);
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

  /** Trace a closed line whose points are in a frame that has a pose: x, y [m] and theta [rad]. */
  _traceAt([x, y, theta], points) {
    const [cosine, sine] = [Math.cos(theta), Math.sin(theta)];
    const placed = points.map(([px, py]) => [
      x + cosine * px - sine * py,
      y + sine * px + cosine * py,
    ]);
    this._trace(this.context, placed, true);
  }

  /** Trace a parcel's base, or the middle of it that is a share as large. */
  _traceBase({ x, y, theta, outline, radius }, share = 1) {
    const { context } = this;
    if (outline) {
      const points = outline.map((corner) => corner.map((each) => share * each));
      this._traceAt([x, y, theta], points);
    } else {
      context.beginPath();
      context.arc(...this._place(x, y), share * radius * this.scale, 0, 2 * Math.PI);
    }
  }

  /** Trace arrows, but for those that would be dots. */
  _traceArrows(forces, size) {
    const least = (LEAST_ARROW * this.ratio) / this.scale;
    traceArrows(this.context, forces, (x, y) => this._place(x, y), { ...size, least });
  }

  _strokeDashed(context, colour, width) {
    const stroke = this._stroke();
    context.setLineDash([4 * stroke, 3 * stroke]);
    strokePath(context, colour, width * stroke);
    context.setLineDash([]);
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
    const [left, top, right, bottom] = this._box(this.edges);
    context.beginPath();
    context.rect(left, top, right - left, bottom - top);
    fillPath(context, colours.plate);
    strokePath(context, colours.plateEdge, this.ratio);
    const marks = surface.marks ?? [];
    for (const mark of marks) if (mark.kind === "zone") this._paintMark(context, mark);
    this._paintSupports(context);
    for (const mark of marks) if (mark.kind !== "zone") this._paintMark(context, mark);
    this.modules.getContext("2d").drawImage(this.ground, 0, 0);
    this.drawn = new Int16Array(surface.rows * surface.columns).fill(-1);
    if (this.spriteSize !== this._cell) this.sprites.clear();
    this.spriteSize = this._cell;
    this.stale = false;
  }

  _paintSupports(context) {
    const radius = Math.max(0.07 * this._cell, 0.6);
    context.beginPath();
    this.surface.rotor.forEach((isRotor, k) => {
      if (isRotor) return;
      const [x, y] = this._place(...placeOf(this.surface, k));
      context.moveTo(x + radius, y);
      context.arc(x, y, radius, 0, 2 * Math.PI);
    });
    fillPath(context, this.colours.support);
  }

  _paintMark(context, mark) {
    const { colours } = this;
    const stroke = this._stroke();
    const colour = this._colour(mark.colour, colours.goal);
    const isArea = mark.kind !== "line" && mark.kind !== "path";
    this._trace(context, mark.points, isArea);
    if (mark.kind === "zone") {
      fillPath(context, colours.zone);
      strokePath(context, colours.zoneEdge, 0.75 * stroke);
    } else if (isArea) {
      const pale = mark.kind === "inlet" ? 0.75 : mark.colour === null ? 0.8 : 0.55;
      fillPath(context, mixed(colour, colours.plate, pale));
      strokePath(context, colour, 0.75 * stroke);
    } else {
      this._strokeDashed(context, colour, 1.4);
    }
    if (!mark.label || mark.kind === "exit") return;
    const look = { colour: colours.ink, rim: colours.paper, size: this._letters() };
    if (isArea) {
      const [left, top, right, bottom] = this._box(boundsOf(mark.points));
      look.room = right - left;
      writeText(context, mark.label, (left + right) / 2, (top + bottom) / 2, look);
    } else {
      const [x, y] = this._place(...mark.points.at(-1));
      writeText(context, mark.label, x, y - 0.8 * look.size, { ...look, colour, room: Infinity });
    }
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
    const { columns, rotor, obeys, origin, pitch } = this.surface;
    const context = this.modules.getContext("2d");
    const size = this._cell;
    const [left, top] = this._place(...origin);
    const [across, up] = pitch.map((each) => each * this.scale);
    const [width, height] = [this.modules.width, this.modules.height];
    for (let k = 0; k < this.drawn.length; k++) {
      if (!rotor[k]) continue;
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
    if (own === colours.ink) strokePath(context, colours.paper, 2 * stroke);
    strokePath(context, own, own === colours.ink ? stroke : 1.5 * stroke);
    context.lineJoin = "round";
  }

  _drawParcel(parcel, isChosen) {
    const { context, colours } = this;
    const { x, y, theta, outline, radius, label, asked, sensed, opacity = 1 } = parcel;
    const isCoded = parcel.colour !== undefined && parcel.colour !== null;
    const colour = this._colour(parcel.colour, colours.parcel);
    const stroke = this._stroke();
    context.lineJoin = "miter";
    const front = outline ? Math.max(...outline.map(([ahead]) => ahead)) : radius;
    context.globalAlpha = (isCoded ? 0.6 : 0.45) * opacity;
    this._traceBase(parcel);
    fillPath(context, colour);
    context.globalAlpha = opacity;
    if (isCoded) {
      this._traceBase(parcel, Math.max(0, 1 - (1.4 * stroke) / (front * this.scale)));
      strokePath(context, colour, 2 * stroke);
      this._traceBase(parcel);
    }
    strokePath(context, isChosen ? colours.goal : colours.ink, (isChosen ? 2 : 1) * stroke);
    const arrow = [
      [0.86 * front, 0],
      [0.56 * front, 0.22 * front],
      [0.56 * front, -0.22 * front],
    ];
    this._traceAt([x, y, theta], arrow);
    fillPath(context, isCoded ? textOn(colour) : colours.ink);
    if (asked !== undefined) this._drawDashed(parcel, [x, y, asked], colours.goal);
    if (sensed) this._drawDashed(parcel, sensed, colours.sensed);
    const size = Math.min(this._letters(), 0.8 * front * this.scale);
    if (label && size > 6 * this.ratio) writeBadge(context, label, this._place(x, y), colour, size);
    context.globalAlpha = 1;
  }

  /** Draw the base dashed, at a pose: as it is asked to turn, or as it is sensed. */
  _drawDashed({ outline, radius }, pose, colour) {
    const diameter = [
      [-radius, 0],
      [radius, 0],
    ];
    this._traceAt(pose, outline ?? diameter);
    this._strokeDashed(this.context, colour, 1);
  }

  /** Draw forces as arrows, all of them in two strokes. */
  _drawForces(forces) {
    if (forces.length === 0) return;
    const { context, colours, surface } = this;
    const size = {
      scale: this.forceScale,
      longest: this.longestForce,
      head: 0.35 * surface.pitch[0],
    };
    context.lineJoin = "round";
    this._traceArrows(forces, size);
    strokePath(context, colours.paper, 1.9 * this._stroke());
    strokePath(context, colours.force, 0.9 * this._stroke());
  }

  _drawRing(module) {
    const place = this._place(...placeOf(this.surface, module));
    this.context.beginPath();
    this.context.arc(...place, 0.5 * this._cell, 0, 2 * Math.PI);
    strokePath(this.context, this.colours.goal, 1.5 * this._stroke());
  }
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
