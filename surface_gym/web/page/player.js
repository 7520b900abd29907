/** A page that plays the recordings it holds, one or several in step. */

import { Picture } from "./draw.js";
import { find, make } from "./elements.js";
import { followPointers } from "./gestures.js";
import { AskedTheme, paintPage } from "./palette.js";
import { Panel } from "./panel.js";
import { readRecording } from "./recording.js";
import { ARROWS, nextModule } from "./view.js";

const WIDE = 1.9; // width over height of pictures that go below one another
const REFRESH = 100; // [ms] between readings while it plays
const LONG_FORCE = 2; // [pitch] the arrow of a large friction
const LONGEST = 2; // times it, an arrow at most
const ZOOM = 1.3; // of a key or a button
const STILL = 5; // [px] that a pointer may move in a tap
const NOTHING = { parcel: -1, module: -1 };

/**
 * @typedef {object} Run as a player shows it
 * @property {string} name
 * @property {import("./recording.js").Recording} recording
 * @property {HTMLCanvasElement} canvas
 * @property {Picture} picture
 * @property {HTMLElement} end where its outcome is written
 * @property {number[]|null} hover [px] where the pointer is over it
 * @property {{parcel: number, module: number}} kept what is chosen to be read; -1: none
 * @property {import("./draw.js").Frame} [frame] that is shown
 * @property {number} [under] the module under the pointer; -1: none
 */

/** Let pictures of surfaces that lie alike show the same part, all that any of them shows. */
function shareView(surfaces) {
  const [first] = surfaces;
  const lieAlike = surfaces.every(
    (each) =>
      each.view &&
      each.rows === first.rows &&
      each.columns === first.columns &&
      [0, 1].every((k) => each.pitch[k] === first.pitch[k] && each.origin[k] === first.origin[k]),
  );
  if (!lieAlike) return;
  const [lefts, lows, rights, highs] = [0, 1, 2, 3].map((k) => surfaces.map(({ view }) => view[k]));
  const view = [Math.min(...lefts), Math.min(...lows), Math.max(...rights), Math.max(...highs)];
  for (const each of surfaces) each.view = view;
}

/** Find where [px] the chosen parcel of a run is, if there is one. */
function placeOfKept({ frame, kept, picture }) {
  const parcel = frame.parcels.find((each) => each.number === kept.parcel);
  return parcel ? picture.toCanvas(parcel.x, parcel.y) : [];
}

class Player {
  /**
   * @param {{name: string, recording: import("./recording.js").Recording}[]} runs
   * @param {AskedTheme} asked
   */
  constructor(runs, asked) {
    this.time = 0;
    this.playing = false;
    this.longest = runs
      .map(({ recording }) => recording)
      .reduce((one, other) => (other.duration > one.duration ? other : one));
    this.duration = this.longest.duration;
    this.frames = this.longest.time;
    this.traces = true;
    this.forces = false;
    this.read = 0; // [ms] when readings were written
    this.theme = "auto";
    this.asked = asked;
    paintPage(asked.name);
    shareView(runs.map((run) => run.recording.surface));
    this.runs = runs.map((run) => this._addRun(run));
    find("runs").classList.toggle("several", runs.length > 1);
    this.panel = new Panel(this.runs);
    this._connect();
    this._labelPlay();
    this.setTime(0);
    asked.follow(() => this.setTheme(this.theme));
  }

  get speed() {
    return Number(find("speed").value);
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
    this.show(true);
  }

  /** Play or pause. */
  turn() {
    if (this.playing) this.pause();
    else this.play();
  }

  /** Show a time [s]. */
  setTime(time) {
    this.time = Math.min(Math.max(time, 0), this.duration);
    this.show();
  }

  /** Go on by frames of the longest run, back where negative. */
  stepFrames(count) {
    this.pause();
    let index = this.longest.indexAt(this.time);
    if (count < 0 && this.time > this.frames[index] + 1e-9) index += 1;
    this.setTime(this.frames[Math.min(Math.max(index + count, 0), this.frames.length - 1)]);
  }

  /** Go on by that many speeds to choose from, to slower ones where negative. */
  stepSpeed(count) {
    const speed = find("speed");
    const last = speed.options.length - 1;
    speed.selectedIndex = Math.min(Math.max(speed.selectedIndex + count, 0), last);
  }

  /**
   * Zoom all runs by a factor, each about the parcel chosen in it or else its middle, or one about a
   * place [px] of it; 0: show all of them.
   */
  zoom(factor, run = null, place = null) {
    for (const each of run ? [run] : this.runs) {
      if (factor === 0) each.picture.fit();
      else each.picture.zoom(factor, ...(place ?? placeOfKept(each)));
      each.canvas.style.touchAction = each.picture.fitted ? "pan-y" : "none";
    }
    this.show();
  }

  /** Take a theme that the reader chose; "auto" is what the page is asked to have. */
  setTheme(theme) {
    this.theme = theme;
    const name = theme === "auto" ? this.asked.name : theme;
    paintPage(name, this.runs);
    this.show();
  }

  /** Show traces or forces, or no longer. */
  toggle(name, isOn) {
    this[name] = isOn;
    find(name).checked = isOn;
    this.show();
  }

  /** Choose a parcel, by its number, or a module of a run, to be read until another is. */
  keep(run, parcel, module = -1) {
    run.kept = { parcel, module };
    this.show(true);
  }

  /** Choose what is at a place of a run. */
  keepAt(run, place) {
    const parcel = run.picture.parcelAt(...place);
    if (parcel < 0) this.keep(run, -1, run.picture.moduleAt(...place));
    else this.keep(run, run.frame.parcels[parcel].number);
  }

  keepNextParcel(run) {
    const { parcels } = run.frame;
    const at = parcels.findIndex((each) => each.number === run.kept.parcel);
    if (parcels.length) this.keep(run, parcels[(at + 1) % parcels.length].number);
  }

  /** Keep the next module from a module in an arrow's direction; from -1, the middle's. */
  keepModule(run, module, arrow) {
    const found = nextModule(run.recording.surface, module, arrow);
    if (found >= 0) this.keep(run, -1, found);
    else this.show(true);
  }

  _addRun({ name, recording }) {
    const canvas = make("canvas", { tabindex: "0", role: "img", "aria-describedby": "reading" });
    const end = make("span", { class: "end" });
    const caption = make("figcaption", {}, make("strong", {}, name), end);
    find("runs").append(make("figure", {}, caption, canvas));
    const large = recording.findLargeFriction();
    const long = LONG_FORCE * recording.surface.pitch[0];
    const picture = new Picture(canvas, recording.surface, {
      forceScale: large ? long / large : 0,
      longestForce: LONGEST * long,
    });
    canvas.style.aspectRatio = String(picture.aspect);
    find("runs").classList.toggle("wide", picture.aspect > WIDE);
    return { name, recording, canvas, picture, end, hover: null, kept: NOTHING };
  }

  /** Let controls, keys and pointers do what they say. */
  _connect() {
    const on = (id, does, kind = "click") =>
      find(id).addEventListener(kind, ({ target }) => does(target));
    on("play", () => this.turn());
    on("back", () => this.stepFrames(-1));
    on("on", () => this.stepFrames(1));
    on("out", () => this.zoom(1 / ZOOM));
    on("in", () => this.zoom(ZOOM));
    on("fit", () => this.zoom(0));
    on("traces", ({ checked }) => this.toggle("traces", checked), "change");
    on("forces", ({ checked }) => this.toggle("forces", checked), "change");
    on("theme", ({ value }) => this.setTheme(value), "change");
    on("time", ({ value }) => this._scrub(Number(value)), "input");
    find("time").max = String(this.frames.length - 1);
    this.hasForces = this.runs.some((run) => run.recording.hasForces);
    if (!this.hasForces) {
      find("forces").disabled = true;
      find("forces").parentElement.className = "off";
      find("forces").parentElement.title = "Forces are not known of this run";
    }
    for (const run of this.runs) this._followPointers(run);
    document.addEventListener("keydown", (event) => this._takeKey(event));
  }

  /** Hover to read, tap to choose, drag to move, pinch or wheel to zoom. */
  _followPointers(run) {
    const { canvas, picture } = run;
    let moved = 0;
    followPointers(canvas, {
      press: () => {
        moved = 0;
      },
      move: (place, before, { pointerType }) => {
        run.hover = pointerType === "touch" ? null : place;
        if (before) {
          const [dx, dy] = [place[0] - before[0], place[1] - before[1]];
          moved += Math.hypot(dx, dy);
          if (!picture.fitted) picture.pan(dx, dy);
        }
        this.show(true);
      },
      release: (place) => {
        if (place && moved < STILL) this.keepAt(run, place);
      },
      zoom: (factor, place) => {
        moved = Infinity;
        this.zoom(factor, run, place);
      },
      takesWheel: () => document.activeElement === canvas, // otherwise the page scrolls
    });
    canvas.addEventListener("pointerleave", () => {
      run.hover = null;
      this.show(true);
    });
    canvas.addEventListener("focus", () => {
      this.focused = run;
    });
  }

  _takeKey(event) {
    const { target, key } = event;
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    const isControl = target.closest("button, select, input, summary");
    if (isControl && (/^( |Enter|Home|End)$/.test(key) || key.startsWith("Arrow"))) return;
    const run = this.focused ?? this.runs[0];
    const many = event.shiftKey ? 10 : 1;
    const actions = {
      " ": () => this.turn(),
      ArrowLeft: () => this.stepFrames(-many),
      ArrowRight: () => this.stepFrames(many),
      Home: () => this.setTime(0),
      End: () => this.setTime(this.duration),
      "<": () => this.stepSpeed(-1),
      ">": () => this.stepSpeed(1),
      "+": () => this.zoom(ZOOM),
      "=": () => this.zoom(ZOOM),
      "-": () => this.zoom(1 / ZOOM),
      0: () => this.zoom(0),
      t: () => this.toggle("traces", !this.traces),
      f: () => this.hasForces && this.toggle("forces", !this.forces),
      n: () => this.keepNextParcel(run),
      m: () => this.keepModule(run, -1),
      Escape: () => {
        for (const each of this.runs) each.kept = NOTHING;
        this.show(true);
      },
    };
    const { module } = run.kept;
    if (module >= 0) {
      for (const [name, arrow] of Object.entries(ARROWS))
        actions[name] = () => this.keepModule(run, module, arrow);
    }
    const action = actions[key.length === 1 ? key.toLowerCase() : key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  /** Show the time at a place between frames. */
  _scrub(place) {
    this.playing = false;
    this._labelPlay();
    const index = Math.floor(place);
    const [from, to] = [0, 1].map((k) => this.frames[Math.min(index + k, this.frames.length - 1)]);
    this.setTime(from + (place - index) * (to - from));
  }

  _labelPlay() {
    const label = this.playing ? "Pause" : "Play";
    const button = find("play");
    button.textContent = label;
    button.setAttribute("aria-label", label);
    button.title = `${label} (Space)`;
    this.panel.setLive(!this.playing);
  }

  /** Draw the time that is shown; readings follow now and then, or at once where `isRead`. */
  show(isRead = !this.playing) {
    for (const run of this.runs) {
      const { picture } = run;
      run.frame = run.recording.frameAt(Math.min(this.time, run.recording.duration), this);
      picture.frame = run.frame;
      const parcel = run.hover ? picture.parcelAt(...run.hover) : -1;
      run.under = run.hover ? picture.moduleAt(...run.hover) : -1;
      const kept = run.frame.parcels.findIndex((each) => each.number === run.kept.parcel);
      picture.chosen = {
        parcel: parcel < 0 ? kept : parcel,
        module: run.under < 0 || parcel >= 0 ? run.kept.module : run.under,
      };
      picture.draw(run.frame);
    }
    const index = this.longest.indexAt(this.time);
    const from = this.frames[index];
    const next = this.frames[Math.min(index + 1, this.frames.length - 1)];
    find("time").value = String(index + (next > from ? (this.time - from) / (next - from) : 0));
    const now = performance.now();
    if (!isRead && now - this.read < REFRESH) return;
    this.read = now;
    const [time, duration] = [this.time, this.duration].map((each) => each.toFixed(2));
    find("clock").textContent = `${time} / ${duration} s`;
    find("time").setAttribute("aria-valuetext", `${time} of ${duration} seconds`);
    this.panel.write(this.time);
  }
}

const page = find("replay");
try {
  const asked = new AskedTheme(); // the page around may ask before recordings are read
  const held = [...document.querySelectorAll("script.recording")];
  const runs = await Promise.all(
    held.map(async ({ dataset, textContent }) => ({
      name: dataset.name,
      recording: await readRecording(textContent),
    })),
  );
  page.hidden = false;
  new Player(runs, asked);
} catch (error) {
  page.hidden = false;
  page.setAttribute("role", "alert");
  page.textContent = `This replay cannot be shown: ${error.message}. It needs a browser of 2023 or later.`;
}
