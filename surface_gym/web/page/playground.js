/** The playground: a scene on the page, run, drawn, changed by the reader, and shared. */

import { Agents, YOU } from "./agents.js";
import { Picture } from "./draw.js";
import { find, make, number } from "./elements.js";
import {
  brushed,
  chosenAngle,
  chosenParcel,
  chosenTool,
  connect,
  fillForm,
  firstScene,
} from "./form.js";
import { catchUp, ensure, explain, get, Machine, Noise, passedSince } from "./machine.js";
import { paintPage } from "./palette.js";
import { listen } from "./pointer.js";
import { PLAYER } from "./rule.js";
import { fromFragment, isDriven, toFragment } from "./scene.js";
import { TableRun } from "./table.js";
import { TaskRun } from "./task.js";

const FORCE = 0.012; // [m/N] of an arrow
const DRAG_SPEED = 2; // [m/s] a metre dragged
const WRITE_EVERY = 700; // [ms] between addresses, at least
const CAMERA = "-camera"; // ends the name of a task whose parcels a camera senses
const SLOW = 600; // [ms] of waiting, after which the page says for what

class Playground {
  /** @param {string[]} modules names of tasks, alone, with a camera, and with driven modules */
  constructor(modules, agents) {
    this.modules = modules;
    this.agents = agents;
    this.loadAgents = async () => agents;
    this.machines = new Map(); // with their noise, as they were loaded, by name
    this.shown = []; // a run, its picture and its caption each
    this.isRunning = false;
    this.owed = 0; // [s] of the run that are to be stepped
    this.moved = 0; // [ms] after the page was asked for, when it first drew what has moved
    this.isStale = true;
    this.aim = null;
    this.written = "";
    this.opening = 0;
  }

  /** Names of the tasks that there are. */
  get tasks() {
    return this.modules.filter((name) => !name.includes("-"));
  }

  hasCamera(task) {
    return this.modules.includes(task + CAMERA);
  }

  /** Kinds of modules that a task may have here; the first is idle. */
  kinds(task) {
    const variants = this.modules.filter((name) => name.startsWith(`${task}-`));
    const kinds = variants.map((name) => name.slice(task.length));
    return ["idle", ...kinds.filter((kind) => kind !== CAMERA).map((kind) => kind.slice(1))];
  }

  /** Show a scene that is checked, at its beginning. */
  async open(scene) {
    const opening = ++this.opening;
    const isTable = scene.task === "table";
    const { task, camera, modules } = scene;
    ensure(!camera || this.hasCamera(task), `The page has no camera for the task ${task}.`);
    const hasKind = !isDriven(scene) || (!camera && this.kinds(task).includes(modules));
    ensure(hasKind, `The page has no such task with ${modules} modules.`);
    const names = isTable ? [null] : [isDriven(scene) ? YOU : scene.agent];
    const beside = find("beside").value;
    if (beside && this.scene?.task === task && !isTable && !isDriven(scene)) names.push(beside);
    const [agents, ...loaded] = await Promise.all([
      isTable ? this.agents : this.loadAgents(),
      ...names.map((_, k) => this._load(scene, k)),
    ]);
    this.agents = agents;
    const acting = await Promise.all(
      isTable ? [] : names.map((name, k) => agents.make(scene.task, name, loaded[k].machine)),
    );
    if (opening !== this.opening) return; // another was opened meanwhile
    const { seeds } = loaded[0].machine;
    ensure(
      isTable || scene.seed < seeds,
      `The page has starts of the seeds 0 to ${seeds - 1}, and the scene asks for ${scene.seed}.`,
    );
    const runs = loaded.map(({ machine, noise }, k) => {
      if (isTable) return new TableRun(machine, scene);
      const own = k === 0 ? scene : { ...structuredClone(scene), agent: names[k], commands: [] };
      return new TaskRun(machine, own, acting[k], noise);
    });
    this.scene = scene;
    for (const { picture } of this.shown) picture.dispose();
    find("pictures").replaceChildren();
    this.shown = runs.map((run, k) => this._show(run, names[k]));
    document.body.classList.toggle("at-table", isTable);
    fillForm(this);
    this.pause();
    this.say("");
  }

  /** Show the scene of the page's address. */
  async openAddress() {
    await this.open(await fromFragment(location.hash, this.tasks));
  }

  /** Load a task's machine and its noise, if any, or take what was loaded; the second is a copy. */
  async _load(scene, copy) {
    const { task, camera = false } = scene;
    const file = isDriven(scene) ? `${task}-${scene.modules}` : camera ? task + CAMERA : task;
    const key = `${file} ${copy}`;
    if (!this.machines.has(key)) {
      const name = task === "table" ? "the table" : `the task ${task}`;
      const text = `Loading ${name}. A checkout compiles it first, which takes up to a minute.`;
      const machine = await this._waitFor(Machine.load(file), text);
      this.machines.set(key, { machine, noise: camera ? await Noise.load(machine) : null });
    }
    return this.machines.get(key);
  }

  /** Wait for something; say what for, if it takes long. */
  async _waitFor(promise, text) {
    const timer = setTimeout(() => this.say(text), SLOW);
    try {
      return await promise;
    } finally {
      clearTimeout(timer);
      if (find("message").textContent === text) this.say("");
    }
  }

  _show(run, name) {
    const figure = find("picture").content.firstElementChild.cloneNode(true);
    const [canvas, caption] = figure.children;
    canvas.role = "application";
    canvas.ariaLabel = `Picture of the surface${name ? `, ${name} acts` : ""}. Arrows move the ring, Enter uses the tool.`;
    find("pictures").append(figure);
    const picture = new Picture(canvas, run.surface(), {
      theme: find("theme").value,
      forceScale: FORCE,
    });
    canvas.style.aspectRatio = String(Math.min(Math.max(picture.aspect, 0.8), 5));
    picture.resize();
    picture.fit();
    listen(picture, {
      tool: () => chosenTool().value,
      paint: (module, begins) => this.try(() => this.paint(run, module, begins)),
      throw: (from, to) => this.try(() => this.throw(run, from, to)),
      aim: (from, to) => {
        this.aim = from && { picture, from, to };
        this.isStale = true;
      },
      changed: () => {
        this.isStale = true;
      },
    });
    return { run, picture, caption, name };
  }

  /** Do something; show its error, if any, in plain words, and pause where nothing can go on. */
  try(does, stops = false) {
    const fail = (error) => {
      if (stops) this.pause();
      this.say(explain(error));
    };
    try {
      const done = does();
      return done?.catch ? done.catch(fail) : done;
    } catch (error) {
      return fail(error);
    }
  }

  say(text) {
    find("message").hidden = !text;
    find("message").textContent = text;
  }

  start() {
    if (this.shown.every(({ run }) => run.over)) this.again();
    this.say("");
    this.isRunning = true;
    this.owed = 0;
    find("start").textContent = "Pause";
    this._tell();
  }

  pause() {
    this.isRunning = false;
    find("start").textContent = "Start";
    this.isStale = true;
    this._tell();
  }

  /** Begin the scene again. */
  again() {
    for (const { run } of this.shown) run.begin();
    this.owed = 0;
    this.isStale = true;
    this._tell();
  }

  /** Do one control period, of a table as long. */
  stepOnce() {
    this.pause();
    const time = Math.max(...this.shown.map(({ run }) => run.unit), 0.02);
    for (const { run } of this.shown)
      for (let done = 0; done < time - 1e-9 && run.advance(); done += run.unit);
    this._tell();
  }

  /** Advance all runs by a step; pause, and return false, where none moves on. */
  advance() {
    let moved = false;
    for (const { run } of this.shown) moved = run.advance() || moved;
    if (!moved) this.pause();
    return moved;
  }

  /** Draw a frame; `passed` [s] since the last. */
  frame(passed) {
    if (this.isRunning) {
      const unit = Math.max(...this.shown.map(({ run }) => run.unit));
      const due = passed * number("speed");
      this.owed = catchUp(this.owed, due, unit, () => this.advance());
      this.isStale = true;
    }
    if (!this.isStale) return;
    this.isStale = false;
    const view = { forces: find("forces").checked, traces: find("traces").checked };
    for (const { run, picture, caption, name } of this.shown) {
      const share = this.isRunning && !run.over ? Math.min(1, this.owed / run.unit) : 1;
      picture.draw(run.frame({ ...view, share }));
      const readings = [...(name ? [["", name]] : []), ...run.readings()];
      const text = readings.map((pair) => pair.join(" ")).join("|");
      if (caption.dataset.text !== text) {
        caption.dataset.text = text;
        caption.replaceChildren(...readings.map(readingOf));
      }
    }
    if (!this.moved && this.shown[0]?.run.time > 0) this.moved = performance.now();
    if (this.aim) {
      const { picture, from, to } = this.aim;
      const speed = DRAG_SPEED * Math.hypot(to[0] - from[0], to[1] - from[1]);
      picture.drawAim(from, to, `${speed.toFixed(1)} m/s`);
    }
  }

  /** Throw a parcel from a place [m]; dragged to another it has the drag's velocity. */
  throw(run, from, to) {
    const velocity = to && [DRAG_SPEED * (to[0] - from[0]), DRAG_SPEED * (to[1] - from[1])];
    run.throw(chosenParcel(from, velocity));
    this.say("");
    if (!this.isRunning) this.start();
  }

  /** Use the tool on a module. */
  paint(run, module, begins) {
    if (chosenTool().value === "stick") {
      if (begins) this._stick([module]);
      return;
    }
    this.turn(
      run,
      brushed(module, run.rows, run.columns, number("brush")).filter((k) => run.rotor[k]),
    );
  }

  /** Turn modules to an angle [rad], by default that of the form; driven ones have a choice. */
  turn(run, modules, angle = chosenAngle()) {
    if (run instanceof TableRun) {
      run.set({ axis: modules.map((module) => [module, angle]) });
    } else {
      const { orientations, drives } = run.about;
      const apart = orientations.map((each) => Math.abs(Math.sin(each - angle)));
      const choice = drives.length ? angle : apart.indexOf(Math.min(...apart));
      this._takeOver(run);
      for (const module of modules) run.want(run.partOf(module), choice);
    }
    this.isStale = true;
    this._tell();
  }

  /** Let the reader act in place of an agent, from what it has set. */
  _takeOver(run) {
    if (run.scene.agent === YOU) return;
    run.scene.agent = YOU;
    run.agent = PLAYER;
    const shown = this.shown.find((each) => each.run === run);
    shown.name = YOU;
    if (run === this.shown[0].run) find("agent").value = YOU;
  }

  /** Turn all modules that obey. */
  turnAll(angle = chosenAngle()) {
    const { run } = this.shown[0];
    const isTable = run instanceof TableRun;
    const modules = isTable ? [...run.rotor.keys()].filter((k) => run.rotor[k]) : run.modules();
    this.turn(run, modules, angle);
  }

  /** Let modules stick that obey, and mend those that stick; the episode begins again. */
  _stick(modules) {
    const { run } = this.shown[0];
    const key = (module) => `${Math.floor(module / run.columns)},${module % run.columns}`;
    const stuck = new Set(this.scene.stuck.map((each) => each.join()));
    for (const module of modules.map(key)) if (!stuck.delete(module)) stuck.add(module);
    return this.reopen({ stuck: [...stuck].map((each) => each.split(",").map(Number)) });
  }

  /** Let one module in ten stick, at least one, of those that still obey. */
  stickSome() {
    const obeying = this.shown[0].run.modules().map((module) => [Math.random(), module]);
    obeying.sort(([a], [b]) => a - b);
    return this._stick(obeying.slice(0, Math.ceil(obeying.length / 10)).map(([, each]) => each));
  }

  /** Open the scene anew with a part of it changed. */
  reopen(change) {
    const scene = structuredClone(this.scene);
    return this.try(() =>
      this.open({ ...scene, ...(scene.task === "table" ? {} : { commands: [] }), ...change }),
    );
  }

  /** Say how the runs stand, where that has changed. */
  _tell() {
    const states = this.shown.map(
      ({ run, name }) =>
        `${name ? `${name}: ` : ""}${run.over ?? (this.isRunning ? "running" : "paused")}`,
    );
    const text = states.join("; ");
    if (find("state").textContent !== text) find("state").textContent = text;
  }

  /** Keep the scene in the address. */
  async writeAddress() {
    if (!this.scene) return;
    const fragment = await toFragment(this.scene);
    if (fragment === this.written) return;
    this.written = fragment;
    history.replaceState(null, "", `#${fragment}`);
  }
}

/** Make what is written of a reading. */
function readingOf([what, value]) {
  return make("span", {}, what && `${what} `, make("b", {}, value));
}

async function begin() {
  paintPage("auto");
  const page = new Playground([], new Agents(null, null));
  globalThis.playground = page; // for those who want to look into it
  await page.try(async () => {
    const address = location.hash;
    const [site] = await Promise.all([get("site.json", "json"), page._load({ task: "table" }, 0)]);
    page.modules = site.tasks;
    for (const task of page.tasks) find("task").append(new Option(`task: ${task}`, task));
    connect(page);
    let agents; // asked for once, where a task is opened first
    if (site.agents) page.loadAgents = () => (agents ??= Agents.load());
    if (address.length > 1) await page.try(() => page.openAddress());
    if (!page.scene) {
      const message = find("message").textContent;
      await page.open(firstScene());
      page.say(message);
      if (!message && !matchMedia("(prefers-reduced-motion: reduce)").matches) page.start();
    }
  });
  let last = performance.now();
  const draw = (now) => {
    page.try(() => page.frame(passedSince(last, now)), true);
    last = now;
    requestAnimationFrame(draw);
  };
  requestAnimationFrame(draw);
  setInterval(() => page.try(() => page.writeAddress()), WRITE_EVERY);
}

begin();
