"""The benchmark's protocol: cells of test starts, and digests that identify them.

A task has four cells of 128 episodes each. In the first three, sensors are exact and the axes turn
ever more slowly, from the same starts. The fourth is the lab, with other parcels, friction, sensors
and actuators. An episode's start follows from the protocol's seed, the cell and the episode's
number. The file `protocol-1.json` holds a digest of all starts of a cell, so a version of the
package that draws other starts is refused.
"""

import hashlib
import json
import math
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from surface_gym import SmartSurfaceVectorEnv, checks
from surface_gym.config import PRESETS, EnvConfig, Preset
from surface_gym.flow.batch import StreamBatch
from surface_gym.randomisation import Actuators
from surface_gym.registration import SHIPPED

from ..scheduling.scheduler import begin_streams
from .process import ENV_KWARGS

VERSION = 1
FILE = Path(__file__).parent / f"protocol-{VERSION}.json"
EPISODES = 128  # per cell and training seed
SEED = 20_261_126_000  # of the first episode of the first cell; training uses small seeds
WARM_UP = 20.0  # [s] of a stream, before deliveries count
TASKS = tuple(SHIPPED)


@dataclass(frozen=True)
class Cell:
    """Conditions of 128 episodes of a task."""

    name: str
    preset: str  # name of a preset
    quarter_turn: float = 0.0  # [s] time of an axis for 90 deg; the lab has its own

    def make_preset(self) -> Preset:
        """Return the sensors, randomisation and actuators of the cell."""
        preset = PRESETS[self.preset]
        if not self.quarter_turn:
            return preset
        return replace(preset, actuators=Actuators(axis_speed=0.5 * math.pi / self.quarter_turn))


CELLS = {
    cell.name: cell
    for cell in (
        Cell("0 ms", "exact"),
        Cell("100 ms", "exact", 0.1),
        Cell("200 ms", "exact", 0.2),
        Cell("lab", "lab"),
    )
}


@dataclass(frozen=True)
class TestCell:
    """A cell of a task."""

    __test__ = False  # for pytest

    task: str
    cell: str

    def __post_init__(self) -> None:
        checks.one_of("task", self.task, TASKS)
        checks.one_of("cell", self.cell, CELLS)

    @property
    def seed(self) -> int:
        """Seed of the first episode; episode k has this seed plus k.

        Cells of a preset have the same starts, so that they differ in the axes alone.
        """
        place = list(PRESETS).index(CELLS[self.cell].preset)
        return SEED + 10_000 * TASKS.index(self.task) + 1000 * place

    @property
    def digest(self) -> str:
        """Digest of all starts by the protocol's file."""
        found: str = read_protocol()["digests"][self.task][self.cell]
        return found

    def config(self, chosen: dict[str, Any]) -> EnvConfig:
        """Return the configuration of the cell's environment.

        Args:
            chosen: arguments that the policy chooses; see `ENV_KWARGS`.

        Raises:
            ValueError: the policy must not choose such an argument, or not this value.
        """
        for name in chosen:
            checks.one_of("env_kwargs", name, ENV_KWARGS)
        try:
            return EnvConfig(task=self.task, preset=CELLS[self.cell].make_preset(), **chosen)
        except TypeError as error:
            raise ValueError(str(error)) from None

    def periods(self, config: EnvConfig) -> int:
        """Return the maximum control periods of an episode: the same time for all policies."""
        usual = EnvConfig(task=self.task)
        return math.ceil(usual.periods * usual.control_period / config.control_period - 1e-9)

    def compute_digest(self, config: EnvConfig, count: int = EPISODES) -> str:
        """Compute the digest of the first `count` starts of an environment."""
        if config.task.is_stream:
            return _digest(_read_streams(begin_streams(config, count, self.seed)))
        env = SmartSurfaceVectorEnv(num_envs=count, **config.arguments())
        _, info = env.reset(seed=self.seed)
        goals = [env.batch.parcels.goal.copy(), env.batch.parcels.path.copy()]
        env.close()
        return _digest([info[name] for name in ("pose", "velocity", "parcel")] + goals)


def _read_streams(batch: StreamBatch) -> list[Any]:
    """Return what arrives, when, how and for which exit."""
    streams = batch.streams
    found = []
    for i in range(batch.num_envs):
        count = int(streams.arrivals[i])
        found += [getattr(streams, name)[i, :count] for name in ("time", "start", "body", "exit")]
    return found


def _digest(arrays: list[Any]) -> str:
    """Compute a digest of arrays as single precision, which is the same on every machine."""
    made = hashlib.sha256()
    for array in arrays:
        made.update(np.ascontiguousarray(array, dtype=np.float32).tobytes())
    return made.hexdigest()[:16]


def list_cells(tasks: tuple[str, ...]) -> list[TestCell]:
    """List the cells of tasks."""
    return [TestCell(task, cell) for task in tasks for cell in CELLS]


@lru_cache
def read_protocol() -> dict[str, Any]:
    """Read the protocol's file: version, digests, and references."""
    found: dict[str, Any] = json.loads(FILE.read_text())
    return found


def write_protocol(references: dict[str, tuple[str, str]]) -> None:
    """Write the file of a new version of the protocol.

    Args:
        references: by task, the names of the entries that score 0 and 1.
    """
    cells = list_cells(TASKS)
    digests = {each.task: dict[str, str]() for each in cells}
    for each in cells:
        digests[each.task][each.cell] = each.compute_digest(each.config({}))
    made = {"version": VERSION, "references": references, "digests": digests}
    FILE.write_text(json.dumps(made, indent=1) + "\n")
