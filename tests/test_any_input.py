"""Nothing that is allowed gives a number that is none, a hang or a crash.

The examples of a test share one compiled kernel. `HYPOTHESIS_PROFILE=nightly` has more of them,
and every kernel.
"""

import math
import os
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import surface_gym as sg
from surface_gym import checks
from surface_gym.env import SmartSurfaceEnv
from surface_gym.lines import Pattern
from surface_gym.physics.jit import kernel_function
from surface_gym.physics.types import Array
from surface_gym.sensors import AdaptiveCamera, Camera, Exact, Presence, Sensor
from surface_gym.state import EnvState
from surface_gym.tasks import TASKS
from tests.environments import ACTIONS
from tests.extremes import (
    COMMON,
    SENSORS,
    any_input,
    crowds,
    run_or_refusal,
    scenes,
    sizes,
    streams,
)
from tests.flow.flows import SHORT
from tests.strategies import Scene

FEW = [  # of those whose code other tests need, too
    ("sort", Exact, "quadrants"),
    ("slow", Presence, "quadrants"),
    ("stop", AdaptiveCamera, "window"),
    ("track", Camera, "halves"),
    ("orient", Exact, "modules"),
]
ALL = [(task, kind, actions) for task in TASKS for kind in SENSORS for actions in ACTIONS]
NIGHTLY = os.environ.get("HYPOTHESIS_PROFILE") == "nightly"


def assert_finite(trajectory: sg.Trajectory) -> None:
    assert np.isfinite(trajectory.pose).all()
    assert np.isfinite(trajectory.velocity).all()


@any_input
@given(
    scene=scenes(),
    dt=sizes(*checks.STEP),
    steps=st.integers(1, 12),
    method=st.sampled_from(["implicit", "explicit"]),
)
def test_simulate(scene: Scene, dt: float, steps: int, method: str) -> None:
    trajectory = run_or_refusal(lambda: scene.run(dt * steps, dt, method))
    if trajectory is not None:
        assert_finite(trajectory)


@any_input
@given(crowd=crowds())
def test_simulate_together(crowd: tuple[sg.Surface, dict[str, Any]]) -> None:
    surface, arguments = crowd
    encounter = run_or_refusal(lambda: sg.simulate_together(surface, **arguments))
    if encounter is not None:
        for trajectory in encounter.trajectories:
            assert_finite(trajectory)
        assert np.isfinite(encounter.touches.impulse).all()


def play(env: gym.Env | gym.vector.VectorEnv, seed: int, periods: int = 4) -> None:
    """Random actions, begun anew where an episode ends."""
    env.action_space.seed(seed)
    observation, _ = env.reset(seed=seed)
    for _ in range(periods):
        assert np.isfinite(observation).all()
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert np.isfinite(observation).all()
        assert np.isfinite(reward).all()
        if isinstance(env, gym.Env) and (terminated or truncated):
            observation, _ = env.reset()


@pytest.mark.parametrize(("task", "kind", "actions"), ALL if NIGHTLY else FEW)
def test_environments(task: str, kind: type[Sensor], actions: str) -> None:
    @any_input
    @given(
        settings=st.fixed_dictionaries({"sensors": SENSORS[kind], **COMMON}),
        seed=st.integers(0, 1000),
        num_envs=st.integers(0, 3),
    )
    def check(settings: dict[str, Any], seed: int, num_envs: int) -> None:
        if num_envs:
            play(sg.SmartSurfaceVectorEnv(num_envs, task, actions=actions, **settings), seed)
        else:
            play(sg.SmartSurfaceEnv(task, actions=actions, **settings), seed)

    check()


@pytest.mark.parametrize("kind", SENSORS if NIGHTLY else [Exact])
def test_flows(kind: type[Sensor]) -> None:
    @any_input
    @given(
        settings=st.fixed_dictionaries({"sensors": SENSORS[kind], "stream": streams, **COMMON}),
        duration=sizes(0.2, checks.EPISODE),
        seed=st.integers(0, 1000),
    )
    def check(settings: dict[str, Any], duration: float, seed: int) -> None:
        play(
            SmartSurfaceEnv(
                "flow", line=SHORT, max_parcels=4, duration=min(duration, 20.0), **settings
            ),
            seed,
        )

    check()


def test_a_pattern_may_lie_far_away() -> None:
    far = Pattern([[True] * 20] * 6, origin=(9_000.0, -9_000.0))
    play(sg.SmartSurfaceEnv(line=far), seed=0)


@dataclass(frozen=True)
class Wild(Sensor):
    """Says the truth at a start, then one number of everything."""

    says: float = math.nan

    def numbers(self, dt: float) -> tuple[float, ...]:
        del dt
        return (self.says,)

    @staticmethod
    @kernel_function
    def read(numbers: Array, state: EnvState) -> None:
        for k in range(state.sensed.shape[0]):
            state.sensed[k] = state.truth[k] if state.steps == 0 else numbers[0]


@pytest.mark.parametrize("says", [math.nan, math.inf, -math.inf, 1e308, -1e308, 1e19, 0.0])
def test_whatever_a_sensor_says_reaches_no_other_memory(says: float) -> None:
    env = sg.SmartSurfaceEnv("sort", actions="window", sensors=Wild(says), observe_axes=True)
    if abs(says) < 1e30:  # an observation is float32
        play(env, seed=0)
        return
    env.reset(seed=0)
    for _ in range(5):  # each acts on what was said before
        with pytest.raises(ValueError, match="must write finite features"):
            env.step(np.full(25, 1))
