"""Comparison of an export's decisions with the policy's decisions.

Sums in single precision depend on their order, so scores differ in their last digits. If the best
two scores are this close, either choice is correct; such decisions are counted separately. Any
other difference is an error.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import gymnasium as gym
import numpy as np

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.config import Preset

from ..base import Integers, Numbers, Singles
from . import onnx
from .policy import NetworkDecision, Source

Decide = Callable[[Singles], tuple[Integers, Numbers]]  # choices, and angles [rad]

TIE = 1e-6  # [-] scores that differ by less, relative to the largest (or 1), are a tie
MAX_TIES = 1e-3  # [-] allowed share of decisions that differ by round-off
NUM_ENVS = 50  # environments for the policy's episodes
FARTHEST = 3.0  # [-] maximum absolute value of a random number
WHOLE_SHARE = 0.1  # [-] share of random numbers that are integers, where comparisons may jump


@dataclass(frozen=True)
class Agreement:
    """Result of a comparison; a decision is one part's choice for one observation."""

    observations: int
    parts: int  # number of choices per observation
    ties: int  # decisions that differ in a tie
    close: int  # decisions in a tie, different or not

    def summary(self) -> str:
        same = "the same" if not self.ties else f"{self.ties} of them otherwise, all ties"
        return (
            f"{self.observations} observations, {self.observations * self.parts} choices: {same} "
            f"({self.close} too close to call in single precision)"
        )


def compare(
    decision: NetworkDecision | onnx.ModulesDecision,
    source: Source,
    observations: Singles,
    decide: Decide,
) -> Agreement:
    """Compare the decisions of an ONNX file with the policy's."""
    actions, _ = source.policy.predict(observations, deterministic=True)
    wanted = source.config.action_kind.commands(actions, len(observations))
    choices, angles = decide(observations)
    differs = choices != wanted
    close = decision.in_doubt(observations, TIE)
    if (differs & ~close).any():
        first = int(np.argmax((differs & ~close).any(axis=1)))
        raise ValueError(
            f"the ONNX file must decide as the policy of {source.name} does, got "
            f"{int((differs & ~close).any(axis=1).sum())} of {len(observations)} observations "
            f"otherwise; of the first, {observations[first].tolist()}, choices "
            f"{choices[first].tolist()} in place of {wanted[first].tolist()}"
        )
    ties = int((differs & close).sum())
    if ties > math.ceil(MAX_TIES * differs.size):
        raise ValueError(
            f"the ONNX file must decide as the policy of {source.name} does, got {ties} of "
            f"{differs.size} choices otherwise, though all where scores are close"
        )
    if not np.array_equal(angles, np.array(decision.angles)[choices]):
        raise ValueError("the ONNX file must give the angles of what it chooses, got others")
    return Agreement(len(observations), decision.parts, ties, int(close.sum()))


def run_onnx(model: bytes) -> Decide:
    """Return a function that decides by an ONNX model, with onnxruntime on one core."""
    onnxruntime = onnx.need("onnxruntime")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])

    def decide(observations: Singles) -> tuple[Integers, Numbers]:
        choices, angles = session.run([onnx.CHOICES, onnx.ANGLES], {onnx.OBSERVATION: observations})
        return choices, angles

    return decide


def make_observations(source: Source, count: int, seed: int = 0) -> Singles:
    """Return observations (count, features), half from the policy's episodes, half random."""
    presets = source.training.presets
    each = count // 2 // len(presets)
    met = [_from_episodes(source, preset, each, seed) for preset in presets]
    return np.concatenate([*met, random_observations(source, count - sum(map(len, met)), seed)])


def _from_episodes(source: Source, preset: Preset, count: int, seed: int) -> Singles:
    """Return observations (count, features) from episodes of the policy under a preset."""
    num_envs = min(NUM_ENVS, count)
    given = {**source.config.arguments(), "preset": preset}
    for name in ("sensors", "actuators", "randomisation"):
        del given[name]  # set by the preset
    env = SmartSurfaceVectorEnv(
        num_envs=num_envs,
        max_episode_steps=source.config.task.periods,
        autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
        **given,
    )
    observations, _ = env.reset(seed=seed)
    kept = [observations]
    while len(kept) * num_envs < count:
        action, _ = source.policy.predict(observations, deterministic=True)
        observations, *_ = env.step(action)
        kept.append(observations)
    env.close()
    return np.concatenate(kept)[:count]


def random_observations(source: Source, count: int, seed: int) -> Singles:
    """Return random observations (count, features) from the observation space near 0."""
    space = source.config.observation_space()
    low, high = np.maximum(space.low, -FARTHEST), np.minimum(space.high, FARTHEST)
    rng = np.random.default_rng(seed)
    drawn = rng.uniform(low, high, (count, len(low)))
    drawn = np.where(rng.random(drawn.shape) < WHOLE_SHARE, np.round(drawn), drawn)
    return drawn.astype(np.float32)
