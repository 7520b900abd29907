"""Make the pictures and films of the documentation: `python docs/pictures.py`, `--help` tells more.

Every file in docs/images has a line in `PICTURES`, and is the same to the byte each time, as long
as the versions of `constraints.txt` are the same.
"""

import argparse
import math
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from time import perf_counter
from typing import Any

import gymnasium as gym
import numpy as np
from encoding import Picture, write_film, write_still

import surface_gym as sg
from surface_gym import agents
from surface_gym.agents.rules import RULES
from surface_gym.env import SmartSurfaceEnv
from surface_gym.files import replacing
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.slope_tasks import MOUTH_ALIGNMENT, lines, shuffled
from surface_gym.flow.stream import Stream
from surface_gym.flow.take_away import bulk
from surface_gym.rendering import Painter, Scene
from surface_gym.rendering.ink import EXITS, GOAL, axis_colours
from surface_gym.rendering.marks import placed
from surface_gym.scenes import Renderer

ROOT = Path(__file__).parents[1]
IMAGES = Path(__file__).parent / "images"
PERIOD = 0.04  # [s] a picture of the films stays: as long as the control period that it shows
LINE = ("--rate", "9000", "--mix", "S=1,B=1", "--speed", "1.5")
OURS = ("--parcel", "0.3x0.4", "--mass", "12", "--speed", "1.2")
# Rules that act in films, of tasks whose name stands before.
SLIDING, PARKING = "track: sliding mode", "park: parking rule"
ORIENTATIONS = (0.0, math.pi / 4.0, -math.pi / 4.0, math.pi / 2.0)  # [rad] in the legend
GENTLE = (*ORIENTATIONS, math.radians(80.0), -math.radians(80.0))  # [rad] of streams
ZONE = 8  # columns of a zone for S- and B-boxes
LAST = 1.0  # [s] for which an episode's end stays before the next begins
ROOM = 0.1  # [m] that is shown around all that moves
WIDE, TEXT = 640, 1.4  # [px] of a film of one parcel, and the size of its texts
BROAD = 800  # of a stream
SLOPE_EVERY = 3  # control periods from picture to picture of a slope
BAR = 8  # [px] between two flows, one above the other
SORTED_AT = 20  # control periods from the start to the picture of Sort
ENLARGED = 5  # times, of an observed picture


@dataclass(frozen=True)
class Film:
    """A film of episodes of one environment, one after the other."""

    env_id: str  # as Gymnasium has it
    controller: str  # an agent of `agents.names()`, or a rule
    starts: tuple[dict[str, Any], ...]  # `options` of each episode's reset
    every: int = 1  # control periods from picture to picture
    text: float = TEXT

    def pictures(self) -> list[Picture]:
        """Draw all episodes on as much of the surface as they need; the end of each stays."""
        env, controller = self._acting()
        scenes: list[Scene] = []
        for start in self.starts:
            episode = list(_episode(env, controller, start))
            stays = round(LAST / PERIOD / self.every)
            scenes += [*episode[: -1 : self.every], *[episode[-1]] * stays]
        env.close()
        painter, area = Painter(WIDE, self.text), _moving_area(scenes)
        return [painter.draw(_cropped(scene, *area)) for scene in scenes]

    def _acting(self) -> tuple[gym.Env[Any, Any], Any]:
        if self.controller not in (SLIDING, PARKING):
            policy = agents.load(self.controller)
            return gym.make(self.env_id, **policy.env_kwargs), policy
        rule = RULES.find(self.controller)
        env = gym.make(self.env_id, actions=rule.actions, observe=rule.observe)
        return env, rule.make(env.get_wrapper_attr("config"))


@dataclass(frozen=True)
class FromCommand:
    """A picture that a command writes into the folder given by `--out`."""

    command: tuple[str, ...]  # behind `python`, run where README.md is
    name: str  # of the picture in that folder

    def __call__(self, file: Path) -> None:
        """Run the command and keep its picture.

        Raises:
            CalledProcessError: the command failed.
        """
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run(
                [sys.executable, *self.command, "--out", folder],
                cwd=ROOT,
                check=True,
                stdout=subprocess.DEVNULL,
            )
            with replacing(file) as part:
                shutil.copyfile(Path(folder) / self.name, part)


SORT = Film(
    "SmartSurface/Sort-v0",
    "sort-ppo",
    (
        {"speed": 0.6, "parcel": "S", "side": 1},
        {"speed": 1.2, "parcel": "B", "side": -1},
        {"speed": 2.0, "parcel": "S", "side": 1},
    ),
)
SLOW = Film(
    "SmartSurface/Slow-v0",
    "slow-ppo",
    (
        {"speed": 1.8, "parcel": "B", "ratio": 0.4},
        {"speed": 1.5, "parcel": "S", "ratio": 0.7},
    ),
)
STOP = Film(
    "SmartSurface/Stop-v0",
    "stop-ppo",
    (
        {"speed": 1.2, "parcel": "S", "position": 1.2},
        {"speed": 2.0, "parcel": "B", "position": 1.6},
    ),
)
ORIENT = Film(
    "SmartSurface/Orient-v0",
    "orient-ppo",
    ({"speed": 1.5, "parcel": "B", "angle": 0.5236}, {"speed": 1.8, "parcel": "S", "angle": -0.5}),
)
TRACK = Film(
    "SmartSurface/Track-v0",
    SLIDING,
    ({"speed": 0.8, "parcel": "S", "tilt": 0.21},),
    every=2,
    text=1.1,
)

PARK = Film(
    "SmartSurface/Park-v0",
    PARKING,
    (
        {"speed": 1.5, "parcel": "S", "ahead": 0.8, "aside": 0.15, "angle": 0.5},
        {"speed": 1.5, "parcel": "B", "ahead": 0.7, "aside": -0.1, "angle": -0.4},
    ),
    text=1.1,
)


def _moving_area(scenes: Sequence[Scene]) -> tuple[slice, slice]:
    """Find the rows and columns that parcels move over, with room around, and those of the zone."""
    first = scenes[0]
    points = np.concatenate(
        [placed(parcel.outline, parcel.pose) for scene in scenes for parcel in scene.parcels]
    )
    edge = np.array(first.origin) - 0.5 * np.array(first.pitches)
    low = np.floor((points.min(axis=0) - ROOM - edge) / first.pitches).astype(int)
    high = np.ceil((points.max(axis=0) + ROOM - edge) / first.pitches).astype(int)
    zones = np.array([scene.zone for scene in scenes])
    begin, end = min(low[0], zones[:, 2].min()), max(high[0], zones[:, 2:].sum(axis=1).max())
    columns = slice(max(0, int(begin)), min(first.columns, int(end)))
    return slice(max(0, int(low[1])), min(first.rows, int(high[1]))), columns


def _cropped(scene: Scene, rows: slice, columns: slice) -> Scene:
    """Leave only some rows and columns of a scene's surface."""
    assert scene.zone is not None
    spans = []
    for kept, (begin, number) in ((rows, scene.zone[:2]), (columns, scene.zone[2:])):
        inside = max(begin, kept.start), min(begin + number, kept.stop)
        spans += [inside[0] - kept.start, inside[1] - inside[0]]
    corner = np.array([columns.start, rows.start]) * scene.pitches
    return replace(
        scene,
        axis=scene.axis[rows, columns],
        rotor=scene.rotor[rows, columns],
        drive=None if scene.drive is None else scene.drive[rows, columns],
        origin=tuple((np.array(scene.origin) + corner).tolist()),
        zone=tuple(spans),
    )


def _episode(
    env: gym.Env[Any, Any],
    controller: Any,
    options: dict[str, Any] | None = None,
    seed: int | None = 0,
) -> Iterator[Scene]:
    bare: Any = env.unwrapped
    renderer = Renderer(bare.batch)
    observation, _ = env.reset(seed=seed, options=options)
    renderer.record(0, begins=True)
    yield renderer.scene()
    state, begun, over = None, np.ones(1, dtype=np.bool_), False
    while not over:
        action, state = controller.predict(observation[np.newaxis], state, begun)
        observation, _, terminated, truncated, _ = env.step(action[0])
        renderer.record(0, begins=False)
        yield renderer.scene()
        begun, over = np.zeros(1, dtype=np.bool_), terminated or truncated


def _stream_env(rate: float, **arguments: Any) -> SmartSurfaceEnv:
    """Make a flow of S- and B-boxes at 1.5 m/s, so many of them an hour; gentle turns on offer."""
    stream = Stream(Steady(rate), ("S", "B"), speeds=1.5)
    given = {"actions": "parcels", "gate": True, "duration": 16.0, "orientations": GENTLE}
    return SmartSurfaceEnv("flow", stream=stream, **{**given, **arguments})


def flow_by_chutes() -> list[Picture]:
    """Film a scheduler that leads a stream of S- and B-boxes to two chutes a side."""
    from surface_gym.agents.scheduling.scheduler import make_scheduler

    env = _stream_env(11000.0)
    painter = Painter(BROAD)
    scenes = _episode(env, make_scheduler(env.config))
    return [painter.draw(scene) for scene in islice(scenes, 163, 301, 2)]


def slope(task: str, rule: str, begin: float, end: float, **arguments: Any) -> list[Picture]:
    """Film a rule at work on a slope, from a time [s] to another."""
    from surface_gym.agents.rules import find_rules

    env = SmartSurfaceEnv(task, actions="parcels", **arguments)
    (made,) = (each.make(env.config) for each in find_rules(task) if each.name == rule)
    painter, first, last = Painter(WIDE), round(begin / PERIOD), round(end / PERIOD)
    scenes = islice(_episode(env, made), first, last, SLOPE_EVERY)
    return [painter.draw(scene) for scene in scenes]


def zone_and_modules(begin: float = 9.0, end: float = 13.0) -> list[Picture]:
    """Film one stream twice: one zone arranged as a whole, and modules that obey their parcels.

    Args:
        begin: [s] of the stream, where the film begins.
        end: [s] where it ends.
    """
    from surface_gym.agents.scheduling.maneuvers import ColumnGroups
    from surface_gym.agents.scheduling.scheduler import make_scheduler

    zone = ColumnGroups(ZONE, 1, exclusive=True)
    rows = []
    for title, actions, groups in (
        ("One zone for all", "modules", zone),
        ("Each module by itself", "parcels", None),
    ):
        env, painter = _stream_env(13000.0, exits="sides", actions=actions), Painter(BROAD)
        first, last, every = (round(time / PERIOD) for time in (begin, end, 2.0 * PERIOD))
        scenes = islice(_episode(env, make_scheduler(env.config, groups)), first, last, every)
        rows.append([painter.draw(replace(scene, title=title)) for scene in scenes])
    bar = np.full((BAR, rows[0][0].shape[1], 3), 255, dtype=np.uint8)
    return [np.concatenate([one, bar, other]) for one, other in zip(*rows, strict=True)]


def sort_still(file: Path) -> None:
    """Draw the S-box at 0.6 m/s on its way off the line."""
    write_still(replace(SORT, starts=SORT.starts[:1]).pictures()[SORTED_AT], file)


def flow_still(file: Path) -> None:
    """Draw the stream under the scheduler, 12 s after its start."""
    from surface_gym.agents.scheduling.scheduler import make_scheduler

    env = _stream_env(13000.0, exits="sides")
    scene = next(islice(_episode(env, make_scheduler(env.config)), round(12.0 / PERIOD), None))
    write_still(Painter(BROAD).draw(scene), file)


def trajectories(file: Path) -> None:
    """Draw the trajectories of sorted parcels under the fixed layout and under PPO."""
    from surface_gym.agents.evaluation.method import all_methods, rivals
    from surface_gym.agents.evaluation.report import write_trajectories

    with replacing(file) as part:
        named = part.with_suffix(".png")
        write_trajectories(rivals(all_methods("sort")), named)
        named.replace(part)


def alignment(file: Path) -> None:
    """Draw boxes over rows that push inwards and outwards."""
    from surface_gym.paper.report import draw_alignment

    with replacing(file) as part:
        draw_alignment().savefig(part, dpi=160, format="png")


def checkered(file: Path) -> None:
    """Run `examples/checkered.py` and keep its picture."""
    with tempfile.TemporaryDirectory() as folder:
        example = ROOT / "examples" / "checkered.py"
        subprocess.run(
            [sys.executable, str(example)], cwd=folder, check=True, stdout=subprocess.DEVNULL
        )
        with replacing(file) as part:
            shutil.copyfile(Path(folder) / "checkered.png", part)


def _film(pictures: Callable[[], list[Picture]], seconds: float, width: int, file: Path) -> None:
    inks = [*axis_colours(ORIENTATIONS).tolist(), GOAL, *EXITS]
    write_film(pictures(), seconds, width, file, inks)


def _design(question: str, *flags: str) -> FromCommand:
    return FromCommand(("-m", "surface_gym.design", question, *flags), f"{question}.png")


SLOPES: dict[str, Callable[[], list[Picture]]] = {
    "singulate": partial(  # a bulk through a mouth
        slope, "singulate", "time slots", 4.0, 12.4, stream=bulk(12000.0), exits="mouth",
        alignment=MOUTH_ALIGNMENT,
    ),
    "merge": partial(slope, "merge", "time slots", 4.0, 13.0, stream=lines(9000.0)),
    "sequence": partial(
        slope, "sequence", "pass and park", 0.0, 16.0, stream=shuffled(2400.0, window=4)
    ),
}  # fmt: skip


def observations(file: Path) -> None:
    """Draw an observation of Sort in grey and in colours, enlarged, side by side."""
    policy, pictures = agents.load("sort-ppo"), []
    for channels in (1, 3):
        image = sg.Image(channels=channels)
        envs = [
            gym.make(SORT.env_id, **{**policy.env_kwargs, **own})
            for own in ({}, {"observe": image})
        ]
        seen, picture = (env.reset(seed=0, options=SORT.starts[0])[0] for env in envs)
        for _ in range(SORTED_AT):
            action = policy.predict(seen)[0]
            seen, picture = (env.step(action)[0] for env in envs)
        pictures.append(np.repeat(picture, 3 // channels, axis=2))
    write_still(np.kron(np.hstack(pictures), np.ones((ENLARGED, ENLARGED, 1), np.uint8)), file)


PICTURES: dict[str, Callable[[Path], None]] = {
    "start.webp": partial(_film, zone_and_modules, 0.08, BROAD),
    "sort.webp": partial(_film, SORT.pictures, PERIOD, WIDE),
    "slow.webp": partial(_film, SLOW.pictures, PERIOD, WIDE),
    "stop.webp": partial(_film, STOP.pictures, PERIOD, WIDE),
    "park.webp": partial(_film, PARK.pictures, PERIOD, WIDE),
    "track.webp": partial(_film, TRACK.pictures, 1.5 * PERIOD, WIDE),
    "orient.webp": partial(_film, ORIENT.pictures, PERIOD, WIDE),
    "flow.webp": partial(_film, flow_by_chutes, 2.0 * PERIOD, BROAD),
    **{
        f"{task}.webp": partial(_film, pictures, SLOPE_EVERY * PERIOD, WIDE)
        for task, pictures in SLOPES.items()
    },
    "sort.png": sort_still,
    "flow.png": flow_still,
    "observations.png": observations,
    "trajectories.png": trajectories,
    "alignment.png": alignment,
    "checkered.png": checkered,
    "design-columns.png": _design("columns", *OURS),
    "design-speed.png": _design("speed", *OURS),
    "design-friction.png": _design("friction", *OURS),
    "design-layout.png": _design("layout", "--parcel", "S", "--any-angle"),
    "robustness.png": FromCommand(("evaluate.py", "--robustness"), "robustness.png"),
    "flow-capacity.png": FromCommand(("evaluate.py", "--tasks", "flow"), "flow-capacity.png"),
    "design-flow.png": _design("flow", *LINE),
    "modules.png": FromCommand(("evaluate.py", "--modules"), "modules.png"),
    "board-orient.png": FromCommand(
        ("-c", "from surface_gym.cli import main; main()", "benchmark", "plot"),
        "orient-scores.png",
    ),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Make all pictures, or those that are asked for."""
    parser = argparse.ArgumentParser(
        prog="python docs/pictures.py",
        description="Make the pictures and films of the documentation, in docs/images.",
        epilog="The films take two minutes, design-layout.png two, flow-capacity.png ten, and "
        "robustness.png thirty.",
    )
    parser.add_argument(
        "--only", nargs="+", choices=PICTURES, metavar="NAME", help=", ".join(PICTURES)
    )
    asked = parser.parse_args(arguments).only or list(PICTURES)
    for number, name in enumerate(asked, start=1):
        print(f"[{number}/{len(asked)}] {name} ...", end=" ", flush=True)
        begun = perf_counter()
        PICTURES[name](IMAGES / name)
        size = (IMAGES / name).stat().st_size
        print(f"{size / 1000:.0f} kB, {perf_counter() - begun:.0f} s", flush=True)


if __name__ == "__main__":
    main()
