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
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.stream import Stream
from surface_gym.tasks.sort import Sort
from surface_gym.vector_env import SmartSurfaceVectorEnv

LANES = 256
MANY = 1024  # lanes, for the threads
ROUNDS = 7
SECONDS = 0.7  # of each contender a round

# What the project asks of itself, as ratios; of Sort as it comes.
LEAST_SINGLE = 1.2  # of LunarLander-v3
LEAST_VECTOR = 4.0  # of EnvPool's LunarLander, one thread each
LEAST_THREADS = 1.8  # two threads over one
LEAST_ADAPTER = 0.7  # of the vector env behind it
LEAST_FLOW = 0.75  # parcels of a flow, over as many lanes of one parcel

# Sort as it comes, and with the smaller parcel alone, which rests on fewer elements.
TASKS = {"Sort": Sort(), "Sort, S-box alone": Sort(parcels=("S",))}
ENVPOOL = importlib.util.find_spec("envpool") is not None
BOX2D = importlib.util.find_spec("Box2D") is not None
LUNAR = "Gymnasium LunarLander-v3"
ON_A_LINE = 8  # parcels of a flow
STREAM_RATE = 7200.0  # [parcels/h] that has so many on 6 m at 1.5 m/s
LUNARS = f"EnvPool LunarLander, {LANES} lanes"


@dataclass(frozen=True)
class Contender:
    """Something to step, again and again."""

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


def _single(env_id: str, **kwargs: Any) -> Contender:
    """A single env with random actions, reset at the end of an episode."""
    env = gym.make(env_id, **kwargs)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(100)]
    env.reset(seed=0)

    def step(count: int) -> None:
        _, _, terminated, truncated, _ = env.step(actions[count % 100])
        if terminated or truncated:
            env.reset()

    return Contender(step, 1)


def _vector(task: Sort, lanes: int = LANES, threads: int = 1) -> Contender:
    """Our vector env with random actions of "halves", a decision every 40 ms."""
    env = SmartSurfaceVectorEnv(
        lanes, task, actions="halves", max_episode_steps=task.periods, threads=threads
    )
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(20)]
    env.reset(seed=0)
    return Contender(lambda count: env.step(actions[count % 20]) and None, lanes)


def _flow() -> Contender:
    """As many parcels as the vector env has lanes, eight on each line: S and B, all straight on."""
    lanes = LANES // ON_A_LINE
    stream = Stream(Steady(STREAM_RATE), parcels=("S", "B"), destinations={"straight": 1.0})
    env = SmartSurfaceVectorEnv(lanes, stream, actions="parcels", duration=3600.0)
    roll = np.full_like(env.action_space.sample(), 3)
    env.reset(seed=0)
    for _ in range(200):  # until as many leave as come
        _, _, _, _, infos = env.step(roll)
    on_the_line = int((infos["parcels"] >= 0).sum())
    return Contender(lambda _: env.step(roll) and None, on_the_line)


def _adapter(task: Sort) -> Contender:
    """The same behind Stable-Baselines3's interface."""
    from surface_gym.agents.vec_env import SurfaceVecEnv

    lanes = SmartSurfaceVectorEnv(
        LANES, task, actions="halves", max_episode_steps=task.periods, autoreset_mode="SameStep"
    )
    env = SurfaceVecEnv(lanes)
    actions = [np.array([env.action_space.sample() for _ in range(LANES)]) for _ in range(20)]
    env.reset()
    return Contender(lambda count: env.step(actions[count % 20]) and None, LANES)


def _envpool() -> Contender:
    """EnvPool's LunarLander with random actions."""
    import envpool

    env = envpool.make("LunarLander-v2", "gymnasium", num_envs=LANES, num_threads=1)
    rng = np.random.default_rng(0)
    actions = rng.integers(0, 4, (20, LANES)).astype(np.int32)
    env.reset()
    return Contender(lambda count: env.step(actions[count % 20]) and None, LANES)


def environment_figures() -> list[Figure]:
    """Steps a second, and their ratios."""
    contenders: dict[str, Contender] = {}
    for name, task in TASKS.items():
        contenders[f"{name}, single env"] = _single(
            "SmartSurface/Sort-v0", task=task, actions="halves"
        )
        contenders[f"{name}, {LANES} lanes"] = _vector(task)
    sort = TASKS["Sort"]
    many = f"Sort, {MANY} lanes"
    adapter = f"Sort, {LANES} lanes, Stable-Baselines3 adapter"
    contenders[many] = _vector(sort, MANY)
    contenders[f"{many}, two threads"] = _vector(sort, MANY, threads=2)
    contenders[adapter] = _adapter(sort)
    flow = f"Flow, {ON_A_LINE} parcels on each of {LANES // ON_A_LINE} lines"
    contenders[flow] = _flow()
    contenders["Gymnasium CartPole-v1"] = _single("CartPole-v1")
    if BOX2D:
        contenders[LUNAR] = _single("LunarLander-v3")
    if ENVPOOL:
        contenders[LUNARS] = _envpool()
    rounds = [
        {name: contender.speed() for name, contender in contenders.items()} for _ in range(ROUNDS)
    ]
    figures = [
        Figure(name, float(np.median([speeds[name] for speeds in rounds])), "steps/s")
        for name in contenders
    ]

    def ratio(over: str, under: str, least: float | None) -> None:
        if under in contenders:
            median = float(np.median([speeds[over] / speeds[under] for speeds in rounds]))
            figures.append(Figure(f"{over} over {under}", median, "", least=least))

    ratio(f"{many}, two threads", many, LEAST_THREADS)
    ratio(adapter, f"Sort, {LANES} lanes", LEAST_ADAPTER)
    ratio(flow, f"Sort, {LANES} lanes", LEAST_FLOW)
    for name, task in TASKS.items():
        as_it_comes = task == sort
        ratio(f"{name}, single env", LUNAR, LEAST_SINGLE if as_it_comes else None)
        ratio(f"{name}, {LANES} lanes", LUNARS, LEAST_VECTOR if as_it_comes else None)
    return figures
