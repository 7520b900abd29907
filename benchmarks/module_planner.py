"""Measure how much a planner gains if it chooses each module's axis instead of halves.

python -m benchmarks.module_planner --tasks stop orient track park --starts 32

Two planners make a plan of halves by a beam search in every control period. Then they vary the
plan's first action, simulate each variation to the end of the plan, and keep the best one. The
planner over halves tries all actions of halves. The planner over modules tries all actions of
quadrants. Then it changes single modules under the parcel as long as the cost decreases.

The planner over halves has a wider beam, so that both simulate about as many control periods.
Sensors are exact, and the model is the true physics.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress

from surface_gym.agents.base import Booleans, Integers, Numbers, axes_apart
from surface_gym.agents.evaluation.method import PLANNER, all_methods, start_benchmark
from surface_gym.agents.evaluation.scenario import SEED, choose_starts
from surface_gym.agents.planning.models import FIRST, SearchNodes, TrueModel, is_under
from surface_gym.agents.planning.planner import make_plan, nodes_needed
from surface_gym.config import PRESETS, EnvConfig
from surface_gym.state import RUNNING, SUCCESS
from surface_gym.tasks.planning import FAILED

HALVES, MODULES = "halves", "modules"
WIDTHS = (8, 32)  # of the first search's beam, until a plan succeeds
WIDTH = {HALVES: 32, MODULES: 8}  # of the later searches' beam
PRECISION = 0.1  # [-] cost of a plan that is good enough, relative to the task's own
MORE = 25  # [control periods] for which a plan's last action may continue
SWEEPS = 3  # maximum rounds of changes of single modules
LESS = 1e-6  # [-] minimum relative decrease of the cost
DEGREE = float(np.degrees(1.0))
ERRORS = {  # metric, unit, and factor to this unit
    "stop": (("stop_error", "mm", 1e3),),
    "orient": (("angle_error", "deg", DEGREE),),
    "track": (("rms_error", "mm", 1e3), ("speed_error", "m/s", 1.0)),
    "park": (("distance", "mm", 1e3), ("angle_error", "deg", DEGREE)),
}


class ModuleModel(TrueModel):
    """The true model of an environment with actions "modules", which also takes halves.

    Args:
        config: configuration with actions "halves" and axes that turn at once.
    """

    def __init__(self, config: EnvConfig, num_envs: int) -> None:
        super().__init__(replace(config, actions="modules"), num_envs)
        self._halves = config.action_kind
        self.kinds, self.choices = self._halves.choices, self._halves.choices**2
        self.simulated = 0  # number of control periods

    def uniform_action(self, angle: float) -> int:
        best = int(axes_apart(self.config.chosen_orientations, angle).argmin())
        return int(self._halves.encode(np.array([[best, best]]))[0])

    def advance(self, parents: Integers, actions: Integers) -> SearchNodes:
        """Branch by actions of halves (nodes,), or by choices of modules (nodes, modules)."""
        self.simulated += (count := len(parents))
        if actions.ndim == 1:
            actions = self.spread_halves(actions, parents)
        self._batch.fork(parents, axes=False)  # a command sets all axes
        commands = self._batch.surfaces.command.copy()
        commands[:count] = actions
        self._batch.step(commands)
        return self.nodes(count)

    @property
    def places(self) -> tuple[Numbers, Numbers]:
        """Positions x (columns,) and y (rows,) [m] of the action's modules."""
        (first_row, rows, first, columns), line = super().nodes(1).zone, self.config.chosen_line
        first_row -= (self._kind.rows - rows) // 2  # a narrow zone is in the middle of the action
        x = first + np.arange(columns, dtype=np.float64)
        y = first_row + np.arange(self._kind.rows, dtype=np.float64)
        return line.origin[0] + line.pitch_x * x, line.origin[1] + line.pitch_y * y

    def spread_halves(self, actions: Integers, parents: Integers) -> Integers:
        """Convert actions of halves (nodes,) to choices of modules (nodes, modules)."""
        halves = self._halves.commands(actions, len(actions))
        return self.spread_quadrants(halves[:, [0, 0, 1, 1]], parents)

    def spread_quadrants(self, quadrants: Integers, parents: Integers) -> Integers:
        """Convert choices of quadrants (nodes, 4) to choices of modules (nodes, modules)."""
        (x, y), centre = self.places, self.parcels.truth[parents, :2, np.newaxis]
        part = 2 * (x < centre[:, 0])[:, np.newaxis] + (y < centre[:, 1])[..., np.newaxis]
        each = np.take_along_axis(quadrants, part.reshape(len(parents), -1), axis=1)
        return np.asarray(each)

    def under(self) -> Booleans:
        """Return (modules,) whether each module of the action is under the first copy's parcel."""
        (x, y), (centre_x, centre_y, theta) = self.places, self.parcels.truth[0, :3]
        from_x, from_y = np.meshgrid(x - centre_x, y - centre_y)
        cosine, sine = np.cos(theta), np.sin(theta)
        ahead, left = cosine * from_x + sine * from_y, cosine * from_y - sine * from_x
        return is_under(self._batch.bodies, int(self.parcels.body[0]), ahead, left).ravel()


class ModulePlanner:
    """A planner over halves or over modules, which plans anew in every control period.

    Args:
        config: configuration with actions "halves".
        acts_by: `HALVES` or `MODULES`.
    """

    def __init__(self, config: EnvConfig, acts_by: str) -> None:
        cost, self._periods = config.task.cost(), config.task.periods
        # A path is planned piece by piece, since the search is too long otherwise.
        self._is_whole = not config.task.has_path
        horizon = self._periods if self._is_whole else cost.horizon
        self._cost = replace(cost, horizon=horizon, enough=PRECISION * cost.enough)
        self._width, self._by_modules = WIDTH[acts_by], acts_by == MODULES
        kinds = config.action_kind.choices
        self._quadrants = np.array(list(product(range(kinds), repeat=4)))
        if not self._by_modules:
            self._quadrants = np.unique(self._quadrants[:, [0, 0, 2, 2]], axis=0)
        size = nodes_needed(self._cost, max(*WIDTHS, self._width), kinds**2)
        self.model = ModuleModel(config, max(size, kinds**4))

    def play(self, options: dict[str, Any], seed: int) -> tuple[float, ...]:
        """Run an episode; return its success, and the absolute values of the task's metrics."""
        model = self.model
        model.begin(options, seed)
        plan = self._begin()
        for _ in range(self._periods):
            action, plan = self._decide(plan)
            model.rewind()
            parcels = model.step(action).parcels
            if parcels.outcome[0] != RUNNING:
                break
        return float(parcels.outcome[0] == SUCCESS), *np.abs(parcels.metrics[0]).tolist()

    def _begin(self) -> Integers:
        """Return the actions (periods,) of the first plan, by the narrowest beam that succeeds."""
        for width in WIDTHS:
            self.model.rewind()
            plan = make_plan(self.model, self._cost, width)
            if plan.cost < FAILED or not self._is_whole:
                break
        return plan.actions

    def _decide(self, plan: Integers) -> tuple[Integers, Integers]:
        """Return choices (modules,) for this control period, and the plan after it."""
        model, enough = self.model, self._cost.enough
        action, least = self._rate_plan(plan)
        if least > enough:
            model.rewind()
            new = make_plan(model, self._cost, self._width).actions
            other, cost = self._rate_plan(new)
            if cost < least or not self._is_whole:  # pieces of a path differ in length
                action, least, plan = other, cost, new
        later = plan[1:]
        if least > enough:
            model.rewind()
            origins = np.zeros(len(self._quadrants), dtype=np.int64)
            tried = model.spread_quadrants(self._quadrants, origins)
            action, least = _choose(tried, self._rate(tried, later), action, least)
        if least > enough and self._by_modules:
            action = self._change(action, least, later)
        return action, later if len(later) else plan

    def _change(self, action: Integers, least: float, later: Integers) -> Integers:
        """Change choices of single modules under the parcel as long as the cost decreases."""
        model = self.model
        model.rewind()
        under = model.under()
        model.advance(FIRST, action[np.newaxis])
        modules = np.flatnonzero(under | model.under())
        place, choice = np.repeat(modules, model.kinds), np.tile(range(model.kinds), len(modules))
        for _ in range(SWEEPS if len(modules) else 0):
            tried = np.repeat(action[np.newaxis], len(place), axis=0)
            tried[np.arange(len(place)), place] = choice
            costs = self._rate(tried, later)
            order = np.argsort(costs, kind="stable")[: np.count_nonzero(costs < least)]
            if not len(order):
                break
            # The best change of each module is also tried together with all better ones.
            _, best = np.unique(place[order], return_index=True)
            order = order[np.sort(best)]
            tried = np.repeat(action[np.newaxis], len(order), axis=0)
            for k, change in enumerate(order):
                tried[k:, place[change]] = choice[change]
            before = least
            action, least = _choose(tried, self._rate(tried, later), action, least)
            if least >= before:
                break
        return action

    def _rate_plan(self, plan: Integers) -> tuple[Integers, float]:
        """Return the choices (modules,) of a plan's first action, and the plan's cost."""
        self.model.rewind()
        action = self.model.spread_halves(plan[:1], FIRST)
        return action[0], float(self._rate(action, plan[1:])[0])

    def _rate(self, actions: Integers, later: Integers) -> Numbers:
        """Return the costs (tried,) of choices (tried, modules) that are followed by a plan."""
        model, costs, running = self.model, np.empty(len(actions)), np.arange(len(actions))
        if self._is_whole and len(later):
            later = np.append(later, np.repeat(later[-1], MORE))
        model.rewind()
        nodes = model.advance(np.zeros(len(actions), dtype=np.int64), actions)
        costs[:] = self._cost.final(nodes)
        for each in later:
            runs = nodes.parcels.outcome == RUNNING
            running = running[runs]
            if not len(running):
                break
            nodes = model.advance(np.flatnonzero(runs), np.full(len(running), each))
            costs[running] = self._cost.final(nodes)
        return costs


def _choose(
    tried: Integers, costs: Numbers, action: Integers, least: float
) -> tuple[Integers, float]:
    """Return the best tried action and its cost; or `action` and `least`, if these are as good."""
    k = int(costs.argmin())
    return (tried[k], float(costs[k])) if costs[k] < (1.0 - LESS) * least else (action, least)


def play(
    task: str, acts_by: str, starts: int, seed: int, on_start: Callable[[], Any]
) -> tuple[Numbers, float]:
    """Return success and metrics (starts, 1 + metrics), and simulated control periods per start."""
    benchmark, preset = start_benchmark(task), PRESETS["exact"]
    method = next(each for each in all_methods(task) if each.kind == PLANNER)
    planner = ModulePlanner(method.config(benchmark.task, preset), acts_by)
    chosen = choose_starts(benchmark, starts, preset)
    found = []
    for k, start in enumerate(chosen):
        found.append(planner.play(start, seed + k))
        on_start()
    return np.array(found), planner.model.simulated / len(found)


def describe(values: Numbers, form: str = ".4f") -> str:
    """Return the mean of values (starts,) with its 95 % interval, as text."""
    # Imported after the first bar, since pandas and SciPy take a second.
    from surface_gym.agents.evaluation.results import half_interval

    return f"{values.mean():{form}} ±{half_interval(values):.4f}"


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--tasks", nargs="+", choices=tuple(ERRORS), default=tuple(ERRORS))
    parser.add_argument("--starts", type=int, default=32)
    parser.add_argument("--seed", type=int, default=SEED, help="of the first start")
    asked = parser.parse_args()
    print("| mean | halves | modules | modules - halves |\n|---|---:|---:|---:|")
    for task in asked.tasks:
        with Progress(console=Console(stderr=True), transient=True) as bars:
            bar = {each: bars.add_task(f"{task}, {each}", total=asked.starts) for each in WIDTH}
            (halves, few), (modules, many) = (
                play(task, each, asked.starts, asked.seed, partial(bars.advance, bar[each]))
                for each in (HALVES, MODULES)
            )
        names = start_benchmark(task).task.metrics
        for name, unit, factor in (("success", "", 1.0), *ERRORS[task]):
            k = 0 if not unit else 1 + names.index(name)
            one, other = factor * halves[:, k], factor * modules[:, k]
            title = f"{task.capitalize()}: {name.replace('_', ' ')}{f' [{unit}]' if unit else ''}"
            gain = describe(other - one, "+.4f")
            print(f"| {title} | {describe(one)} | {describe(other)} | {gain} |")
        print(f"{task}: {few:.0f} and {many:.0f} control periods simulated a start", flush=True)


if __name__ == "__main__":
    main()
