/** Which part of a surface a canvas shows, and where on it: zoom, places, sizes of strokes. */

const MOST_SCALE = 4000; // [device px/m]
const MARGIN = 0.25; // [pitch] round the view

/** A canvas that shows a surface, or a part of it; `stale` once that has changed. */
export class View {
  /** @param {HTMLCanvasElement} canvas @param {import("./draw.js").Surface} surface */
  constructor(canvas, surface) {
    this.canvas = canvas;
    this.fitted = true;
    this.setSurface(surface);
  }

  /** Show another surface, all of it. */
  setSurface(surface) {
    this.surface = surface;
    const { rows, columns, pitch, origin } = surface;
    this.pitch = typeof pitch === "number" ? [pitch, pitch] : pitch;
    const [px, py] = this.pitch;
    this.edges = [
      origin[0] - px / 2,
      origin[1] - py / 2,
      origin[0] + (columns - 0.5) * px,
      origin[1] + (rows - 0.5) * py,
    ];
    this.rotorEdges = this._findRotorEdges();
    const margin = MARGIN * Math.min(px, py);
    const [left, low, right, high] = surface.view ?? this.edges;
    this.view = [left - margin, low - margin, right + margin, high + margin];
    this.resize();
    this.fit();
  }

  /** Find the least x and y and the greatest [m] of all modules, or of the surface without any. */
  _findRotorEdges() {
    const { columns, rotor } = this.surface;
    const [left, low] = this.edges;
    const [px, py] = this.pitch;
    const found = [Infinity, Infinity, -Infinity, -Infinity];
    rotor?.forEach((isRotor, k) => {
      if (!isRotor) return;
      const [x, y] = [left + (k % columns) * px, low + Math.floor(k / columns) * py];
      found[0] = Math.min(found[0], x);
      found[1] = Math.min(found[1], y);
      found[2] = Math.max(found[2], x + px);
      found[3] = Math.max(found[3], y + py);
    });
    return Number.isFinite(found[0]) ? found : this.edges;
  }

  /** Width over height of what `fit` shows. */
  get aspect() {
    const [left, low, right, high] = this.view;
    return (right - left) / (high - low);
  }

  /** Follow the canvas's size on the screen; return whether it changed. */
  resize() {
    this.ratio = window.devicePixelRatio || 1;
    const width = Math.max(1, Math.round(this.canvas.clientWidth * this.ratio));
    const height = Math.max(1, Math.round(this.canvas.clientHeight * this.ratio));
    if (this.canvas.width === width && this.canvas.height === height && this.scale) return false;
    this.canvas.width = width;
    this.canvas.height = height;
    this.stale = true;
    if (this.fitted) this.fit();
    return true;
  }

  /** Show the whole surface. */
  fit() {
    const [left, low, right, high] = this.view;
    this.scale = Math.min(this.canvas.width / (right - left), this.canvas.height / (high - low));
    this.centre = [(left + right) / 2, (low + high) / 2];
    this.leastScale = this.scale / 2;
    this.fitted = true;
    this.stale = true;
  }

  /** Zoom by a factor; the point of the surface at a place [CSS px] of the canvas stays there. */
  zoom(factor, px = this.canvas.clientWidth / 2, py = this.canvas.clientHeight / 2) {
    const [x, y] = this.toSurface(px, py);
    this.scale = Math.min(Math.max(this.scale * factor, this.leastScale), MOST_SCALE);
    const [toX, toY] = this.toSurface(px, py);
    this._centreOn(this.centre[0] + x - toX, this.centre[1] + y - toY);
  }

  /** Move the picture with the pointer, by CSS pixels to the right and down. */
  pan(dx, dy) {
    const perPixel = this.ratio / this.scale;
    this._centreOn(this.centre[0] - dx * perPixel, this.centre[1] + dy * perPixel);
  }

  _centreOn(x, y) {
    const [left, low, right, high] = this.view;
    this.centre = [Math.min(Math.max(x, left), right), Math.min(Math.max(y, low), high)];
    this.fitted = false;
    this.stale = true;
  }

  /** Convert a place [CSS px] on the canvas to x, y [m]. */
  toSurface(px, py) {
    return [
      this.centre[0] + (px * this.ratio - this.canvas.width / 2) / this.scale,
      this.centre[1] - (py * this.ratio - this.canvas.height / 2) / this.scale,
    ];
  }

  /** Convert x, y [m] to a place [CSS px] on the canvas: the inverse of `toSurface`. */
  toCanvas(x, y) {
    const [across, down] = this._place(x, y);
    return [across / this.ratio, down / this.ratio];
  }

  /** Find the module at a place [CSS px]: row times columns plus column; -1: none. */
  moduleAt(px, py) {
    const [x, y] = this.toSurface(px, py);
    const { rows, columns, rotor } = this.surface;
    const column = Math.floor((x - this.edges[0]) / this.pitch[0]);
    const row = Math.floor((y - this.edges[1]) / this.pitch[1]);
    if (column < 0 || column >= columns || row < 0 || row >= rows) return -1;
    const index = row * columns + column;
    return rotor && !rotor[index] ? -1 : index;
  }

  /** Where a module is, x and y [m]. */
  placeOf(module) {
    const { columns, origin } = this.surface;
    const [row, column] = [Math.floor(module / columns), module % columns];
    return [origin[0] + column * this.pitch[0], origin[1] + row * this.pitch[1]];
  }

  /** Convert x, y [m] to device pixels. */
  _place(x, y) {
    return [
      this.canvas.width / 2 + (x - this.centre[0]) * this.scale,
      this.canvas.height / 2 - (y - this.centre[1]) * this.scale,
    ];
  }

  /** Compute the size [device px] of a module's picture. */
  get _cell() {
    return Math.max(1, Math.floor(Math.min(...this.pitch) * this.scale));
  }

  _stroke() {
    return this.ratio * (1 + Math.min(this._cell / this.ratio, 60) / 30);
  }

  _letters() {
    return this.ratio * Math.min(Math.max(11, (0.95 * this._cell) / this.ratio), 26);
  }
}
