"""Data sets of episodes for offline learning, in Minari's format: `surface-gym dataset`.

A recipe says how a data set is made: by which method, with how many random actions, in which
preset. The seed of an episode sets its start, noise and random actions. So an episode depends
neither on other episodes nor on the number of environments that run at once. The environment that
Minari recovers from a data set repeats an episode after `reset(seed=...)`.
"""

import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

import surface_gym as sg
from surface_gym import checks, parallel
from surface_gym.config import PRESETS, EnvConfig
from surface_gym.registration import PERIODS, SHIPPED, env_id

from . import library
from .base import Numbers, Singles
from .evaluation.method import (
    AGENT,
    FIXED,
    PLANNER,
    ROLL_ON,
    RULE,
    Method,
    all_methods,
    policy_folders,
    rules,
    shipped,
    trained,
)
from .rules import BEST_RULES

RANDOM, MIXED, LAB = "random", "mixed", "lab"
RECIPES = (RANDOM, RULE, PLANNER, AGENT, MIXED, LAB)
MIXED_RATES = (0.0, 0.3, 1.0)  # [-] shares of random actions in episodes of MIXED, in turn
REFERENCE_SEED = 2 * 10**9  # of the first episode of reference scores


@dataclass(frozen=True)
class Portion:
    """Number of episodes in one job, and number of environments that play the episodes at once."""

    episodes: int
    num_envs: int  # environments that play at once
    references: int = 0  # episodes of a reference score


PARCELS = Portion(500, 250, 200)
STREAMS = Portion(16, 8, 8)
PLANS = Portion(10, 1)  # a planner would also decide for environments without an episode


@dataclass(frozen=True)
class DataRecipe:
    """How a data set's episodes are played: method, share of random actions, and preset."""

    method: Method
    rates: tuple[float, ...] = (0.0,)  # [-] shares of random actions; episodes take turns by seed
    preset: str | None = None  # of sensors, randomisation and actuators; None: the task's defaults

    @property
    def task(self) -> str:
        return self.method.task

    @property
    def arguments(self) -> dict[str, Any]:
        return self.method.arguments | ({} if self.preset is None else {"preset": self.preset})

    @property
    def portion(self) -> Portion:
        """Numbers of episodes and environments of one job."""
        if PERIODS[self.task] is None:
            return STREAMS
        return PARCELS if self.method.most is None else PLANS


def find_recipe(task: str, policy: str, preset: str | None = None) -> DataRecipe:
    """Return a `DataRecipe`, which says how a policy plays the episodes of a data set.

    Args:
        policy: one of `RECIPES`, a method of the task, a shipped agent, or the folder of a run.
        preset: preset that replaces the recipe's preset; None keeps the recipe's preset.

    Raises:
        ValueError: the task has no such policy, or there is no such task or preset.
    """
    checks.one_of("task", task, SHIPPED)
    found = _find_recipe(task, policy)
    if preset is None:
        return found
    return replace(found, preset=checks.one_of("preset", preset, PRESETS))


def _find_recipe(task: str, policy: str) -> DataRecipe:
    folder = library.SHELF / policy if policy in library.names() else Path(policy)
    if policy not in RECIPES and folder.is_dir():
        method = trained(policy_folders(folder))
        checks.one_of("task", task, (method.task,))
        return DataRecipe(method)
    methods = (*rules(task), *all_methods(task))
    found = {each.name: DataRecipe(each) for each in methods if _is_recoverable(each)}
    found[RANDOM] = DataRecipe(_without_controller(task), (1.0,))
    found[RULE] = DataRecipe(find_best_rule(task))
    if agents := shipped(task):
        of_lab = [each for each in agents if each.name.endswith(f", {LAB}")]
        found[AGENT] = DataRecipe(agents[0])
        found[MIXED] = DataRecipe(agents[0], MIXED_RATES)
        found[LAB] = DataRecipe((of_lab or agents)[0], preset=LAB)
    own = [name for name in library.names() if name.startswith(f"{task}-")]
    return found[checks.one_of("policy", policy, dict.fromkeys((*found, *own)))]


def _is_recoverable(method: Method) -> bool:
    """Return whether a method can decide from the observations of a registered environment."""
    is_clairvoyant = method.kind == PLANNER and PERIODS[method.task] is None
    return method.observed_task is None and method.estimate is None and not is_clairvoyant


def find_best_rule(task: str) -> Method:
    """Return the best rule of a task, named in `BEST_RULES`."""
    found = {each.name: each for each in rules(task) if _is_recoverable(each)}
    return found[BEST_RULES[task]]


def _without_controller(task: str) -> Method:
    actions = "parcels" if PERIODS[task] is None else "halves"
    return Method(RANDOM, task, _no_controller, {"actions": actions})


def _no_controller(_config: EnvConfig, _seed: int) -> None:
    return None


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode of a data set."""

    seed: int
    observations: Singles  # (periods + 1, ...)
    actions: NDArray[Any]  # (periods, ...)
    rewards: Numbers  # (periods,)
    is_terminated: bool  # else truncated
    success: float  # 1 for a success, else 0; on streams, number of correct deliveries

    @property
    def result(self) -> tuple[float, float]:
        """Undiscounted return and success."""
        return float(self.rewards.sum()), self.success


class _RandomActions:
    """Replaces some of a controller's actions. The episode's seed draws the random actions."""

    def __init__(self, rates: tuple[float, ...], space: Any, num_envs: int) -> None:
        self._rates, self._space = rates, space
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self._rate = np.zeros(num_envs)

    def begin(self, i: int, seed: int) -> None:
        """Begin an episode in environment `i`. `seed` determines the episode's random actions."""
        self._rate[i] = self._rates[seed % len(self._rates)]
        self._generators[i] = np.random.default_rng((seed, 1)) if self._rate[i] else None

    def replace(self, actions: NDArray[Any]) -> None:
        """Overwrite some of the actions (num_envs, ...) with random actions."""
        most = getattr(self._space, "nvec", None)
        for i, generator in enumerate(self._generators):
            if generator is not None and generator.random() < self._rate[i]:
                actions[i] = generator.integers(self._space.n if most is None else most)


@dataclass(frozen=True)
class EpisodesJob:
    """A job that plays episodes of a recipe with successive seeds."""

    recipe: DataRecipe
    seed: int  # of the first
    episodes: int
    num_envs: int  # environments at once; episodes do not depend on it

    def __call__(self) -> list[Episode]:
        method, count = self.recipe.method, min(self.num_envs, self.episodes)
        config = EnvConfig(task=method.task, **self.recipe.arguments)
        controller = method.controller(config, method.seeds[0])
        env = sg.SmartSurfaceVectorEnv(
            count, max_episode_steps=PERIODS[method.task], autoreset_mode=AutoresetMode.DISABLED,
            **config.arguments(),
        )  # fmt: skip
        space: Any = env.single_action_space
        succeeded = "correct" if config.task.is_stream else "is_success"
        random = _RandomActions(self.recipe.rates, space, count)
        seeds = [self.seed + i for i in range(count)]  # of the running episodes
        for i, seed in enumerate(seeds):
            random.begin(i, seed)
        begun = [0] * count  # period in which each began
        seen, _ = env.reset(seed=seeds)
        fresh, state = np.ones(count, dtype=np.bool_), None
        steps: list[tuple[Any, ...]] = []  # observations, actions and rewards of each period
        done: dict[int, Episode] = {}
        while len(done) < self.episodes:
            actions = np.zeros((count, *space.shape), dtype=space.dtype)
            if controller is not None:
                actions[:], state = controller.predict(seen, state, fresh, deterministic=True)
            random.replace(actions)
            after, rewards, terminated, truncated, info = env.step(actions)
            steps.append((seen, actions, rewards))
            seen, fresh = after, terminated | truncated
            if not fresh.any():
                continue
            following: list[int | None] = [None] * count
            for i in np.nonzero(fresh)[0].tolist():
                if seeds[i] < self.seed + self.episodes:
                    shown, acted, paid = zip(*steps[begun[i] :], strict=True)
                    done[seeds[i]] = Episode(
                        seeds[i], np.array([*(each[i] for each in shown), after[i]]),
                        np.array([each[i] for each in acted]), np.array([each[i] for each in paid]),
                        bool(terminated[i]), float(info[succeeded][i]),
                    )  # fmt: skip
                # Without an episode left, an environment plays on, and nothing is recorded.
                following[i] = seeds[i] = max(seeds) + 1
                begun[i] = len(steps)
                random.begin(i, seeds[i])
            seen, _ = env.reset(seed=following, options={"reset_mask": fresh})
        env.close()
        return [done[seed] for seed in sorted(done)]


@dataclass(frozen=True)
class DataScore:
    """Mean results of episodes."""

    episodes: int
    mean_return: float  # undiscounted
    success: float  # share of successes; on streams, correct deliveries per episode


def compute_score(results: Sequence[tuple[float, float]]) -> DataScore:
    """Compute mean return and success rate from the pairs (return, success) of all episodes."""
    mean_return, success = np.mean(results, axis=0).tolist()
    return DataScore(len(results), round(mean_return, 4), round(success, 4))


def plan_references(recipe: DataRecipe) -> dict[str, EpisodesJob]:
    """Return a job for each reference method of a recipe, e.g. random actions or a rule."""
    names = [RANDOM, ROLL_ON if PERIODS[recipe.task] is None else FIXED, RULE]
    if shipped(recipe.task):
        names.append(LAB if recipe.preset == LAB else AGENT)
    jobs = {}
    for name in names:
        found = find_recipe(recipe.task, name, recipe.preset)
        size = found.portion
        jobs[name] = EpisodesJob(found, REFERENCE_SEED, size.references, size.num_envs)
    return jobs


def plan_episodes(recipe: DataRecipe, seed: int, episodes: int) -> list[EpisodesJob]:
    """Return the jobs that play a number of episodes; the first episode has the seed `seed`."""
    size = recipe.portion
    return [
        EpisodesJob(recipe, seed + first, min(size.episodes, episodes - first), size.num_envs)
        for first in range(0, episodes, size.episodes)
    ]


def write_dataset(
    name: str, recipe: DataRecipe, seed: int, episodes: int, workers: int = 1,
    advance: Callable[[int, int, str], None] = lambda *_: None,
) -> DataScore:  # fmt: skip
    """Play episodes, write a data set with reference scores, and return the episodes' mean results.

    Args:
        name: name of the data set, e.g. "smart-surface/sort/rule-v0".
        seed: seed of the first episode.
        advance: called after each job with the number of finished jobs, the number of all jobs, and
            the name of the finished job.

    Raises:
        ValueError: the name is invalid or taken.
    """
    from minari.dataset.minari_storage import MinariStorage

    references = plan_references(recipe)
    jobs = [*references.values(), *plan_episodes(recipe, seed, episodes)]
    work = [partial(parallel.without_report, job) for job in jobs]
    with _new_dataset(name) as folder:
        env = gym.make(env_id(recipe.task), **recipe.arguments)
        storage = MinariStorage.new(folder, env_spec=env.spec)
        env.close()
        scores: dict[str, DataScore] = {}
        results: list[tuple[float, float]] = []
        for place, found in enumerate(_in_order(parallel.map_jobs(work, workers))):
            if place < len(references):
                label = list(references)[place]
                scores[label] = compute_score([each.result for each in found])
            else:
                label = f"{len(results) + len(found)} episodes"
                _add_episodes(storage, found, len(results))
                results += [each.result for each in found]
            advance(place + 1, len(jobs), label)
        score = compute_score(results)
        storage.update_metadata(_describe(name, recipe, score, scores))
    return score


def _in_order(results: Iterator[tuple[int, Any]]) -> Iterator[Any]:
    """Yield the results of jobs in the order of the jobs; `results` are (job's index, result)."""
    waiting: dict[int, Any] = {}
    following = 0
    for place, result in results:
        waiting[place] = result
        while following in waiting:
            yield waiting.pop(following)
            following += 1


def _add_episodes(storage: Any, episodes: Sequence[Episode], first: int) -> None:
    from minari.data_collector import EpisodeBuffer

    buffers = []
    for each in episodes:
        ends = np.zeros((2, len(each.rewards)), dtype=np.bool_)
        ends[0 if each.is_terminated else 1, -1] = True
        buffers.append(
            EpisodeBuffer(
                seed=each.seed,
                observations=each.observations,
                actions=each.actions,
                rewards=each.rewards,
                terminations=ends[0],
                truncations=ends[1],
            )
        )
    storage.update_episodes(buffers)
    marks = [{"success": each.success} for each in episodes]
    storage.update_episode_metadata(marks, range(first, first + len(episodes)))


def _describe(
    name: str, recipe: DataRecipe, score: DataScore, references: dict[str, DataScore]
) -> dict[str, Any]:
    """Return a data set's metadata, with its own score and the scores of reference methods."""
    from importlib.metadata import version

    label = recipe.method.name + ("" if recipe.preset is None else f", {recipe.preset}")
    best = max(references, key=lambda each: references[each].mean_return)
    return {
        "dataset_id": name,
        "minari_version": version("minari"),
        "algorithm_name": label,
        "description": f"{score.episodes} episodes of {recipe.task} by {label}",
        "requirements": [f"surface_gym=={sg.__version__}"],
        "ref_min_score": references[RANDOM].mean_return,
        "ref_max_score": references[best].mean_return,
        "num_episodes_average_score": references[best].episodes,
        "score": asdict(score),
        "reference_scores": {each: asdict(found) for each, found in references.items()},
        "best_known": best,
    }


@contextmanager
def _new_dataset(name: str) -> Iterator[Path]:
    """Yield a folder for the data of a new data set; if writing fails, delete the folder.

    Raise a ValueError if the name is invalid or taken.
    """
    from minari.namespace import create_namespace, list_local_namespaces
    from minari.storage import get_dataset_path

    root = get_dataset_path()
    place = root / name
    if not re.fullmatch(r"(\w[\w-]+/)*\w[\w-]*-v\d+", name, re.ASCII):
        raise ValueError(f"name must be like smart-surface/sort/rule-v0, got {name!r}")
    if place.exists():
        raise ValueError(f"name must be new, got {name!r}: delete it by `minari delete {name}`")
    part = root / f".{name.replace('/', '.')}.part"  # Minari does not list hidden folders
    shutil.rmtree(part, ignore_errors=True)
    try:
        (part / "data").mkdir(parents=True)
        yield part / "data"
        namespace = name.rpartition("/")[0]
        if namespace and namespace not in list_local_namespaces():
            create_namespace(namespace)
        part.rename(place)
    finally:
        shutil.rmtree(part, ignore_errors=True)
