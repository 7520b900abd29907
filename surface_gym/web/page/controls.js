/** The controls of the playground: what they say, and layouts that they offer. */

const UNITS = {
  length: "m",
  width: "m",
  mass: "kg",
  load: "of half",
  turned: "°",
  "throw-speed": "m/s",
  heading: "°",
  spin: "rad/s",
  tilt: "°",
  downhill: "°",
  other: "°",
};
const RADIAN = Math.PI / 180;

/** Find an element of the page. @returns {any} */
export const find = (id) => document.getElementById(id);

/** Read a slider's number. */
export const number = (id) => Number(find(id).value);

/** Show a slider's number behind it. */
export function showNumber(input) {
  const output = input.parentElement.querySelector("output");
  if (!output) return;
  const unit = UNITS[input.id] ?? "";
  output.value = `${input.value}${unit === "°" ? unit : unit && ` ${unit}`}`;
}

/** Fill a list of choices. */
export function fill(select, names, chosen = names[0]) {
  select.replaceChildren(...names.map((name) => new Option(name, name, false, name === chosen)));
}

let idleAngles = null; // the options of idle modules, as in the page

/** Offer angles, of a table also others, or what driven modules do: velocities [m/s] in x and y. */
export function fillAngles(isTable, drives) {
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
export function radians(degrees) {
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
export function layoutAngles(name, rows, columns) {
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

/** Offer a file to be saved. */
export function save(name, text, kind) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: kind }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
