/**
 * Colours of pages: those of the pictures of `surface_gym/rendering/ink.py`, and a dark theme; and
 * which theme a page is asked to have.
 *
 * A test compares the light theme, the exits' colours and the axes' with the Python.
 */

export const THEMES = {
  light: {
    paper: "#ffffff",
    plate: "#f4f5f6",
    plateEdge: "#cbd0d6",
    support: "#d8dce1",
    zone: "#ffffff",
    zoneEdge: "#707a88",
    ink: "#212730",
    faintInk: "#6c7480",
    parcel: "#9298a4",
    goal: "#be1848",
    sensed: "#5e3caa",
    runs: "#343c48",
    stands: "#acb1b9",
    bar: "#ffffff",
    driven: "#42546c",
    force: "#006d77",
  },
  dark: {
    paper: "#12161b",
    plate: "#1b2027",
    plateEdge: "#3a424c",
    support: "#39424d",
    zone: "#232a33",
    zoneEdge: "#8b96a5",
    ink: "#e6eaef",
    faintInk: "#9aa4b0",
    parcel: "#a7aebb",
    goal: "#ff7a9e",
    sensed: "#b79cff",
    runs: "#c6ccd4",
    stands: "#59616c",
    bar: "#ffffff",
    driven: "#4c6080",
    force: "#5ad1dc",
  },
};

/** Of exits and groups: far from the axes' colours and from each other, for dichromats too. */
const EXITS = ["#ac70fc", "#fcd818", "#54fcb4", "#a80c84", "#0c2484", "#fcb4fc", "#b4cc6c"];

/** Choose a theme's name: "auto" is what the reader's system prefers. */
export function themeName(theme) {
  if (theme !== "auto") return theme;
  return matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
}

/** Set a theme's colours, as CSS variables `--plate-edge` and so on, and of pictures shown. */
export function paintPage(theme, shown = []) {
  const { style } = document.documentElement;
  const name = themeName(theme);
  for (const [key, colour] of Object.entries(THEMES[name])) {
    const kebab = key.replace(/[A-Z]/g, (letter) => `-${letter.toLowerCase()}`);
    style.setProperty(`--${kebab}`, colour);
  }
  style.colorScheme = name;
  for (const { picture } of shown) picture.setTheme(name);
}

/** Return the colour of an exit or a group; colours repeat where there are more of them. */
export function exitColour(index) {
  return EXITS[index % EXITS.length];
}

/** Split "#rrggbb" into numbers from 0 to 255. */
function channels(colour) {
  return [1, 3, 5].map((k) => Number.parseInt(colour.slice(k, k + 2), 16));
}

function hex(parts) {
  return `#${parts.map((part) => Math.round(part).toString(16).padStart(2, "0")).join("")}`;
}

/** Mix a share of another colour into a colour. */
export function mixed(colour, other, share) {
  const to = channels(other);
  return hex(channels(colour).map((part, k) => part + share * (to[k] - part)));
}

/** Choose the colour in which to write on another. */
export function textOn(colour) {
  const [red, green, blue] = channels(colour);
  return 0.299 * red + 0.587 * green + 0.114 * blue > 120 ? THEMES.light.ink : THEMES.light.paper;
}

/** Compute the colour of an axis angle [rad], on an ellipse in Oklab; 0 and 180 deg are one. */
export function axisColour(angle) {
  const [cosine, sine] = [Math.cos(2 * angle), Math.sin(2 * angle)];
  const light = 0.62 - 0.17 * cosine - 0.055 * sine;
  const a = 0.012 + 0.08 * cosine - 0.045 * sine;
  const b = 0.005 + 0.005 * cosine - 0.125 * sine;
  const l = (light + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (light - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (light - 0.0894841775 * a - 1.291485548 * b) ** 3;
  const linear = [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ];
  return hex(
    linear.map((x) => 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055)),
  );
}

/**
 * What a page is asked to look like, from now on. The page around sends `{ theme: "dark" }`, or
 * "light"; the address may end in `#dark` or `#light`; otherwise it is "auto", the system's.
 */
export class AskedTheme {
  constructor() {
    this.name = "auto";
    this.onChange = () => {};
    const ask = (name) => {
      this.name = Object.hasOwn(THEMES, name) ? name : "auto";
      this.onChange();
    };
    const readAddress = () => ask(location.hash.slice(1));
    addEventListener("hashchange", readAddress);
    addEventListener("message", ({ source, data }) => {
      if (source === window.parent && typeof data?.theme === "string") ask(data.theme);
    });
    const system = matchMedia("(prefers-color-scheme: dark)");
    system.addEventListener("change", () => this.onChange());
    readAddress();
  }

  /** Call a function now, and whenever another theme is asked for. */
  follow(onChange) {
    this.onChange = onChange;
    onChange();
  }
}
