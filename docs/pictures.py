"""Make the pictures and films of the documentation: `python docs/pictures.py`, `--help` tells more.

Every file in docs/images has a line in `PICTURES`, and is the same to the byte each time, as long
as the versions of `constraints.txt` are the same.
"""

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from time import perf_counter

from picturing import drawing
from picturing.acting import SLIDING, Scene, flow_by_chutes, zone_and_modules
from picturing.drawing import FromCommand
from picturing.encoding import Picture, write_film

IMAGES = Path(__file__).parent / "images"
PERIOD = 0.04  # [s] a picture of the films stays: as long as the control period that it shows
OURS = ("--parcel", "0.3x0.4", "--mass", "12", "--speed", "1.2")

SORT = Scene(
    "SmartSurface/Sort-v0",
    "sort-ppo",
    (
        {"speed": 0.6, "parcel": "S", "side": 1},
        {"speed": 1.2, "parcel": "B", "side": -1},
        {"speed": 2.0, "parcel": "S", "side": 1},
    ),
)
SLOW = Scene(
    "SmartSurface/Slow-v0",
    "slow-ppo",
    (
        {"speed": 1.8, "parcel": "B", "ratio": 0.4},
        {"speed": 1.5, "parcel": "S", "ratio": 0.7},
    ),
)
STOP = Scene(
    "SmartSurface/Stop-v0",
    "stop-ppo",
    (
        {"speed": 1.2, "parcel": "S", "position": 1.2},
        {"speed": 2.0, "parcel": "B", "position": 1.6},
    ),
)
ORIENT = Scene(
    "SmartSurface/Orient-v0",
    "orient-ppo",
    ({"speed": 1.5, "parcel": "B", "angle": 0.5236}, {"speed": 1.8, "parcel": "S", "angle": -0.5}),
)
TRACK = Scene(
    "SmartSurface/Track-v0",
    SLIDING,
    ({"speed": 0.8, "parcel": "S", "tilt": 0.21},),
    every=2,
)


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
    "sort.png": drawing.sort_still,
    "flow.png": drawing.flow_still,
    "trajectories.png": drawing.trajectories,
    "alignment.png": drawing.alignment,
    "checkered.png": drawing.checkered,
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
    """Make all of them, or those that are asked for."""
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
    for place, name in enumerate(asked, start=1):
        print(f"[{place}/{len(asked)}] {name} ...", end=" ", flush=True)
        begun = perf_counter()
        PICTURES[name](IMAGES / name)
        size = (IMAGES / name).stat().st_size
        print(f"{size / 1000:.0f} kB, {perf_counter() - begun:.0f} s", flush=True)


if __name__ == "__main__":
    main()
