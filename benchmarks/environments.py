"""Steps per second of the environments and of other packages, measured in one run.

All programs are timed in turn in each round, so that a change of the machine's speed slows all of
them alike. Figures are medians over the rounds; ratios are medians of the rounds' ratios.
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

NUM_ENVS = 256
MANY = 1024  # environments, for the threads
ROUNDS = 7
SECONDS = 0.7  # of each program in a round

# Requirements for Sort with its own parcels: ratios of speeds, except LEAST_PICTURES.
LEAST_SINGLE = 1.2  # single env over LunarLander-v3
LEAST_VECTOR = 4.0  # vector env over EnvPool's LunarLander, one thread each
LEAST_THREADS = 1.8  # two threads over one
LEAST_ADAPTER = 0.7  # Stable-Baselines3's interface over the vector env without it
LEAST_PICTURES = 20_000.0  # pictures per second
LEAST_STREAM = 0.75  # parcels of a stream over as many environments of one parcel

# Sort with its own parcels; and with only the smaller parcel, which covers fewer elements.
TASKS = {"Sort": Sort(), "Sort, S-box alone": Sort(parcels=("S",))}
ENVPOOL = importlib.util.find_spec("envpool") is not None
BOX2D = importlib.util.find_spec("Box2D") is not None
LUNAR = "Gymnasium LunarLander-v3"
PARCELS_PER_LINE = 8  # of a stream
STREAM_RATE = 7200.0  # [parcels/h] for this number of parcels on 6 m at 1.5 m/s
LUNARS = f"EnvPool LunarLander, {NUM_ENVS} environments"


@dataclass(frozen=True)
class Program:
    """An environment to be timed, with a function that steps it."""

    step: Callable[[int], None]  # takes the number of the step
    num_envs: int  # stepped by one call

    def speed(self) -> float:
        """Return the environment steps per second [1/s] in one round."""
        begin = time.perf_counter()
        count = 0
        while time.perf_counter() - begin < SECONDS:
            for _ in range(20):
                self.step(count)
                count += 1
        return count * self.num_envs / (time.perf_counter() - begin)


def _cycle(env: Any, actions: Any, num_envs: int) -> Program:
    """Make the program of a vector env that gets the given actions in turn."""
    env.reset()
    return Program(lambda count: env.step(actions[count % len(actions)]) and None, num_envs)


def _single(env_id: str, **arguments: Any) -> Program:
    """Make the program of a single env with random actions and resets."""
    env = gym.make(env_id, **arguments)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(100)]
    env.reset(seed=0)

    def step(count: int) -> None:
        _, _, terminated, truncated, _ = env.step(actions[count % 100])
        if terminated or truncated:
            env.reset()

    return Program(step, 1)


def _vector(task: Sort, num_envs: int = NUM_ENVS, **arguments: Any) -> SmartSurfaceVectorEnv:
    """Make a vector env of Sort with actions "halves"."""
    env = SmartSurfaceVectorEnv(
        num_envs, task=task, actions="halves", max_episode_steps=task.periods, **arguments
    )
    env.action_space.seed(0)
    env.reset(seed=0)
    return env


def _random(env: SmartSurfaceVectorEnv) -> Program:
    """Make the program of a vector env with random actions."""
    return _cycle(env, [env.action_space.sample() for _ in range(20)], env.num_envs)


def _stream() -> Program:
    """Make the program of streams with as many parcels in total as the vector env, all rolling."""
    stream = Stream(Steady(STREAM_RATE), parcels=("S", "B"), destinations={"straight": 1.0})
    env = SmartSurfaceVectorEnv(
        NUM_ENVS // PARCELS_PER_LINE, task="flow", stream=stream, actions="parcels", duration=3600.0
    )
    roll = np.full_like(env.action_space.sample(), 3)
    env.reset(seed=0)
    for _ in range(200):  # until as many leave as enter
        _, _, _, _, infos = env.step(roll)
    parcels = int((infos["parcels"] >= 0).sum())
    return Program(lambda _: env.step(roll) and None, parcels)


def _adapter(task: Sort) -> Program:
    """Make the program of the vector env with Stable-Baselines3's interface."""
    from surface_gym.agents.vec_env import SurfaceVecEnv

    env = SurfaceVecEnv(_vector(task, autoreset_mode="SameStep"))
    actions = [np.array([env.action_space.sample() for _ in range(NUM_ENVS)]) for _ in range(20)]
    return _cycle(env, actions, NUM_ENVS)


def _envpool() -> Program:
    """Make the program of EnvPool's LunarLander with random actions."""
    import envpool

    env = envpool.make("LunarLander-v2", "gymnasium", num_envs=NUM_ENVS, num_threads=1)
    actions = np.random.default_rng(0).integers(0, 4, (20, NUM_ENVS)).astype(np.int32)
    return _cycle(env, actions, NUM_ENVS)


def environment_figures() -> list[Figure]:
    """Measure the steps per second of all programs, and ratios."""
    programs: dict[str, Program] = {}
    for name, task in TASKS.items():
        programs[f"{name}, single env"] = _single(
            "SmartSurface/Sort-v0", task=task, actions="halves"
        )
        programs[f"{name}, {NUM_ENVS} environments"] = _random(_vector(task))
    sort = TASKS["Sort"]
    vector, many = f"Sort, {NUM_ENVS} environments", f"Sort, {MANY} environments"
    adapter = f"{vector}, Stable-Baselines3 adapter"
    pictures = f"{vector}, 64 x 64 pictures"
    programs[pictures] = _random(_vector(sort, observe="image"))
    programs[many] = _random(_vector(sort, MANY))
    programs[f"{many}, two threads"] = _random(_vector(sort, MANY, threads=2))
    programs[adapter] = _adapter(sort)
    stream = f"Flow, {PARCELS_PER_LINE} parcels on each of {NUM_ENVS // PARCELS_PER_LINE} lines"
    programs[stream] = _stream()
    programs["Gymnasium CartPole-v1"] = _single("CartPole-v1")
    if BOX2D:
        programs[LUNAR] = _single("LunarLander-v3")
    if ENVPOOL:
        programs[LUNARS] = _envpool()
    rounds = [{name: program.speed() for name, program in programs.items()} for _ in range(ROUNDS)]
    figures = [
        Figure(
            name,
            float(np.median([speeds[name] for speeds in rounds])),
            "steps/s",
            least=LEAST_PICTURES if name == pictures else None,
        )
        for name in programs
    ]

    def add_ratio(over: str, under: str, least: float | None) -> None:
        if under in programs:
            median = float(np.median([speeds[over] / speeds[under] for speeds in rounds]))
            figures.append(Figure(f"{over} over {under}", median, "", least=least))

    add_ratio(f"{many}, two threads", many, LEAST_THREADS)
    add_ratio(adapter, vector, LEAST_ADAPTER)
    add_ratio(stream, vector, LEAST_STREAM)
    for name, task in TASKS.items():
        required = task == sort
        add_ratio(f"{name}, single env", LUNAR, LEAST_SINGLE if required else None)
        add_ratio(f"{name}, {NUM_ENVS} environments", LUNARS, LEAST_VECTOR if required else None)
    return figures
