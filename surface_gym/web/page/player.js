/** A player of recordings, one or several in step: pictures and controls. */

import { Picture } from "./draw.js";
import { listenTo, ZOOM } from "./gestures.js";
import { paintPage } from "./palette.js";
import { make, Panel } from "./panel.js";

const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2, 4];
const WIDE = 1.9; // width over height of pictures that go below one another
const REFRESH = 100; // [ms] between readings while it plays
const LONG_FORCE = 2; // [pitch] the arrow of a large friction
const LONGEST = 2; // times it, an arrow at most

/**
 * @typedef {object} Run as a player shows it
 * @property {string} name
 * @property {import("./recording.js").Recording} recording
 * @property {HTMLCanvasElement} canvas
 * @property {Picture} picture
 * @property {HTMLElement} end where its outcome is written
 * @property {{x: number, y: number}|null} hover [px] where the pointer is over it
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

export class Player {
  /**
   * @param {HTMLElement} root to fill
   * @param {{name: string, recording: import("./recording.js").Recording}[]} runs
   * @param {import("./theme.js").AskedTheme} asked
   */
  constructor(root, runs, asked) {
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
    this.theme = "auto";
    this.asked = asked;
    paintPage(document.documentElement, asked.name);
    root.replaceChildren();
    this.room = make("div", { class: "runs" });
    root.append(this.room);
    shareView(runs.map((run) => run.recording.surface));
    this.runs = runs.map((run) => this._addRun(run));
    this.room.classList.toggle("several", runs.length > 1);
    this._addControls();
    this.panel = new Panel(root, this.runs);
    listenTo(this);
    this.setTime(0);
    asked.follow(() => this.setTheme(this.theme));
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

  /** Show a time [s]. */
  setTime(time) {
    this.time = Math.min(Math.max(time, 0), this.duration);
    this.show();
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

  /** Go on by that many speeds to choose from, to slower ones where negative. */
  stepSpeed(count) {
    const index = SPEEDS.indexOf(this.speed) + count;
    this.setSpeed(SPEEDS[Math.min(Math.max(index, 0), SPEEDS.length - 1)]);
  }

  /**
   * Zoom all runs by a factor, each about the parcel chosen in it or else its middle, or one about a
   * place [px] of it; 0: show all of them.
   */
  zoom(factor, run = null, x = undefined, y = undefined) {
    for (const each of run ? [run] : this.runs) {
      if (factor === 0) each.picture.fit();
      else each.picture.zoom(factor, ...(x === undefined ? placeOfKept(each) : [x, y]));
      each.canvas.style.touchAction = each.picture.fitted ? "pan-y" : "none";
    }
    this.show();
  }

  /** Take a theme that the reader chose; "auto" is what the page is asked to have. */
  setTheme(theme) {
    this.theme = theme;
    const name = theme === "auto" ? this.asked.name : theme;
    paintPage(document.documentElement, name);
    for (const { picture } of this.runs) picture.setTheme(name);
    this.show();
  }

  _addRun({ name, recording }) {
    const canvas = make("canvas", { tabindex: "0", role: "img", "aria-describedby": "reading" });
    const end = make("span", { class: "end" });
    const caption = make("figcaption", {}, make("strong", {}, name), end);
    this.room.append(make("figure", {}, caption, canvas));
    const large = recording.findLargeFriction();
    const long = LONG_FORCE * recording.surface.pitch[0];
    const picture = new Picture(canvas, recording.surface, {
      forceScale: large ? long / large : 0,
      longestForce: LONGEST * long,
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
      traces: toggle("Traces", this.traces, (isOn) => this.toggle("traces", isOn)),
      forces: toggle("Forces", this.forces, (isOn) => this.toggle("forces", isOn)),
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

  /** Show traces or forces, or no longer. */
  toggle(name, isOn) {
    this[name] = isOn;
    this.controls[name].firstChild.checked = isOn;
    this.show();
  }

  _labelPlay() {
    const label = this.playing ? "Pause" : "Play";
    const { play } = this.controls;
    play.textContent = label;
    play.setAttribute("aria-label", label);
    play.title = `${label} (Space)`;
    this.panel.setLive(!this.playing);
  }

  /** Draw the time that is shown; readings follow now and then, or at once where `isRead`. */
  show(isRead = !this.playing) {
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
    this.panel.write(this.time);
  }
}
