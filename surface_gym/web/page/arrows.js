/** Arrows of forces. */

const HEAD = 0.3; // of an arrow's length

/**
 * Trace arrows as one path.
 * @param {CanvasRenderingContext2D} context
 * @param {number[][]} forces x, y [m] where each acts, and fx, fy [N]
 * @param {(x: number, y: number) => number[]} place converts x, y [m] to pixels
 * @param {{scale: number, longest: number, least: number, head: number}} size [m/N]; [m] of an
 *   arrow at most, and at least to be one; and [m] of its head at most
 */
export function traceArrows(context, forces, place, { scale, longest, least, head }) {
  context.beginPath();
  for (const [x, y, fx, fy] of forces) {
    const force = Math.hypot(fx, fy);
    const length = Math.min(scale * force, longest);
    if (length < least || length === 0) continue;
    const [alongX, alongY] = [fx / force, fy / force];
    const [tipX, tipY] = [x + length * alongX, y + length * alongY];
    const size = Math.min(HEAD * length, head);
    const [hx, hy] = [size * alongX, size * alongY];
    const tip = place(tipX, tipY);
    context.moveTo(...place(x, y));
    context.lineTo(...tip);
    context.moveTo(...place(tipX - hx - 0.6 * hy, tipY - hy + 0.6 * hx));
    context.lineTo(...tip);
    context.lineTo(...place(tipX - hx + 0.6 * hy, tipY - hy - 0.6 * hx));
  }
}
