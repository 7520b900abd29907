"""The ways that parcels take over a line that each has to itself."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surface_gym.flow.batch import FlowBatch
from surface_gym.flow.memory import RIGHT
from surface_gym.flow.settings import FlowSettings
from surface_gym.flow.stream import Stream
from surface_gym.flow.trace import Arrival, Trace
from surface_gym.parcel import Parcel
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Exact
from surface_gym.state import RUNNING

from ..controller import Controller
from .packing import Numbers, Way

SPEED_STEP = 0.1  # [m/s] between the ways of a stream whose speeds vary, at most
SIGNATURE = (3, 6, 13, 14, 16, 17)  # features that tell apart what waits at the gate

Asked = tuple[Parcel, float, str]  # a parcel, its speed [m/s] and its exit's name


@dataclass(frozen=True, eq=False)
class Ways:
    """How each of some parcels goes alone, by one controller."""

    asked: tuple[Asked, ...]
    ways: tuple[Way, ...]
    right: tuple[bool, ...]  # whether it leaves by its own exit
    signature: Numbers  # (ways, features) by which each is known as it waits


def asked_of(settings: FlowSettings) -> list[Asked]:
    """Every parcel, speed and exit of a stream; of speeds that vary, some from the least to the
    greatest.
    """
    stream = settings.stream
    if isinstance(stream.arrivals, Trace):
        return list(dict.fromkeys((a.parcel, a.speed, a.exit) for a in stream.arrivals.arrivals))
    if isinstance(stream.speeds, tuple):
        low, high = stream.speeds
        count = 1 + int(np.ceil((high - low) / SPEED_STEP - 1e-9))
        speeds = np.linspace(low, high, max(2, count)).tolist()
    else:
        speeds = [stream.speeds]
    named = stream.destinations or [(name, 1.0) for name in settings.exits.names]
    return [
        (parcel, speed, name) for parcel in stream.kinds for speed in speeds for name, _ in named
    ]


def ways_of(
    make: Callable[[FlowSettings], Controller], settings: FlowSettings, asked: Sequence[Asked]
) -> Ways:
    """The ways of parcels, each alone on the line, seen as they are.

    Args:
        make: the controller, of the settings it acts in.
        settings: of the flow; its stream, its sensors and what varies are of no account.
        asked: which parcels.
    """
    alone = replace(
        settings, places=1, gate=True, sensors=Exact(), randomisation=Randomisation(),
        stream=_only(asked[0]),
    )  # fmt: skip
    count = len(asked)
    batch = FlowBatch(alone, count)
    for lane in range(count):
        batch.seed(lane, np.random.default_rng(lane))
    batch.start(np.arange(count), [{"stream": _only(one)} for one in asked])
    signature = batch.observation[:, -1, SIGNATURE].astype(np.float64)
    controller, actions = make(alone), alone.flow_actions
    state: Any = None
    moments, poses = [], []
    while (batch.outcome == RUNNING).any() and np.isnan(batch.streams.left[:, 0]).any():
        action, state = controller.predict(batch.observation, state)
        batch.advance(actions.commands(action, count))
        moments.append(batch.streams.clock.copy())
        poses.append(batch.parcels.truth.reshape(count, alone.rows, 6)[:, 0, :3].copy())
    time, pose = np.array(moments), np.array(poses)
    entered, left = batch.streams.entered[:, 0], batch.streams.left[:, 0]
    return Ways(
        asked=tuple(asked),
        ways=tuple(
            _way(one[0], time[:, lane], pose[:, lane], entered[lane], left[lane])
            for lane, one in enumerate(asked)
        ),
        right=tuple(bool(count) for count in batch.streams.tally[:, RIGHT]),
        signature=signature,
    )


def _way(parcel: Parcel, time: Numbers, pose: Numbers, entered: float, left: float) -> Way:
    """From times (moments,) [s] and poses (moments, 3) between which it entered and left; the pose
    at which it left stays until the next is looked at.
    """
    left = time[-1] if np.isnan(left) else left
    inside = (time > entered) & (time < left)
    last = pose[np.searchsorted(time, left)] if left <= time[-1] else pose[-1]
    time, pose = np.append(time[inside], left), np.vstack([pose[inside], last])
    return Way(parcel.base.outline - np.array(parcel.base.centroid), time - entered, pose)


def _only(one: Asked) -> Stream:
    """A stream of one parcel, at once."""
    return Stream(Trace((Arrival(0.0, *one),)))
