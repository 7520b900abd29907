"""Sorting by entry speed: how controllers do on the same starts."""

from collections.abc import Callable
from dataclasses import dataclass

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from agents.controller import Controller
from surface_gym.settings import Settings

SPEEDS = np.arange(30, 271, 2) / 100.0  # [m/s] entry speeds compared
SIDES = (1, -1)
PARCELS = ("S", "B")


@dataclass(frozen=True, eq=False)
class SortRecord:
    """How one controller sorted one parcel, by entry speed and side."""

    controller: str
    parcel: str  # "S" or "B"
    speed: NDArray[np.float64]  # (speeds,) [m/s]
    success: NDArray[np.bool_]  # (speeds, sides)
    time: NDArray[np.float64]  # (speeds, sides) [s] until off the line; inf where it was not
    path: tuple[NDArray[np.float64], ...]  # one (periods, 3) [m, m, rad] a start, side by side

    @property
    def success_rate(self) -> float:
        """[-] over all speeds and both sides."""
        return float(self.success.mean())

    @property
    def slowest_time(self) -> NDArray[np.float64]:
        """(speeds,) [s] of the slower side."""
        return self.time.max(axis=1)

    @property
    def minimum_speed(self) -> float | None:
        """[m/s] the speed from which on every start is sorted; None if the fastest is not."""
        fails = np.nonzero(~self.success.all(axis=1))[0]
        first = 0 if len(fails) == 0 else int(fails[-1]) + 1
        return float(self.speed[first]) if first < len(self.speed) else None


def compare_sorting(
    controllers: dict[str, tuple[Controller, Settings]],
    progress: Callable[[str], None] = lambda _: None,
) -> list[SortRecord]:
    """Run every controller on every parcel, speed and side.

    Args:
        controllers: by name, each with the settings it acts under.
        progress: called with a line before each part.
    """
    records = []
    for name, (controller, settings) in controllers.items():
        for parcel in PARCELS:
            progress(f"{name}, {parcel}-box")
            records.append(sort_by_speed(name, controller, settings, parcel))
    return records


def sort_by_speed(name: str, controller: Controller, settings: Settings, parcel: str) -> SortRecord:
    """One controller, one parcel: every speed and side, a lane each."""
    starts = [
        {"speed": float(speed), "side": side, "parcel": parcel}
        for speed in SPEEDS
        for side in SIDES
    ]
    env = gym.make_vec(
        "SmartSurface/Sort-v0",
        num_envs=len(starts),
        actions=settings.actions,
        control_period=settings.control_period,
        zone=settings.zone,
        orientations=settings.orientations,
        autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
    )
    observation, info = env.reset(seed=0, options=starts)  # type: ignore[arg-type]
    success = np.zeros(len(starts), dtype=np.bool_)
    time = np.full(len(starts), np.inf)
    running = np.ones(len(starts), dtype=np.bool_)
    paths = [[pose] for pose in info["pose"]]
    while running.any():
        action, _ = controller.predict(observation, deterministic=True)
        observation, _, terminated, truncated, info = env.step(action)
        ended = running & (terminated | truncated)
        for lane in np.nonzero(running)[0]:
            source = info["final_info"] if ended[lane] else info
            paths[lane].append(source["pose"][lane])
        if ended.any():
            final = info["final_info"]
            success[ended] = final["is_success"][ended]
            sorted_now = ended & success
            time[sorted_now] = final["time"][sorted_now]
        running &= ~ended
    env.close()
    shape = (len(SPEEDS), len(SIDES))
    return SortRecord(
        name,
        parcel,
        SPEEDS,
        success.reshape(shape),
        time.reshape(shape),
        tuple(np.array(path) for path in paths),
    )
