"""Runs of Sort whose sensed poses are held against the true ones."""

from typing import Any

import numpy as np

import surface_gym as sg
from tests.environments import outside

ROLL, MINUS_45, PLUS_45, BRAKE = 3, 2, 1, 0


def all_say(env: Any, choice: int) -> Any:
    """The actions that set every module to one choice."""
    kind = env.config.action_kind
    return kind.encode(np.full((env.num_envs, kind.size), choice))


def errors(
    sensors: Any, choice: int, num_envs: int = 16, actions: str = "halves", **start: Any
) -> np.ndarray:
    """(decisions, 6) sensed pose and velocity minus the true ones, over episodes of one choice."""
    env = sg.SmartSurfaceVectorEnv(
        num_envs, actions=actions, sensors=sensors, max_episode_steps=60, autoreset_mode="SameStep"
    )
    env.reset(seed=0, options={"side": 1, **start})
    memory = env.batch.parcels
    found = []
    running = np.ones(num_envs, dtype=bool)
    while running.any():
        _, _, terminated, truncated, _ = env.step(all_say(env, choice))
        running &= ~(terminated | truncated)
        found.append((memory.sensed - memory.truth)[running])
    return np.concatenate(found)


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt((values**2).mean(axis=0))


def contradicts(env: Any, parcel: str, tolerance: float) -> np.ndarray:
    """Whether the sensed pose of each box has other rotors covered than the true one has, by
    more than a tolerance [m]; by the base's own functions.
    """
    elements, parcels, bodies = env.batch.params.elements, env.batch.parcels, env.batch.bodies
    base = sg.layouts.box(parcel).base
    rows, columns = np.indices(bodies.rotor.shape[1:])
    x, y = elements.x0 + elements.pitch_x * columns, elements.y0 + elements.pitch_y * rows
    found = []
    for i in range(env.num_envs):
        covered = outside(base, parcels.truth[i], x, y) <= 0.0
        beyond = outside(base, parcels.sensed[i], x, y)
        wrong = np.where(covered, beyond, -beyond) > tolerance
        found.append((wrong & bodies.rotor[parcels.body[i] if len(bodies.rotor) > 1 else 0]).any())
    return np.array(found)
