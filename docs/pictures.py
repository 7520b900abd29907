"""Make the pictures and films of the documentation: `python docs/pictures.py`, `--help` tells more.

Every file in docs/images has a line in `PICTURES`, and is the same to the byte each time, as long
as the versions of `constraints.txt` are the same.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from time import perf_counter
from typing import Any

import gymnasium as gym
import numpy as np
from encoding import Picture, write_film, write_still

from surface_gym import agents
from surface_gym.files import replacing
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.stream import Stream
from surface_gym.rendering import with_caption

ROOT = Path(__file__).parents[1]
IMAGES = Path(__file__).parent / "images"
PERIOD = 0.04  # [s] a picture of the films stays: as long as the control period that it shows
OURS = ("--parcel", "0.3x0.4", "--mass", "12", "--speed", "1.2")
SLIDING = "sliding mode"  # the rule that tracks, by the modules around the parcel
LAST = 12  # pictures for which an episode's end stays before the next begins
BAR = 8  # [px] between two flows, one above the other
SORTED_AT = 20  # control periods from the start to the picture of Sort


@dataclass(frozen=True)
class Film:
    """A film of episodes of one environment, one after the other."""

    env_id: str  # as Gymnasium has it
    controller: str  # an agent of `agents.names()`, or SLIDING
    starts: tuple[dict[str, Any], ...]  # `options` of each episode's reset
    every: int = 1  # control periods from picture to picture

    def pictures(self) -> list[Picture]:
        """Draw all episodes; the end of each stays for some time."""
        env, controller = self._acting()
        shown: list[Picture] = []
        for start in self.starts:
            episode = list(_episode(env, controller, start))
            shown += [*episode[: -1 : self.every], *[episode[-1]] * (LAST // self.every)]
        env.close()
        return shown

    def _acting(self) -> tuple[gym.Env[Any, Any], Any]:
        if self.controller != SLIDING:
            policy = agents.load(self.controller)
            return gym.make(self.env_id, render_mode="rgb_array", **policy.env_kwargs), policy
        from surface_gym.agents.rules.steering import SlidingMode

        env = gym.make(self.env_id, render_mode="rgb_array", actions="window")
        bare: Any = env.unwrapped
        return env, SlidingMode(bare.settings)


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
)


def _episode(env: gym.Env[Any, Any], controller: Any, options: dict[str, Any]) -> Iterator[Picture]:
    observation, _ = env.reset(seed=0, options=options)
    yield _picture(env)
    state, begun, over = None, np.ones(1, dtype=np.bool_), False
    while not over:
        action, state = controller.predict(observation[np.newaxis], state, begun)
        observation, _, terminated, truncated, _ = env.step(action[0])
        yield _picture(env)
        begun, over = np.zeros(1, dtype=np.bool_), terminated or truncated


def _picture(env: gym.Env[Any, Any]) -> Picture:
    picture: Any = env.render()
    return np.asarray(picture, dtype=np.uint8)


def flow_by_chutes() -> list[Picture]:
    """Film a reservation that leads a stream of S- and B-boxes to two chutes a side."""
    from surface_gym.agents.rules.reservation import Reservation

    stream = Stream(Steady(7000.0), ("S", "B"), speeds=1.5)
    env = gym.make(
        "SmartSurface/Flow-v0",
        render_mode="rgb_array",
        stream=stream,
        actions="parcels",
        gate=True,
        duration=12.0,
    )
    bare: Any = env.unwrapped
    reservation, state = Reservation(bare.settings), None
    observation, _ = env.reset(seed=0)
    shown, over, time = [], False, 0.0
    while not over:
        action, state = reservation.predict(observation, state)
        observation, _, terminated, truncated, info = env.step(action)
        over, time = terminated or truncated, info["time"]
        if time > 6.5:
            shown.append(_picture(env))
    env.close()
    return shown[::2]


def zone_and_modules(begin: float = 9.0, end: float = 15.0) -> list[Picture]:
    """Film one stream twice: one zone arranged as a whole, and modules that obey their parcels.

    Args:
        begin: [s] of the stream, where the film begins.
        end: [s] where it ends.
    """
    from surface_gym.agents.evaluation.report import stream_player
    from surface_gym.agents.evaluation.streams import ARRANGED, CURVE, LEARNED, stream_methods
    from surface_gym.agents.evaluation.video import play

    titles = {
        ARRANGED: "One zone, arranged as a whole for each parcel",
        LEARNED: "Every module obeys the parcel that it bears: flow-ppo",
    }
    named = {each.name: each for each in stream_methods()}
    rows = []
    for name, title in titles.items():
        method = named[name]
        period = method.control_period
        first, last, every = (round(time / period) for time in (begin, end, 0.08))
        pictures = play(stream_player(method, CURVE, rate=8500.0), every=every)
        shown = [
            with_caption(picture, title)
            for frame, (picture, _) in enumerate(islice(pictures, last))
            if frame >= first and frame % every == 0
        ]
        rows.append(shown)
    bar = np.full((BAR, rows[0][0].shape[1], 3), 255, dtype=np.uint8)
    return [np.concatenate([one, bar, other]) for one, other in zip(*rows, strict=True)]


def sort_still(file: Path) -> None:
    """Draw the S-box at 0.6 m/s on its way off the line."""
    scene = Film("SmartSurface/Sort-v0", "sort-ppo", ({"speed": 0.6, "parcel": "S", "side": 1},))
    write_still(scene.pictures()[SORTED_AT], file)


def flow_still(file: Path) -> None:
    """Draw the stream under the reservation, 12 s after its start."""
    from surface_gym.agents.evaluation.report import stream_picture
    from surface_gym.agents.evaluation.streams import RESERVATION, stream_methods

    method = next(each for each in stream_methods() if each.name == RESERVATION)
    write_still(stream_picture(method, rate=8550.0), file)


def trajectories(file: Path) -> None:
    """Draw the trajectories of sorted parcels under the fixed layout and under PPO."""
    from surface_gym.agents.evaluation.methods import all_methods, rivals
    from surface_gym.agents.evaluation.report import write_trajectories

    with replacing(file) as part:
        named = part.with_suffix(".png")
        write_trajectories(rivals(all_methods("sort")), named)
        named.replace(part)


def alignment(file: Path) -> None:
    """Draw boxes over rows that push inwards and outwards."""
    from surface_gym.paper.figures import draw_alignment

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
    write_film(pictures(), seconds, width, file)


def _design(question: str, *flags: str) -> FromCommand:
    return FromCommand(("-m", "surface_gym.design", question, *flags), f"{question}.png")


PICTURES: dict[str, Callable[[Path], None]] = {
    "start.webp": partial(_film, zone_and_modules, 0.08, 640),
    "sort.webp": partial(_film, SORT.pictures, PERIOD, 480),
    "slow.webp": partial(_film, SLOW.pictures, PERIOD, 480),
    "stop.webp": partial(_film, STOP.pictures, PERIOD, 480),
    "track.webp": partial(_film, TRACK.pictures, 1.5 * PERIOD, 560),
    "orient.webp": partial(_film, ORIENT.pictures, PERIOD, 480),
    "flow.webp": partial(_film, flow_by_chutes, 2.0 * PERIOD, 640),
    "sort.png": sort_still,
    "flow.png": flow_still,
    "trajectories.png": trajectories,
    "alignment.png": alignment,
    "checkered.png": checkered,
    "design-columns.png": _design("columns", *OURS),
    "design-speed.png": _design("speed", *OURS),
    "design-friction.png": _design("friction", *OURS),
    "design-map.png": _design("map", "--parcel", "0.3x0.4", "--speed", "1.2"),
    "design-control.png": _design("control", "--parcel", "0.3x0.4", "--speed", "1.2"),
    "design-layout.png": _design("layout", "--parcel", "S", "--any-angle"),
    "robustness.png": FromCommand(("evaluate.py", "--robustness"), "robustness.png"),
    "flow-rate.png": FromCommand(("evaluate.py", "--tasks", "flow"), "flow-rate.png"),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Make all pictures, or those that are asked for."""
    parser = argparse.ArgumentParser(
        prog="python docs/pictures.py",
        description="Make the pictures and films of the documentation, in docs/images.",
        epilog="The films take two minutes, design-layout.png two, flow-rate.png five, and "
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
