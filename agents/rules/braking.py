"""Rules of Slow and Stop: in every period, take the option of braking that ends nearest to the
goal. An option gives each column near the parcel a level: rolling, half braking or full braking.
An angle off 90 deg is the angle by which an axis is turned away from rolling. An option's regret is
its predicted error. Elements are rotors and supports.
"""

import math
from typing import Any, NamedTuple

import numpy as np

import surface_gym as sg
from surface_gym.compiler.jit import compiled, inlined, linked
from surface_gym.config import EnvConfig
from surface_gym.physics.types import GRAVITY
from surface_gym.tasks.base import BRAKING, ROLLING_LOSS

from ..base import Booleans, Integers, Numbers, Singles
from . import base
from .base import ColumnAxes, Commands, CompiledRule, Observations, rule
from .decoding import LineReading, Sight, add, look_at_line, see_line

# Optional groups of features: width and shape of the base; estimates of friction and load.
SHOWN = ("parcel", "load")
MOST_AFTER = 24  # maximum simulated steps after a period
COM_HEIGHT = 0.1  # [m] of the centre of mass: Table 1
SUPPORT_LOSS = 0.005 * GRAVITY  # [m/s^2] mu_support g of Table 1
NEAR = 128  # maximum columns under a parcel
# [m] elements this close to the outline count, since observations are single precision
ON_EDGE = 1e-6
RECTANGLE = 0.999  # [-] minimum filled share of the bounding box of a rectangle
# Exponents of the ovals |x / a|^p + |y / b|^p = 1 that model other bases, and their filled share.
POWERS = np.geomspace(1.2, 60.0, 200)
FILLS = np.array([math.gamma(1.0 + 1.0 / p) ** 2 / math.gamma(1.0 + 2.0 / p) for p in POWERS])

# Tuned on other starts than the reported ones. Gentle, early braking compensates prediction errors
# (friction, loads, drift onto supports).
SLOW_GENTLY, STOP_GENTLY = 0.6, 0.3  # [-] share of half braking assumed for the future
# Parameters of Slow:
SHORT = 3.0  # [-] cost of a missing m/s relative to an excess m/s
CAUTION = 3.0  # [-] margin for rolling losses in standard deviations
TRIM_TIME = 1.2  # [s] remaining time at the goal speed when half braking should end

# Places in an estimate: friction along axes and across them, their variances and covariance.
ALONG, ACROSS, VAR_ALONG, VAR_ACROSS, BOTH = range(5)
UNSURE = 0.12  # [-] initial standard deviation of braking and of rolling
LEAST, MOST = 0.4, 1.7  # [-] limits of an estimate
# Standard deviations of the observed and of the predicted loss of speed in a period.
SEEN_EXACTLY, SEEN = 2e-4, 0.01  # [m/s] with exact sensors, and with others
PREDICTED = 0.16  # [-] relative to the loss by braking: columns come and go, loads are off centre
HALF_SINE, HALF_COSINE = math.sin(base.LEANS[base.HALF]), math.cos(base.LEANS[base.HALF])


class Model(NamedTuple):
    """Parameters of the prediction of braking."""

    columns: int
    rows: int
    is_line: int  # 1: the parcel's width sets the number of rotor rows
    dt: float  # [s]
    steps: int  # physics steps of a period
    turn: float  # [rad] turn of an axis per step; infinite: it turns at once
    tail: int  # steps in which axes turn after the period
    then: float  # [rad] off 90 deg: goal of the axes in these steps, at most half braking
    period: float  # [s]
    noise: float  # [m/s] standard deviation of an observed loss of speed


def make_model(config: EnvConfig, then: float) -> Model:
    """Make a model. After the predicted period, axes turn to the angle `then` [rad] off 90 deg."""
    rows, columns = config.action_kind.shape
    turn = config.actuators.axis_speed * config.timing.dt
    exact = isinstance(config.sensors, sg.sensors.Exact)
    return Model(
        columns=columns, rows=rows, is_line=int(isinstance(config.chosen_line, sg.lines.Line)),
        dt=config.timing.dt, steps=config.timing.steps, turn=turn,
        tail=0 if turn == math.inf else min(MOST_AFTER, math.ceil(0.25 * math.pi / turn)),
        then=then, period=config.control_period, noise=SEEN_EXACTLY if exact else SEEN,
    )  # fmt: skip


class Footprint(NamedTuple):
    """Position and size of a parcel on the zone, and the elements under the parcel."""

    place: float  # [m] x of the base's centroid past the zone's first edge
    middle: float  # [m] from the centroid to the middle of the base's length
    load: float  # [m] from the centroid to the load, along x
    half_length: float  # [m]
    first: int  # first column under the parcel
    half_rows: int  # rotor rows on each side of the middle
    rotor_share: float  # [-] mean share of rotors among the elements under the parcel


class Frictions(NamedTuple):
    """Estimated friction relative to nominal friction."""

    braking: float  # [-] along axes
    rolling: float  # [-] across them, and on supports
    doubt: float  # [-] standard deviation of `rolling`


class Result(NamedTuple):
    """Predicted state after a period, and losses of speed during the period."""

    place: float  # [m] centroid past the zone's first edge, after all axes have turned
    speed: float  # [m/s] speed at that time
    braking: float  # [m/s] speed lost by nominal friction along the axes
    rolling: float  # [m/s] speed lost by nominal friction across the axes and on supports


class BrakingScratch(NamedTuple):
    """Scratch arrays that the prediction overwrites."""

    reach: Numbers  # (rows + 2,) [m] half length of a row under the parcel; -1: none
    covered: Numbers  # (rows + 2,) [m]
    target: Numbers  # (columns,) [rad] off 90 deg: goals of the zone's axes
    start: Numbers  # (near,) [rad] off 90 deg; near: columns that a parcel may cover
    turned: Numbers  # (near,) [rad] remaining turn
    sine: Numbers  # (near,) sine of the current angle off 90 deg
    cosine: Numbers  # (near,)
    arm: Numbers  # (near,) [m] from the load
    elements: Numbers  # (near,) number of elements under the parcel
    rotors: Numbers  # (near,) number of rotors among them
    load: Numbers  # (near,) [-] load per element
    terms: Numbers  # (near,) terms of a sum


def make_scratch(model: Model) -> BrakingScratch:
    """Allocate the scratch arrays of a model."""
    rows, near = np.zeros((2, model.rows + 2)), np.zeros((9, NEAR))
    arrays: list[Any] = [*rows, np.zeros(model.columns), *near]
    return BrakingScratch(*arrays)


@linked
def find_power(fill: float) -> float:
    """Return the exponent p of the oval |x|^p + |y|^p = 1 that has the share `fill` [-].

    The share is the oval's area, divided by the area of the rectangle around the oval.
    """
    last = FILLS.shape[0] - 1
    if fill >= FILLS[last]:
        return POWERS[last]
    if fill <= FILLS[0]:
        return POWERS[0]
    k = 0
    while FILLS[k + 1] <= fill:
        k += 1
    slope = (POWERS[k + 1] - POWERS[k]) / (FILLS[k + 1] - FILLS[k])
    return slope * (fill - FILLS[k]) + POWERS[k]


@linked
def find_span(seen: LineReading, sight: Sight, model: Model, scratch: BrakingScratch) -> Footprint:
    """Estimate the elements under an observed parcel; write `scratch.reach` and `scratch.covered`.

    If the base is not a rectangle, it is modelled as an oval. The oval has the same length, width
    and area as the base.
    """
    rear = sight.pitch_x * model.columns - seen.rear_to_go
    # The observed size is the distance from the rear to the centroid at heading 0.
    place = rear + seen.reach
    half_length = max(0.5 * (seen.front_in_zone - rear), 0.5 * sight.pitch_x)
    rows = model.rows + 2
    half_rows = model.rows // 2
    if model.is_line != 0:
        under = math.floor((seen.half_width + ON_EDGE) / sight.pitch_y)
        half_rows = min(half_rows, max(1, under))
    power = find_power(seen.fill)
    for row in range(rows):
        y = sight.pitch_y * (row - (rows - 1) / 2.0) - seen.y
        aside = abs(y) / (seen.half_width + ON_EDGE)
        part = 1.0
        if seen.fill <= RECTANGLE:
            part = max(0.0, 1.0 - min(aside, 1.0) ** power) ** (1.0 / power)
        scratch.reach[row] = part * half_length + ON_EDGE if aside <= 1.0 else -1.0
        scratch.covered[row] = max(0.0, scratch.reach[row])
    every = add(scratch.covered, rows)
    for row in range(rows):
        if abs(row - (rows - 1) / 2.0) >= half_rows:
            scratch.covered[row] = 0.0
    middle = 0.5 * (rear + seen.front_in_zone) - place
    return Footprint(
        place,
        middle,
        seen.load_ahead,
        half_length,
        math.floor((place + middle - half_length) / sight.pitch_x),
        half_rows,
        add(scratch.covered, rows) / max(every, ON_EDGE),
    )


@inlined
def find_frictions(estimate: Numbers) -> Frictions:
    """Convert `estimate` (5,) to `Frictions`, and clip the frictions [-] to `LEAST` .. `MOST`."""
    return Frictions(
        min(MOST, max(LEAST, estimate[ALONG])),
        min(MOST, max(LEAST, estimate[ACROSS])),
        math.sqrt(max(0.0, estimate[VAR_ACROSS])),
    )


@linked
def update(estimate: Numbers, lost: float, braking: float, rolling: float, noise: float) -> None:
    """Update an estimate of friction along axes and across axes, by a Kalman filter.

    Args:
        estimate: (5,) relative friction along and across axes, two variances, and a covariance.
        lost: [m/s] observed loss of speed in a period.
        braking: [m/s] predicted loss by nominal friction along axes.
        rolling: [m/s] predicted loss by nominal friction across axes.
        noise: [m/s] standard deviation of the observed loss.
    """
    along, across, var_along, var_across, both = (
        estimate[0], estimate[1], estimate[2], estimate[3], estimate[4]
    )  # fmt: skip
    with_along = var_along * braking + both * rolling
    with_across = both * braking + var_across * rolling
    share = PREDICTED * braking
    doubt = noise * noise + share * share
    variance = with_along * braking + with_across * rolling + doubt
    surprise = (lost - along * braking - across * rolling) / variance
    estimate[ALONG] = along + with_along * surprise
    estimate[ACROSS] = across + with_across * surprise
    estimate[VAR_ALONG] = var_along - with_along * with_along / variance
    estimate[VAR_ACROSS] = var_across - with_across * with_across / variance
    estimate[BOTH] = both - with_along * with_across / variance


@inlined
def _bear(span: Footprint, model: Model, arm: float, scratch: BrakingScratch, k: int) -> None:
    """Write to entry `k` of the scratch arrays how many elements of a column the parcel covers.

    The column is `arm` [m] ahead of the parcel's centroid, or behind it if `arm` is negative.
    """
    far, elements, rotors = abs(arm - span.middle), 0.0, 0.0
    rows = model.rows + 2
    for row in range(rows):
        if far <= scratch.reach[row]:
            elements += 1.0
            if abs(row - (rows - 1) / 2.0) < span.half_rows:
                rotors += 1.0
    scratch.elements[k], scratch.rotors[k] = elements, rotors
    scratch.arm[k] = arm - span.load


@inlined
def _share_load(scratch: BrakingScratch, near: int, before: float) -> None:
    """Write the share [-] of the parcel's weight that a single element of each column carries.

    Shares are by the study's Eq. (1); negative shares become 0. The first `near` entries of the
    scratch arrays are the columns near the parcel. `before` [m/s^2] is the deceleration in the last
    step. This deceleration shifts the load.
    """
    elements, arm, terms, load = scratch.elements, scratch.arm, scratch.terms, scratch.load
    count = max(1.0, add(elements, near))
    for k in range(near):
        terms[k] = elements[k] * arm[k]
    mean = add(terms, near) / count
    for k in range(near):
        apart = arm[k] - mean
        terms[k] = elements[k] * (apart * apart)
    spread = max(add(terms, near), 1e-9)
    slope = (before * COM_HEIGHT / GRAVITY - mean) / spread
    for k in range(near):
        load[k] = max(0.0, 1.0 / count + (arm[k] - mean) * slope) if elements[k] > 0.0 else 0.0
        terms[k] = load[k] * elements[k]
    weight = max(add(terms, near), 1e-9)
    for k in range(near):
        load[k] /= weight


@inlined
def _set_out(
    span: Footprint, model: Model, lean: Numbers, scratch: BrakingScratch, near: int
) -> None:
    """Write to `scratch` the current angles and unfinished turns of columns near the parcel.

    The first column is `span.first`, and `near` is the number of columns. The array `lean`
    (columns,) [rad] holds the current angle off 90 deg for each column of the zone.
    """
    for k in range(near):
        column = span.first + k
        inside = 0 <= column < model.columns
        start = lean[column] if inside else 0.0
        scratch.start[k] = start
        scratch.turned[k] = (scratch.target[column] if inside else 0.0) - start
        scratch.sine[k] = math.sin(start + scratch.turned[k])
        scratch.cosine[k] = math.cos(start + scratch.turned[k])


@linked
def predict(
    span: Footprint, model: Model, pitch: float, speed: float, frictions: Frictions, lean: Numbers,
    scratch: BrakingScratch,
) -> Result:  # fmt: skip
    """Predict the state after a control period in which axes turn to `scratch.target`.

    The prediction also covers `model.tail` steps after the period, in which slow axes turn to the
    angle `model.then`. `pitch` [m] is the distance between columns. `speed` [m/s] is the current
    speed along the line. `lean` (columns,) [rad] are the present angles between axes and 90 deg.
    """
    dt, steps = model.dt, model.steps
    longest = 2.0 * span.half_length + max(0.0, speed) * dt * (steps + model.tail)
    near = min(scratch.arm.shape[0], math.ceil(longest / pitch) + 2)
    _set_out(span, model, lean, scratch, near)
    x, v, braking, rolling, loss, turned = span.place, speed, 0.0, 0.0, 0.0, 0.0
    terms = scratch.terms
    for step in range(steps + model.tail):
        if step == steps:
            for k in range(near):
                inside = 0 <= span.first + k < model.columns
                scratch.start[k] += min(turned, max(-turned, scratch.turned[k]))
                scratch.turned[k] = (model.then if inside else 0.0) - scratch.start[k]
            turned = 0.0
        if model.tail > 0:
            turned += model.turn
            for k in range(near):
                leant = scratch.start[k] + min(turned, max(-turned, scratch.turned[k]))
                scratch.sine[k], scratch.cosine[k] = math.sin(leant), math.cos(leant)
        for k in range(near):
            centre = pitch * (span.first + k + 0.5)
            _bear(span, model, centre - (x + 0.5 * dt * v), scratch, k)
        _share_load(scratch, near, loss)
        for k in range(near):
            terms[k] = scratch.load[k] * scratch.rotors[k] * scratch.sine[k]
        brake = BRAKING * add(terms, near)
        for k in range(near):
            terms[k] = scratch.load[k] * scratch.rotors[k] * scratch.cosine[k]
        roll = ROLLING_LOSS * add(terms, near)
        for k in range(near):
            load = scratch.load[k]
            terms[k] = load * scratch.elements[k] - load * scratch.rotors[k]
        roll += SUPPORT_LOSS * add(terms, near)
        loss = frictions.braking * brake + frictions.rolling * roll
        slower = max(0.0, v - dt * loss)
        x += 0.5 * dt * (v + slower)
        v = slower
        if step < steps:
            braking += dt * brake
            rolling += dt * roll
    return Result(x, v, braking, rolling)


@inlined
def _choose_level(option: int, place: int, reached: int) -> int:
    """Return the level of a column for an option of braking.

    With option 0, all columns roll. With other options, some columns at the front or at the rear
    brake fully or half, and the others roll. `place` is the index of the column, counted from the
    column under the parcel's rear. In one period, the parcel is over at most `reached` columns.
    """
    if option == 0 or place < 0 or place >= reached:
        return base.ROLL
    parts = 2 * reached - 1
    part = (option - 1) % parts
    brakes = place >= part if part < reached else place <= part - reached
    if not brakes:
        return base.ROLL
    return base.HALF if option <= parts else base.FULL


@inlined
def _soften(level: int, lean: float, model: Model) -> int:
    """Return the level to which slow axes turn next, on the way to a wanted `level`.

    The axes are at `lean` [rad] off 90 deg now. On a direct turn between 90 and 0 deg, all axes
    would push to the same side. So half braking comes first: pushes at 45 and -45 deg cancel out.
    """
    half = base.LEANS[base.HALF]
    gently = model.then == 0.0  # axes return too slowly from full braking to rolling
    if level == base.FULL and (lean < half - 1e-6 or gently):
        return base.HALF
    return base.HALF if level == base.ROLL and lean > half + 1e-6 else level


@inlined
def _set_target(
    option: int, reached: int, span: Footprint, model: Model, lean: Numbers, levels: Integers,
    scratch: BrakingScratch,
) -> None:  # fmt: skip
    """Write `levels` (columns,) and target angles of the zone's columns for an option of braking.

    `lean` (columns,) [rad] holds the current angles off 90 deg. `option` and `reached` are as in
    `_choose_level`.
    """
    for column in range(model.columns):
        level = _choose_level(option, column - span.first, reached)
        if model.tail > 0:
            level = _soften(level, lean[column], model)
        levels[column] = level
        scratch.target[column] = base.LEANS[level]


class Deceleration(NamedTuple):
    """Expected deceleration [m/s^2] after the present control period."""

    held: float  # with half braking everywhere
    rolled: float  # with rolling everywhere


@inlined
def decelerate(share: float, frictions: Frictions) -> Deceleration:
    """Compute the decelerations of a parcel with half braking and with rolling.

    `share` [-] is the share of rotors among the elements under the parcel.
    """
    supports = SUPPORT_LOSS * (1.0 - share)
    rolled = frictions.rolling * (ROLLING_LOSS * share + supports)
    slope = ROLLING_LOSS * HALF_COSINE * share + supports
    held = frictions.braking * BRAKING * HALF_SINE * share + frictions.rolling * slope
    return Deceleration(held, rolled)


@inlined
def regret_speed(
    seen: LineReading, span: Footprint, frictions: Frictions, after: Result, rolls: bool
) -> float:
    """Compute the error [m/s] of the exit speed if an option leads to the state `after`.

    If `rolls` says that the option lets all columns roll, and there is still time to correct the
    speed later, the error is 0.
    """
    expected = decelerate(span.rotor_share, frictions)
    rolled = expected.rolled * (1.0 + CAUTION * frictions.doubt)
    to_go = max(0.0, (span.place + seen.rear_to_go) - after.place)
    asked = seen.ratio * seen.entry_speed
    if rolls:
        braked = 2.0 * SLOW_GENTLY * expected.held
        over = to_go - (after.speed * after.speed - asked * asked) / braked
        if over > TRIM_TIME * asked:
            return 0.0
    excess = after.speed - math.sqrt(asked * asked + 2.0 * rolled * to_go)
    return -SHORT * excess if excess < 0.0 else excess


@inlined
def regret_place(
    seen: LineReading, span: Footprint, frictions: Frictions, after: Result, _rolls: bool
) -> float:
    """Compute the error [m] of the final x if an option leads to the state `after`.

    After this state, the parcel is assumed to brake gently until it stands still.
    """
    held = STOP_GENTLY * decelerate(span.rotor_share, frictions).held
    asked = span.place + seen.to_go
    return abs(after.place + after.speed * after.speed / (2.0 * held) - asked)


class BrakingMemory(NamedTuple):
    """Memory of a braking rule."""

    lean: Numbers  # (num_envs, columns) [rad] of each column's axes off 90 deg
    estimate: Numbers  # (num_envs, 5) estimate of friction
    taken: Numbers  # (num_envs, 3) [m/s] speed, and its predicted losses by braking and rolling
    begins: Booleans  # (num_envs,) nothing is remembered yet


def _make_kernel(regret: Any) -> Any:
    def choose_braking(
        observations: Singles, sight: Sight, model: Model, choices: Integers, lean: Numbers,
        estimate: Numbers, taken: Numbers, begins: Booleans, levels: Integers,
        scratch: BrakingScratch, commands: Integers,
    ) -> None:  # fmt: skip
        """Write commands (num_envs, modules) for the option of braking with the least regret.

        `lean`, `estimate`, `taken` and `begins` are the arrays of a `BrakingMemory`. `choices`
        (levels, rows) are the orientations of a column's modules at each level. `levels` (columns,)
        is a scratch array.
        """
        for i in range(observations.shape[0]):
            seen = see_line(observations[i], sight)
            if not begins[i]:
                lost = taken[i, 0] - seen.vx
                update(estimate[i], lost, taken[i, 1], taken[i, 2], model.noise)
            begins[i] = False
            estimated = find_frictions(estimate[i])
            frictions = Frictions(
                estimated.braking * seen.friction, estimated.rolling, estimated.doubt
            )
            span = find_span(seen, sight, model, scratch)
            ahead = max(0.0, seen.vx) * model.period
            reached = math.ceil((2.0 * span.half_length + ahead) / sight.pitch_x) + 1
            reached = min(scratch.arm.shape[0], max(1, reached))
            best, least, braking, rolling = 0, math.inf, 0.0, 0.0
            for option in range(4 * reached - 1):
                _set_target(option, reached, span, model, lean[i], levels, scratch)
                after = predict(
                    span, model, sight.pitch_x, seen.vx, frictions, lean[i], scratch
                )  # fmt: skip
                off = regret(seen, span, frictions, after, option == 0)
                if off < least:
                    best, least = option, off
                    braking, rolling = seen.friction * after.braking, after.rolling
            _set_target(best, reached, span, model, lean[i], levels, scratch)
            taken[i, 0], taken[i, 1], taken[i, 2] = seen.vx, braking, rolling
            most = model.turn * model.steps
            for k in range(commands.shape[1]):
                commands[i, k] = choices[levels[k % model.columns], k // model.columns]
            for column in range(model.columns):
                to_turn = scratch.target[column] - lean[i, column]
                lean[i, column] += min(most, max(-most, to_turn))

    return compiled(choose_braking)


class BrakingRule(CompiledRule):
    """Rule that predicts the result of each option of braking, and takes the best option.

    The rule's memory holds the angle of each column's axes and an estimate of friction. The rule
    also uses the sensors' estimates of friction and load.
    """

    def __init__(self, config: EnvConfig, task: str, then: int) -> None:
        super().__init__(config, (task,), ("modules",))
        self._sight = look_at_line(config)
        self._model = make_model(config, base.LEANS[then])
        levels = np.arange(len(base.LEANS))[:, np.newaxis]
        self._choices = ColumnAxes(config)(levels).reshape(len(levels), self._model.rows)
        self._levels = np.zeros(self._model.columns, dtype=np.int64)
        self._scratch = make_scratch(self._model)

    def make_memory(self, num_envs: int) -> BrakingMemory:
        estimate = np.tile([1.0, 1.0, UNSURE**2, UNSURE**2, 0.0], (num_envs, 1))
        lean = np.zeros((num_envs, self._model.columns))
        begins = np.ones(num_envs, dtype=np.bool_)
        return BrakingMemory(lean, estimate, np.zeros((num_envs, 3)), begins)

    def arguments(
        self, observations: Observations, memory: Any, commands: Commands
    ) -> tuple[Any, ...]:
        return (
            observations, self._sight, self._model, self._choices, *memory, self._levels,
            self._scratch, commands,
        )  # fmt: skip


@rule("braking rule", "slow", actions="modules", observe=SHOWN)
class SlowingRule(BrakingRule):
    """Rule of Slow: roll, then brake. The speed must not fall below the goal speed.

    The rule brakes late, since slow motion costs time. The rule reserves some time at the goal
    speed for the last corrections.
    """

    kernel = staticmethod(_make_kernel(regret_speed))

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, "slow", base.ROLL)


@rule("braking rule", "stop", actions="modules", observe=SHOWN)
class StoppingRule(BrakingRule):
    """Rule of Stop: brake so that gentle braking afterwards would stop the parcel at the goal x.

    Gentle braking is weaker than half braking. So the rule can later brake less, or much more.
    """

    kernel = staticmethod(_make_kernel(regret_place))

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, "stop", base.HALF)
