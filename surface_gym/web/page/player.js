/** A player of recordings, one or several in step: picture, controls and numbers. */

import { Picture } from "./draw.js";
import { paintPage } from "./palette.js";

const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2, 4];
const WIDE = 1.9; // width over height of pictures that go below one another
const ZOOM = 1.3; // of a key or a button
const REFRESH = 100; // [ms] between readings while it plays
const LONGEST_FORCE = 2.5; // [pitch] the arrow of the greatest friction
const KEYS = [
  ["Space", "play or pause"],
  ["← →", "a frame back or on; with Shift ten"],
  ["Home End", "to the start or the end"],
  ["< >", "slower, faster"],
  ["+ − 0", "zoom in, zoom out, all of it"],
  ["Ctrl + wheel, pinch", "zoom where you point; drag to move"],
  ["T F", "traces, forces"],
  ["N", "next parcel"],
  ["M", "a module; arrows then go to its neighbours, Escape leaves"],
];

/** Make an element with attributes and children. */
function make(kind, attributes = {}, ...children) {
  const element = document.createElement(kind);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

function degrees(angle) {
  return `${((angle * 180) / Math.PI)
    .toFixed(1)
    .replace(/^-0\.0$/, "0.0")
    .replace("-", "−")}°`;
}

/** Write an axis between −90 and 90 degrees: half a turn is the same axis. */
function axisText(angle) {
  const half = angle - Math.PI * Math.round(angle / Math.PI - 1e-6);
  return degrees(half);
}

export class Player {
  /**
   * @param {HTMLElement} root to fill
   * @param {{name: string, recording: import("./recording.js").Recording}[]} runs
   */
  constructor(root, runs) {
    this.root = root;
    this.time = 0;
    this.speed = 1;
    this.playing = false;
    this.duration = Math.max(...runs.map((run) => run.recording.duration));
    const longest = runs.find((run) => run.recording.duration === this.duration);
    this.frames = longest.recording.time;
    this.hasForces = runs.some((run) => run.recording.hasForces);
    this.traces = true;
    this.forces = false;
    this.read = 0;
    paintPage(document.documentElement, "auto");
    root.replaceChildren();
    this.room = make("div", { class: "runs" });
    root.append(this.room);
    this.runs = runs.map((run) => this._addRun(run));
    this.room.classList.toggle("several", runs.length > 1);
    this._addControls();
    this._addReadings();
    this._listen();
    this.setTime(0);
  }

  /** Play from here, or from the start where it has ended. */
  play() {
    if (this.time >= this.duration) this.time = 0;
    this.playing = true;
    let before = performance.now();
    const go = (now) => {
      if (!this.playing) return;
      const time = this.time + (this.speed * Math.max(0, now - before)) / 1000;
      before = now;
      this.setTime(Math.min(time, this.duration));
      if (this.time >= this.duration) this.pause();
      else requestAnimationFrame(go);
    };
    requestAnimationFrame(go);
    this._labelPlay();
  }

  pause() {
    this.playing = false;
    this._labelPlay();
    this._show(true);
  }

  /** Show a time [s]. */
  setTime(time) {
    this.time = Math.min(Math.max(time, 0), this.duration);
    this._show();
  }

  /** Go on by frames of the longest run, back where negative. */
  stepFrames(count) {
    this.pause();
    const { recording } = this.runs.find((run) => run.recording.time === this.frames);
    let index = recording.indexAt(this.time);
    if (count < 0 && this.time > this.frames[index] + 1e-9) index += 1;
    this.setTime(this.frames[Math.min(Math.max(index + count, 0), this.frames.length - 1)]);
  }

  setSpeed(speed) {
    this.speed = speed;
    this.controls.speed.value = String(speed);
  }

  zoom(factor, run = null, x = undefined, y = undefined) {
    for (const each of run ? [run] : this.runs) {
      if (factor === 0) each.picture.fit();
      else each.picture.zoom(factor, x, y);
      each.canvas.style.touchAction = each.picture.fitted ? "pan-y" : "none";
    }
    this._show();
  }

  setTheme(theme) {
    this.theme = theme;
    paintPage(document.documentElement, theme);
    for (const { picture } of this.runs) picture.setTheme(theme);
    this._show();
  }

  _addRun({ name, recording }) {
    const canvas = make("canvas", { tabindex: "0", role: "img", "aria-describedby": "reading" });
    const end = make("span", { class: "end" });
    const caption = make("figcaption", {}, make("strong", {}, name), end);
    this.room.append(make("figure", {}, caption, canvas));
    const most = Math.max(
      ...[0, ...recording.contacts[2].map((fx, k) => Math.hypot(fx, recording.contacts[3][k]))],
    );
    const pitch = recording.surface.pitch[0];
    const picture = new Picture(canvas, recording.surface, {
      forceScale: most ? (LONGEST_FORCE * pitch) / most : 0,
    });
    canvas.style.aspectRatio = String(picture.aspect);
    this.room.classList.toggle("wide", picture.aspect > WIDE);
    return { name, recording, canvas, picture, end, hover: null, kept: { parcel: -1, module: -1 } };
  }

  _addControls() {
    const button = (label, text, action, kind = "") => {
      const made = make(
        "button",
        { type: "button", "aria-label": label, title: label, class: kind },
        text,
      );
      made.addEventListener("click", action);
      return made;
    };
    const toggle = (label, isOn, action) => {
      const box = make("input", { type: "checkbox" });
      box.checked = isOn;
      box.addEventListener("change", () => action(box.checked));
      return make("label", {}, box, label);
    };
    const choice = (label, options, value, action) => {
      const made = make("select", { "aria-label": label });
      for (const [key, text] of options) made.append(make("option", { value: key }, text));
      made.value = value;
      made.addEventListener("change", () => action(made.value));
      return made;
    };
    const scrub = make("input", {
      type: "range",
      min: "0",
      max: String(this.frames.length - 1),
      step: "any",
      value: "0",
      "aria-label": "Time",
    });
    scrub.addEventListener("input", () => {
      this.playing = false;
      this._labelPlay();
      const index = Math.floor(Number(scrub.value));
      const [from, to] = [
        this.frames[index],
        this.frames[Math.min(index + 1, this.frames.length - 1)],
      ];
      this.setTime(from + (Number(scrub.value) - index) * (to - from));
    });
    this.controls = {
      play: button("Play", "Play", () => (this.playing ? this.pause() : this.play()), "main"),
      scrub,
      clock: make("output", { "aria-label": "Time shown" }),
      speed: choice(
        "Speed",
        SPEEDS.map((each) => [each, `${each}×`]),
        "1",
        (value) => this.setSpeed(Number(value)),
      ),
      traces: toggle("Traces", this.traces, (isOn) => this._toggle("traces", isOn)),
      forces: toggle("Forces", this.forces, (isOn) => this._toggle("forces", isOn)),
    };
    const { play, clock, speed, traces, forces } = this.controls;
    if (!this.hasForces) {
      forces.firstChild.disabled = true;
      forces.className = "off";
      forces.title = "Forces are not known of this run";
    }
    this.root.append(
      make(
        "div",
        { class: "controls", role: "group", "aria-label": "Playback" },
        play,
        button("A frame back", "‹", () => this.stepFrames(-1)),
        button("A frame on", "›", () => this.stepFrames(1)),
        scrub,
        clock,
        speed,
        make(
          "span",
          { class: "group" },
          button("Zoom out", "−", () => this.zoom(1 / ZOOM)),
          button("Zoom in", "+", () => this.zoom(ZOOM)),
          button("Show all", "Fit", () => this.zoom(0)),
        ),
        traces,
        forces,
        choice(
          "Theme",
          [
            ["auto", "Auto"],
            ["light", "Light"],
            ["dark", "Dark"],
          ],
          "auto",
          (theme) => this.setTheme(theme),
        ),
      ),
    );
  }

  _addReadings() {
    this.reading = make("p", { class: "reading", id: "reading", "aria-live": "polite" });
    this.table = make("table");
    const numbers = make(
      "details",
      {},
      make("summary", {}, "Numbers"),
      make("div", { class: "scroll" }, this.table),
    );
    numbers.addEventListener("toggle", () => this._show(true));
    this.numbers = numbers;
    const keys = make("dl");
    for (const [key, meaning] of KEYS) keys.append(make("dt", {}, key), make("dd", {}, meaning));
    this.root.append(
      this.reading,
      numbers,
      make("details", { class: "keys" }, make("summary", {}, "Keys"), keys),
    );
  }

  _toggle(name, isOn) {
    this[name] = isOn;
    this.controls[name].firstChild.checked = isOn;
    this._show();
  }

  _labelPlay() {
    const label = this.playing ? "Pause" : "Play";
    const { play } = this.controls;
    play.textContent = label;
    play.setAttribute("aria-label", label);
    play.title = `${label} (Space)`;
    this.reading.setAttribute("aria-live", this.playing ? "off" : "polite");
  }

  _show(isRead = !this.playing) {
    for (const run of this.runs) {
      const frame = run.recording.frameAt(Math.min(this.time, run.recording.duration), this);
      run.frame = frame;
      const point = run.hover && [run.hover.x, run.hover.y];
      run.picture.frame = frame;
      const parcel = point ? run.picture.parcelAt(...point) : -1;
      const module = point ? run.picture.moduleAt(...point) : -1;
      const kept = frame.parcels.findIndex((each) => each.number === run.kept.parcel);
      run.picture.chosen = {
        parcel: parcel < 0 ? kept : parcel,
        module: module < 0 || parcel >= 0 ? run.kept.module : module,
      };
      run.under = module;
      run.picture.draw(frame);
    }
    const { scrub, clock } = this.controls;
    const { recording } = this.runs.find((run) => run.recording.time === this.frames);
    const index = recording.indexAt(this.time);
    const next = this.frames[Math.min(index + 1, this.frames.length - 1)];
    const share =
      next > this.frames[index]
        ? (this.time - this.frames[index]) / (next - this.frames[index])
        : 0;
    scrub.value = String(index + share);
    const now = performance.now();
    if (!isRead && now - this.read < REFRESH) return;
    this.read = now;
    clock.textContent = `${this.time.toFixed(2)} / ${this.duration.toFixed(2)} s`;
    scrub.setAttribute(
      "aria-valuetext",
      `${this.time.toFixed(2)} of ${this.duration.toFixed(2)} seconds`,
    );
    this._readOut();
  }

  /** Write what is under the pointer or chosen, how runs end, and the numbers. */
  _readOut() {
    const lines = [];
    for (const run of this.runs) {
      const { recording, frame, picture } = run;
      const isOver = this.time >= recording.duration - 1e-9;
      run.end.textContent = isOver ? recording.head.outcome : "";
      const many = frame.parcels.length === 1 ? "one parcel" : `${frame.parcels.length} parcels`;
      run.canvas.setAttribute(
        "aria-label",
        `${run.name}: ${many} on a surface of ${recording.surface.rows} by ${recording.surface.columns}`,
      );
      const parts = [];
      const { parcel } = picture.chosen;
      const module = run.under >= 0 ? run.under : picture.chosen.module;
      if (parcel >= 0) parts.push(this._parcelText(run, frame.parcels[parcel]));
      if (module >= 0) parts.push(this._moduleText(run, module));
      if (parts.length)
        lines.push((this.runs.length > 1 ? `${run.name}: ` : "") + parts.join("; "));
    }
    const text =
      lines.join("\n") || "Point at a parcel or a module, or press N or M, to read its numbers.";
    if (this.reading.textContent !== text) this.reading.textContent = text;
    if (this.numbers.open) this._fillTable();
  }

  _parcelText({ recording, frame }, parcel) {
    const name = recording.parcels.length > 1 ? `parcel ${parcel.number + 1}` : "parcel";
    const label = parcel.label ? ` (${parcel.label})` : "";
    const speed = Math.hypot(parcel.vx, parcel.vy);
    const motion = `${speed.toFixed(2)} m/s towards ${degrees(Math.atan2(parcel.vy, parcel.vx))}, turning ${degrees(parcel.omega)}/s`;
    const pose = `at x ${parcel.x.toFixed(3)} m, y ${parcel.y.toFixed(3)} m, ${degrees(parcel.theta)}`;
    let forces = "";
    if (recording.hasForces) {
      const [normal, fx, fy] = recording.loadAt(frame.index);
      forces = `; carried with ${normal.toFixed(1)} N, friction ${Math.hypot(fx, fy).toFixed(1)} N towards ${degrees(Math.atan2(fy, fx))}`;
    }
    return `${name}${label} ${motion}, ${pose}${forces}`;
  }

  _moduleText({ recording }, module) {
    const { columns, obeys } = recording.surface;
    const axis = axisText(recording.axes[module]);
    const fixed = obeys[module] ? "" : ", fixed";
    return `module in row ${Math.floor(module / columns)}, column ${module % columns}: axis ${axis}${fixed}`;
  }

  _fillTable() {
    const names = [
      ...new Set(this.runs.flatMap((run) => run.recording.metrics.map(([name]) => name))),
    ];
    const head = make(
      "tr",
      {},
      make("th", { scope: "col" }, ""),
      ...this.runs.map((run) => make("th", { scope: "col" }, run.name)),
    );
    const rows = names.map((name) => {
      const cells = this.runs.map(({ recording, frame }) => {
        const value = recording.metrics.find(([each]) => each === name)?.[1][frame.index];
        return make("td", {}, Number.isFinite(value) ? String(Number(value.toPrecision(4))) : "–");
      });
      return make("tr", {}, make("th", { scope: "row" }, name.replaceAll("_", " ")), ...cells);
    });
    this.table.replaceChildren(head, ...rows);
  }

  _listen() {
    for (const run of this.runs) this._listenTo(run);
    document.addEventListener("keydown", (event) => this._onKey(event));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () =>
      this.setTheme(this.theme ?? "auto"),
    );
  }

  /** Follow pointers over a run: hover, tap to choose, drag to move, pinch or wheel to zoom. */
  _listenTo(run) {
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
        if (wide > 0) this.zoom(spread() / wide, run, (one.x + other.x) / 2, (one.y + other.y) / 2);
        moved = Infinity;
      }
      if (before) pointers.set(event.pointerId, now);
      this._show(true);
    });
    const leave = (event) => {
      pointers.delete(event.pointerId);
      if (event.type === "pointerup" && moved < 5) this._choose(run, at(event));
    };
    canvas.addEventListener("pointerup", leave);
    canvas.addEventListener("pointercancel", leave);
    canvas.addEventListener("pointerleave", () => {
      run.hover = null;
      this._show(true);
    });
    canvas.addEventListener(
      "wheel",
      (event) => {
        if (!event.ctrlKey && document.activeElement !== canvas) return; // the page scrolls
        event.preventDefault();
        const { x, y } = at(event);
        this.zoom(Math.exp(-0.002 * event.deltaY), run, x, y);
      },
      { passive: false },
    );
    canvas.addEventListener("focus", () => {
      this.focused = run;
    });
  }

  /** Choose what is at a place of a run, to be read until another is. */
  _choose(run, { x, y }) {
    const parcel = run.picture.parcelAt(x, y);
    run.kept = {
      parcel: parcel < 0 ? -1 : run.frame.parcels[parcel].number,
      module: parcel < 0 ? run.picture.moduleAt(x, y) : -1,
    };
    this._show(true);
  }

  _onKey(event) {
    const { target, key } = event;
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    const isOwn = target.closest("button, select, input, summary");
    if (
      isOwn &&
      (key === " " || key === "Enter" || key.startsWith("Arrow") || key === "Home" || key === "End")
    )
      return;
    const run = this.focused ?? this.runs[0];
    const many = event.shiftKey ? 10 : 1;
    const actions = {
      " ": () => (this.playing ? this.pause() : this.play()),
      ArrowLeft: () => this.stepFrames(-many),
      ArrowRight: () => this.stepFrames(many),
      Home: () => this.setTime(0),
      End: () => this.setTime(this.duration),
      "<": () => this.setSpeed(SPEEDS[Math.max(0, SPEEDS.indexOf(this.speed) - 1)]),
      ">": () => this.setSpeed(SPEEDS[Math.min(SPEEDS.length - 1, SPEEDS.indexOf(this.speed) + 1)]),
      "+": () => this.zoom(ZOOM),
      "=": () => this.zoom(ZOOM),
      "-": () => this.zoom(1 / ZOOM),
      0: () => this.zoom(0),
      t: () => this._toggle("traces", !this.traces),
      f: () => this.hasForces && this._toggle("forces", !this.forces),
      n: () => this._nextParcel(run),
      m: () => this._keepModule(run, 0, 0),
      Escape: () => {
        for (const each of this.runs) each.kept = { parcel: -1, module: -1 };
        this._show(true);
      },
    };
    if (run.kept.module >= 0) {
      actions.ArrowLeft = () => this._keepModule(run, 0, -1);
      actions.ArrowRight = () => this._keepModule(run, 0, 1);
      actions.ArrowUp = () => this._keepModule(run, 1, 0);
      actions.ArrowDown = () => this._keepModule(run, -1, 0);
    }
    const action = actions[key.length === 1 ? key.toLowerCase() : key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  _nextParcel(run) {
    const { parcels } = run.frame;
    if (!parcels.length) return;
    const at = parcels.findIndex((each) => each.number === run.kept.parcel);
    run.kept = { parcel: parcels[(at + 1) % parcels.length].number, module: -1 };
    this._show(true);
  }

  /** Go to the next module up and to the right; the first is the nearest to the middle. */
  _keepModule(run, up, right) {
    const { rows, columns, rotor } = run.recording.surface;
    const [middleRow, middleColumn] = [Math.floor(rows / 2), Math.floor(columns / 2)];
    let found = -1;
    if (run.kept.module >= 0 && (up || right)) {
      let row = Math.floor(run.kept.module / columns) + up;
      let column = (run.kept.module % columns) + right;
      while (
        row >= 0 &&
        row < rows &&
        column >= 0 &&
        column < columns &&
        !rotor[row * columns + column]
      ) {
        row += up;
        column += right;
      }
      if (row >= 0 && row < rows && column >= 0 && column < columns) found = row * columns + column;
    } else {
      let least = Infinity;
      rotor.forEach((isRotor, k) => {
        const away = Math.hypot(Math.floor(k / columns) - middleRow, (k % columns) - middleColumn);
        if (isRotor && away < least) [least, found] = [away, k];
      });
    }
    if (found >= 0) run.kept = { parcel: -1, module: found };
    this._show(true);
  }
}
