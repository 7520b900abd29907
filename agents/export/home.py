"""The comparison on the site's home page: one stream of boxes on two lines, each with its schedule.

It writes `home.bin`, a stream with all boxes yet to come, and `home.json`, its layout. The module
is `flow.wasm`: the same kernel, whatever the exits, the gate and the boxes. The function of the
schedulers is another module, with a memory for each line.
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

from ..evaluation.ladder import ARRANGED, MODULES, TASK, ladder
from ..evaluation.method import Method, stream_benchmark
from ..evaluation.report import filmed_scenario
from ..scheduling.leading import schedule
from ..scheduling.scheduler import Scheduler
from .rules import write, write_machine

FILES = ("home.bin", "home.json")
BOXES = 1000  # that come within an hour; a page lets them come as fast as its reader asks
SEED = 0  # of their kinds and exits


def find_methods() -> list[Method]:
    """Find the methods that both lines have in the comparison, the upper line's first."""
    named = {each.name: each for each in ladder()}
    return [named[ARRANGED], named[MODULES]]


def make_config(method: Method) -> EnvConfig:
    """Configure the line of a method."""
    return filmed_scenario(TASK).config(method, BOXES).replace(duration=HOUR)


@lru_cache(maxsize=1)
def make_schedulers() -> tuple[Scheduler, ...]:
    """Make the scheduler of each line; takes seconds."""
    made = [method.controller(make_config(method), 0) for method in find_methods()]
    return tuple(each for each in made if isinstance(each, Scheduler))


def place_stream(config: EnvConfig) -> StreamBatch:
    """Place the stream: the same boxes, at the same times, on every line."""
    batch = StreamBatch(config, 1)
    batch.seed(0, np.random.default_rng(SEED))
    batch.place_drawn(np.zeros(1, dtype=np.int64))
    return batch


def write_home(folder: Path, obeying: dict[str, Any]) -> None:
    """Write the comparison beside the modules of a site.

    Args:
        folder: of the site.
        obeying: describes the function that finds the parcel that each module of Flow obeys.
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
