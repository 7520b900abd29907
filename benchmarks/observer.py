"""`python -m benchmarks.observer`: how far a sensor's estimate strays where the world is not as
assumed, over all tasks, controllers and both boxes.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

import surface_gym as sg
from benchmarks.estimates import Watch, watch
from surface_gym.agents.base import Controller
from surface_gym.agents.library import load, names
from surface_gym.agents.rollout import env_arguments
from surface_gym.agents.rules import find_rules
from surface_gym.config import EnvConfig
from surface_gym.physics.types import THETA, X, Y
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Camera, Presence, Sensor
from surface_gym.tasks import TASKS

NOMINAL_MU = 0.5  # [-] mu_max of every plant here
SEARCHING = "best fixed layout"  # rules that take seconds a start
PERIODS_HELD = 5  # that random actions are held for

MIXED = Randomisation(
    friction=0.2,
    rolling=0.2,
    mass=0.2,
    size=0.1,
    com_offset=0.2,
    stiffness=0.2,
    lateral=0.01,
    heading=0.03,
)


@dataclass(frozen=True)
class World:
    """One way in which a world is not as an observer assumes."""

    name: str
    randomisation: Randomisation = Randomisation()
    actuators: Actuators = Actuators()
    friction: float = 1.0  # [-] mu_max over what the observer assumes


WORLDS = (
    World("as assumed"),
    World("load off centre by up to 0.5", Randomisation(com_offset=0.5)),
    World("friction 0.8 of assumed", friction=0.8),
    World("friction 1.2 of assumed", friction=1.2),
    World("uneven elements", Randomisation(stiffness=0.3)),
    World("a little of everything", MIXED),
    World("everything, load by up to 0.5", Randomisation(
        friction=0.2, rolling=0.5, mass=0.3, com_offset=0.5, stiffness=0.3, lateral=0.02,
        heading=0.05,
    )),
    World("5 % stuck", actuators=Actuators(stuck_share=0.05)),
    World("5 % stuck and a little of everything", MIXED, Actuators(stuck_share=0.05)),
)  # fmt: skip


@dataclass(frozen=True)
class ObserverConfig:
    """How far a sensor's estimate strays where the world is not as assumed."""

    lanes: int = 48
    """Starts of every task, controller and world."""
    seed: int = 0
    """Of the first start."""
    tasks: tuple[str, ...] = tuple(TASKS)
    """To run."""
    camera: bool = False
    """Try the camera's filter instead of the presence switches' observer."""
    halves_only: bool = False
    """Leave out controllers of any kind of action but "halves": fewer kernels to compile."""


class _Random:
    """Random actions, each held for some periods."""

    def __init__(self, settings: EnvConfig, lanes: int, seed: int) -> None:
        self._space = settings.action_space()
        self._space.seed(seed)
        self._lanes = lanes
        self._left = 0
        self._actions: Any = None

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """As a `Controller`."""
        del observation, episode_start, deterministic
        if self._left == 0:
            self._left = PERIODS_HELD
            self._actions = np.stack([self._space.sample() for _ in range(self._lanes)])
        self._left -= 1
        return self._actions, state


class _Fixed:
    """Every axis at one of the orientations on offer, another a lane."""

    def __init__(self, settings: EnvConfig, lanes: int) -> None:
        kind = settings.action_kind
        choices = np.arange(lanes) % kind.choices
        shape = settings.action_space().shape or ()
        self._actions = np.broadcast_to(
            choices.reshape(-1, *(1,) * len(shape)), (lanes, *shape)
        ).copy()

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """As a `Controller`."""
        del observation, episode_start, deterministic
        return self._actions, state


def _contenders(
    task: str, lanes: int, seed: int
) -> Iterator[tuple[str, str, float, Callable[[EnvConfig], Controller]]]:
    """Name, kind of action, control period [s] and maker of each controller of a task."""
    yield "random actions", "quadrants", 0.04, lambda settings: _Random(settings, lanes, seed)
    yield "fixed layouts", "quadrants", 0.04, lambda settings: _Fixed(settings, lanes)
    for rule in find_rules(task):
        if rule.name != SEARCHING:
            yield rule.name, rule.actions, 0.04, rule.make
    for name in names():
        if name.startswith(f"{task}-"):
            policy: Any = load(name)
            yield name, policy.card.actions, policy.card.control_period, partial(_loaded, policy)


def _loaded(policy: Any, settings: EnvConfig) -> Controller:
    del settings
    controller: Controller = policy
    return controller


def sensor_of(world: World, camera: bool) -> Sensor:
    """The sensor that assumes another friction than there is."""
    assumed = None if world.friction == 1.0 else NOMINAL_MU / world.friction
    return Camera(mu_max=assumed) if camera else Presence(mu_max=assumed)


def measure(config: ObserverConfig, console: Console) -> dict[tuple[str, str], Watch]:
    """What was seen of each world and task."""
    found: dict[tuple[str, str], Watch] = {}
    tried = [
        (task, contender)
        for task in config.tasks
        for contender in _contenders(task, config.lanes, config.seed)
        if not config.halves_only or contender[1] == "halves"
    ]
    for task, (_, actions, period, make) in track(tried, "running", console=console):
        for world in WORLDS:
            settings = EnvConfig(
                task=task,
                actions=actions,
                sensors=sensor_of(world, config.camera),
                control_period=period,
                randomisation=world.randomisation,
                actuators=world.actuators,
            )
            env = sg.SmartSurfaceVectorEnv(
                config.lanes,
                max_episode_steps=settings.task.periods,
                **env_arguments(settings),
            )
            seen = watch(env, make(settings), settings.task.periods, config.seed)
            found.setdefault((world.name, task), Watch()).add(seen)
            env.close()
    return found


def _row(seen: Watch) -> list[str]:
    error = np.concatenate(seen.error)
    position = 1e3 * np.hypot(error[:, X], error[:, Y])
    # Squares: a quarter turn more or less is the same to every switch.
    quarter = 0.5 * np.pi
    turned = np.abs(error[:, THETA])
    heading = np.degrees(np.abs((error[:, THETA] + 0.5 * quarter) % quarter - 0.5 * quarter))
    share = np.concatenate(seen.contradicts).mean()
    return [
        f"{len(error):,}",
        *(f"{np.percentile(position, p):.1f}" for p in (50.0, 99.0, 99.9, 100.0)),
        *(f"{np.percentile(heading, p):.1f}" for p in (50.0, 99.9, 100.0)),
        f"{100.0 * (turned > 0.5 * quarter).mean():.3f}",
        f"{seen.lost} of {seen.episodes}",
        f"{100.0 * share:.3f}",
        f"{seen.longest}",
        f"{seen.outside}",
    ]


def table(found: dict[tuple[str, str], Watch]) -> Table:
    """Errors by world and task."""
    result = Table("world", "task", title="estimate against truth, at decisions")
    for column in (
        "decisions", "position [mm]\np50", "p99", "p99.9", "worst", "heading [deg]\np50", "p99.9",
        "worst", "turned [%]", "beyond a pitch", "contradicts [%]", "in a row", "outside space",
    ):  # fmt: skip
        result.add_column(column, justify="right")
    for world in WORLDS:
        every = Watch()
        for (name, task), seen in found.items():
            if name == world.name:
                result.add_row(name, task, *_row(seen))
                every.add(seen)
        result.add_row(world.name, "all", *_row(every), end_section=True)
    return result


def main() -> None:
    """Measure and print."""
    config = tyro.cli(ObserverConfig)
    console = Console(width=200)
    console.print(table(measure(config, console)))


if __name__ == "__main__":
    main()
