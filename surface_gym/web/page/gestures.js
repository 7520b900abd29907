/** What pointers and keys do in a player of recordings. */

export const ZOOM = 1.3; // of a key or a button
const STILL = 5; // [px] that a pointer may move in a tap
const NOTHING = { parcel: -1, module: -1 };

/** Follow the keys of the page, and the pointers over each run. */
export function listenTo(player) {
  for (const run of player.runs) followPointers(player, run);
  document.addEventListener("keydown", (event) => onKey(player, event));
}

/** Follow pointers over a run: hover, tap to choose, drag to move, pinch or wheel to zoom. */
function followPointers(player, run) {
  const { canvas, picture } = run;
  const pointers = new Map();
  let moved = 0;
  const at = (event) => {
    const box = canvas.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  };
  const spread = () => {
    const [one, other] = [...pointers.values()];
    return Math.hypot(one.x - other.x, one.y - other.y);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, at(event));
    moved = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const now = at(event);
    const before = pointers.get(event.pointerId);
    run.hover = event.pointerType === "touch" ? null : now;
    if (before && pointers.size === 1) {
      moved += Math.hypot(now.x - before.x, now.y - before.y);
      if (!picture.fitted) picture.pan(now.x - before.x, now.y - before.y);
    }
    if (before && pointers.size === 2) {
      const wide = spread();
      pointers.set(event.pointerId, now);
      const [one, other] = [...pointers.values()];
      if (wide > 0) player.zoom(spread() / wide, run, (one.x + other.x) / 2, (one.y + other.y) / 2);
      moved = Infinity;
    }
    if (before) pointers.set(event.pointerId, now);
    player.show(true);
  });
  const leave = (event) => {
    pointers.delete(event.pointerId);
    if (event.type === "pointerup" && moved < STILL) choose(player, run, at(event));
  };
  canvas.addEventListener("pointerup", leave);
  canvas.addEventListener("pointercancel", leave);
  canvas.addEventListener("pointerleave", () => {
    run.hover = null;
    player.show(true);
  });
  canvas.addEventListener(
    "wheel",
    (event) => {
      if (!event.ctrlKey && document.activeElement !== canvas) return; // the page scrolls
      event.preventDefault();
      const { x, y } = at(event);
      player.zoom(Math.exp(-0.002 * event.deltaY), run, x, y);
    },
    { passive: false },
  );
  canvas.addEventListener("focus", () => {
    player.focused = run;
  });
}

function onKey(player, event) {
  const { target, key } = event;
  if (event.altKey || event.ctrlKey || event.metaKey) return;
  const isOwn = target.closest("button, select, input, summary");
  if (
    isOwn &&
    (key === " " || key === "Enter" || key.startsWith("Arrow") || key === "Home" || key === "End")
  )
    return;
  const run = player.focused ?? player.runs[0];
  const many = event.shiftKey ? 10 : 1;
  const actions = {
    " ": () => (player.playing ? player.pause() : player.play()),
    ArrowLeft: () => player.stepFrames(-many),
    ArrowRight: () => player.stepFrames(many),
    Home: () => player.setTime(0),
    End: () => player.setTime(player.duration),
    "<": () => player.stepSpeed(-1),
    ">": () => player.stepSpeed(1),
    "+": () => player.zoom(ZOOM),
    "=": () => player.zoom(ZOOM),
    "-": () => player.zoom(1 / ZOOM),
    0: () => player.zoom(0),
    t: () => player.toggle("traces", !player.traces),
    f: () => player.hasForces && player.toggle("forces", !player.forces),
    n: () => keepNextParcel(player, run),
    m: () => keepModule(player, run, 0, 0),
    Escape: () => {
      for (const each of player.runs) each.kept = NOTHING;
      player.show(true);
    },
  };
  if (run.kept.module >= 0) {
    actions.ArrowLeft = () => keepModule(player, run, 0, -1);
    actions.ArrowRight = () => keepModule(player, run, 0, 1);
    actions.ArrowUp = () => keepModule(player, run, 1, 0);
    actions.ArrowDown = () => keepModule(player, run, -1, 0);
  }
  const action = actions[key.length === 1 ? key.toLowerCase() : key];
  if (!action) return;
  event.preventDefault();
  action();
}

/** Choose what is at a place of a run, to be read until another is. */
function choose(player, run, { x, y }) {
  const parcel = run.picture.parcelAt(x, y);
  run.kept = {
    parcel: parcel < 0 ? -1 : run.frame.parcels[parcel].number,
    module: parcel < 0 ? run.picture.moduleAt(x, y) : -1,
  };
  player.show(true);
}

function keepNextParcel(player, run) {
  const { parcels } = run.frame;
  if (!parcels.length) return;
  const at = parcels.findIndex((each) => each.number === run.kept.parcel);
  run.kept = { parcel: parcels[(at + 1) % parcels.length].number, module: -1 };
  player.show(true);
}

/** Go to the next module up and to the right; the first is the nearest to the middle. */
function keepModule(player, run, up, right) {
  const { rows, columns, rotor } = run.recording.surface;
  const [middleRow, middleColumn] = [Math.floor(rows / 2), Math.floor(columns / 2)];
  let found = -1;
  if (run.kept.module >= 0 && (up || right)) {
    let row = Math.floor(run.kept.module / columns) + up;
    let column = (run.kept.module % columns) + right;
    const isThere = () => row >= 0 && row < rows && column >= 0 && column < columns;
    while (isThere() && !rotor[row * columns + column]) {
      row += up;
      column += right;
    }
    if (isThere()) found = row * columns + column;
  } else {
    let least = Infinity;
    rotor.forEach((isRotor, k) => {
      const away = Math.hypot(Math.floor(k / columns) - middleRow, (k % columns) - middleColumn);
      if (isRotor && away < least) [least, found] = [away, k];
    });
  }
  if (found >= 0) run.kept = { parcel: -1, module: found };
  player.show(true);
}
