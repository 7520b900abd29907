/** Which part of a surface a canvas shows, and where on it: zoom, places, sizes of strokes. */

const MOST_SCALE = 4000; // [device px/m]
const MARGIN = 0.25; // [pitch] round the view
// Keys and their directions on a surface: up and right.
export const ARROWS = {
  ArrowLeft: [0, -1],
  ArrowRight: [0, 1],
  ArrowUp: [1, 0],
  ArrowDown: [-1, 0],
};

/** Find the least x and y and the greatest of some points. */
export function boundsOf(points) {
  return points.reduce(
    ([left, low, right, high], [x, y]) => [
      Math.min(left, x),
      Math.min(low, y),
      Math.max(right, x),
      Math.max(high, y),
    ],
    [Infinity, Infinity, -Infinity, -Infinity],
  );
}

/** Make bounds larger on all sides. */
function grown([left, low, right, high], dx, dy) {
  return [left - dx, low - dy, right + dx, high + dy];
}

/** Where a module of a surface is, x and y [m]. */
export function placeOf({ columns, origin, pitch }, module) {
  const [row, column] = [Math.floor(module / columns), module % columns];
  return [origin[0] + column * pitch[0], origin[1] + row * pitch[1]];
}

/**
 * Find the next module from a module in an arrow's direction; without one, return that module.
 * From -1, find the module nearest to the middle row at a share of the length; -1: there is none.
 */
export function nextModule({ rows, columns, rotor }, module, [up, right] = [0, 0], share = 0.5) {
  let [row, column] = [Math.floor(rows / 2), Math.floor(columns * share)];
  if (module < 0) {
    const away = (k) => Math.hypot(Math.floor(k / columns) - row, (k % columns) - column);
    const modules = [...rotor.keys()].filter((k) => rotor[k]);
    return modules.sort((one, other) => away(one) - away(other))[0] ?? -1;
  }
  [row, column] = [Math.floor(module / columns) + up, (module % columns) + right];
  for (; row >= 0 && row < rows && column >= 0 && column < columns; row += up, column += right)
    if (rotor[row * columns + column]) return row * columns + column;
  return module;
}

/** A canvas that shows a surface, or a part of it; `stale` once that has changed. */
export class View {
  /** @param {HTMLCanvasElement} canvas @param {import("./draw.js").Surface} surface */
  constructor(canvas, surface) {
    this.canvas = canvas;
    this.fitted = true;
    this.surface = surface;
    const { rotor, pitch } = surface;
    const [halfX, halfY] = pitch.map((each) => each / 2);
    const edgesOf = (some) => grown(boundsOf(some.map((k) => placeOf(surface, k))), halfX, halfY);
    const modules = [...rotor.keys()];
    const rotors = modules.filter((k) => rotor[k]);
    this.edges = edgesOf(modules);
    this.rotorEdges = rotors.length ? edgesOf(rotors) : this.edges;
    const margin = MARGIN * Math.min(...pitch);
    this.view = grown(surface.view ?? this.edges, margin, margin);
    this.resize();
    this.fit();
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
    const { rows, columns, rotor, pitch } = this.surface;
    const column = Math.floor((x - this.edges[0]) / pitch[0]);
    const row = Math.floor((y - this.edges[1]) / pitch[1]);
    if (column < 0 || column >= columns || row < 0 || row >= rows) return -1;
    const index = row * columns + column;
    return rotor[index] ? index : -1;
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
    return Math.max(1, Math.floor(Math.min(...this.surface.pitch) * this.scale));
  }

  _stroke() {
    return this.ratio * (1 + Math.min(this._cell / this.ratio, 60) / 30);
  }

  _letters() {
    return this.ratio * Math.min(Math.max(11, (0.95 * this._cell) / this.ratio), 26);
  }
}
