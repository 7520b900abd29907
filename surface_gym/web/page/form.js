/** The form of the playground: what its controls say, and what they do. */

import { YOU } from "./agents.js";
import { find, number } from "./elements.js";
import { paintPage } from "./palette.js";
import { emptyTable, isDriven, packed, readJson, toCsv, toPython, VERSION } from "./scene.js";

const RADIAN = Math.PI / 180;
/** Show a slider's number behind it. */
function showNumber({ parentElement, value, dataset }) {
  const output = parentElement.querySelector("output");
  if (output) output.value = value + (dataset.unit ?? "");
}

/** The tool of the pointer: its name, and what it is for. */
export const chosenTool = () => document.querySelector("input[name=tool]:checked");

function showHint() {
  find("hint").textContent = chosenTool().dataset.hint;
}

/** Fill a list of choices, of which "" is nobody. */
function fill(id, names, chosen) {
  const options = names.map((each) => new Option(each || "nobody", each, false, each === chosen));
  find(id).replaceChildren(...options);
}

let idleAngles = null; // the options of idle modules, as in the page

/** Offer angles, of a table also others, or what driven modules do: velocities [m/s] in x and y. */
function fillAngles(isTable, drives) {
  const select = find("angle");
  idleAngles ??= [...select.options];
  const texts = drives.map(driveText);
  if (texts.join() !== (select.dataset.drives ?? ""))
    select.replaceChildren(
      ...(texts.length ? texts.map((text, k) => new Option(text, k)) : idleAngles),
    );
  select.dataset.drives = texts.join();
  for (const option of idleAngles)
    option.hidden = option.disabled = !isTable && option.value === "other";
}

/** Write a driven module's velocity. */
function driveText([vx, vy]) {
  const speed = Number(Math.hypot(vx, vy).toFixed(2));
  const heading = Math.round(Math.atan2(vy, vx) / RADIAN);
  return speed ? `${speed} m/s, ${String(heading).replace("-", "−")}°` : "stop";
}

/** Read the angle [rad] that modules are to turn to, or the choice of driven ones. */
export function chosenAngle() {
  const chosen = find("angle").value;
  if (find("angle").dataset.drives) return Number(chosen);
  return radians(chosen === "other" ? number("other") : Number(chosen));
}

/** Convert degrees, so that 45 gives pi / 4 to the bit. */
function radians(degrees) {
  return degrees % 45 === 0 ? (degrees / 45) * (Math.PI / 4) : degrees * RADIAN;
}

/** Read the parcel that would be thrown from a place [m], with a velocity or the sliders'. */
export function chosenParcel([x, y], velocity = null) {
  const [length, width, corners] = [number("length"), number("width"), number("corners")];
  const shape = find("shape").value;
  let base = { rectangle: [length, width] };
  if (shape === "disc") base = { disc: length / 2 };
  if (shape === "polygon") base = { polygon: regular(corners, length / 2) };
  const heading = radians(number("heading"));
  const speed = number("throw-speed");
  const [vx, vy] = velocity ?? [speed * Math.cos(heading), speed * Math.sin(heading)];
  return {
    base,
    mass: number("mass"),
    com_height: 0.1,
    com_offset: [(number("load") * length) / 2, 0],
    pose: [x, y, radians(number("turned"))],
    velocity: [vx, vy, number("spin")],
  };
}

/** Corners of a regular polygon. */
function regular(corners, radius) {
  return Array.from({ length: corners }, (_, k) => {
    const angle = (2 * Math.PI * k) / corners;
    return [radius * Math.cos(angle), radius * Math.sin(angle)];
  });
}

/** Axis angles [rad] of a whole table, by a layout's name. */
function layoutAngles(name, rows, columns) {
  const angles = [];
  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) {
      const [across, along] = [row - (rows - 1) / 2, column - (columns - 1) / 2];
      const isLead = column < columns / 4;
      let degrees = 90;
      if (name === "sort" && !isLead) degrees = -45;
      if (name === "zigzag" && !isLead) degrees = row % 2 ? 45 : -45;
      if (name === "funnel" && !isLead) degrees = Math.abs(across) < 1 ? 90 : across > 0 ? 45 : -45;
      // Rolls around the middle, 5 deg apart.
      if (name === "whirl") degrees = 5 * Math.round(Math.atan2(across, along) / RADIAN / 5);
      angles.push(radians(((degrees + 270) % 180) - 90 || 0));
    }
  }
  return name === "" ? null : angles.map((angle) => (angle === -Math.PI / 2 ? Math.PI / 2 : angle));
}

/** Modules within a brush around a module. */
export function brushed(module, rows, columns, reach) {
  const [row, column] = [Math.floor(module / columns), module % columns];
  const found = [];
  for (let r = Math.max(0, row - reach); r <= Math.min(rows - 1, row + reach); r++) {
    for (let c = Math.max(0, column - reach); c <= Math.min(columns - 1, column + reach); c++)
      found.push(r * columns + c);
  }
  return found;
}

/** A scene to begin with: parcels that come along and are led aside. */
export function firstScene() {
  const scene = emptyTable();
  scene.axis = packed(layoutAngles("funnel", scene.rows, scene.columns));
  const own = { mass: 10, com_height: 0.1, com_offset: [0, 0], step: 0 };
  const pentagon = { polygon: regular(5, 0.15) };
  scene.parcels = [
    { ...own, base: { rectangle: [0.3, 0.25] }, pose: [0.25, 0.25, 0], velocity: [2.2, 0, 0] },
    { ...own, base: { disc: 0.13 }, pose: [0.25, 0.75, 0], velocity: [2, 0, 0] },
    { ...own, base: pentagon, pose: [0.25, 0.5, 0.3], velocity: [2.4, 0, 2], step: 80 },
  ];
  return scene;
}

function taskScene(task) {
  return {
    version: VERSION,
    task,
    seed: 0,
    agent: YOU,
    stuck: [],
    late: 0,
    camera: false,
    modules: "idle",
    commands: [],
  };
}

/** Let the controls show the page's scene. */
export function fillForm(page) {
  const { scene } = page;
  find("task").value = scene.task;
  const tools = [...document.querySelectorAll("input[name=tool]")];
  const isTable = scene.task === "table";
  fillAngles(isTable, isTable ? [] : page.shown[0].run.about.drives);
  const allowed = isTable ? ["throw", "turn", "pan"] : ["turn", "stick", "pan"];
  for (const tool of tools) tool.disabled = !allowed.includes(tool.value);
  if (!tools.some((tool) => tool.checked && !tool.disabled))
    tools.find((tool) => tool.value === allowed[0]).checked = true;
  showHint();
  find("summary").textContent = isTable
    ? "Throw parcels on it, turn its modules, tilt it."
    : page.shown[0].run.about.summary;
  if (isTable) {
    find("tilt").value = scene.tilt / RADIAN;
    find("downhill").value = scene.tilt_direction / RADIAN;
    find("along").value = scene.friction[0];
    find("across").value = scene.friction[1];
    find("size").value = `${scene.rows} ${scene.columns}`;
  } else {
    const seeds = Array.from({ length: page.shown[0].run.machine.seeds }, (_, k) => String(k));
    const names = isDriven(scene) ? [YOU] : page.agents.names(scene.task);
    fill("seed", seeds, String(scene.seed));
    fill("kind", page.kinds(scene.task), scene.modules ?? "idle");
    fill("agent", names, names.includes(scene.agent) ? scene.agent : YOU);
    fill("beside", ["", ...names.slice(1)], page.shown[1]?.name ?? "");
    find("late").value = String(scene.late);
    find("camera").checked = scene.camera;
    find("camera").disabled = isDriven(scene) || !page.hasCamera(scene.task);
  }
  for (const input of document.querySelectorAll("input[type=range]")) showNumber(input);
}

/** Let the form's controls do what they say. */
export function connect(page) {
  const on = (id, kind, does) =>
    find(id).addEventListener(kind, (event) => {
      page.isStale = true; // what is done may be seen
      page.try(() => does(event));
    });
  on("start", "click", () => (page.isRunning ? page.pause() : page.start()));
  on("step", "click", () => page.stepOnce());
  on("again", "click", () => page.again());
  on("fit", "click", () => {
    for (const { picture } of page.shown) picture.fit();
  });
  for (const id of ["forces", "traces"]) on(id, "change", () => {});
  on("theme", "change", ({ target }) => paintPage(target.value, page.shown));
  on("task", "change", ({ target }) =>
    page.open(target.value === "table" ? emptyTable() : taskScene(target.value)),
  );
  for (const id of ["seed", "late"])
    on(id, "change", ({ target }) => page.reopen({ [id]: Number(target.value) }));
  on("agent", "change", ({ target }) => page.reopen({ agent: target.value }));
  on("beside", "change", () => page.reopen({}));
  on("afresh", "click", () => page.reopen({}));
  on("kind", "change", ({ target }) =>
    page.reopen({ modules: target.value, agent: YOU, camera: false }),
  );
  on("camera", "change", ({ target }) => page.reopen({ camera: target.checked }));
  on("clear", "click", () => {
    page.shown[0].run.clear();
    page.pause();
    page.say("");
  });
  on("size", "change", ({ target }) => {
    const [rows, columns] = target.value.split(" ").map(Number);
    const { tilt, tilt_direction, friction } = page.scene;
    return page.open({ ...emptyTable({ rows, columns }), tilt, tilt_direction, friction });
  });
  on("all", "click", () => page.turnAll());
  on("layout", "change", ({ target }) => {
    const { run } = page.shown[0];
    const angles = layoutAngles(target.value, run.rows, run.columns);
    if (angles) run.set({ axis: angles.map((angle, module) => [module, angle]) });
  });
  const set = (id, change) => on(id, "input", () => page.shown[0].run.set(change()));
  set("tilt", () => ({ tilt: radians(number("tilt")) }));
  set("downhill", () => ({ tilt_direction: radians(number("downhill")) }));
  for (const id of ["along", "across"]) {
    set(id, () => {
      const support = page.shown[0].run.table.friction[2];
      return { friction: [Math.max(number("along"), number("across")), number("across"), support] };
    });
  }
  on("stick-some", "click", () => page.stickSome());
  on("mend", "click", () => page.reopen({ stuck: [] }));
  on("link", "click", async () => {
    await page.writeAddress();
    await navigator.clipboard.writeText(location.href).catch(() => {});
    find("shared").textContent = "The address of this page is the scene; it was copied.";
  });
  const name = () => `${page.scene.task}-scene`;
  on("python", "click", () => {
    const { period, about } = page.shown[0].run;
    save(`${name()}.py`, toPython(page.scene, period, about), "text/x-python");
  });
  on("json", "click", () => save(`${name()}.json`, JSON.stringify(page.scene), "application/json"));
  on("csv", "click", () => save(`${name()}.csv`, toCsv(page.shown[0].run.tracks), "text/csv"));
  on("open", "change", async ({ target }) => {
    const [file] = target.files;
    if (file) await page.open(readJson(await file.text(), page.tasks));
    target.value = "";
  });
  for (const input of document.querySelectorAll("input[type=range]"))
    input.addEventListener("input", () => showNumber(input));
  for (const tool of document.querySelectorAll("input[name=tool]"))
    tool.addEventListener("change", showHint);
  find("controls").addEventListener("submit", (event) => event.preventDefault());
  document.addEventListener("keydown", (event) => page.try(() => takeKey(page, event)));
  window.addEventListener("hashchange", () => {
    if (location.hash !== `#${page.written}`) page.try(() => page.openAddress());
  });
}

function takeKey(page, event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const { tagName } = event.target;
  if (["INPUT", "SELECT"].includes(tagName)) return;
  if (event.key === " " && ["BUTTON", "SUMMARY"].includes(tagName)) return;
  const angles = { 1: 0, 2: 45, 3: -45, 4: 90 };
  const drives = page.shown[0]?.run.about?.drives ?? [];
  if (event.key === " ") find("start").click();
  else if (event.key === ".") page.stepOnce();
  else if (event.key === "r" || event.key === "R") page.again();
  else if (drives[event.key - 1]) page.turnAll(event.key - 1);
  else if (event.key in angles && !drives.length) page.turnAll(radians(angles[event.key]));
  else return;
  event.preventDefault();
}

/** Offer a file to be saved. */
function save(name, text, kind) {
  const href = URL.createObjectURL(new Blob([text], { type: kind }));
  Object.assign(document.createElement("a"), { href, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(href), 10000);
}
