"""`python -m benchmarks.observer`: errors of a sensor's estimate where the world differs from the
sensor's assumptions, over all tasks, controllers and both boxes.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

import surface_gym as sg
from surface_gym.agents.base import Controller
from surface_gym.agents.library import load, names
from surface_gym.agents.rules import find_rules
from surface_gym.config import EnvConfig
from surface_gym.physics.types import RADIUS, THETA, X, Y
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Camera, Presence, Sensor
from surface_gym.tasks import TASKS

Numbers = NDArray[np.float64]
Booleans = NDArray[np.bool_]

NOMINAL_MU = 0.5  # [-] mu_max of every line here
SLOW_RULE = "best fixed layout"  # takes seconds for each start
PERIODS_HELD = 5  # control periods for which a random action is held
TOLERANCE = 0.001  # [m] of a module that is covered by the estimate or in truth only

MIXED = Randomisation(
    friction=0.2, rolling=0.2, mass=0.2, size=0.1, com_offset=0.2, stiffness=0.2, lateral=0.01,
    heading=0.03,
)  # fmt: skip


@dataclass(frozen=True)
class World:
    """A difference between the world and what an observer assumes."""

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
    """Measure a sensor's estimate where the world differs from its assumptions."""

    num_envs: int = 48
    """Starts of every task, controller and world."""
    seed: int = 0
    """Of the first start."""
    tasks: tuple[str, ...] = tuple(TASKS)
    """To run."""
    camera: bool = False
    """Measure the camera's filter instead of the presence switches' observer."""
    halves_only: bool = False
    """Leave out controllers of other kinds of action than "halves": fewer kernels to compile."""


@dataclass(eq=False)
class Errors:
    """Errors of the estimate over the decisions of some runs."""

    error: list[Numbers] = field(default_factory=list)  # (decisions, 6) estimate minus truth
    contradicts: list[Booleans] = field(default_factory=list)  # (decisions,) the switches
    longest: int = 0  # decisions in a row that contradict
    outside: int = 0  # observations outside of their space
    lost: int = 0  # episodes with an error of more than the pitch
    episodes: int = 0

    def add(self, other: "Errors") -> None:
        """Add the errors of other runs."""
        self.error += other.error
        self.contradicts += other.contradicts
        self.longest = max(self.longest, other.longest)
        self.outside += other.outside
        self.lost += other.lost
        self.episodes += other.episodes

    def cells(self) -> list[str]:
        """Format a row of the table."""
        error = np.concatenate(self.error)
        position = 1e3 * np.hypot(error[:, X], error[:, Y])
        # Squares: a quarter turn more or less is the same to every switch.
        quarter = 0.5 * np.pi
        turned = np.abs(error[:, THETA])
        heading = np.degrees(np.abs((error[:, THETA] + 0.5 * quarter) % quarter - 0.5 * quarter))
        share = np.concatenate(self.contradicts).mean()
        return [
            f"{len(error):,}",
            *(f"{np.percentile(position, p):.1f}" for p in (50.0, 99.0, 99.9, 100.0)),
            *(f"{np.percentile(heading, p):.1f}" for p in (50.0, 99.9, 100.0)),
            f"{100.0 * (turned > 0.5 * quarter).mean():.3f}",
            f"{self.lost} of {self.episodes}",
            f"{100.0 * share:.3f}",
            f"{self.longest}",
            f"{self.outside}",
        ]


def _distances(env: sg.SmartSurfaceVectorEnv, pose: Numbers, columns: Any, rows: Any) -> Numbers:
    """Return the signed distances [m] of modules from the bases in given poses, negative inside.

    Args:
        env: whose parcels they are.
        pose: (num_envs, 6) poses and velocities.
        columns: (num_envs, modules) of the modules.
        rows: (num_envs, modules).

    Returns:
        (num_envs, modules).
    """
    bodies, elements = env.batch.bodies, env.batch.params.elements
    body = env.batch.parcels.body
    dx = elements.x0 + elements.pitch_x * columns - pose[:, X, None]
    dy = elements.y0 + elements.pitch_y * rows - pose[:, Y, None]
    cosine, sine = np.cos(pose[:, THETA, None]), np.sin(pose[:, THETA, None])
    x, y = cosine * dx + sine * dy, cosine * dy - sine * dx
    edges = bodies.edges[body][:, :, :, None]
    beyond = edges[:, :, 0] * x[:, None] + edges[:, :, 1] * y[:, None] - edges[:, :, 2]
    circle = np.hypot(x, y) - bodies.body[body, RADIUS][:, None]
    found: Numbers = np.maximum(beyond.max(axis=1, initial=-np.inf), circle)
    return found


def contradicts(env: sg.SmartSurfaceVectorEnv, tolerance: float) -> Booleans:
    """Return whether the estimate covers other modules than the parcel (num_envs,), by more than a
    tolerance [m].
    """
    batch = env.batch
    parcels, bodies, elements = batch.parcels, batch.bodies, batch.params.elements
    layout = parcels.body if len(bodies.rotor) > 1 else np.zeros_like(parcels.body)
    rotor = bodies.rotor[layout]
    reach = int(np.ceil(bodies.body[:, RADIUS].max() / min(elements.pitch_x, elements.pitch_y))) + 1
    around = np.arange(-reach, reach + 1)
    column, row = np.meshgrid(around, around)
    env_indices = np.arange(len(rotor))[:, None]
    result = np.zeros(len(rotor), dtype=np.bool_)
    for centre in (parcels.truth, parcels.sensed):
        position = centre[:, :2] - np.array([elements.x0, elements.y0])
        nearest = np.round(np.clip(position, -1e3, 1e3) / [elements.pitch_x, elements.pitch_y])
        columns = nearest[:, :1].astype(int) + column.ravel()
        rows = nearest[:, 1:].astype(int) + row.ravel()
        exists = (columns >= 0) & (columns < rotor.shape[2]) & (rows >= 0)
        exists &= rows < rotor.shape[1]
        exists[exists] = rotor[np.broadcast_to(env_indices, rows.shape)[exists], rows[exists],
                               columns[exists]]  # fmt: skip
        covered = _distances(env, parcels.truth, columns, rows) <= 0.0
        estimated = _distances(env, parcels.sensed, columns, rows)
        wrong = (covered & (estimated > tolerance)) | (~covered & (estimated < -tolerance))
        result |= (wrong & exists).any(axis=1)
    return result


def run_controller(
    env: sg.SmartSurfaceVectorEnv, controller: Controller, periods: int, seed: int
) -> Errors:
    """Run a controller for one episode of each environment, and return the errors."""
    errors = Errors(episodes=env.num_envs)
    observation, _ = env.reset(seed=seed)
    running = np.ones(env.num_envs, dtype=np.bool_)
    begun, state = running.copy(), None
    in_a_row = np.zeros(env.num_envs, dtype=np.int64)
    worst = np.zeros(env.num_envs)
    space = env.single_observation_space
    assert isinstance(space, gym.spaces.Box)
    parcels = env.batch.parcels
    for _ in range(periods):
        action, state = controller.predict(observation, state, begun, deterministic=True)
        observation, _, terminated, truncated, _ = env.step(action)
        error = parcels.sensed - parcels.truth
        wrong = contradicts(env, TOLERANCE)
        errors.error.append(error[running])
        errors.contradicts.append(wrong[running])
        in_a_row = np.where(wrong & running, in_a_row + 1, 0)
        errors.longest = max(errors.longest, int(in_a_row.max()))
        outside = ((observation < space.low) | (observation > space.high)).any(axis=1)
        errors.outside += int((outside & running).sum())
        worst = np.maximum(worst, np.where(running, np.hypot(error[:, X], error[:, Y]), 0.0))
        begun = terminated | truncated
        running &= ~begun
        if not running.any():
            break
    errors.lost = int((worst > env.batch.params.elements.pitch_x).sum())
    return errors


class RandomActions:
    """A controller of random actions, each held for some periods."""

    def __init__(self, config: EnvConfig, num_envs: int, seed: int) -> None:
        self._space = config.action_space()
        self._space.seed(seed)
        self._num_envs = num_envs
        self._periods_left = 0
        self._actions: Any = None

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:  # fmt: skip
        """Return the held actions, or new ones; see `Controller`."""
        del observation, episode_start, deterministic
        if self._periods_left == 0:
            self._periods_left = PERIODS_HELD
            self._actions = np.stack([self._space.sample() for _ in range(self._num_envs)])
        self._periods_left -= 1
        return self._actions, state


class FixedActions:
    """A controller that sets every axis to one orientation, another in each environment."""

    def __init__(self, config: EnvConfig, num_envs: int) -> None:
        choices = np.arange(num_envs) % config.action_kind.choices
        shape = config.action_space().shape or ()
        columns = choices.reshape(-1, *(1,) * len(shape))
        self._actions = np.broadcast_to(columns, (num_envs, *shape)).copy()

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:  # fmt: skip
        """Return the actions; see `Controller`."""
        del observation, episode_start, deterministic
        return self._actions, state


@dataclass(frozen=True)
class Method:
    """A controller of a task, with its kind of action and control period."""

    actions: str
    control_period: float  # [s]
    make: Callable[[EnvConfig], Controller]
    observe: tuple[str, ...] = ()  # groups of features beside the task's


def list_methods(task: str, config: ObserverConfig) -> Iterator[Method]:
    """List the controllers of a task: random and fixed actions, rules, and shipped policies."""
    count, seed = config.num_envs, config.seed
    yield Method("quadrants", 0.04, lambda made_for: RandomActions(made_for, count, seed))
    yield Method("quadrants", 0.04, lambda made_for: FixedActions(made_for, count))
    for rule in find_rules(task):
        if rule.name != SLOW_RULE:
            yield Method(rule.actions, 0.04, rule.make)
    for name in names():
        if name.startswith(f"{task}-"):
            policy: Any = load(name)
            card = policy.card
            make = partial(_return_policy, policy)
            yield Method(card.actions, card.control_period, make, card.observe)


def _return_policy(policy: Any, config: EnvConfig) -> Controller:
    """Return a policy, whatever the configuration."""
    del config
    controller: Controller = policy
    return controller


def make_sensor(world: World, camera: bool) -> Sensor:
    """Make the sensor, which assumes the nominal friction unless the world's is another."""
    assumed = None if world.friction == 1.0 else NOMINAL_MU / world.friction
    return Camera(mu_max=assumed) if camera else Presence(mu_max=assumed)


def measure(config: ObserverConfig, console: Console) -> dict[tuple[str, str], Errors]:
    """Measure the errors by world and task."""
    found: dict[tuple[str, str], Errors] = {}
    methods = [
        (task, method)
        for task in config.tasks
        for method in list_methods(task, config)
        if not config.halves_only or method.actions == "halves"
    ]
    for task, method in track(methods, "running", console=console):
        for world in WORLDS:
            env_config = EnvConfig(
                task=task,
                actions=method.actions,
                sensors=make_sensor(world, config.camera),
                control_period=method.control_period,
                randomisation=world.randomisation,
                actuators=world.actuators,
                observe=method.observe,
            )
            periods = env_config.periods
            env = sg.SmartSurfaceVectorEnv(
                config.num_envs, max_episode_steps=periods, **env_config.arguments()
            )
            errors = run_controller(env, method.make(env_config), periods, config.seed)
            found.setdefault((world.name, task), Errors()).add(errors)
            env.close()
    return found


def errors_table(found: dict[tuple[str, str], Errors]) -> Table:
    """Make a table of the errors by world and task."""
    table = Table("world", "task", title="estimate against truth, at decisions")
    for column in (
        "decisions", "position [mm]\np50", "p99", "p99.9", "worst", "heading [deg]\np50", "p99.9",
        "worst", "turned [%]", "beyond a pitch", "contradicts [%]", "in a row", "outside space",
    ):  # fmt: skip
        table.add_column(column, justify="right")
    for world in WORLDS:
        total = Errors()
        for (name, task), errors in found.items():
            if name == world.name:
                table.add_row(name, task, *errors.cells())
                total.add(errors)
        table.add_row(world.name, "all", *total.cells(), end_section=True)
    return table


def main() -> None:
    """Run `python -m benchmarks.observer`."""
    config = tyro.cli(ObserverConfig, prog="python -m benchmarks.observer")
    console = Console(width=200)
    console.print(errors_table(measure(config, console)))


if __name__ == "__main__":
    main()
