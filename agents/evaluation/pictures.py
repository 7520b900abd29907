"""Pictures of the comparison: plots, and videos of episodes, one or several side by side."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import cycle, islice, repeat, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon as Patch
from moviepy.video.io.ffmpeg_writer import FFMPEG_VideoWriter
from numpy.typing import NDArray

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.env import SmartSurfaceEnv
from surface_gym.player import replay
from surface_gym.recorder import RecordReplay
from surface_gym.rendering import with_caption
from surface_gym.tasks.benchmark import PARCELS, SIDES, SpeedGrid

from ..base import Controller
from ..library import task_label
from ..rollout import Episodes
from .method import FIXED, PLANNER
from .results import Results
from .scenario import FACTORS, LAB, SHAPES, TRAINED, Factor
from .streams import SIX_MODULES
from .views import BEST, CANNOT, ENTRANCE, Capacities, Sweep, level_text

Picture = NDArray[np.uint8]

DOTS = 150  # dots per inch
LIMIT, INK, PALE = "#be1848", "#333333", "#eeeeee"
# Okabe and Ito's colours, safe for colour-blind readers.
BLUE, ORANGE, GREEN, RED, PINK, SKY = (
    "#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9",
)  # fmt: skip
PALETTE = (BLUE, ORANGE, GREEN, PINK, INK, SKY, RED, "#999999", "#882255", "#a5a12c")
SHOWN_SPEEDS = {  # [m/s] speeds of trajectories, with colours
    0.4: "#440154", 0.6: "#3b528b", 0.8: "#21918c", 1.2: "#5ec962", 2.0: "#c9a227",
}  # fmt: skip


def choose_colours(names: Iterable[str]) -> dict[str, str]:
    """Choose a colour for each name; the first colours differ most."""
    return dict(zip(names, cycle(PALETTE), strict=False))


def save_figure(figure: Figure, file: Path, *panels: Axes, legend: Axes | None = None) -> None:
    """Write a figure. Its legend explains one panel (`legend`), or all panels for None."""
    for panel in panels:
        panel.spines[["top", "right"]].set_visible(False)
    handles: Sequence[Any] = () if legend is None else legend.get_legend_handles_labels()
    figure.legend(*handles, loc="outside right center", frameon=False)
    figure.savefig(file, dpi=DOTS)


class Bar(NamedTuple):
    """A bar with its confidence interval or with a text."""

    height: float
    low: float = math.nan
    high: float = math.nan
    text: str = ""


def draw_bars(
    panel: Axes, groups: Sequence[str], names: Sequence[str],
    find: Callable[[str, str], Bar | None],
) -> None:  # fmt: skip
    """Draw groups of bars along x. `find` returns the bar for a group and a name, or None."""
    colours, width = choose_colours(names), 0.84 / max(1, len(names))
    for k, name in enumerate(names):
        for place, group in enumerate(groups):
            if (bar := find(group, name)) is None:
                continue
            x = place + (k - 0.5 * (len(names) - 1)) * width
            label = name if place == 0 else None
            panel.bar(x, bar.height, 0.92 * width, color=colours[name], label=label)
            if bar.text:
                panel.annotate(
                    bar.text, (x, 0.0), (0, 3), textcoords="offset points", ha="center",
                    va="bottom", rotation=90, color=INK, fontsize=8,
                )  # fmt: skip
            elif math.isfinite(bar.low):
                errors = [[max(0.0, bar.height - bar.low)], [max(0.0, bar.high - bar.height)]]
                panel.errorbar(x, bar.height, errors, color=INK, elinewidth=0.8)
    panel.set_xticks(range(len(groups)), groups)


def draw_trajectories(grid: SpeedGrid, runs: dict[str, Episodes], file: Path) -> None:
    """Draw trajectories of parcels whose goal side is y > 0, by method (row) and box (column).

    Args:
        grid: grid of starts in the order of the episodes. Entry speeds have different colours.
        runs: episodes of each method.
    """
    figure = Figure(figsize=(12.0, 3.4 * len(runs)), layout="constrained")
    panels = figure.subplots(len(runs), len(PARCELS), sharex=True, sharey=True, squeeze=False)
    for row, (name, episodes) in zip(panels, runs.items(), strict=True):
        for panel, parcel in zip(row, PARCELS, strict=True):
            _draw_line(panel, parcel)
            for speed, colour in SHOWN_SPEEDS.items():
                at = (PARCELS.index(parcel), int(np.argmin(np.abs(grid.speeds - speed))))
                start = int(np.ravel_multi_index((*at, SIDES.index(1)), grid.shape))
                _draw_path(panel, episodes, start, parcel, colour, f"{speed:g} m/s")
            panel.set_title(f"{name}, {parcel}-box")
    for panel in panels[-1]:
        panel.set_xlabel("x [m]")
    for panel in panels[:, 0]:
        panel.set_ylabel("y [m]")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.savefig(file, dpi=DOTS)


def _draw_line(panel: Axes, parcel: str) -> None:
    """Draw rotors, supports and the zone of the default line for a box."""
    line = sg.lines.Line()
    rotor, (_, rows, first, columns) = line.site(sg.layouts.box(parcel).base)
    row, column = np.mgrid[: line.rows, : line.columns]
    x = line.origin[0] + line.pitch_x * column
    y = line.origin[1] + line.pitch_y * row
    zone = line.column_edge(first), line.column_edge(first + columns)
    middle, half = line.line_y, 0.5 * line.pitch_y * rows
    panel.axvspan(*zone, color="#eef2f7", zorder=0)
    panel.axhspan(middle - half, middle + half, color="#dde3ea", zorder=0)
    panel.plot(x[~rotor], y[~rotor], ".", color="#c3ccd6", markersize=1.5)
    panel.plot(x[rotor], y[rotor], ".", color="#8795a5", markersize=4)
    panel.set(
        xlim=(0.0, 2.2), ylim=(sg.layouts.LINE_Y - 0.35, sg.layouts.LINE_Y + 0.85), aspect="equal"
    )


def _draw_path(
    panel: Axes, episodes: Episodes, start: int, parcel: str, colour: str, label: str
) -> None:
    style: dict[str, Any] = {"linestyle": "-" if episodes.success[start] else ":"}
    path = episodes.path(start)
    panel.plot(path[:, 0], path[:, 1], label=label, color=colour, linewidth=1.6, **style)
    x, y, theta = path[-1]
    turn = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
    outline = sg.layouts.box(parcel).base.outline @ turn + (x, y)
    panel.add_patch(Patch(outline, fill=False, edgecolor=colour, linewidth=1.0, **style))


def draw_capacities(found: Capacities, file: Path) -> None:
    """Draw methods' capacities on each stream as bars. Lines show entry limit and best rate."""
    figure = Figure(figsize=(12.0, 4.2), layout="constrained")
    panel = figure.subplots()

    def find(offer: str, name: str) -> Bar:
        sample = found.find(name, offer)
        if sample is not None and sample.is_sustained:
            rate, margin = sample.throughput, sample.margin
            return Bar(rate, rate - margin, rate + margin)
        hardware = sample is not None and sample.constant("actuators")
        return Bar(0.0, text="0" if hardware else CANNOT)

    draw_bars(panel, found.offers, found.names, find)
    best = found.constants(SIX_MODULES, "best")
    for place, offer in enumerate(found.offers):
        bounds = {
            ENTRANCE: (found.bound(offer), "-"),
            BEST.format(SIX_MODULES): (best[place], "--"),
        }
        for name, (bound, style) in bounds.items():
            if math.isfinite(bound):
                panel.hlines(
                    bound, place - 0.45, place + 0.45, color=LIMIT, linestyle=style, linewidth=1.2,
                    label=name if place == 0 else "_again",
                )  # fmt: skip
    panel.set(ylabel="capacity [parcels/h]")
    save_figure(figure, file, panel)


# The figure of robustness has one column per task and one line per method. Factors are rows, so
# that it fits the width of a page.
WIDTH, HEIGHT = 2.0, 1.35  # [inch] size of a panel
NARROWEST = 9.0  # [inch] minimum width of the figure, for its legend
IN_LAB = ("all", "square", "rect.", "disc", "poly.")
OWN_RULES = ("event rule", "braking rule", "sliding mode", "turning rule")  # one per task
ALGORITHMS = {"PPO": BLUE, "DQN": ORANGE, "PPO per module": GREEN}

LineStyle = dict[str, Any]  # arguments of `Line2D`


def _style(
    label: str, colour: str, dashes: str = "-", width: float = 1.6, marker: str = "o",
    order: int = 2,
) -> LineStyle:  # fmt: skip
    return {
        "label": label, "color": colour, "linestyle": dashes, "linewidth": width, "marker": marker,
        "zorder": order,
    }  # fmt: skip


OWN = _style(f"rule of the task ({', '.join(OWN_RULES)})", RED, "-.", 1.6, "s", 3)
STYLES = {
    FIXED: _style(FIXED, "#8c8c8c", ":", 1.3, "x"),
    "threshold logic": _style("threshold logic", PINK, ":", 1.3, "v"),
    "PID per module": _style("PID per module", SKY, ":", 1.3, "^"),
    PLANNER: _style(PLANNER, INK, "None", 1.0, "_", 6),
} | dict.fromkeys(OWN_RULES, OWN)


def find_style(name: str) -> LineStyle:
    """Return the style of a method's curve; agents of one algorithm have the same colour."""
    algorithm, comma, preset = name.partition(", ")
    if colour := ALGORITHMS.get(algorithm):
        if comma:
            return _style(f"{algorithm}, trained for the {preset}", colour, "-", 2.0, "D", 5)
        return _style(name, colour, "--", 1.2, "o", 4)
    return STYLES.get(name, _style(name, INK, "--"))


def draw_sweep(tasks: Sequence[str], results: Results, file: Path) -> None:
    """Draw success rates of the robustness study, one row per factor and one column per task."""
    factors = [factor for factor in FACTORS.values() if factor.name != TRAINED]
    sweeps = [Sweep(task, results) for task in tasks]
    figure = Figure(
        figsize=(max(NARROWEST, WIDTH * len(tasks) + 0.5), HEIGHT * len(factors) + 1.2),
        layout="constrained",
    )
    panels = figure.subplots(len(factors), len(tasks), squeeze=False, sharey=True)
    for row, factor in zip(panels, factors, strict=True):
        unit = f" [{factor.unit}]" if factor.unit else ""
        row[0].set_ylabel(f"{factor.label}{unit}", fontsize=9, color=INK)
        for panel, sweep in zip(row, sweeps, strict=True):
            _draw_panel(panel, sweep, factor)
    for panel, task in zip(panels[0], tasks, strict=True):
        panel.set_title(task_label(task).capitalize(), fontsize=12, fontweight="bold", color=INK)
    found = [find_style(name) for sweep in sweeps for name in sweep.methods]
    handles = [
        Line2D([], [], markersize=5, **each)
        for each in {style["label"]: style for style in found}.values()
    ]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9,
    )  # fmt: skip
    figure.savefig(file, dpi=DOTS)


def _draw_panel(panel: Axes, sweep: Sweep, factor: Factor) -> None:
    """Draw a task's success rate at each level of a factor, with a curve for each method.

    If the levels are names, draw points instead of curves, with the methods side by side.
    """
    points = {name: _points(sweep, name, factor) for name in sweep.methods}
    for place, (name, found) in enumerate(points.items()):
        if not found:
            continue
        x, rates = np.array(found).T
        style = find_style(name)
        if factor.is_named:
            x += 0.7 * ((place + 0.5) / len(points) - 0.5)
            style = style | {"linestyle": "None"}
        if style["linestyle"] != "None":
            style = style | {"marker": ""}
        panel.plot(x, rates, markersize=4.5, clip_on=False, **style)
    panel.set(ylim=(0.0, 1.0), yticks=(0.0, 0.5, 1.0))
    panel.tick_params(labelsize=8, colors=INK, length=2)
    panel.grid(color="#e9e9e9", linewidth=0.7)
    panel.set_axisbelow(True)
    panel.spines[["top", "right"]].set_visible(False)
    panel.spines[["left", "bottom"]].set_color("#b0b0b0")
    if factor.trained is not None and not factor.is_named:
        panel.axvline(float(factor.trained), color="#c9c9c9", linewidth=2.5, zorder=1)
    if factor.is_named:
        ticks = IN_LAB if factor.name == LAB else tuple(map(level_text, factor.levels))
        panel.set_xlim(-0.5, len(ticks) - 0.5)
        panel.set_xticks(range(len(ticks)), ticks, fontsize=8)
    if not any(points.values()):
        panel.axis("off")


def _points(sweep: Sweep, name: str, factor: Factor) -> list[tuple[float, float]]:
    """Return a method's points in the plot of a factor: x, and the success rate at each value.

    Values without results are left out. If there are results only for the value that training
    used, return [].
    """
    if all(sweep.rate(name, factor.name, level) is None for level in factor.swept):
        return []
    rates = [sweep.rate(name, factor.name, level) for level in factor.levels]
    if factor.name == LAB:
        shapes = sweep.by_shape(name)
        rates += [float(shapes[each].mean()) if each in shapes else None for each in SHAPES]
    places = range(len(rates)) if factor.is_named else map(float, factor.levels)
    return [
        (float(place), rate) for place, rate in zip(places, rates, strict=True) if rate is not None
    ]


HOLD = 1.0  # [s] duration of the last picture
BAR = 6  # [px] between pictures


@dataclass(frozen=True, eq=False)
class Player:
    """A controller in an environment, and the start of the episode."""

    name: str  # title of its pictures
    controller: Controller
    config: EnvConfig
    rng: np.random.Generator  # source of random values that the options leave open
    options: dict[str, Any] | None = None


def write_comparison(
    players: Sequence[Player], file: Path, seconds: float = math.inf
) -> tuple[bool, ...]:
    """Write one episode of each controller, side by side, to a video (.mp4) and a replay (.html).

    The video runs in real time, for at most `seconds`. A finished episode shows its last picture
    until all episodes have ended. Returns whether each episode succeeded.
    """
    period = min(player.config.control_period for player in players)
    envs = [RecordReplay(make_env(player.config)) for player in players]
    episodes = [
        _repeated(play(player, env), round(player.config.control_period / period))
        for player, env in zip(players, envs, strict=True)
    ]
    last: list[Any] = [None] * len(players)

    def frames() -> Iterator[Picture]:
        for row in zip_longest(*episodes):
            last[:] = [old if new is None else new for old, new in zip(last, row, strict=True)]
            yield _stacked(
                [with_caption(p, each.name) for (p, _), each in zip(last, players, strict=True)]
            )

    shown = islice(frames(), None if math.isinf(seconds) else round(seconds / period))
    write_video(shown, 1.0 / period, file)
    runs = [replace(env.recording, title=p.name) for p, env in zip(players, envs, strict=True)]
    replay(*runs).save(file.with_suffix(".html"))
    return tuple(bool(info.get("is_success", False)) for _, info in last)


def write_video(frames: Iterator[Picture], rate: float, file: Path) -> None:
    """Write an mp4 at `rate` [frames/s]; the last frame stays for another `HOLD` seconds."""
    frame = next(frames)  # one by one, since a minute of frames would fill the memory
    height, width, _ = frame.shape
    with FFMPEG_VideoWriter(str(file), (width, height), rate, codec="libx264") as writer:
        writer.write_frame(frame)
        for frame in frames:
            writer.write_frame(frame)
        for _ in range(round(HOLD * rate)):
            writer.write_frame(frame)


def make_env(config: EnvConfig) -> gym.Env[Any, Any]:
    """Make the environment of a video."""
    env: gym.Env[Any, Any] = SmartSurfaceEnv(render_mode="rgb_array", **config.arguments())
    if config.task.is_stream:  # streams end by themselves
        return env
    return gym.wrappers.TimeLimit(env, config.periods)


def play(
    player: Player, env: gym.Env[Any, Any], every: int = 1
) -> Iterator[tuple[Picture, dict[str, Any]]]:
    """Play an episode; yield picture and `info` at the start and after each control period.

    Args:
        env: environment of `make_env` for the player's configuration.
        every: number of control periods that share one drawn picture.
    """
    env.unwrapped.np_random = player.rng
    observation, info = env.reset(options=player.options)
    picture: Any = env.render()
    yield picture, info
    state: Any = None
    begun, number, over = np.ones(1, dtype=np.bool_), 0, False
    while not over:
        action, state = player.controller.predict(
            observation[np.newaxis], state, begun, deterministic=True
        )
        observation, _, terminated, truncated, info = env.step(action[0])
        begun, number = np.zeros(1, dtype=np.bool_), number + 1
        over = terminated or truncated
        if over or number % every == 0:
            picture = env.render()
        yield picture, info
    env.close()


def _repeated(items: Iterator[Any], times: int) -> Iterator[Any]:
    return (item for each in items for item in repeat(each, times))


def _stacked(pictures: Sequence[Picture]) -> Picture:
    """Place pictures side by side. If a picture is wider than twice its height, stack the pictures.

    Width and height of the result are even numbers of pixels.
    """
    height, width, _ = pictures[0].shape
    down = 2 * height < width
    bar = np.full((BAR, width, 3) if down else (height, BAR, 3), 255, dtype=np.uint8)
    row = [part for picture in pictures for part in (bar, picture)][1:]
    frame = np.concatenate(row, axis=0 if down else 1)
    return frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2]
