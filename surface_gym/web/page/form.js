/** The form of the playground: its controls do what they say. */

import { YOU } from "./agents.js";
import {
  fill,
  fillAngles,
  find,
  layoutAngles,
  number,
  radians,
  save,
  showNumber,
} from "./controls.js";
import { paintPage } from "./palette.js";
import { emptyTable, isDriven, packed, readJson, toCsv, toPython, VERSION } from "./scene.js";

const RADIAN = Math.PI / 180;
const HINTS = {
  throw:
    "Press where the parcel is to be, and drag: the longer, the faster. A click takes speed and direction from below.",
  turn: "Press on modules, or drag over them: they turn to the angle below, or are driven as it says.",
  stick: "Press on modules: they obey nobody, or do so again. The run begins again.",
  pan: "Drag the picture. The wheel, two fingers, or + and − zoom.",
};

/** A scene to begin with: parcels that come along and are led aside. */
export function firstScene() {
  const scene = emptyTable();
  scene.axis = packed(layoutAngles("funnel", scene.rows, scene.columns));
  const parcel = (base, pose, velocity, step) => ({
    base,
    mass: 10,
    com_height: 0.1,
    com_offset: [0, 0],
    pose,
    velocity,
    step,
  });
  scene.parcels = [
    parcel({ rectangle: [0.3, 0.25] }, [0.25, 0.25, 0], [2.2, 0, 0], 0),
    parcel({ disc: 0.13 }, [0.25, 0.75, 0], [2, 0, 0], 0),
    parcel(
      {
        polygon: [
          [0.15, 0],
          [0.04, 0.14],
          [-0.12, 0.09],
          [-0.12, -0.09],
          [0.04, -0.14],
        ],
      },
      [0.25, 0.5, 0.3],
      [2.4, 0, 2],
      80,
    ),
  ];
  return scene;
}

export function taskScene(task) {
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
  find("hint").textContent = HINTS[document.querySelector("input[name=tool]:checked").value];
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
    const { machine } = page.shown[0].run;
    fill(
      find("seed"),
      Array.from({ length: machine.seeds }, (_, k) => String(k)),
      String(scene.seed),
    );
    const names = isDriven(scene) ? [YOU] : page.agents.names(scene.task);
    fill(find("kind"), page.kinds(scene.task), scene.modules ?? "idle");
    fill(find("agent"), names, names.includes(scene.agent) ? scene.agent : YOU);
    const beside = page.shown[1]?.name;
    find("beside").replaceChildren(
      new Option("nobody", ""),
      ...names.slice(1).map((name) => new Option(name, name, false, name === beside)),
    );
    find("late").value = String(scene.late);
    find("camera").checked = scene.camera;
    find("camera").disabled = isDriven(scene) || !page.hasCamera(scene.task);
  }
  for (const input of document.querySelectorAll("input[type=range]")) showNumber(input);
}

/** Let the form's controls do what they say. */
export function connect(page) {
  const on = (id, kind, does) =>
    find(id).addEventListener(kind, (event) => page.try(() => does(event)));
  on("start", "click", () => (page.isRunning ? page.pause() : page.start()));
  on("step", "click", () => page.stepOnce());
  on("again", "click", () => page.again());
  on("fit", "click", () => {
    for (const { picture } of page.shown) picture.fit();
    page.isStale = true;
  });
  for (const id of ["forces", "traces"])
    on(id, "change", () => {
      page.isStale = true;
    });
  on("theme", "change", ({ target }) => {
    paintPage(document.documentElement, target.value);
    for (const { picture } of page.shown) picture.setTheme(target.value);
    page.isStale = true;
  });
  on("task", "change", ({ target }) =>
    page.open(target.value === "table" ? emptyTable() : taskScene(target.value)),
  );
  on("seed", "change", ({ target }) => page.reopen({ seed: Number(target.value) }));
  on("agent", "change", ({ target }) => page.reopen({ agent: target.value }));
  on("beside", "change", () => page.reopen({}));
  on("afresh", "click", () => page.reopen({}));
  on("kind", "change", ({ target }) =>
    page.reopen({ modules: target.value, agent: YOU, camera: false }),
  );
  on("late", "change", ({ target }) => page.reopen({ late: Number(target.value) }));
  on("camera", "change", ({ target }) => page.reopen({ camera: target.checked }));
  on("clear", "click", () => {
    page.shown[0].run.clear();
    page.pause();
    page.say("");
  });
  on("size", "change", ({ target }) => {
    const [rows, columns] = target.value.split(" ").map(Number);
    return page.open({
      ...emptyTable({ rows, columns }),
      tilt: page.scene.tilt,
      tilt_direction: page.scene.tilt_direction,
      friction: page.scene.friction,
    });
  });
  on("all", "click", () => page.turnAll());
  on("layout", "change", ({ target }) => {
    const { run } = page.shown[0];
    const angles = layoutAngles(target.value, run.rows, run.columns);
    if (angles) run.set({ axis: angles.map((angle, module) => [module, angle]) });
    page.isStale = true;
  });
  const set = (id, change) =>
    on(id, "input", () => {
      page.shown[0].run.set(change());
      page.isStale = true;
    });
  set("tilt", () => ({ tilt: radians(number("tilt")) }));
  set("downhill", () => ({ tilt_direction: radians(number("downhill")) }));
  for (const id of ["along", "across"]) {
    set(id, () => {
      const support = page.shown[0].run.table.friction[2];
      return { friction: [Math.max(number("along"), number("across")), number("across"), support] };
    });
  }
  on("stick-some", "click", () =>
    page._stick(page.shown[0].run.modules().filter(() => Math.random() < 0.1)),
  );
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
  for (const tool of document.querySelectorAll("input[name=tool]")) {
    tool.addEventListener("change", () => {
      find("hint").textContent = HINTS[tool.value];
    });
  }
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
