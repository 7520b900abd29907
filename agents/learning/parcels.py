"""Shared-policy PPO per parcel of a stream: agent slots, training streams and imitation.

A slot follows one parcel: from when it comes up to the gate until it has left the line. The
observation of a free slot is zero, and its actions have no effect.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common import base_class, callbacks, vec_env

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.flow import arrivals, task
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import JAM, NOBODY
from surface_gym.flow.stream import Stream
from surface_gym.state import OUT_OF_TIME, RUNNING

from ..policy import ParcelActions, ParcelNetwork, mirrored_rows, parcel_spaces
from ..rules.reservation import Reservation
from ..vec_env import BatchVecEnv, ConcatVecEnv, EpisodeRecorder
from .config import ParcelsConfig

Rows = NDArray[np.float32]
Choices = NDArray[np.int64]

# Streams of training: always a parcel waits at the gate.
SPEEDS = (0.9, 2.2)  # [m/s] of a stream, uniform between them
MIXES: tuple[tuple[str, ...], ...] = (("S",), ("S", "B"))  # parcels of a stream, equally likely
SPACING = 0.3  # [m] from parcel to parcel of the densest stream: an S-box and 5 cm
DURATION = 20.0  # [s] of an episode

# Rewards.
SCALES = np.array([1.0, 1.5, 2.0, 1.0, 0.5])  # [-] on the terms: right, wrong, touch, reach, time
TIME = task.PARCEL_TERMS.index("time")  # the term that includes waiting at the gate
GATE_REWARD = -3.0  # per second at the gate: the line could have delivered parcels meanwhile
JAM_REWARD = -1.0  # once, for each parcel of a line on which nothing moves any more

# Imitation.
SPEED_STEP = 0.1  # [m/s] between the demonstrated streams
NUM_ENVS = 8  # of each stream
LOADS = (1.0, 1.0, 1.0, 1.0, 0.6, 0.5, 0.4, 0.3)  # [-] of the densest stream, by environment
MARGIN = 0.008  # [m] of the reservations
SHOWN = 0.8  # [-] of an episode's duration
BATCH = 4096  # samples of a gradient step; half of them at the gate, where parcels are fewer
LEARNING_RATE = 1e-3  # at the start; it falls to 0


def densest_stream(speed: float, parcels: tuple[str, ...], load: float = 1.0) -> Stream:
    """Build a stream of a speed [m/s] that always has a parcel at the gate, or a share of it."""
    return Stream(
        arrivals.Steady(arrivals.HOUR * speed / SPACING * load), parcels=parcels, speeds=speed
    )


def draw_stream(rng: np.random.Generator) -> Stream:
    """Draw the stream of an episode: a uniform speed and one of the mixes."""
    speed = float(rng.uniform(*SPEEDS))
    return densest_stream(speed, MIXES[int(rng.integers(len(MIXES)))])


def training_env_config(control_period: float) -> EnvConfig:
    """Build the configuration of the training line with exact sensors."""
    return EnvConfig(
        "flow",
        stream=densest_stream(1.5, ("S", "B")),
        exits="sides",
        actions="parcels",
        gate=True,
        control_period=control_period,
        duration=DURATION,
        sensors=sg.sensors.Exact(),
    )


class SlotVecEnv(BatchVecEnv):
    """Agent slots on environments of one stream as a VecEnv, each slot one environment."""

    def __init__(
        self,
        env_config: EnvConfig,
        num_streams: int,
        slots: int,
        draw: Callable[[np.random.Generator], Stream],
    ) -> None:
        self._batch = StreamBatch(env_config, num_streams)
        self._draw = draw
        self._actions = ParcelActions(env_config)
        self._streams, self._slots, self._rows = num_streams, slots, env_config.stream_task.rows
        self._period = env_config.control_period
        self._arrival = np.full((num_streams, slots), NOBODY)  # number of the arrival in a slot
        self._row = np.zeros((num_streams, slots), dtype=np.int64)  # its row in the observation
        self._recorder = EpisodeRecorder(num_streams * slots, task.PARCEL_TERMS)
        self._rng = np.random.default_rng(0)
        self.render_mode = None
        super().__init__(num_streams * slots, *parcel_spaces(env_config))

    @property
    def batches(self) -> list[tuple[Any, int]]:
        return [(self, self.num_envs)]

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        self._rng = np.random.default_rng(seed)
        for i in range(self._streams):
            self._batch.seed(i, np.random.default_rng(self._rng.integers(2**63)))
        return [seed] * self.num_envs

    def reset(self) -> vec_env.base_vec_env.VecEnvObs:
        if not self._batch.is_seeded(0):
            self.seed(0)
        self._start(np.arange(self._streams))
        self._recorder.reset()
        self._fill_slots()
        return self._observe()

    def step_async(self, actions: NDArray[np.int64]) -> None:
        choices = np.zeros((self._streams, self._rows, 3), dtype=np.int64)
        each = actions.reshape(self._streams, self._slots, 3)
        i, slot = np.nonzero(self._arrival != NOBODY)
        choices[i, self._row[i, slot]] = each[i, slot]
        self._batch.step(self._actions.to_env(self._batch.observation, choices))

    def step_wait(self) -> vec_env.base_vec_env.VecEnvStepReturn:
        streams = self._batch.streams
        taken = self._arrival != NOBODY
        i, slot = np.nonzero(taken)
        arrival, row = self._arrival[i, slot], self._row[i, slot]
        waited = row == self._rows - 1
        left = ~waited & ~streams.present[i, row]
        entered = waited & (arrival < streams.coming[i])
        # A parcel that entered has a row on the line now.
        found = (streams.number[i][:, :-1] == arrival[:, np.newaxis]).argmax(axis=1)
        row = np.where(entered, found, row)
        left |= entered & ~streams.present[i, row]
        self._row[i, slot] = row
        terms = self._batch.parcels.terms.reshape(self._streams, self._rows, -1)[i, row]
        scaled = terms * SCALES
        scaled[waited] = 0.0
        # A parcel that entered is taken to have waited for half of the period.
        scaled[waited, TIME] = GATE_REWARD * self._period * np.where(entered[waited], 0.5, 1.0)
        earned = np.zeros((self._streams, self._slots, len(SCALES)))
        earned[i, slot] = scaled
        rewards = earned.sum(axis=2)
        outcome = streams.outcome
        rewards[taken & (outcome == JAM)[:, np.newaxis]] += JAM_REWARD
        self._recorder.add(rewards.ravel(), earned.reshape(self.num_envs, -1), taken.ravel())
        gone = np.zeros((self._streams, self._slots), dtype=np.bool_)
        gone[i, slot] = left
        success = np.zeros_like(gone)
        success[i, slot] = terms[:, 0] > 0.0
        over = outcome != RUNNING
        ends = gone | (taken & over[:, np.newaxis])
        infos = self._recorder.finish(
            ends.ravel(),
            self._observe(),
            ((outcome == OUT_OF_TIME)[:, np.newaxis] & ~gone).ravel(),
            success.ravel(),
            np.repeat([self._batch.outcomes[code] for code in outcome], self._slots),
            np.repeat(streams.clock, self._slots),
        )
        self._arrival[ends] = NOBODY
        if over.any():
            self._start(np.nonzero(over)[0])
        # The episode of a free slot ends where a parcel takes it.
        ends |= self._fill_slots()
        return self._observe(), rewards.ravel().astype(np.float32), ends.ravel(), infos

    def _start(self, streams: NDArray[np.int64]) -> None:
        options = [{"stream": self._draw(self._rng)} for _ in streams]
        self._batch.reset(streams, options)
        self._arrival[streams] = NOBODY

    def _fill_slots(self) -> NDArray[np.bool_]:
        """Assign slots to parcels that have come up to the gate; return which were taken."""
        head = self._batch.streams.number[:, -1]
        new = (head != NOBODY) & ~(self._arrival == head[:, np.newaxis]).any(axis=1)
        taken = np.zeros((self._streams, self._slots), dtype=np.bool_)
        for i in np.nonzero(new)[0].tolist():
            free = np.nonzero(self._arrival[i] == NOBODY)[0]
            if len(free) > 0:
                self._arrival[i, free[0]] = head[i]
                self._row[i, free[0]] = self._rows - 1
                taken[i, free[0]] = True
        return taken

    def _observe(self) -> Rows:
        """Return the observations (slots of all lines, features)."""
        seen = np.zeros((self._streams, self._slots, len(task.FEATURES)), dtype=np.float32)
        i, slot = np.nonzero(self._arrival != NOBODY)
        seen[i, slot] = mirrored_rows(self._batch.observation[i, self._row[i, slot]])
        return seen.reshape(self.num_envs, -1)

    def close(self) -> None:
        """Do nothing; no resource is held."""


def make_parcel_envs(config: ParcelsConfig) -> vec_env.VecEnv:
    """Make the lines of a configuration, a share of them with a camera and varied friction."""
    exact = training_env_config(config.control_period)
    camera = replace(
        exact, sensors=sg.sensors.Camera(), randomisation=sg.Randomisation(friction=config.friction)
    )
    by_camera = round(config.camera_share * config.num_envs)
    shares = ((exact, config.num_envs - by_camera), (camera, by_camera))
    return ConcatVecEnv(
        [
            SlotVecEnv(env_config, count, config.slots, draw_stream)
            for env_config, count in shares
            if count
        ]
    )


class CriticFirst(callbacks.BaseCallback):
    """Training of the value network alone, until it knows the value of the imitated policy.

    Advantages by an untrained value network would undo the imitation.
    """

    def __init__(self, steps: int) -> None:
        super().__init__()
        self._steps = steps

    def _on_rollout_start(self) -> None:
        policy = self.model.policy
        assert isinstance(policy, ParcelNetwork)
        learns = self.num_timesteps >= self._steps
        policy.action_net.requires_grad_(learns)
        policy.mlp_extractor.policy_net.requires_grad_(learns)

    def _on_step(self) -> bool:
        return True


def pretrain(model: base_class.BaseAlgorithm, config: ParcelsConfig) -> None:
    """Let a new model imitate a reservation rule, if the configuration says so.

    Random choices would brake all parcels to rest.
    """
    assert isinstance(model.policy, ParcelNetwork)
    if config.imitation > 0:
        seen, choices = demonstrate(config.control_period, config.seed)
        imitate(model.policy, seen, choices, config.imitation, config.seed)


def demonstrate(control_period: float, seed: int) -> tuple[Rows, Choices]:
    """Collect observations (samples, features) and choices (samples, 3) of a reservation rule."""
    seen, chosen = [], []
    base = training_env_config(control_period)
    speeds = np.arange(SPEEDS[0], SPEEDS[1] + 1e-9, SPEED_STEP)
    for number, speed in enumerate(speeds.round(3).tolist()):
        for mix, parcels in enumerate(MIXES):
            env_config = base.replace(
                stream=densest_stream(speed, parcels), duration=SHOWN * base.stream_task.duration
            )
            rule, actions = Reservation(env_config, margin=MARGIN), env_config.action_kind
            conversion = ParcelActions(env_config)
            batch = StreamBatch(env_config, NUM_ENVS)
            for i in range(NUM_ENVS):
                batch.seed(i, np.random.default_rng((seed, number, mix, i)))
            streams = [densest_stream(speed, parcels, load) for load in LOADS]
            batch.reset(np.arange(NUM_ENVS), [{"stream": stream} for stream in streams])
            state = None
            while (batch.outcome == RUNNING).any():
                tables = batch.observation.copy()
                action, state = rule.predict(tables, state)
                present = tables[..., task.PRESENT] > 0.5
                seen.append(mirrored_rows(tables)[present])
                chosen.append(conversion.to_parcels(tables, action)[present])
                batch.step(actions.commands(action, NUM_ENVS))
    return np.concatenate(seen), np.concatenate(chosen)


def imitate(policy: ParcelNetwork, seen: Rows, chosen: Choices, epochs: int, seed: int) -> None:
    """Maximise the likelihood of demonstrated choices."""
    generator = torch.Generator().manual_seed(seed)
    observations, choices = torch.from_numpy(seen), torch.from_numpy(chosen)
    waits = observations[:, task.WAITS] > 0.5
    groups = [torch.nonzero(part)[:, 0] for part in (waits, ~waits)]
    optimiser = torch.optim.Adam(policy.parameters(), LEARNING_RATE)
    steps = epochs * (len(seen) // BATCH)
    for step in range(steps):
        optimiser.param_groups[0]["lr"] = LEARNING_RATE * (1.0 - step / steps)
        batch = torch.cat(
            [
                group[torch.randint(len(group), (BATCH // 2,), generator=generator)]
                for group in groups
            ]
        )
        _, log_prob, _ = policy.evaluate_actions(observations[batch], choices[batch])
        optimiser.zero_grad()
        torch.autograd.backward(-log_prob.mean())
        optimiser.step()
