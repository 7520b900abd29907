"""Episodes of a controller on many starts at once, and their results."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.config import EnvConfig
from surface_gym.state import ENERGIES

from .base import Booleans, Controller, Numbers


@dataclass(frozen=True, eq=False)
class Episodes:
    """Results of one episode from each start."""

    success: Booleans  # (starts,)
    outcome: tuple[str, ...]  # (starts,) outcome of the episode
    time: Numbers  # (starts,) [s] duration of the episode
    # metrics of the task; energies and turns of all axes if asked for; each (starts,)
    metrics: dict[str, Numbers]
    pose: Numbers  # (periods + 1, starts, 3) [m, m, rad] true poses; NaN after the end
    velocity: Numbers  # (starts, 3) [m/s, m/s, rad/s] at the end
    decision_times: Numbers  # [s] time of each decision, or mean time of a start's decisions

    @property
    def decision_time(self) -> float:
        """Median time [s] of a decision for one environment. One slow decision hardly matters."""
        return float(np.median(self.decision_times))

    def path(self, start: int) -> Numbers:
        """Return the true poses (periods + 1, 3) [m, m, rad] of the episode from one start."""
        poses = self.pose[:, start]
        return poses[~np.isnan(poses[:, 0])]


def run_episodes(
    controller: Controller, config: EnvConfig, starts: Sequence[dict[str, Any]], seed: int,
    periods: int | None = None,
) -> Episodes:  # fmt: skip
    """Run one episode of a controller from every start, all in one batch of environments.

    Args:
        starts: one dictionary of `reset` options per start. Values without an option are random.
        seed: environment i is seeded by `seed` + i.
        periods: maximum number of control periods of an episode. The default is the task's maximum.
    """
    count = len(starts)
    env = SmartSurfaceVectorEnv(
        num_envs=count,
        max_episode_steps=config.task.periods if periods is None else periods,
        autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
        **config.arguments(),
    )
    observation, info = env.reset(seed=seed, options=list(starts))
    metrics = (*config.task.metrics, *(ENERGIES if config.meters else ()))
    metrics += ("axis_turns",) if "turns" in config.info else ()
    kept: dict[str, Any] = {
        key: np.zeros_like(info[key])
        for key in ("is_success", "outcome", "time", "velocity", *metrics)
    }
    poses = [info["pose"].copy()]
    running = np.ones(count, dtype=np.bool_)
    begun = np.ones(count, dtype=np.bool_)
    state: Any = None
    seconds = []
    while running.any():
        before = time.perf_counter()
        action, state = controller.predict(observation, state, begun, deterministic=True)
        seconds.append(time.perf_counter() - before)
        observation, _, terminated, truncated, info = env.step(action)
        begun = terminated | truncated
        ended = running & begun
        pose = info["pose"].copy()
        if begun.any():
            final = info["final_info"]
            pose[begun] = final["pose"][begun]
            for key, values in kept.items():
                values[ended] = final[key][ended]
        pose[~running] = np.nan
        poses.append(pose)
        running &= ~begun
    env.close()
    return Episodes(
        success=kept["is_success"],
        outcome=tuple(map(str, kept["outcome"])),
        time=kept["time"],
        metrics={
            name: kept[name] if kept[name].ndim == 1 else kept[name].sum(axis=(1, 2))
            for name in metrics
        },
        pose=np.array(poses),
        velocity=kept["velocity"],
        decision_times=np.array(seconds) / count,
    )


def run_sequentially(
    controller: Controller, config: EnvConfig, starts: Sequence[dict[str, Any]], seed: int
) -> Episodes:
    """Run one start after the other, with the same results as `run_episodes`.

    The function suits slow controllers, because `run_episodes` also decides for environments whose
    episode has ended.
    """
    runs = [run_episodes(controller, config, [start], seed + k) for k, start in enumerate(starts)]
    return Episodes(
        success=np.concatenate([run.success for run in runs]),
        outcome=tuple(outcome for run in runs for outcome in run.outcome),
        time=np.concatenate([run.time for run in runs]),
        metrics={
            name: np.concatenate([run.metrics[name] for run in runs]) for name in runs[0].metrics
        },
        pose=stack_poses([run.pose[:, 0] for run in runs]),
        velocity=np.concatenate([run.velocity for run in runs]),
        # A planner plans at some decisions only, so the times of an episode are averaged.
        decision_times=np.array([run.decision_times.mean() for run in runs]),
    )


def stack_poses(paths: Sequence[Numbers]) -> Numbers:
    """Stack paths (poses, 3) into an array (longest, paths, 3); pad shorter paths with NaN."""
    pose = np.full((max(map(len, paths)), len(paths), 3), np.nan)
    for k, path in enumerate(paths):
        pose[: len(path), k] = path
    return pose
