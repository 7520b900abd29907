"""Training of the network that predicts which decisions of a scheduler make parcels touch.

The network learns from episodes on random lines, with its own decisions and exploration.
"""

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.flow import arrivals
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.exits import Exit, Exits, flow_line, sides
from surface_gym.flow.state import JAM, ON_ITS_WAY
from surface_gym.flow.stream import Stream
from surface_gym.registration import DEFAULT_STREAM
from surface_gym.state import RUNNING

from ..base import Booleans, Integers, Numbers
from ..library import QUEUE
from ..schedule_policy import NetworkScheduler, ScheduleNetwork, as_tensors
from ..scheduling.decisions import LEVELS, USUAL, Decisions
from ..scheduling.scheduler import entrance_bound
from ..tensors import check_like, load_optimizer
from .algorithms import SchedulesConfig
from .learner import MAX_GRAD_NORM, PlainAdam, learning_rate
from .runs import Curve

DURATION = 16.0  # [s] of an episode
PRICES = (0.5, 50.0)  # [-] price of a touch, log-uniform in this range
WRONG = 2.0  # [touches] penalty of a wrong exit or a jam
IN_THE_WAY = 0.5  # [touches] penalty of the parcel ahead
ANY_LEVEL, ANY_OPTION = 0.3, 0.15  # [-] share of exploring decisions
NEAR = 0.7  # [parcels] maximum additional cost of an explored maneuver
STRONG = 100.0  # [parcels] bonus that enforces exploration
MEMORY = 160  # number of remembered rollouts
PASSES = 2  # maximum passes over the memory per update
KEPT = 0.9  # [-] probability of a rollout on a stored line
LINES = 24  # number of stored lines, whose libraries take seconds to make
FOUR, SIX = (0.0, 45.0, -45.0, 90.0), (0.0, 45.0, -45.0, 90.0, 80.0, -80.0)  # [deg]
TERMS = ("touches", "wrong")


def draw_config(rng: np.random.Generator, control_period: float) -> EnvConfig:
    """Draw the configuration of a random line, stream and sensor, for a control period [s]."""
    length = round(float(rng.uniform(4.0, 8.0)), 1) if rng.random() < 0.5 else 6.0
    line = flow_line(length)
    speed = float(rng.uniform(0.9, 2.2))
    # A library has maneuvers for each parcel, speed and exit, so not all three vary at once.
    spread, chutes, six = (rng.random() < odds for odds in (0.3, 0.5, 0.4))
    speeds = (max(0.8, speed - float(rng.uniform(0.3, 0.9))), speed) if spread else speed
    exits = _draw_exits(rng, length) if chutes and not spread else sides(length)
    parcels = _draw_parcels(rng)[: 2 if spread or (chutes and six) else None]
    angles = SIX if six and not spread else FOUR
    camera = rng.random() < 0.5
    config = EnvConfig(
        DEFAULT_STREAM,
        stream=Stream(arrivals.Steady(3600.0), parcels=parcels, speeds=speeds),
        line=line,
        exits=exits,
        actions="parcels",
        orientations=tuple(np.radians(angles)),
        control_period=control_period,
        duration=DURATION,
        gate=True,
        queue=QUEUE,
        sensors=sg.sensors.Camera() if camera else sg.sensors.Exact(),
        randomisation=sg.Randomisation(
            friction=float(rng.uniform(0.0, 0.25)) if camera else 0.0,
            com_offset=float(rng.uniform(0.0, 0.2)) if rng.random() < 0.3 else 0.0,
        ),
        actuators=sg.Actuators(
            axis_speed=0.5 * math.pi / float(rng.uniform(0.01, 0.08))
            if rng.random() < 0.5
            else math.inf,
            stuck_share=float(rng.uniform(0.0, 0.015)) if rng.random() < 0.3 else 0.0,
        ),
    )
    rate = entrance_bound(config)
    law: arrivals.Law = arrivals.Steady(rate)
    if rng.random() < 0.4:
        law = arrivals.Poisson(float(rng.uniform(0.5, 1.0)) * rate)
    stream = Stream(law, parcels=parcels, speeds=speeds)
    return config.replace(stream=stream)


def _draw_parcels(rng: np.random.Generator) -> tuple[sg.Parcel, ...]:
    """Draw one or two of the study's boxes, or one to four random boxes."""
    if rng.random() < 0.4:
        return tuple(sg.layouts.box(name) for name in ("S", "B")[: int(rng.integers(1, 3))])
    sizes = rng.uniform(0.2, 0.45, (int(rng.integers(1, 5)), 2)).round(2).tolist()
    return tuple(sg.Parcel(sg.Rectangle(*each)) for each in sizes)


def _draw_exits(rng: np.random.Generator, length: float) -> Exits:
    """Draw one to three chutes per side of a line `length` [m] long; add the exit at the end."""
    found = [Exit("straight", 0)]
    for name, side in (("left", 1), ("right", -1)):
        count = int(rng.integers(1, 4))
        edges = np.linspace(0.4, length - 0.1, count + 1)
        for k, (low, high) in enumerate(pairwise(edges.tolist())):
            first, last = low + rng.uniform(0.0, 0.2), high - rng.uniform(0.1, 0.3)
            found.append(Exit(f"{name} {k + 1}", side, first, last))
    return Exits(tuple(found))


class Recorder(NetworkScheduler):
    """Scheduler that explores and records its decisions."""

    def record(self, batch: StreamBatch, rng: np.random.Generator) -> None:
        """Begin to record a batch's decisions. `rng` draws random numbers for exploration."""
        self._batch, self._rng = batch, rng
        self._prices = np.exp(rng.uniform(math.log(PRICES[0]), math.log(PRICES[1]), batch.num_envs))
        self.kept: list[tuple[Decisions, Integers, Integers, Integers]] = []

    def choose(self, decisions: Decisions) -> tuple[Integers, Integers]:
        rng, count = self._rng, len(decisions.env)
        price = self._prices[decisions.env][:, np.newaxis, np.newaxis]
        cost = decisions.cost + price * np.exp(self.risk(decisions))
        # Some decisions take any level, and some any maneuver with a small additional cost.
        levels = rng.random((count, 1, 1)) < ANY_LEVEL
        cost += STRONG * levels * rng.random((count, 1, len(LEVELS)))
        near = decisions.cost[..., USUAL, np.newaxis] < NEAR
        cost += np.where((rng.random((count, 1, 1)) < ANY_OPTION) & near, STRONG, 0.0) * (
            rng.random((*cost.shape[:2], 1)) - 1.0
        )
        option, level = np.divmod(cost.reshape(count, -1).argmin(axis=1), len(LEVELS))
        arrival = self._batch.streams.number[decisions.env, self._parcels].copy()
        self.kept.append((decisions, option, level, arrival))
        return option, level


class DecisionSamples(NamedTuple):
    """Features of each decision's chosen option, and the number of touches after the decision."""

    option: torch.Tensor  # (samples, 1, OPTION)
    token: torch.Tensor
    shown: torch.Tensor
    about: torch.Tensor
    level: torch.Tensor  # (samples,)
    touches: torch.Tensor  # (samples,)

    def select(self, chosen: torch.Tensor) -> "DecisionSamples":
        """Return the samples with the indices `chosen`."""
        return DecisionSamples(*(each[chosen] for each in self))


class ScheduleLearner:
    """`Learner` of the network that predicts touches. The network trains on its own decisions."""

    terms = TERMS

    def __init__(self, config: SchedulesConfig) -> None:
        self._config = config
        torch.manual_seed(config.seed)
        self.network = ScheduleNetwork(config.hidden)
        self._optimiser = PlainAdam(self.network.parameters(), config.learning_rate)
        self.steps = 0
        self.begin(config.seed)

    def begin(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._lines: list[tuple[EnvConfig, Recorder]] = []
        self._samples: list[DecisionSamples] = []

    def learn(self, curve: Curve) -> None:
        for group in self._optimiser.param_groups:
            group["lr"] = learning_rate(self._config, self.steps)
        for _ in range(self._config.lines):
            samples, infos = self._roll_out()
            self._samples = [*self._samples, samples][-MEMORY:]
            curve.add_episodes(infos)
        every = DecisionSamples(*map(torch.cat, zip(*self._samples, strict=True)))
        # Avoids overfitting to few decisions, at the start and after a checkpoint.
        most = PASSES * len(every.level) // self._config.batch_size
        for _ in range(min(self._config.gradient_steps, most)):
            chosen = self._rng.integers(len(every.level), size=self._config.batch_size)
            self._step(every.select(torch.from_numpy(chosen)))

    def state(self) -> dict[str, Any]:
        return {
            "network": self.network.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "steps": self.steps,
        }

    def restore(self, state: dict[str, Any]) -> None:
        own = {"network": self.network.state_dict(), "steps": 0}
        for name, values in own.items():
            check_like(name, state[name], values)
        self.network.load_state_dict(state["network"])
        load_optimizer(self._optimiser, state["optimiser"])
        self.steps = state["steps"]

    def _take_line(self) -> tuple[EnvConfig, Recorder]:
        """Return the configuration and the scheduler of a recent line or of a new line."""
        if len(self._lines) == LINES and self._rng.random() < KEPT:
            return self._lines[int(self._rng.integers(LINES))]
        config = draw_config(self._rng, self._config.control_period)
        made = config, Recorder(config, self.network)
        self._lines = [*self._lines, made][-LINES:]
        return made

    def _roll_out(self) -> tuple[DecisionSamples, list[dict[str, Any]]]:
        """Run one episode of each stream; return decisions, and infos for the learning curve."""
        config, recorder = self._take_line()
        count = self._config.num_envs
        batch = StreamBatch(config, count)
        for i in range(count):
            batch.seed(i, np.random.default_rng(self._rng.integers(2**63)))
        batch.reset(np.arange(count))
        recorder.record(batch, self._rng)
        blame = np.zeros(batch.streams.touches.shape)
        state = None
        while (batch.outcome == RUNNING).any():
            before = batch.streams.touches.copy()
            self.steps += int((batch.outcome == RUNNING).sum())
            action, state = recorder.predict(batch.observation, state)
            batch.step(config.action_kind.commands(action, count))
            share_blame(batch.streams.touches > before, blame)
        found = _collect(recorder, batch, blame), _infos(batch, blame)
        recorder.kept.clear()
        return found

    def _step(self, samples: DecisionSamples) -> None:
        """Take a gradient step on the Poisson likelihood of the touches in the samples."""
        risk = self.network(samples.option, samples.token, samples.shown, samples.about)[:, 0]
        own = risk.gather(1, samples.level[:, None])[:, 0]
        loss = (own.exp() - samples.touches * own).mean()
        self._optimiser.zero_grad()
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), MAX_GRAD_NORM)
        self._optimiser.step()


def _collect(recorder: Recorder, batch: StreamBatch, blame: Numbers) -> DecisionSamples:
    """Return the last recorded decision for each parcel that has departed or is in a jam.

    A decision's number of touches is the parcel's `blame`. A wrong exit or a jam adds `WRONG`.
    """
    streams = batch.streams
    env = np.concatenate([each.env for each, *_ in recorder.kept])
    option, level, arrival = (
        np.concatenate([each[k] for each in recorder.kept]) for k in (1, 2, 3)
    )
    inputs = zip(*(as_tensors(each) for each, *_ in recorder.kept), strict=True)
    options, token, shown, about = map(torch.cat, inputs)
    left = streams.taken[env, arrival] != ON_ITS_WAY
    wrong = left & (streams.taken[env, arrival] != streams.exit[env, arrival])
    wrong |= (streams.outcome[env] == JAM) & ~left
    touches = blame[env, arrival] + WRONG * wrong
    # If a parcel's entry was postponed, the last decision counts.
    last = {key: k for k, key in enumerate(zip(env.tolist(), arrival.tolist(), strict=True))}
    kept = [k for k in last.values() if left[k] or streams.outcome[env[k]] == JAM]
    chosen = options[kept, option[kept]][:, None]
    return DecisionSamples(
        chosen, token[kept], shown[kept], about[kept], torch.from_numpy(level[kept]),
        torch.from_numpy(touches[kept]).float(),
    )  # fmt: skip


def share_blame(touched: Booleans, blame: Numbers) -> None:
    """Add blame to the parcels that were touched in a control period.

    If at least two parcels of an environment were touched, the touched parcel that arrived first
    gets a blame of `IN_THE_WAY`, and every other touched parcel gets a blame of 1. If only one
    parcel of an environment was touched, the parcel gets no blame.

    Args:
        touched: (num_envs, arrivals) whether a parcel was touched.
        blame: (num_envs, arrivals) blame of each parcel so far, changed in place.
    """
    for i in np.nonzero(touched.sum(axis=1) > 1)[0].tolist():
        first, *others = np.nonzero(touched[i])[0].tolist()
        blame[i, first] += IN_THE_WAY
        blame[i, others] += 1.0


def _infos(batch: StreamBatch, blame: Numbers) -> list[dict[str, Any]]:
    """Return each episode's info, with the share of departed parcels that took their own exit.

    The info also has the penalties for touches and for wrong exits.
    """
    streams = batch.streams
    infos = []
    for i in range(batch.num_envs):
        left = streams.taken[i] != ON_ITS_WAY
        wrong = float((left & (streams.taken[i] != streams.exit[i])).sum())
        lost = dict(zip(TERMS, (-float(blame[i].sum()), -WRONG * wrong), strict=True))
        infos.append(
            {
                "is_success": 1.0 - wrong / max(1, int(left.sum())),
                "episode": {"r": sum(lost.values()), "l": float(streams.clock[i])},
                "reward_terms": lost,
            }
        )
    return infos
