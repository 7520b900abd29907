/** The theme that a page is asked to have: by the page around it, by its address, or by the system. */

import { THEMES } from "./palette.js";

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
