/** What a player writes below its pictures: what is pointed at, and the numbers. */

import { find, make } from "./elements.js";

function degrees(angle) {
  return `${((angle * 180) / Math.PI)
    .toFixed(1)
    .replace(/^-0\.0$/, "0.0")
    .replace("-", "−")}°`;
}

/** Write an axis between −90 and 90 degrees: half a turn is the same axis. */
function axisText(angle) {
  return degrees(angle - Math.PI * Math.round(angle / Math.PI - 1e-6));
}

function forceText([fx, fy]) {
  return `${Math.hypot(fx, fy).toFixed(1)} N towards ${degrees(Math.atan2(fy, fx))}`;
}

/** The readings of a player's runs. */
export class Panel {
  /** @param {import("./player.js").Run[]} runs */
  constructor(runs) {
    this.runs = runs;
    find("numbers").addEventListener("toggle", () => this._fillTable());
  }

  /** Let those who hear the page hear what is pointed at, or not while it changes all the time. */
  setLive(isLive) {
    find("reading").setAttribute("aria-live", isLive ? "polite" : "off");
  }

  /** Write what is under the pointer or chosen at a time [s], how runs end, and the numbers. */
  write(time) {
    const lines = [];
    for (const run of this.runs) {
      const { recording, frame, picture } = run;
      const isOver = time >= recording.duration - 1e-9;
      run.end.textContent = isOver ? recording.head.outcome : "";
      const many = frame.parcels.length === 1 ? "one parcel" : `${frame.parcels.length} parcels`;
      run.canvas.setAttribute(
        "aria-label",
        `${run.name}: ${many} on a surface of ${recording.surface.rows} by ${recording.surface.columns}`,
      );
      const parts = [];
      const { parcel } = picture.chosen;
      const module = run.under >= 0 ? run.under : picture.chosen.module;
      if (parcel >= 0) parts.push(this._parcelText(run, frame.parcels[parcel]));
      if (module >= 0) parts.push(this._moduleText(run, module));
      if (parts.length)
        lines.push((this.runs.length > 1 ? `${run.name}: ` : "") + parts.join("; "));
    }
    const text =
      lines.join("\n") || "Point at a parcel or a module, or press N or M, to read its numbers.";
    if (find("reading").textContent !== text) find("reading").textContent = text;
    this._fillTable();
  }

  _parcelText({ recording, frame }, parcel) {
    const name = recording.parcels.length > 1 ? `parcel ${parcel.number + 1}` : "parcel";
    const label = parcel.label ? ` (${parcel.label})` : "";
    const speed = Math.hypot(parcel.vx, parcel.vy);
    const motion = `${speed.toFixed(2)} m/s towards ${degrees(Math.atan2(parcel.vy, parcel.vx))}, turning ${degrees(parcel.omega)}/s`;
    const pose = `at x ${parcel.x.toFixed(3)} m, y ${parcel.y.toFixed(3)} m, ${degrees(parcel.theta)}`;
    return `${name}${label} ${motion}, ${pose}${this._forcesText(recording, frame, parcel)}`;
  }

  _forcesText(recording, frame, parcel) {
    if (!recording.hasForces) return "";
    const { normal, friction, push } = recording.loadAt(frame.index, parcel.number ?? 0);
    const pushed = Math.hypot(...push) > 0 ? `, pushed with ${forceText(push)}` : "";
    if (normal === 0) return pushed;
    return `; carried with ${normal.toFixed(1)} N, friction ${forceText(friction)}${pushed}`;
  }

  _moduleText({ recording }, module) {
    const { columns, obeys } = recording.surface;
    const drive = recording.drives?.[module];
    const state = drive
      ? `running at ${Math.hypot(...drive).toFixed(2)} m/s towards ${degrees(Math.atan2(drive[1], drive[0]))}`
      : `axis ${axisText(recording.axes[module])}`;
    const fixed = obeys[module] ? "" : ", fixed";
    return `module in row ${Math.floor(module / columns)}, column ${module % columns}: ${state}${fixed}`;
  }

  /** Fill the table of numbers, where it is open, but for those that stay zero in all runs. */
  _fillTable() {
    if (!find("numbers").open) return;
    const known = this.runs.flatMap((run) => run.recording.metrics);
    const moving = known.filter(([, values]) => values.some(Boolean));
    const names = [...new Set((moving.length ? moving : known).map(([name]) => name))];
    const head = make(
      "tr",
      {},
      make("th", { scope: "col" }, ""),
      ...this.runs.map((run) => make("th", { scope: "col" }, run.name)),
    );
    const rows = names.map((name) => {
      const cells = this.runs.map(({ recording, frame }) => {
        const value = recording.metrics.find(([each]) => each === name)?.[1][frame.index];
        return make("td", {}, Number.isFinite(value) ? String(Number(value.toPrecision(4))) : "–");
      });
      return make("tr", {}, make("th", { scope: "row" }, name.replaceAll("_", " ")), ...cells);
    });
    find("numbers")
      .querySelector("table")
      .replaceChildren(head, ...rows);
  }
}
