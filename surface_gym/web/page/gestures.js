/** Pointers over a picture: press, move and release, a pinch, and the wheel. */

const WHEEL = 0.0015; // [1/px] of the wheel: logarithm of the zoom

/**
 * Follow the pointers over a canvas. Places are [CSS px] on it.
 * @param {HTMLCanvasElement} canvas
 * @param {object} does
 * @param {(place: number[], isSecond: boolean) => void} does.press with a pointer more
 * @param {(place: number[], before: number[]|undefined, event: PointerEvent) => void} does.move of
 *   the only pointer; `before` is undefined where it is not pressed
 * @param {(place: number[]|null, isLast: boolean) => void} does.release; null: it was cancelled
 * @param {(factor: number, place: number[], shift: number[]) => void} does.zoom about a place,
 *   which two fingers have moved by a shift meanwhile
 * @param {() => boolean} [does.takesWheel] whether the wheel zooms, rather than scroll the page
 */
export function followPointers(canvas, { press, move, release, zoom, takesWheel = () => true }) {
  const pointers = new Map();
  const at = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button > 0) return;
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, at(event));
    press(at(event), pointers.size > 1);
  });
  canvas.addEventListener("pointermove", (event) => {
    const place = at(event);
    const before = pointers.get(event.pointerId);
    if (before) pointers.set(event.pointerId, place);
    if (pointers.size < 2) {
      move(place, before, event);
    } else if (before && pointers.size === 2) {
      const [, other] = [...pointers].find(([id]) => id !== event.pointerId);
      const wide = ([x, y]) => Math.max(1, Math.hypot(x - other[0], y - other[1]));
      const middle = [0, 1].map((k) => (place[k] + other[k]) / 2);
      const shift = [0, 1].map((k) => (place[k] - before[k]) / 2);
      zoom(wide(place) / wide(before), middle, shift);
    }
  });
  for (const kind of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(kind, (event) => {
      if (!pointers.delete(event.pointerId)) return;
      release(kind === "pointerup" ? at(event) : null, pointers.size === 0);
    });
  }
  canvas.addEventListener(
    "wheel",
    (event) => {
      if (!event.ctrlKey && !takesWheel()) return;
      event.preventDefault();
      zoom(Math.exp(-WHEEL * event.deltaY), at(event), [0, 0]);
    },
    { passive: false },
  );
}
