"""How parcels that come one at a time pass a zone of a line: their exits, and when it is free."""

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
from surface_gym.state import RUNNING

from ..controller import Controller
from .packing import Numbers
from .parcel_rule import Booleans
from .ways import Asked

TRIES = 32  # of each parcel: what varies is drawn anew, and it enters at another physics step


@dataclass(frozen=True, eq=False)
class Passing:
    """Of some parcels, over all tries of each."""

    right: Booleans  # (parcels,) whether it left by its exit every time
    enters: Numbers  # (parcels,) [s] since it came: the soonest that its front was over the zone
    leaves: Numbers  # (parcels,) [s] since it came: the latest that it had left the zone

    def gaps(self, period: float) -> Numbers:
        """(parcels, parcels) [s] between entries, for each (column) to find the zone free of each
        other (row), and turned meanwhile: by a decision that comes up to a period [s] late.
        """
        return np.maximum(0.0, np.subtract.outer(self.leaves + period, self.enters))


def passing(
    make: Callable[[FlowSettings], Controller],
    settings: FlowSettings,
    asked: Sequence[Asked],
    span: tuple[float, float],
) -> Passing:
    """Try parcels, each alone on the line, as the sensors see it and with all that varies.

    Args:
        make: the controller, of the settings it acts in.
        settings: of the flow, with a gate; its stream is of no account.
        asked: which parcels.
        span: [m] of x over which the zone lies.
    """
    alone = replace(settings, places=1, gate=True, stream=_only(asked[0]))
    each = [one for one in asked for _ in range(TRIES)]
    lanes = len(each)
    attempt = np.tile(np.arange(TRIES), len(asked))
    batch = FlowBatch(alone, lanes)
    for lane in range(lanes):
        batch.seed(lane, np.random.default_rng(int(attempt[lane])))
    batch.start(np.arange(lanes), [{"stream": _only(one)} for one in each])
    controller, actions = make(alone), alone.flow_actions
    opens = 1 + attempt % alone.timing.steps
    state: Any = None
    clocks, poses = [], []
    while (batch.outcome == RUNNING).any() and np.isnan(batch.streams.left[:, 0]).any():
        action, state = controller.predict(batch.observation, state)
        action = np.asarray(action).copy()
        action[:, -1] = opens
        batch.advance(actions.commands(action, lanes))
        clocks.append(batch.streams.clock.copy())
        poses.append(batch.parcels.truth.reshape(lanes, alone.rows, 6)[:, 0, :3].copy())
    clock, pose = np.array(clocks), np.array(poses)
    entered, left = batch.streams.entered[:, 0], batch.streams.left[:, 0]
    enters, leaves = np.empty(lanes), np.empty(lanes)
    for lane, (parcel, _, _) in enumerate(each):
        there = (clock[:, lane] > entered[lane]) & ~(clock[:, lane] > left[lane])
        time = clock[there, lane] - entered[lane]
        rear, front = _reach(parcel, pose[there, lane])
        enters[lane] = _time_at(time, front, span[0])
        gone = np.inf if np.isnan(left[lane]) else left[lane] - entered[lane]
        leaves[lane] = min(gone, _time_at(time, rear, span[1]))
    shape = len(asked), TRIES
    right: Booleans = np.all(batch.streams.tally[:, RIGHT].reshape(shape) > 0, axis=1)
    return Passing(
        right=right,
        enters=enters.reshape(shape).min(axis=1),
        leaves=leaves.reshape(shape).max(axis=1),
    )


def _reach(parcel: Parcel, pose: Numbers) -> tuple[Numbers, Numbers]:
    """(moments,) [m] least and greatest x of a base at poses (moments, 3) of its centroid."""
    along, across = (parcel.base.outline - np.array(parcel.base.centroid)).T
    turned = np.outer(np.cos(pose[:, 2]), along) - np.outer(np.sin(pose[:, 2]), across)
    return pose[:, 0] + turned.min(axis=1), pose[:, 0] + turned.max(axis=1)


def _time_at(time: Numbers, x: Numbers, place: float) -> float:
    """[s] when x [m] first passes a place; infinite if it never does."""
    past = x >= place
    if not past.any():
        return float("inf")
    k = int(past.argmax())
    if k == 0:
        return float(time[0])
    share = (place - x[k - 1]) / (x[k] - x[k - 1])
    return float(time[k - 1] + share * (time[k] - time[k - 1]))


def _only(one: Asked) -> Stream:
    """A stream of one parcel, at once."""
    return Stream(Trace((Arrival(0.0, *one),)))
