"""One trial: a short run of learning, looked at on the way, then judged on fresh starts.

It works in a folder of its own that nobody shares, and is done again from its beginning where its
process dies: it is short, and so comes to the same wherever it is carried out.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np

from surface_gym.sharing import Tell

from ..learning.config import TrainConfig
from ..learning.curve import read_curve
from ..learning.hyperparams import of_seed
from ..learning.legs import Progress
from ..learning.practice import make_lanes
from ..learning.start import start
from ..policies.files import load_policy
from ..tasks import find_task
from .study import Order, Watch
from .sweep import Sweep
from .tried import COMPLETE, FAILED, PRUNED, REFUSED, Tried

STARTS = 512  # that a policy is judged on
JUDGED = 2**32  # first seed of these starts; PyTorch and NumPy learn with lower ones


class _Prune(KeyboardInterrupt):
    """Ends a run as an interrupt does, which leaves its files closed."""


@dataclass
class _Looks:
    """Looks at a trial on the way."""

    order: Order
    tell: Tell
    watch: Watch
    values: dict[int, float] = field(default_factory=dict)  # by the number of the look, from 1
    pruned: bool = False

    def progress(self, place: int, folder: Path) -> Progress:
        """What a run calls, of the seed at a place."""
        sweep = self.order.sweep
        spacing = sweep.steps / (sweep.evaluations + 1)
        left = list(range(1, sweep.evaluations + 1))

        def look(steps: int, success: float) -> None:
            del success  # the curve has it, and the return as well
            while left and steps >= left[0] * spacing:
                number = place * sweep.evaluations + left.pop(0)
                self._take(number, read_curve(folder)[-1][sweep.metric])

        return look

    def _take(self, look: int, value: float) -> None:
        if np.isnan(value):  # no episode has ended yet
            return
        self.values[look] = value
        self.tell((look, value))
        if self.watch.prunes(look, value):
            self.pruned = True
            raise _Prune


def run_trial(order: Order, tell: Tell) -> Tried:
    """Carry a trial out.

    Args:
        order: what to do.
        tell: called with the number of each look, from 1, and the value then.
    """
    started = perf_counter()
    looks = _Looks(order, tell, Watch(order))
    state, value, why = _outcome(order.sweep, order.params, looks)
    return Tried(
        number=order.number,
        params=order.params,
        state=state,
        value=value,
        intermediate=looks.values,
        rungs=looks.watch.rungs,
        why=why,
        seconds=round(perf_counter() - started, 1),
    )


def judge(config: TrainConfig, sweep: Sweep, folder: Path) -> float:
    """What a search goes by: the mean of the greedy policy's first episodes on fresh starts, which
    are the same for all trials.

    Args:
        config: that the policy was trained by.
        sweep: of the search.
        folder: that holds the policy.
    """
    policy = load_policy(folder, find_task(config.task))
    # Seen as the search's own lanes are, whatever share of the camera's a trial learned from.
    usual: dict[str, Any] = {
        name: sweep.fixed.get(name, getattr(sweep.default, name))
        for name in ("camera_share", "friction")
    }
    usual |= {"lanes": STARTS, "batch_size": STARTS}  # which go together, for whoever checks
    lanes = make_lanes(replace(config, **usual))
    lanes.seed(JUDGED + sweep.seed)
    seen = np.asarray(lanes.reset())
    values = np.full(STARTS, np.nan)
    while np.isnan(values).any():
        action, _ = policy.predict(seen, deterministic=True)
        observations, _, ended, infos = lanes.step(action)
        seen = np.asarray(observations)
        for lane in np.nonzero(ended & np.isnan(values))[0]:
            info = infos[lane]
            values[lane] = info["is_success"] if sweep.metric == "success" else info["episode"]["r"]
    lanes.close()
    return float(values.mean())


def _outcome(sweep: Sweep, params: dict[str, Any], looks: _Looks) -> tuple[str, float | None, str]:
    """State of a trial, its value, and why it has none."""
    try:
        config = sweep.config(params)
    except ValueError as error:
        return REFUSED, None, str(error)
    try:
        values = [_value(sweep, config, place, looks) for place in range(sweep.seeds)]
    except _Prune:
        return PRUNED, None, ""
    except (ValueError, ArithmeticError) as error:  # of weights that are no numbers any more
        return FAILED, None, " ".join(str(error).split())[:200]
    return COMPLETE, float(np.mean(values)), ""


def _value(sweep: Sweep, config: TrainConfig, place: int, looks: _Looks) -> float:
    """What the seed at a place comes to."""
    run = of_seed(config, sweep.seed + place)
    with TemporaryDirectory() as name:
        folder = Path(name)
        learned = start(run, folder, looks.progress(place, folder))
        if looks.pruned:
            raise _Prune
        if learned.interrupted:
            raise KeyboardInterrupt
        return judge(run, sweep, folder)
