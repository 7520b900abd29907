/**
 * Scenes: what a run is made of, so that anybody can repeat it. A scene lives in the address of the
 * page, after "#", and comes out as JSON and as a Python script.
 */

import { ensure, PlainError } from "./machine.js";
import { checkArray, checkNumber, checkNumbers, makeBody, shown } from "./shapes.js";

export const VERSION = 1;
export const MOST_PARCELS = 24;
const MOST_MODULES = 6000;
const MOST_BYTES = 2_000_000; // of a scene as JSON
const MOST_CHANGES = 5000;
export const MOST_TIME = 60; // [s]
const HERE = 1000; // [m]
const FAST = 20; // [m/s]
const MARK = "1."; // before a scene in an address: how it is packed

/**
 * @typedef {object} Thrown a parcel as it comes in
 * @property {import("./shapes.js").Base} base
 * @property {number} mass [kg]
 * @property {number} com_height [m]
 * @property {number[]} com_offset [m]
 * @property {number[]} pose [m, m, rad] of the base's frame
 * @property {number[]} velocity [m/s, m/s, rad/s]
 * @property {number} [step] at whose beginning it comes; 0: it is there from the start
 *
 * @typedef {object} Change of the table from a step on
 * @property {number} step
 * @property {number[][]} [axis] module and its new angle [rad]
 * @property {number} [tilt] [rad]
 * @property {number} [tilt_direction] [rad]
 * @property {number[]} [friction]
 *
 * @typedef {object} TableScene
 * @property {1} version
 * @property {"table"} task
 * @property {number} rows
 * @property {number} columns
 * @property {number[]} pitch [m]
 * @property {number[]} origin [m]
 * @property {number[][]} axis angle [rad] and how many modules in a row have it, row by row
 * @property {number[][]} rotor 1 or 0, and how many in a row
 * @property {number[]} friction [-] along an axis, across it, of a support
 * @property {number} tilt [rad]
 * @property {number} tilt_direction [rad]
 * @property {number[]} sides [-] restitution and friction between parcels
 * @property {number} dt [s]
 * @property {number} duration [s]
 * @property {Thrown[]} parcels
 * @property {Change[]} changes
 *
 * @typedef {object} TaskScene
 * @property {1} version
 * @property {string} task
 * @property {number} seed
 * @property {string} agent that acts; "you": the commands
 * @property {number[][]} stuck row and column of modules
 * @property {number} late control periods by which axes are
 * @property {boolean} [camera] whether a camera senses parcels; otherwise sensors are exact
 * @property {string} [modules] their kind; default: idle
 * @property {[number, number[][]][]} commands a period, and the modules and choices set from it on
 */

/** Return whether a scene's modules are driven. */
export function isDriven({ modules = "idle" }) {
  return modules !== "idle";
}

/** Make a table to begin with. @returns {TableScene} */
export function emptyTable({ rows = 10, columns = 24, angle = Math.PI / 2 } = {}) {
  return {
    version: VERSION,
    task: "table",
    rows,
    columns,
    pitch: [0.1, 0.1],
    origin: [0.05, 0.05],
    axis: [[angle, rows * columns]],
    rotor: [[1, rows * columns]],
    friction: [0.5, 0.01, 0.005],
    tilt: 0,
    tilt_direction: 0,
    sides: [0, 0.3],
    dt: 0.005,
    duration: 20,
    parcels: [],
    changes: [],
  };
}

/** Write a long list as values and how many of each follow each other. */
export function packed(values) {
  const runs = [];
  for (const value of values) {
    const last = runs[runs.length - 1];
    if (last && last[0] === value) last[1] += 1;
    else runs.push([value, 1]);
  }
  return runs;
}

/** Read what `packed` wrote, for so many values. */
export function unpacked(name, runs, count, least, most) {
  const values = [];
  for (const run of checkArray(name, runs, 1, count)) {
    const [value, many] = checkArray(name, run, 2);
    checkNumber(name, value, least, most);
    checkWhole(`${name}, how many`, many, 1, count - values.length);
    for (let k = 0; k < many; k++) values.push(value);
  }
  ensure(values.length === count, `${name} must be of ${count} modules, got ${values.length}.`);
  return values;
}

/** Check that a value is a whole number between two bounds. */
function checkWhole(name, value, least, most) {
  checkNumber(name, value, least, most);
  ensure(Number.isInteger(value), `${name} must be a whole number, got ${value}.`);
  return value;
}

/** Check that a value is an array of so many whole numbers of modules or choices. */
function checkIndices(name, value, many) {
  for (const each of checkArray(name, value, many)) checkWhole(name, each, 0, MOST_MODULES);
}

/** Check all of a scene; @param {string[]} tasks that there are. @returns the scene */
function checkScene(scene, tasks) {
  const isObject = typeof scene === "object" && scene !== null && !Array.isArray(scene);
  ensure(isObject, `A scene must be an object, got ${shown(scene)}.`);
  const { version, task } = scene;
  ensure(version === VERSION, `The scene's version must be ${VERSION}, got ${shown(version)}.`);
  const known = ["table", ...tasks];
  ensure(
    known.includes(task),
    `The scene's task must be one of ${known.join(", ")}, got ${shown(task)}.`,
  );
  if (task === "table") checkTable(scene);
  else checkTask(scene);
  return scene;
}

function checkTable(scene) {
  checkWhole("rows", scene.rows, 1, MOST_MODULES);
  checkWhole("columns", scene.columns, 1, MOST_MODULES);
  const modules = scene.rows * scene.columns;
  ensure(modules <= MOST_MODULES, `A table has at most ${MOST_MODULES} modules, got ${modules}.`);
  checkNumbers("pitch", scene.pitch, 2, 0.01, 10);
  checkNumbers("origin", scene.origin, 2, -HERE, HERE);
  unpacked("axis", scene.axis, modules, -7, 7);
  unpacked("rotor", scene.rotor, modules, 0, 1);
  checkFriction(scene.friction);
  checkTilt(scene);
  const [restitution, rubbing] = checkArray("sides", scene.sides, 2);
  checkNumber("sides, restitution", restitution, 0, 1);
  checkNumber("sides, friction", rubbing, 0, 10);
  checkNumber("dt", scene.dt, 0.0005, 0.01);
  checkNumber("duration", scene.duration, scene.dt, MOST_TIME);
  const steps = Math.round(scene.duration / scene.dt);
  const { parcels } = scene;
  ensure(Array.isArray(parcels), `parcels must be an array, got ${shown(parcels)}.`);
  ensure(
    parcels.length <= MOST_PARCELS,
    `A table holds at most ${MOST_PARCELS} parcels, and the scene has ${parcels.length}.`,
  );
  for (const [k, parcel] of parcels.entries()) checkThrown(parcel, `parcel ${k + 1}`, steps);
  let last = 0;
  for (const change of checkArray("changes", scene.changes, 0, MOST_CHANGES)) {
    last = checkWhole("step of a change", change?.step, last, steps);
    for (const turn of checkArray("axis of a change", change.axis ?? [], 0, modules)) {
      const [module, angle] = checkArray("axis of a change", turn, 2);
      checkWhole("module of a change", module, 0, modules - 1);
      checkNumber("angle of a change", angle, -7, 7);
    }
    checkFriction(change.friction ?? scene.friction);
    checkTilt({ tilt: 0, tilt_direction: 0, ...change });
  }
}

function checkThrown(parcel, name, steps) {
  const isObject = typeof parcel === "object" && parcel !== null;
  ensure(isObject, `${name} must be an object, got ${shown(parcel)}.`);
  makeBody(parcel, name);
  const [x, y, theta] = checkArray(`${name}.pose`, parcel.pose, 3);
  checkNumbers(`${name}.pose`, [x, y], 2, -HERE, HERE);
  checkNumber(`${name}.pose`, theta, -1000, 1000);
  checkNumbers(`${name}.velocity`, parcel.velocity, 3, -FAST, FAST);
  checkWhole(`${name}.step`, parcel.step ?? 0, 0, steps);
}

function checkFriction(friction) {
  const [along, across] = checkNumbers("friction", friction, 3, 0, 10);
  ensure(
    across <= along,
    `friction along an axis must not be less than across it, got ${shown(friction)}.`,
  );
}

function checkTilt({ tilt, tilt_direction }) {
  checkNumber("tilt", tilt, -0.78, 0.78);
  checkNumber("tilt_direction", tilt_direction, -7, 7);
}

function checkTask({ seed, agent, stuck, late, camera = false, modules = "idle", commands }) {
  checkWhole("seed", seed, 0, 1e6);
  const isName = typeof agent === "string" && agent.length <= 60;
  ensure(isName, `agent must be a name, got ${shown(agent)}.`);
  for (const module of checkArray("stuck", stuck, 0, MOST_MODULES))
    checkIndices("stuck", module, 2);
  checkWhole("late", late, 0, 10);
  ensure(typeof camera === "boolean", `camera must be true or false, got ${shown(camera)}.`);
  const isKind = /^[a-z]{1,20}$/.test(modules);
  ensure(isKind, `modules must be the name of a kind, got ${shown(modules)}.`);
  let last = 0;
  for (const command of checkArray("commands", commands, 0, MOST_CHANGES)) {
    const [period, turns] = checkArray("commands", command, 2);
    last = checkWhole("period of a command", period, last, 1e5);
    for (const turn of checkArray("commands", turns, 0, MOST_MODULES))
      checkIndices("commands", turn, 2);
  }
}

/** Read a scene from text in JSON. */
export function readJson(text, tasks) {
  ensure(
    text.length <= MOST_BYTES,
    `A scene has at most ${MOST_BYTES} letters, got ${text.length}.`,
  );
  let found;
  try {
    found = JSON.parse(text);
  } catch (error) {
    throw new PlainError(`The scene is not whole: ${error.message}.`);
  }
  return checkScene(found, tasks);
}

/** Write a scene for the address of the page. */
export async function toFragment(scene) {
  const packer = new Blob([JSON.stringify(scene)])
    .stream()
    .pipeThrough(new CompressionStream("deflate-raw"));
  const bytes = new Uint8Array(await new Response(packer).arrayBuffer());
  let text = "";
  for (const byte of bytes) text += String.fromCharCode(byte);
  return MARK + btoa(text).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
}

/** Read the scene of an address, or say what is wrong with it. */
export async function fromFragment(fragment, tasks) {
  const text = fragment.replace(/^#/, "");
  ensure(text.startsWith(MARK), `The address holds no scene: after "#" it must begin with ${MARK}`);
  let json;
  try {
    const plain = atob(text.slice(MARK.length).replaceAll("-", "+").replaceAll("_", "/"));
    json = await unzipped(Uint8Array.from(plain, (letter) => letter.charCodeAt(0)));
  } catch (error) {
    if (error instanceof PlainError) throw error;
    throw new PlainError("The scene in the address is cut short or damaged.");
  }
  return readJson(json, tasks);
}

/** Unpack bytes, but no more than a scene has. */
async function unzipped(bytes) {
  const reader = new Blob([bytes])
    .stream()
    .pipeThrough(new DecompressionStream("deflate-raw"))
    .getReader();
  const decoder = new TextDecoder();
  let text = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return text + decoder.decode();
    text += decoder.decode(value, { stream: true });
    if (text.length > MOST_BYTES) {
      reader.cancel().catch(() => {});
      throw new PlainError(
        `A scene has at most ${MOST_BYTES} letters, and the address holds more.`,
      );
    }
  }
}

/**
 * Write a scene as a Python script that gives the same run, of so many control periods in a task.
 * @param {{file?: string, rolling?: number}} [about] the file of a task of the reader's own, and the
 *   choice by which parcels roll on
 */
export function toPython(scene, periods = 0, { file = "", rolling = 3 } = {}) {
  return scene.task === "table" ? tableScript(scene) : taskScript(scene, periods, file, rolling);
}

function tableScript(scene) {
  return `"""A run of the playground: the same parcels on the same surface."""

from surface_gym.web.scene import TableScene

scene = TableScene.from_json(r"""${JSON.stringify(scene)}""")
for trajectory in scene.run().trajectories:
    print(trajectory.time[-1], *trajectory.pose[-1], *trajectory.velocity[-1], trajectory.end)
`;
}

function taskScript({ task, seed, camera, modules, ...scene }, periods, file, rolling) {
  const stuck = scene.stuck.map((module) => `(${module.join(", ")})`);
  const id = `SmartSurface/${task[0].toUpperCase()}${task.slice(1)}-v0`;
  const made = file
    ? `SmartSurfaceEnv(find_task(${JSON.stringify(`${file}:${task}`)})`
    : `gym.make("${id}"`;
  const faults = [
    ...(stuck.length ? [`actuators=Actuators(stuck=(${stuck.join(", ")},))`] : []),
    ...(camera ? ["sensors=Camera()"] : []),
    ...(isDriven({ modules }) ? [`modules="${modules}"`] : []),
  ];
  const commands = scene.commands.map(
    ([period, turns]) =>
      `    ${period}: {${turns.map(([k, choice]) => `${k}: ${choice}`).join(", ")}},`,
  );
  const own =
    "from surface_gym.agents.library import find_task\nfrom surface_gym.env import SmartSurfaceEnv";
  const imports = [
    ...(file ? [] : ["import gymnasium as gym"]),
    "import numpy as np",
    "",
    file ? own : "import surface_gym",
    ...(stuck.length ? ["from surface_gym.randomisation import Actuators"] : []),
    ...(camera ? ["from surface_gym.sensors import Camera"] : []),
  ];
  return `"""A run of the playground: the same start, and the same commands in the same periods."""

${imports.join("\n")}

env = ${[made, ...faults].join(", ")})
observation, info = env.reset(seed=${seed})
commands = {  # by the control period: modules and their choices
${commands.join("\n")}
}
action = np.full(env.action_space.shape, ${rolling})  # parcels roll on
rewards = 0.0
for period in range(${periods}):
    for module, choice in commands.get(period, {}).items():
        action[module] = choice
    observation, reward, terminated, truncated, info = env.step(action)
    rewards += reward
    if terminated or truncated:
        break
print(rewards, info["time"], info.get("outcome"), *info.get("pose", ()), *info.get("velocity", ()))
`;
}

/** Write a run as comma-separated values. @param {import("./draw.js").Track[]} tracks of its parcels */
export function toCsv(tracks) {
  const rows = ["time [s],parcel,x [m],y [m],theta [rad],vx [m/s],vy [m/s],omega [rad/s]"];
  for (const { number, times, motion } of tracks) {
    for (const [k, time] of times.entries())
      rows.push([time, number, ...motion.slice(6 * k, 6 * k + 6)].join(","));
  }
  return `${rows.join("\n")}\n`;
}
