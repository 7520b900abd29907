"""What a sensor's estimate is, beside the truth, over episodes of a controller."""

from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import surface_gym as sg
from surface_gym.agents.base import Controller
from surface_gym.physics.types import RADIUS, THETA, X, Y

Numbers = NDArray[np.float64]
Booleans = NDArray[np.bool_]

TOLERANCE = 0.001  # [m] by which a pattern may be off


@dataclass(eq=False)
class Watch:
    """What was seen of the decisions of some runs."""

    error: list[Numbers] = field(default_factory=list)  # (decisions, 6) estimate minus truth
    contradicts: list[Booleans] = field(default_factory=list)  # (decisions,) the switches
    longest: int = 0  # decisions in a row that contradict
    outside: int = 0  # observations outside of their space
    lost: int = 0  # episodes with an error beyond the pitch
    episodes: int = 0

    def add(self, other: "Watch") -> None:
        """What another saw as well."""
        self.error += other.error
        self.contradicts += other.contradicts
        self.longest = max(self.longest, other.longest)
        self.outside += other.outside
        self.lost += other.lost
        self.episodes += other.episodes


def _beyond(env: sg.SmartSurfaceVectorEnv, motion: Numbers, columns: Any, rows: Any) -> Numbers:
    """[m] by how far modules lie outside of the bases in given poses, negative inside.

    Args:
        env: whose parcels they are.
        motion: (lanes, 6) the poses.
        columns: (lanes, modules) of the modules.
        rows: (lanes, modules).

    Returns:
        (lanes, modules).
    """
    sites, elements = env.batch.sites, env.batch.rules.elements
    site = env.batch.lanes.site
    dx = elements.x0 + elements.pitch_x * columns - motion[:, X, None]
    dy = elements.y0 + elements.pitch_y * rows - motion[:, Y, None]
    cosine, sine = np.cos(motion[:, THETA, None]), np.sin(motion[:, THETA, None])
    x, y = cosine * dx + sine * dy, cosine * dy - sine * dx
    edges = sites.edges[site][:, :, :, None]
    beyond = edges[:, :, 0] * x[:, None] + edges[:, :, 1] * y[:, None] - edges[:, :, 2]
    circle = np.hypot(x, y) - sites.body[site, RADIUS][:, None]
    found: Numbers = np.maximum(beyond.max(axis=1, initial=-np.inf), circle)
    return found


def contradicts(env: sg.SmartSurfaceVectorEnv, tolerance: float) -> Booleans:
    """(lanes,) whether the estimate has another pattern of covered modules than there is, by more
    than a tolerance [m].
    """
    batch = env.batch
    lanes, sites, elements = batch.lanes, batch.sites, batch.rules.elements
    layout = lanes.site if len(sites.rotor) > 1 else np.zeros_like(lanes.site)
    rotor = sites.rotor[layout]
    reach = int(np.ceil(sites.body[:, RADIUS].max() / min(elements.pitch_x, elements.pitch_y))) + 1
    around = np.arange(-reach, reach + 1)
    result = np.zeros(len(rotor), dtype=np.bool_)
    for centre in (lanes.truth, lanes.sensed):
        places = centre[:, :2] - np.array([elements.x0, elements.y0])
        nearest = np.round(np.clip(places, -1e3, 1e3) / [elements.pitch_x, elements.pitch_y])
        column, row = np.meshgrid(around, around)
        columns = nearest[:, :1].astype(int) + column.ravel()
        rows = nearest[:, 1:].astype(int) + row.ravel()
        exists = (columns >= 0) & (columns < rotor.shape[2]) & (rows >= 0)
        exists &= rows < rotor.shape[1]
        lane = np.arange(len(rotor))[:, None]
        exists[exists] = rotor[np.broadcast_to(lane, rows.shape)[exists], rows[exists],
                               columns[exists]]  # fmt: skip
        true = _beyond(env, lanes.truth, columns, rows) <= 0.0
        estimated = _beyond(env, lanes.sensed, columns, rows)
        wrong = (true & (estimated > tolerance)) | (~true & (estimated < -tolerance))
        result |= (wrong & exists).any(axis=1)
    return result


def watch(env: sg.SmartSurfaceVectorEnv, controller: Controller, periods: int, seed: int) -> Watch:
    """Run a controller on one episode a lane, and see how far the estimate is off."""
    seen = Watch(episodes=env.num_envs)
    observation, _ = env.reset(seed=seed)
    running = np.ones(env.num_envs, dtype=np.bool_)
    begun, state = running.copy(), None
    row = np.zeros(env.num_envs, dtype=np.int64)
    worst = np.zeros(env.num_envs)
    space = env.single_observation_space
    assert isinstance(space, gym.spaces.Box)
    low, high = space.low, space.high
    lanes = env.batch.lanes
    for _ in range(periods):
        action, state = controller.predict(observation, state, begun, deterministic=True)
        observation, _, terminated, truncated, _ = env.step(action)
        error = lanes.sensed - lanes.truth
        wrong = contradicts(env, TOLERANCE)
        seen.error.append(error[running])
        seen.contradicts.append(wrong[running])
        row = np.where(wrong & running, row + 1, 0)
        seen.longest = max(seen.longest, int(row.max()))
        outside = ((observation < low) | (observation > high)).any(axis=1)
        seen.outside += int((outside & running).sum())
        worst = np.maximum(worst, np.where(running, np.hypot(error[:, X], error[:, Y]), 0.0))
        begun = terminated | truncated
        running &= ~begun
        if not running.any():
            break
    seen.lost = int((worst > env.batch.rules.elements.pitch_x).sum())
    return seen
