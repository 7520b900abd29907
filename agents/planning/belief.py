"""A planner on a belief, which is the state, friction and load of a parcel as sensors show them.

In every control period the planner derives the belief from the observation. It searches from the
belief through copies of the simulator, and takes the first action of the best plan.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

import surface_gym as sg
from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.parcel import Base, Parcel, Polygon
from surface_gym.physics.step import axis_directions
from surface_gym.state import ACROSS_FACTOR, ALONG_FACTOR, OUT_OF_TIME, RUNNING
from surface_gym.tasks import planning
from surface_gym.tasks.start import Start

from ..base import BatchController, Integers, Numbers, Singles, is_fresh
from .models import FIRST, SearchNodes, TrueModel
from .planner import LEAST, Plan, make_plan, nodes_needed

BUDGET = 32  # maximum width of the beam
# Errors that a plan allows for, to the side of `PlanCost.caution`; tuned on other starts.
FRICTION_ERROR = 0.03  # [-] of the estimated friction, beside its standard deviation
ROLLING_ERROR = 0.15  # [-] of rolling friction, which no sensor estimates
FOLLOWED = 3  # control periods between beam searches while no plan succeeds
VARIATIONS = 128  # plans per generation
GENERATIONS = 3
PARENTS = 12  # plans kept per generation
REPLACED = 0.4  # [-] inverse of the mean number of replaced actions
LONGER = 4  # control periods that a varied plan may last longer
OUTLINE = ("size", "length", "width", "fill")  # features that tell parcels apart


class Belief(NamedTuple):
    """State, friction and load of a parcel, as an observation shows them."""

    start: Start  # its motion and goal, and the parcel with its load at the estimated position
    # [-] factors of the rotors' friction along and across their axes, with a margin
    friction: float
    rolling: float = 1.0


class BeliefDecoder:
    """Decodes observations into beliefs.

    A belief's base is chosen from the task's parcels: it fits the observed features `OUTLINE` best.
    If the sensor does not estimate the load's position, the belief has the load over the middle of
    the base.
    """

    def __init__(self, config: EnvConfig) -> None:
        self._config, self._caution = config, config.task.cost().caution
        bases = dict.fromkeys(parcel.base for parcel in config.task.parcels)
        self._bases = [_centred(base) for base in bases]
        self._outlines = np.array([_measure(base) for base in self._bases])

    def decode(self, observation: Singles) -> Belief:
        """Decode an observation (features,)."""
        seen = self._config.observed(observation)
        size = float(seen["size"][0])
        shown = [float(seen.get(n, 1.0 if n == "fill" else size)[0]) for n in OUTLINE]
        base = self._bases[int(np.abs(self._outlines - shown).sum(axis=1).argmin())]
        friction, load = self._config.sensors.learned_spreads
        side = -1.0 if seen.get("side")[0] < 0.0 else 1.0  # such an observation is mirrored
        x, y = (load * float(seen.get(f"load learned, {axis}")[0]) for axis in "xy")
        parcel = _loaded(base, x, side * y)
        start = self._config.task.decode_start(replace(seen, parcel=parcel))
        learned = 1.0 + friction * float(seen.get("friction learned")[0])
        unsure = friction * float(seen.get("doubt of friction")[0])
        factor = (1.0 + FRICTION_ERROR * self._caution) * (learned + self._caution * unsure)
        rolling = 1.0 + ROLLING_ERROR * max(0.0, self._caution)
        return Belief(start._replace(parcel=parcel), factor, rolling)


def _centred(base: Base) -> Base:
    """Return a base with its centroid at the origin. Sensors report the centroid's position."""
    if isinstance(base, Polygon):
        return Polygon(base.vertices - np.array(base.centroid))
    return base


def _measure(base: Base) -> tuple[float, ...]:
    """Return origin-to-rear distance, half length, half width [m], area / (length * width) [-]."""
    x, y = base.outline.T
    length, width = np.ptp(base.outline, axis=0)
    area = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
    return -float(x.min()), 0.5 * length, 0.5 * width, area / (length * width)


def _loaded(base: Base, x: float, y: float) -> Parcel:
    """Return a parcel with a load at (x, y) [m]. A load beside the base is moved onto the base."""
    while base.functions(x, y).max() > 0.0:
        x, y = 0.9 * x, 0.9 * y
    return Parcel(base, com_offset=(x, y))


class BeliefModel(TrueModel):
    """Copies of the simulator that begin at a belief.

    Axes take as long to turn as the configuration says, but no module is stuck. The model has no
    sensor delay, since a camera's filter estimates the current motion.
    """

    def __init__(self, config: EnvConfig, num_envs: int) -> None:
        actuators = replace(config.actuators, stuck_share=0.0)
        known = replace(config, randomisation=sg.Randomisation(), actuators=actuators)
        super().__init__(known, num_envs)

    @property
    def angles(self) -> Numbers:
        """(rows, columns) [rad] axes of the first copy."""
        return self._batch.surfaces.angle[0].copy()

    def begin_from(self, belief: Belief, angles: Numbers | None = None) -> None:
        """Begin every copy at a belief. The default of `angles` (rows, columns) [rad] is 90 deg."""
        surfaces, parcels = self._batch.surfaces, self._batch.parcels
        parcels.outcome[:] = OUT_OF_TIME
        self._batch.place(FIRST, belief.start)
        surfaces.conditions[0, ALONG_FACTOR] = belief.friction
        surfaces.conditions[0, ACROSS_FACTOR] = belief.rolling
        self._batch.begin(FIRST)
        if angles is not None and self._turns:
            surfaces.angle[0] = surfaces.target[0] = angles
            surfaces.direction[0, surfaces.axis[0].ravel()] = axis_directions(angles.ravel())
        self.spread()
        self._find_profile()

    def run(self, plans: Integers) -> SearchNodes:
        """Run plans (count, periods) from the belief until all plans or all episodes have ended."""
        count, batch = len(plans), self._batch
        batch.restore(self._begun)
        batch.outcome[count:] = OUT_OF_TIME
        commands = batch.surfaces.command.copy()
        for actions in plans.T:
            commands[:count] = self._kind.commands(actions, count)
            batch.step(commands)
            if not (batch.outcome == RUNNING).any():
                break
        return self.nodes(count)


class Pursuit(NamedTuple):
    """Memory of a `BeliefPlanner` for one environment."""

    plan: Plan
    age: int  # control periods since the last search
    angles: Numbers  # (rows, columns) [rad] axes at the end of the control period
    place: Numbers  # (2,) [m] expected x and y of the parcel at that time


class BeliefPlanner(BatchController):
    """Plan over a receding horizon, from a belief that follows from observations only.

    Observations show pose and velocity, the outline, and the sensor's estimates of friction and
    load. The model has nominal stiffness and no stuck modules, and all axes follow their commands.
    `PlanCost.caution` makes the model's friction a little higher or lower than the estimate, so
    that an error of the estimate is easier to correct later.

    In every control period, the planner simulates its plan from the new belief. If the result is
    not good enough, the planner tries random variations of the plan. If no variation succeeds, a
    beam search, if necessary with a wider beam, looks for another plan. `Task.cost` defines the
    objective.

    Args:
        config: configuration of the environment, with actions "halves"; `observe=("parcel",
            "load")` shows outline and estimates.
        budget: maximum width of the beam; each node tries every action.
    """

    def __init__(self, config: EnvConfig, budget: int = BUDGET) -> None:
        checks.one_of("actions", config.actions, ("halves",))
        self._shape = (len(config.features),)
        self._cost = cost = config.task.cost()
        most = max(1, checks.integer("budget", budget, least=1) // cost.share)
        self._widths = tuple(dict.fromkeys(min(each, most) for each in (LEAST, most)))
        self._decoder = BeliefDecoder(config)
        own = config if cost.zone is None else replace(config, zone=cost.zone)
        choices = config.action_kind.choices**2
        self._models = [BeliefModel(own, nodes_needed(cost, w, choices)) for w in self._widths]
        self._pitch = np.array([config.chosen_line.pitch_x, config.chosen_line.pitch_y])

    def _predict(
        self, batch: Singles, state: Any, episode_start: Any, **_: bool
    ) -> tuple[Any, list[Pursuit]]:
        """Return actions and the new `state`: a `Pursuit` (plan and axes) per environment."""
        fresh = is_fresh(len(batch), state, episode_start)
        known = zip(batch, fresh, state or [None] * len(batch), strict=True)
        pursued = [self._pursue(seen, None if new else last) for seen, new, last in known]
        return np.array([each.plan.actions[0] for each in pursued]), pursued

    def _pursue(self, seen: Singles, last: Pursuit | None) -> Pursuit:
        """Return the plan for an observation (features,); `last` is the previous plan, or None."""
        belief, angles, age = self._decoder.decode(seen), None, 0
        model = self._models[0]
        if last is not None:
            # A periodic field has no places: the parcel may be some modules from the expected one.
            apart = np.rint((np.array(belief.start.pose[:2]) - last.place) / self._pitch)
            angles, age = np.roll(last.angles, apart[::-1].astype(int), axis=(0, 1)), last.age + 1
        model.begin_from(belief, angles)
        plan = None if last is None else self._improve(model, last.plan)
        if plan is None or age >= self._cost.follow:
            plan, age = self._search(belief, angles), 0
        elif plan.cost >= planning.FAILED and age >= FOLLOWED:
            plan = min(self._search(belief, angles), plan, key=lambda each: each.cost)
            age = 0
        model.rewind()
        parcels = model.advance(FIRST, plan.actions[:1]).parcels
        return Pursuit(plan, age, model.angles, parcels.truth[0, :2].copy())

    def _improve(self, model: BeliefModel, plan: Plan) -> Plan:
        """Return `plan` after its first action. If this remaining plan costs too much, vary it."""
        plans = np.append(plan.actions[1:], plan.actions[-1])[np.newaxis]
        costs = self._cost.final(model.run(plans))
        for generation in range(GENERATIONS // self._cost.share):
            if costs[0] <= self._cost.enough:
                break
            rng = np.random.default_rng(generation)
            parents = plans[rng.integers(len(plans), size=min(VARIATIONS, model.size))]
            tried = vary(parents, model.choices, rng)
            found = self._cost.final(model.run(tried))
            plans, costs = np.concatenate([plans, tried]), np.concatenate([costs, found])
            best = np.argsort(costs, kind="stable")[:PARENTS]
            plans, costs = plans[best], costs[best]
        return Plan(plans[0], plan.seen, float(costs[0]))

    def _search(self, belief: Belief, angles: Numbers | None) -> Plan:
        """Search for a plan. If the search fails, search again with a wider beam.

        `angles` (rows, columns) [rad] are the current axis angles. None means 90 deg.
        """
        for model, width in zip(self._models, self._widths, strict=True):
            model.begin_from(belief, angles)
            plan = make_plan(model, self._cost, width)
            if plan.cost < planning.FAILED:
                break
        longer = np.full(LONGER, plan.actions[-1])
        return replace(plan, actions=np.concatenate([plan.actions, longer]))


def vary(plans: Integers, choices: int, rng: np.random.Generator) -> Integers:
    """Return random variations of plans, shape (count, periods).

    A variation begins in a random period. From this period on, a few actions become the same random
    action, or all actions are one period earlier or later than in the plan, or both changes are
    made. Actions are numbers from 0 to `choices` - 1.
    """
    count, periods = plans.shape
    period, first = np.arange(periods), rng.integers(periods, size=(count, 1))
    replaced = (period >= first) & (period < first + rng.geometric(REPLACED, size=(count, 1)))
    moved = period + np.where(period >= first, rng.choice((-1, 1), size=(count, 1)), 0)
    shifted = np.take_along_axis(plans, moved.clip(0, periods - 1), axis=1)
    action, kind = rng.integers(choices, size=(count, 1)), rng.integers(3, size=(count, 1))
    changed = np.where(kind == 0, plans, shifted)
    return np.where(replaced & (kind != 1), action, changed)
