"""The comparison on the site's home page: one stream of boxes on two lines, each with its schedule.

It writes `home.bin`, a stream of which all boxes are yet to come, and `home.json`, what lies where
in it, and the tables by which `page/schedule.js` schedules both lines. The module is `flow.wasm`:
the same kernel, whatever the exits, the gate and the boxes.
"""

import json
import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from surface_gym.compiler.wasm_image import make_image
from surface_gym.config import EnvConfig
from surface_gym.files import replacing
from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.task import COLUMN
from surface_gym.web.starts import describe, goal_marks

from ..evaluation.capacity import WARM_UP, StreamMethod
from ..evaluation.streams import ARRANGED, FILMED, MODULES, stream_methods
from ..scheduling.scheduler import BOOKED, LONG_AGO, WIDTH, Scheduler
from ..scheduling.trajectories import SIGNATURE

FILES = ("home.bin", "home.json")
BOXES = 1000  # that come within an hour; a page lets them come as fast as its reader asks
SEED = 0  # of their kinds and exits


def find_methods() -> list[StreamMethod]:
    """Find the methods that both lines have in the comparison, the upper line's first."""
    named = {each.name: each for each in stream_methods()}
    return [named[ARRANGED], named[MODULES]]


def make_config(method: StreamMethod) -> EnvConfig:
    """Configure the line of a method."""
    return method.config(FILMED, BOXES).replace(duration=HOUR)


@lru_cache(maxsize=1)
def make_schedulers() -> tuple[Scheduler, ...]:
    """Make the scheduler of each line; takes seconds."""
    made = [method.make(make_config(method)) for method in find_methods()]
    return tuple(each for each in made if isinstance(each, Scheduler))


def place_stream(config: EnvConfig) -> StreamBatch:
    """Place the stream: the same boxes, at the same times, on every line."""
    batch = StreamBatch(config, 1)
    batch.seed(0, np.random.default_rng(SEED))
    batch.place_drawn(np.zeros(1, dtype=np.int64))
    return batch


def describe_schedule(scheduler: Scheduler) -> dict[str, Any]:
    """Describe a scheduler for `page/schedule.js`: its tables, and what it reads of a parcel."""
    library = scheduler.library
    lead, maneuvers = library.lead, library.maneuvers
    card: dict[str, Any] = {
        "gaps": library.gaps.tolist(),
        "delay": library.delay.tolist(),
        "options": [[k for k in own if k >= 0] for own in library.options.tolist()],
        "signature": library.signature.tolist(),
        "kind": maneuvers.kind.tolist(),
        "place": [None if math.isinf(x) else x for x in maneuvers.place.tolist()],
        "choice": maneuvers.choice.tolist(),
        "roll": lead.axes.roll,
        "groups": None,
    }
    if lead.groups is not None:
        card["groups"] = {
            "turned": maneuvers.groups.tolist(),
            "origin": lead.origin.tolist(),
            "first": lead.first_x.tolist(),
            "last": lead.last_x.tolist(),
            "columns": np.diff(lead.spans).ravel().tolist(),
            "ahead": lead.ahead,
        }
    return card


def describe_table() -> dict[str, Any]:
    """Describe what all schedulers share: columns of the table, units, sizes of their memory."""
    return {
        "present": COLUMN.present.place, "time": COLUMN.time.place,
        "past": COLUMN.past_the_exit_s_start.place, "speed": COLUMN.forward_speed.place,
        "length": COLUMN.size.place, "seen": SIGNATURE, "horizon": COLUMN.time.scale,
        "unit": COLUMN.past_the_exit_s_start.scale,
        "half": COLUMN.size.offset, "fifth": COLUMN.size.scale,
        "booked": BOOKED, "width": WIDTH, "longAgo": LONG_AGO,
    }  # fmt: skip


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
        "warmUp": WARM_UP,
        "obeying": obeying,
        "table": describe_table(),
        "lines": [describe_schedule(each) for each in make_schedulers()],
    }
    written = (json.dumps(layout, separators=(",", ":"), allow_nan=False) + "\n").encode()
    for name, content in zip(FILES, (image.block, written), strict=True):
        with replacing(folder / name) as part:
            part.write_bytes(content)
