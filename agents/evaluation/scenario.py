"""Scenarios: conditions of the comparison, and their episodes."""

import math
import pickle
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import surface_gym as sg
from surface_gym.config import PRESETS, EnvConfig, Preset
from surface_gym.tasks.benchmark import Benchmark

from ..rollout import Episodes, run_episodes, run_sequentially
from .method import Method, find_benchmark, start_benchmark
from .results import KEY, Key

SEED = 20_261_121  # seed of every episode
STARTS = "starts"  # scenario name of tasks of one parcel

Row = dict[str, Any]


@dataclass(frozen=True)
class Extent:
    """Extent of a comparison."""

    starts: int | None = None  # starts of a task of one parcel; None: all of its benchmark
    level_starts: int = 240  # starts per level of robustness
    seeds: int | None = None  # maximum seeds of a method; None: all
    replications: int | None = None  # of a stream; None: the benchmark's number
    duration: float = math.inf  # [s] maximum duration of a stream
    offers: int | None = None  # number of streams of a task; None: all
    levels: int | None = None  # levels of a factor; None: all
    searched: int | None = None  # maximum starts of methods that search; None: their own
    presets: tuple[str, ...] | None = None  # presets of streams; None: all
    film: float = 20.0  # [s] maximum duration of a stream's film
    rungs: int | None = None  # maximum rungs in a film; None: all


WHOLE = Extent()
# `--quick`: the same tables with fewer episodes.
QUICK = Extent(
    starts=12, level_starts=12, seeds=1, replications=2, duration=20.0, offers=1, levels=1,
    searched=2, presets=("exact",), film=3.0, rungs=2,
)  # fmt: skip


@dataclass(frozen=True)
class Scenario(ABC):
    """Conditions for the comparison of a task's methods, given by names only.

    Other processes look up the names, so custom tasks need not be sent to them.
    """

    task: str
    preset: str
    extent: Extent

    @property
    @abstractmethod
    def name(self) -> str:
        """The scenario's name, once a task."""

    def accepts(self, method: Method) -> bool:
        """Return whether a method takes part."""
        return method.presets is None or self.preset in method.presets

    @abstractmethod
    def episodes(self, method: Method) -> int:
        """Return the number of episodes per seed of a method."""

    @abstractmethod
    def play(self, method: Method, seed: int) -> list[Row]:
        """Run a seed of a method; return the numbers of each episode."""


@dataclass(frozen=True)
class ScenarioJob:
    """A seed of a method under a scenario."""

    scenario: Scenario
    method: Method
    seed: int

    def __reduce__(self) -> Any:
        packed = pickle.dumps((self.scenario, self.method, self.seed))
        return _unpack, (self.scenario.task, packed)

    @property
    def key(self) -> Key:
        at = self.scenario
        return (at.task, at.name, at.preset, self.method.name, self.seed)

    @property
    def episodes(self) -> int:
        return self.scenario.episodes(self.method)

    def __call__(self) -> list[Row]:
        """Run the job; return rows of the table of results."""
        names = dict(zip(KEY, self.key, strict=True)) | {"kind": self.method.kind}
        rows = self.scenario.play(self.method, self.seed)
        return [{**names, "episode": k, **row} for k, row in enumerate(rows)]


def _unpack(task: str, packed: bytes) -> ScenarioJob:
    """Unpack a job in another process, after loading the file of a custom task."""
    find_benchmark(task)
    return ScenarioJob(*pickle.loads(packed))


def make_jobs(scenarios: Sequence[Scenario], methods: Sequence[Method]) -> list[ScenarioJob]:
    """List the jobs of a task: methods in order, each under its scenarios."""
    return [
        ScenarioJob(each, method, seed)
        for method in methods
        for each in scenarios
        if each.accepts(method)
        for seed in method.seeds[: each.extent.seeds]
    ]


@dataclass(frozen=True)
class StartScenario(Scenario):
    """The starts of a benchmark of one parcel under a preset."""

    @property
    def name(self) -> str:
        return STARTS

    @property
    def chosen_preset(self) -> Preset:
        """The preset by its name."""
        return PRESETS[self.preset]

    def count(self, method: Method) -> int | None:
        """Return the number of starts for a method; None: all."""
        asked = [each for each in (self.extent.starts, method.most) if each is not None]
        if method.most is not None and self.extent.searched is not None:
            asked.append(self.extent.searched)
        return min(asked, default=None)

    def episodes(self, method: Method) -> int:
        starts, count = len(start_benchmark(self.task).starts), self.count(method)
        return starts if count is None else min(starts, count)

    def play(self, method: Method, seed: int) -> list[Row]:
        episodes, config, starts = self.run(method, seed)
        metrics = episodes.metrics | _path_metrics(config, episodes, starts)
        return [
            {
                "success": episodes.success[k], "time": episodes.time[k],
                **{name: values[k] for name, values in metrics.items()},
                "decision_time": episodes.decision_time,
            }
            for k in range(len(starts))
        ]  # fmt: skip

    def run(
        self, method: Method, seed: int
    ) -> tuple[Episodes, EnvConfig, tuple[dict[str, Any], ...]]:
        """Run a seed of a method from every start."""
        preset, benchmark = self.chosen_preset, start_benchmark(self.task)
        starts = choose_starts(benchmark, self.count(method), preset)
        config = method.config(benchmark.task, preset)
        run = run_episodes if method.most is None else run_sequentially
        return run(method.controller(config, seed), config, starts, SEED), config, starts


def start_scenarios(task: str, extent: Extent = WHOLE) -> list[Scenario]:
    """List the starts of a task under each preset."""
    return [StartScenario(task, preset, extent) for preset in PRESETS]


def choose_starts(
    benchmark: Benchmark, count: int | None, preset: Preset
) -> tuple[dict[str, Any], ...]:
    """Choose the starts of a benchmark under a preset.

    Args:
        count: number of starts, evenly spaced; None: all.
        preset: preset of the scenario. If the preset has its own parcels, the starts do not set the
            parcel.
    """
    starts = benchmark.starts
    if count is not None:
        places = np.linspace(0, len(starts) - 1, min(count, len(starts))).round()
        starts = tuple(starts[place] for place in places.astype(int).tolist())
    if not preset.parcels:
        return starts
    return tuple({key: start[key] for key in start if key != "parcel"} for start in starts)


def drawn_parcels(
    config: EnvConfig, starts: Sequence[dict[str, Any]], seed: int
) -> tuple[sg.Parcel, ...]:
    """List the parcel of each start; start k is seeded by `seed` + k."""
    env = sg.SmartSurfaceVectorEnv(num_envs=len(starts), **config.arguments())
    env.reset(seed=seed, options=list(starts))
    parcels = tuple(env.batch.parcel(i) for i in range(len(starts)))
    env.close()
    return parcels


def _path_metrics(
    config: EnvConfig, episodes: Episodes, starts: Sequence[dict[str, Any]]
) -> dict[str, list[float]]:
    """Compute the task's metrics of whole paths; most tasks have none."""
    task, line = config.task, config.chosen_line
    found: dict[str, list[float]] = {}
    if type(task).path_metrics is sg.tasks.Task.path_metrics:
        return found
    for k, parcel in enumerate(drawn_parcels(config, starts, SEED)):
        for name, value in task.path_metrics(episodes.path(k), parcel, line, None).items():
            found.setdefault(name, []).append(value)
    return found
