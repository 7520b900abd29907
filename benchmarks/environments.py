"""Steps a second of the environments beside those of other packages, in one run.

Every contender runs in turn, round after round, so that a machine whose speed drifts slows all of
them alike; the figures are medians over the rounds, the ratios medians of the rounds' ratios.
"""

import importlib.util
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.figure import Figure
from surface_gym import SmartSurfaceVectorEnv
from surface_gym.tasks.sort import Sort

LANES = 256
ROUNDS = 7
SECONDS = 0.7  # of each contender a round
PERIOD = 0.04  # [s]

# What the project asks of itself, as ratios.
LEAST_SINGLE = 1.0  # of LunarLander-v3
LEAST_VECTOR = 4.0  # of EnvPool's LunarLander, one thread each
LEAST_THREADS = 1.8  # two threads over one
LEAST_ADAPTER = 0.7  # of the vector env behind it

_SMALL = Sort(parcels=("S",))
_SETTINGS: Any = {
    "task": _SMALL,
    "actions": "halves",
    "control_period": PERIOD,
    "max_episode_steps": 100,
}
ENVPOOL = importlib.util.find_spec("envpool") is not None
BOX2D = importlib.util.find_spec("Box2D") is not None


@dataclass(frozen=True)
class Contender:
    """Something to step, again and again."""

    name: str
    step: Callable[[int], None]  # takes the number of the step
    lanes: int  # moved by a step

    def speed(self) -> float:
        """[1/s] lane steps in one round."""
        begin = time.perf_counter()
        count = 0
        while time.perf_counter() - begin < SECONDS:
            for _ in range(20):
                self.step(count)
                count += 1
        return count * self.lanes / (time.perf_counter() - begin)


def _single(env_id: str, name: str, **kwargs: Any) -> Contender:
    """A single env with random actions, reset at the end of an episode."""
    env = gym.make(env_id, **kwargs)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(100)]
    env.reset(seed=0)

    def step(count: int) -> None:
        _, _, terminated, truncated, _ = env.step(actions[count % 100])
        if terminated or truncated:
            env.reset()

    return Contender(name, step, 1)


def _vector(threads: int, name: str) -> Contender:
    """Our vector env, S-box alone, with random actions."""
    env = SmartSurfaceVectorEnv(LANES, **_SETTINGS, threads=threads)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(20)]
    env.reset(seed=0)
    return Contender(name, lambda count: env.step(actions[count % 20]) and None, LANES)


def _adapter(name: str) -> Contender:
    """The same behind Stable-Baselines3's interface."""
    from agents.vec_env import SurfaceVecEnv

    env = SurfaceVecEnv(SmartSurfaceVectorEnv(LANES, **_SETTINGS, autoreset_mode="SameStep"))
    actions = [np.array([env.action_space.sample() for _ in range(LANES)]) for _ in range(20)]
    env.reset()
    return Contender(name, lambda count: env.step(actions[count % 20]) and None, LANES)


def _envpool(threads: int, name: str) -> Contender:
    """EnvPool's LunarLander with random actions."""
    import envpool

    env = envpool.make("LunarLander-v2", "gymnasium", num_envs=LANES, num_threads=threads)
    rng = np.random.default_rng(0)
    actions = rng.integers(0, 4, (20, LANES)).astype(np.int32)
    env.reset()
    return Contender(name, lambda count: env.step(actions[count % 20]) and None, LANES)


def environment_figures() -> list[Figure]:
    """Steps a second, and their ratios."""
    ours = [
        _single("SmartSurface/Sort-v0", "Sort, single env", task=_SMALL, actions="halves"),
        _vector(1, f"Sort, {LANES} lanes, one thread"),
        _vector(2, f"Sort, {LANES} lanes, two threads"),
        _adapter(f"Sort, {LANES} lanes, Stable-Baselines3 adapter"),
    ]
    theirs = [_single("CartPole-v1", "Gymnasium CartPole-v1")]
    if BOX2D:
        theirs.append(_single("LunarLander-v3", "Gymnasium LunarLander-v3"))
    if ENVPOOL:
        theirs.append(_envpool(1, f"EnvPool LunarLander, {LANES} lanes, one thread"))
    contenders = ours + theirs
    speeds = np.array(
        [[contender.speed() for contender in contenders] for _ in range(ROUNDS)]
    )  # (rounds, contenders)
    figures = [
        Figure(contender.name, float(np.median(column)), "steps/s")
        for contender, column in zip(contenders, speeds.T, strict=True)
    ]
    single, one, two, adapter = speeds[:, : len(ours)].T

    def ratio(name: str, over: Any, under: Any, least: float) -> None:
        figures.append(Figure(name, float(np.median(over / under)), "", least=least))

    ratio("two threads over one", two, one, LEAST_THREADS)
    ratio("adapter over the vector env", adapter, one, LEAST_ADAPTER)
    if BOX2D:
        ratio("single env over LunarLander-v3", single, speeds[:, 5], LEAST_SINGLE)
    if ENVPOOL:
        ratio("vector env over EnvPool's LunarLander", one, speeds[:, -1], LEAST_VECTOR)
    return figures
