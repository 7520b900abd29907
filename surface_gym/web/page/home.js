/**
 * The comparison on the site's home page: the same boxes on two lines, live. Above, one zone is
 * arranged as a whole for each box; below, every module obeys the box that it bears.
 */

import { Picture } from "./draw.js";
import { find, number } from "./elements.js";
import { catchUp, explain, get, Machine, Obeying, passedSince } from "./machine.js";
import { AskedTheme, paintPage } from "./palette.js";
import { CompiledRule } from "./rule.js";
import { TaskRun } from "./task.js";

const HOUR = 3600; // [s]
const FULL = 9; // [s] of the stream, with which a show begins: boxes are all along both lines
const MEAN_OVER = 30; // [s] of deliveries an hour, at most,
const MEAN_LEAST = 3; // [s] and at least
const EXACT_TO = 100; // [1/h] to which such a mean is written: a box more makes 120 in 30 s
const BEFORE = 1.7; // [m] before the line, where boxes are drawn that wait
const APART = 0.04; // [m] between two of them

/** Write a whole number, its thousands apart; "–" for NaN. */
const written = (count) =>
  Number.isNaN(count) ? "–" : count.toLocaleString("en").replaceAll(",", "\u202f");

/** A run of a line, on which boxes come at a rate that may change. */
class LineRun extends TaskRun {
  /** Keep no record, which would grow with every box. */
  _record() {
    this.scene.commands = [];
  }

  /** Let the boxes to come follow each other at a rate [1/h]. */
  setRate(rate) {
    const times = this.machine.view("streams.time");
    const due = this.machine.get("streams.due");
    const gap = HOUR / rate;
    const last = Math.max(times[due - 1], this.time - gap);
    for (let k = due; k < times.length; k++) times[k] = last + gap * (k - due + 1);
  }

  /** Count what has come about, and what waits. */
  count() {
    const tally = Array.from(this.machine.view("streams.tally"), Number);
    const [entered, delivered, wrong, touches] = tally;
    const waiting = this.machine.get("streams.due") - entered;
    return { time: this.time, delivered, wrong, touches, waiting };
  }

  /** Whether all boxes have come that there are. */
  get hasAll() {
    return this.machine.get("streams.due") >= this.machine.get("streams.arrivals");
  }

  surface() {
    const surface = super.surface();
    const [left, ...others] = surface.view;
    return { ...surface, view: [left - BEFORE, ...others] };
  }

  /** What is seen, and before the line the boxes that wait, as many as the gate shows. */
  frame(options) {
    const frame = super.frame(options);
    const { machine } = this;
    const numbers = machine.view("streams.number");
    const first = numbers.length - machine.get("stream_params.queue");
    const shown = numbers.subarray(first).findLastIndex((each) => each >= 0n) + 1;
    let rear = this.about.origin[0] - this.about.pitch[0] / 2;
    for (let row = first; row < first + shown; row++) {
      const look = this._look(row);
      const half = Math.max(...look.outline.map(([x]) => x));
      rear -= APART + 2 * half;
      const [, y] = machine.row("parcels.truth", row);
      frame.parcels.push({ x: rear + half, y, theta: 0, ...look });
    }
    const more = this.count().waiting - shown;
    if (shown && more) frame.parcels.at(-1).label = `+${written(more)}`;
    return frame;
  }
}

/** A scheduler of a line: it lets boxes in, and leads those on the line. */
class Scheduler extends CompiledRule {
  /** Write what modules and the gate are to do for a control period. */
  act(run) {
    const [actions] = this.call(run, "tables", "actions");
    if (this.card.byGroups) run.wanted.set(actions);
    else this.obeying.act(run, actions);
    run.wanted[run.wanted.length - 1] = actions.at(-1);
  }
}

/** A line with its picture and its readings. */
class Line {
  constructor(run, figure) {
    this.run = run;
    const canvas = figure.querySelector("canvas");
    this.picture = new Picture(canvas, run.surface(), { theme: "auto" });
    canvas.style.aspectRatio = String(this.picture.aspect);
    this.name = figure.querySelector("figcaption b").textContent;
    this.readings = new Map(
      [...figure.querySelectorAll("dd")].map((each) => [each.dataset.reading, each]),
    );
    this.past = []; // counts of the control periods over which the rate is a mean
  }

  begin(rate) {
    this.run.begin();
    this.run.setRate(rate);
    this.past = [];
  }

  advance() {
    this.run.advance();
    const now = this.run.count();
    if (now.time < this.run.machine.layout.warmUp) return;
    this.past.push(now);
    while (now.time - this.past[0].time > MEAN_OVER + 1e-6) this.past.shift();
  }

  /** Correct deliveries an hour, of late; NaN while the line is too young. */
  get rate() {
    const [first, last] = [this.past[0], this.past.at(-1)];
    const time = first ? last.time - first.time : 0;
    if (time < MEAN_LEAST) return Number.NaN;
    return EXACT_TO * Math.round((HOUR * (last.delivered - first.delivered)) / time / EXACT_TO);
  }

  draw(share) {
    this.picture.draw(this.run.frame({ share }));
    const now = { ...this.run.count(), rate: this.rate };
    for (const [name, cell] of this.readings) {
      const text = written(now[name]);
      if (cell.textContent !== text) cell.textContent = text;
    }
    this.readings.get("wrong").parentElement.hidden = now.wrong === 0;
  }

  /** Say how the line stands, for those who hear it. */
  get summary() {
    const { delivered, waiting } = this.run.count();
    const rate = written(this.rate);
    return `${this.name}: ${written(delivered)} deliveries, ${rate} per hour; ${written(waiting)} wait`;
  }
}

/** Both lines, their stream, and the page's controls. */
class Home {
  constructor(lines) {
    this.lines = lines;
    this.unit = lines[0].run.unit; // [s] of a control period
    this.isStarted = false; // by the reader
    this.isSeen = false;
    this.owed = 0; // [s] of the stream that are to be stepped
    this.last = null; // [ms] when the last frame was
    this.asked = 0;
    this.moved = 0; // [ms] after the page was asked for, when it first drew what has moved
  }

  get isRunning() {
    return this.isStarted && this.isSeen;
  }

  /** Begin the stream anew, with boxes all along the lines. */
  begin() {
    const rate = number("rate");
    for (const line of this.lines) line.begin(rate);
    for (let k = 0; k < Math.round(FULL / this.unit); k++) this.step();
    this.owed = 0;
    this.draw();
  }

  /** Do a control period of both lines; after the last box they begin anew. */
  step() {
    for (const line of this.lines) line.advance();
    if (this.lines[0].run.hasAll) this.begin();
  }

  /** Let boxes come as the slider says, from now on. */
  setRate() {
    for (const { run } of this.lines) run.setRate(number("rate"));
    this.write();
  }

  setTheme(theme) {
    paintPage(theme, this.lines);
    this.draw();
  }

  start() {
    this.isStarted = true;
    this.go();
  }

  pause() {
    this.isStarted = false;
    this.go();
  }

  /** Let frames come while the page runs, and say how it stands. */
  go() {
    find("start").textContent = this.isStarted ? "Pause" : "Start";
    const state = this.isStarted ? "" : this.lines.map(({ summary }) => summary).join(". ");
    if (find("state").textContent !== state) find("state").textContent = state;
    if (!this.isRunning) this.last = null;
    else if (!this.asked) this.asked = requestAnimationFrame((now) => this.frame(now));
  }

  frame(now) {
    this.asked = 0;
    if (!this.isRunning) return;
    try {
      const passed = passedSince(this.last ?? now, now);
      this.last = now;
      this.owed = catchUp(this.owed, passed * number("speed"), this.unit, () => {
        this.step();
        this.moved ||= performance.now();
      });
      this.draw();
      this.go();
    } catch (error) {
      this.pause();
      say(error);
    }
  }

  draw() {
    for (const line of this.lines) line.draw(Math.min(1, this.owed / this.unit));
  }

  /** Write the rate beside its slider. */
  write() {
    const rate = written(number("rate"));
    find("rate").setAttribute("aria-valuetext", `${rate} boxes an hour`);
    document.querySelector("output").textContent = rate;
  }
}

function say(error) {
  find("message").hidden = false;
  find("message").textContent = explain(error);
}

/** Load the stream, which both lines have, and the module of Flow, which steps it. */
async function loadLines() {
  const [layout, block, code] = await Promise.all([
    get("home.json", "json"),
    get("home.bin", "arrayBuffer"),
    get("flow.wasm", "arrayBuffer"),
  ]);
  const figures = document.querySelectorAll("figure");
  return Promise.all(
    layout.lines.map(async (card, k) => {
      const machine = await Machine.make("home", layout, block, code, new ArrayBuffer(0));
      const scene = { seed: 0, late: 0, stuck: [], commands: [] };
      const obeying = await Obeying.load(layout.obeying, machine);
      const own = await Machine.load(card.machine, card.code);
      const run = new LineRun(machine, scene, new Scheduler(card, { machine: own, obeying }));
      return new Line(run, figures[k]);
    }),
  );
}

async function begin() {
  const asked = new AskedTheme(); // the page around may ask before the lines are loaded
  paintPage(asked.name);
  for (const figure of document.querySelectorAll("figure"))
    figure.append(find("readings").content.cloneNode(true)); // before their numbers are known
  try {
    const home = new Home(await loadLines());
    globalThis.home = home; // for those who want to look into it
    home.begin();
    home.write();
    asked.follow(() => home.setTheme(asked.name));
    find("start").addEventListener("click", () => (home.isStarted ? home.pause() : home.start()));
    find("again").addEventListener("click", () => home.begin());
    find("rate").addEventListener("input", () => home.setRate());
    new IntersectionObserver(([{ isIntersecting }]) => {
      home.isSeen = isIntersecting;
      home.go();
    }).observe(document.body);
    if (!matchMedia("(prefers-reduced-motion: reduce)").matches) home.start();
    else home.pause();
    window.frameElement?.dispatchEvent(new Event("ready")); // the page around shows this one now
  } catch (error) {
    say(error);
  }
}

begin();
