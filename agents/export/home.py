"""The home page's comparison: the same stream of boxes on two lines, each with its own scheduler.

Writes `home.bin`, the stream with all boxes yet to arrive, and `home.json`, its layout. The page
runs `flow.wasm`, since one kernel serves all exits, gates and boxes. The schedulers share a second
module, with one memory per line.
"""

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from surface_gym.compiler.wasm_image import make_image
from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.batch import StreamBatch
from surface_gym.web.starts import describe, goal_marks

from ..evaluation.method import Method, stream_benchmark
from ..evaluation.report import filmed_scenario
from ..evaluation.streams import ARRANGED, MODULES, TASK, ladder
from ..scheduling.leading import schedule
from ..scheduling.scheduler import Scheduler
from .rules import write, write_machine

FILES = ("home.bin", "home.json")
BOXES = 1000  # number of boxes in an hour; the page scales the arrival rate
SEED = 0  # seed of the boxes' kinds and exits


def find_methods() -> list[Method]:
    """Return the compared methods of both lines, the upper line first."""
    named = {each.name: each for each in ladder()}
    return [named[ARRANGED], named[MODULES]]


def make_config(method: Method) -> EnvConfig:
    """Return the configuration of a method's line."""
    return filmed_scenario(TASK).config(method, BOXES).replace(duration=HOUR)


@lru_cache(maxsize=1)
def make_schedulers() -> tuple[Scheduler, ...]:
    """Make the scheduler of each line. It takes seconds."""
    made = [method.controller(make_config(method), 0) for method in find_methods()]
    return tuple(each for each in made if isinstance(each, Scheduler))


def place_stream(config: EnvConfig) -> StreamBatch:
    """Make the stream: the same boxes at the same times on every line."""
    batch = StreamBatch(config, 1)
    batch.seed(0, np.random.default_rng(SEED))
    batch.place_drawn(np.zeros(1, dtype=np.int64))
    return batch


def write_home(folder: Path, obeying: dict[str, Any]) -> None:
    """Write the comparison's files to the folder of a site.

    Args:
        folder: folder of the site.
        obeying: card of the function that assigns parcels to Flow's modules.
    """
    batch = place_stream(make_config(find_methods()[0]))
    image = make_image(batch.make_kernel(), batch.arguments)
    layout = {
        **image.layout(),
        "scene": describe(batch),
        "starts": {"fields": [], "marks": [goal_marks(batch)]},  # the image is the only start
        "warmUp": stream_benchmark(TASK).warm_up,
        "obeying": obeying,
        "lines": [
            {
                **write_machine(
                    "schedule", f"home-{place}", schedule, each.start_arguments(), folder
                ),
                "byGroups": each.library.lead.groups is not None,
            }
            for place, each in enumerate(make_schedulers())
        ],
    }
    written = (json.dumps(layout, separators=(",", ":"), allow_nan=False) + "\n").encode()
    for name, content in zip(FILES, (image.block, written), strict=True):
        write(folder / name, content)
