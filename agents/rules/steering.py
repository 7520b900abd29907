"""Rules that predict the motion of a period: on a path, in a turn, and with driven modules.
An option gives an orientation to each module. A rule takes the option with the least regret, which
is the predicted error. A window is the block of modules around a parcel that Track's actions set.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.compiler.jit import compiled, inlined, linked
from surface_gym.config import EnvConfig
from surface_gym.modules import (
    Belt,
    ModuleKind,
    OmniModule,
    PopUp,
    SteeredRoller,
    surface_velocities,
)
from surface_gym.physics.types import GRAVITY
from surface_gym.tasks import base, track

from ..base import Integers, Numbers, Singles, find_axes
from .base import BaseRule, Commands, CompiledRule, Decision, Observations, rule
from .decoding import (
    LineReading,
    Motion,
    PathReading,
    Sight,
    add,
    find_directions,
    is_under,
    look_at_line,
    look_at_path,
    see_line,
    see_path,
)

STEPS = 4  # steps of the prediction per period
PARTS = 6  # parts into which modules are divided
# A lattice that spreads any share of modules evenly (powers of the inverse plastic number).
SPREAD = (0.7548776662466927, 0.5698402909980532)

# All weights were tuned on other starts than the reported ones.
# Parameters of the sliding mode; at this slope the error across the path dominates:
SLOPE = 60.0  # [1/s] slope of the surface: speed across the path per error across it
# [-] weight of the squared speed error relative to the squared distance to the surface
SPEED_WEIGHT = 24.0
TURN_WEIGHT = 1.5  # [-] weight of the squared turning speed at the base's edge
STRAIGHTENING = 4.0  # [1/s] turning speed towards theta = 0 per angle
# Parameters of the turning rule:
END_OF_TURN = 2.2  # [m rad/s^2] angular deceleration by 90 deg everywhere, times the half length
SPEED_WORTH = 0.11  # [rad s/m] cost of lost speed, as an angle error
DRIFT_WORTH = 0.3  # [rad s/m] cost of lateral speed, as an angle error
CLOSE_ENOUGH = 0.015  # [rad] smaller angle errors cost nothing (0.035 is allowed)
WORTH_IT = 0.004  # [rad] minimum advantage of turning over rolling
# [-] distances from the centre, relative to the half length, from which modules turn the parcel.
FROM = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
KINDS_OF_TURN = 6  # both directions, by the modules ahead, behind, or both


class Modules(NamedTuple):
    """The modules that an action sets, in scratch arrays (modules,)."""

    x: Numbers  # [m] from the parcel's centre
    y: Numbers  # [m]
    braking: Numbers  # [m/s^2] deceleration by the module
    arm: Numbers  # [m] lever arm of its axis about the centre
    soft: Numbers  # [m/s] speed below which it brakes less
    by_x: Numbers  # [m/s] loss of speed in a step
    by_y: Numbers  # [m/s]
    by_arm: Numbers  # [m^2/s]
    choice: Integers  # orientation of each


def make_modules(size: int) -> Modules:
    """Allocate the arrays for the `size` modules that an action sets."""
    numbers: list[Any] = [*np.zeros((8, size)), np.zeros(size, dtype=np.int64)]
    return Modules(*numbers)


@linked
def place_modules(seen: LineReading | PathReading, sight: Sight, scratch: Modules) -> None:
    """Write each module's position relative to the parcel's centre to `scratch`.

    Also write how much each module decelerates the parcel [m/s^2].
    """
    columns, under = sight.x.shape[0], 0
    for k in range(scratch.x.shape[0]):
        x, y = sight.x[k % columns] - seen.x, sight.y[k // columns] - seen.y
        scratch.x[k], scratch.y[k] = x, y
        is_there = is_under(seen, x, y)
        scratch.braking[k] = 1.0 if is_there else 0.0
        under += is_there
    for k in range(scratch.x.shape[0]):
        scratch.braking[k] = base.BRAKING * (scratch.braking[k] / max(1, under))


@linked
def predict(
    scratch: Modules, directions: Numbers, motion: Motion, half_length: float, pull: float,
    period: float,
) -> Motion:  # fmt: skip
    """Predict a parcel's motion after a period [s] in which modules have axes `scratch.choice`.

    The parcel is modelled as an evenly loaded square with a `half_length` [m], and moves at
    `motion` now. `directions` (choices, 2) are cosine and sine of each orientation. `pull` [m/s^2]
    is the acceleration along x by gravity.
    """
    dt = period / STEPS
    gyration = 2.0 / 3.0 * (half_length * half_length)  # [m^2] gyration of a square
    vx, vy, omega = motion
    count = scratch.x.shape[0]
    for k in range(count):
        cosine, sine = directions[scratch.choice[k], 0], directions[scratch.choice[k], 1]
        arm = scratch.x[k] * sine - scratch.y[k] * cosine
        scratch.arm[k] = arm
        # Friction is proportional up to the speed it removes in a step, so it does not overshoot.
        scratch.soft[k] = base.BRAKING * dt * (1.0 + arm * arm / gyration)
    for _ in range(STEPS):
        for k in range(count):
            cosine, sine = directions[scratch.choice[k], 0], directions[scratch.choice[k], 1]
            slip = vx * cosine + vy * sine + omega * scratch.arm[k]
            share = min(1.0, max(-1.0, slip / scratch.soft[k]))
            taken = dt * scratch.braking[k] * share
            scratch.by_x[k] = taken * cosine
            scratch.by_y[k] = taken * sine
            scratch.by_arm[k] = taken * scratch.arm[k]
        vx = vx + dt * pull - add(scratch.by_x, count)
        vy = vy - add(scratch.by_y, count)
        omega = omega - add(scratch.by_arm, count) / gyration
    return Motion(vx, vy, omega)


def mixes(parts: int) -> Commands:
    """List all ways (mixes, 3) to divide `parts` into rolling, leading and braking parts."""
    side, brake = np.indices((parts + 1, parts + 1)).reshape(2, -1)
    whole = side + brake <= parts
    return np.stack([parts - side - brake, side, brake], axis=-1)[whole]


def leading_options(config: EnvConfig) -> Commands:
    """List options (options, modules). In an option, modules roll, lead aside or brake.

    An option combines shares of rolling, leading and braking modules (see `mixes`), a side to lead
    to, and one of two ways to spread these modules over the window.
    """
    axes = find_axes(config)
    rows, columns = config.action_kind.shape
    row, column = np.indices((rows, columns))
    order = np.modf(SPREAD[0] * row + SPREAD[1] * column)[0]
    spreads = np.stack([order.ravel(), order[::-1].ravel()])  # with its mirror image
    rolls, leads, _ = mixes(PARTS).T / PARTS
    first = rolls[:, np.newaxis, np.newaxis] > spreads + 1e-9
    second = (rolls + leads)[:, np.newaxis, np.newaxis] > spreads + 1e-9
    options = [
        np.select([first, second], [axes.roll, side], axes.brake).reshape(-1, rows * columns)
        for side in (axes.left, axes.right)
    ]
    return np.unique(np.concatenate(options), axis=0)


@inlined
def _slide_regret(path: PathReading, after: Motion, period: float) -> float:
    """Return the regret [m^2/s^2] of an option that leads to the motion `after` in a period [s].

    The regret is the weighted sum of three squared errors. The first is the error of the speed
    across the path; the control law of `SlidingMode` sets this speed. The second is the error of
    the speed along the path. The third is half the parcel's length times the turning speed's error.
    """
    # The path's heading at the predicted position.
    ahead = min(1.0, max(0.0, path.vx * period / track.AHEAD[1]))
    slope = path.slope + ahead * (path.slope_ahead - path.slope)
    cosine = 1.0 / math.sqrt(1.0 + slope * slope)
    sine = slope * cosine
    along = cosine * after.vx + sine * after.vy
    across = cosine * after.vy - sine * after.vx
    mean = 0.5 * (path.cross_speed + across)
    off = across + SLOPE * (path.cross_error + period * mean)
    late = along - path.asked_speed
    turn = after.omega + STRAIGHTENING * (path.theta + period * after.omega)
    edge = path.half_length * turn
    return off * off + SPEED_WEIGHT * (late * late) + TURN_WEIGHT * (edge * edge)


@compiled
def slide(
    observations: Singles, sight: Sight, directions: Numbers, options: Integers, period: float,
    scratch: Modules, commands: Integers,
) -> None:  # fmt: skip
    """Write commands (num_envs, modules) of sliding-mode control on Track's path.

    The commands are the option with the least regret at the end of the next `period` [s]. The array
    `options` has shape (options, modules). `directions` (choices, 2) has the cosine and the sine of
    each orientation.
    """
    for i in range(observations.shape[0]):
        path = see_path(observations[i], sight)
        place_modules(path, sight, scratch)
        motion, pull = Motion(path.vx, path.vy, path.omega), GRAVITY * math.sin(path.tilt)
        best, least = 0, math.inf
        for option in range(options.shape[0]):
            for k in range(options.shape[1]):
                scratch.choice[k] = options[option, k]
            after = predict(scratch, directions, motion, path.half_length, pull, period)
            regret = _slide_regret(path, after, period)
            if regret < least:
                best, least = option, regret
        for k in range(options.shape[1]):
            commands[i, k] = options[best, k]


@rule("sliding mode", "track", actions="window")
class SlidingMode(CompiledRule):
    """Rule of Track: sliding-mode control. The wanted speed across the path is -SLOPE times the
    distance from the path.

    An option is a mix of rolling, leading and braking axes. In every period, the rule takes the
    option whose predicted motion comes closest to three goals. These goals are the wanted speed
    across the path, the goal speed along the path, and theta 0. Headings other than 0 and 45 deg
    need a mix, since no orientation rolls in these directions.
    """

    kernel = staticmethod(slide)

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, ("track",), ("window",))
        self._sight = look_at_path(config)
        self._options = leading_options(config)
        self._directions = find_directions(config)
        self._scratch = make_modules(self._kind.size)

    def arguments(self, observations: Observations, _: Any, commands: Commands) -> tuple[Any, ...]:
        return (
            observations, self._sight, self._directions, self._options,
            self._config.control_period, self._scratch, commands,
        )  # fmt: skip


@inlined
def choose_turn(option: int, seen: LineReading, axes: Integers, scratch: Modules) -> None:
    """Write the modules' orientations `scratch.choice` for an option of turning.

    If `option` is 0 or the parcel is not wholly in the zone, all modules roll. Otherwise modules
    turn the parcel. These modules are under the parcel's front, under its rear, or under both ends.
    `axes` (4,) has the orientations for rolling, braking, leading left and leading right.
    """
    start = FROM[(option - 1) % FROM.shape[0]] * seen.half_length
    roll, _, left, right = axes
    # Both ends, the front, the rear; then the same in the other direction.
    kind = (option - 1) // FROM.shape[0]
    front, rear = (left, right) if kind < 3 else (right, left)
    for k in range(scratch.x.shape[0]):
        scratch.choice[k] = roll
        if option == 0 or not seen.wholly_in_zone:
            continue
        if scratch.x[k] > start and kind % 3 != 2:
            scratch.choice[k] = front
        elif scratch.x[k] < -start and kind % 3 != 1:
            scratch.choice[k] = rear


@inlined
def _turn_regret(seen: LineReading, after: Motion, period: float) -> float:
    """Compute the regret [rad] of an option that leads to the motion `after` in a period [s].

    The regret is the angle error after the turn has ended, plus the costs of lost speed and drift.
    """
    turn = 0.5 * period * (seen.omega + after.omega)
    end = after.omega * abs(after.omega) * seen.half_length
    remaining = (seen.angle - seen.theta) - turn - end / (2.0 * END_OF_TURN)
    off = max(0.0, abs(remaining) - CLOSE_ENOUGH)
    return off - SPEED_WORTH * after.vx + DRIFT_WORTH * abs(after.vy)


@compiled
def turn(
    observations: Singles, sight: Sight, directions: Numbers, axes: Integers, period: float,
    scratch: Modules, commands: Integers,
) -> None:  # fmt: skip
    """Write the commands (num_envs, modules) with the least predicted error of the parcel's turn.

    `axes` are as in `choose_turn`, and the other arguments are as in `slide`.
    """
    options = 1 + KINDS_OF_TURN * FROM.shape[0]
    for i in range(observations.shape[0]):
        seen = see_line(observations[i], sight)
        place_modules(seen, sight, scratch)
        motion = Motion(seen.vx, seen.vy, seen.omega)
        best, least = 0, math.inf
        for option in range(options):
            choose_turn(option, seen, axes, scratch)
            after = predict(scratch, directions, motion, seen.half_length, 0.0, period)
            regret = _turn_regret(seen, after, period)
            if option == 0:
                regret -= WORTH_IT
            if regret < least:
                best, least = option, regret
        choose_turn(best, seen, axes, scratch)
        for k in range(commands.shape[1]):
            commands[i, k] = scratch.choice[k]


@rule("turning rule", "orient", actions="modules")
class TurningRule(CompiledRule):
    """Rule of Orient: turn the parcel by axes with opposite signs ahead of and behind the centre.

    In one option, axes are at 45 deg ahead and at -45 deg behind. In another option, the signs are
    reversed. Axes at 90 deg end the turn. In every period, the rule predicts final angle, lost
    speed and drift for each option, and takes the best option.
    """

    kernel = staticmethod(turn)

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, ("orient",), ("modules",))
        self._sight = look_at_line(config)
        self._directions = find_directions(config)
        self._scratch = make_modules(self._kind.size)

    def arguments(self, observations: Observations, _: Any, commands: Commands) -> tuple[Any, ...]:
        return (
            observations, self._sight, self._directions, self._axes,
            self._config.control_period, self._scratch, commands,
        )  # fmt: skip


# A rule for driven modules: the choices whose friction brings a parcel nearest to a wanted motion.
# Each task asks for a velocity of the parcel. The rule predicts one period of Coulomb friction for
# every choice of the modules ahead of the parcel's centre and behind it, and takes the best pair.
MOST_PAIRS = 3000  # pairs of choices to predict; with more, both halves do the same
STOPPING = 0.8  # [-] share of full braking on which the wanted speed near a place is based
CREEP = 4.0  # [1/s] wanted speed per distance from a place, if that is slower
AHEAD = 0.02  # [s] time until a choice acts
NEAR_ENOUGH = 0.001  # [m] distance from a place at which a parcel should rest
BRISK = 1.0  # [m/s] least speed on the way to a zone's end
TO_MIDDLE = 2.0  # [1/s] wanted lateral speed per offset
TO_PATH = 8.0  # [1/s] wanted speed across a path per distance from it
TURN_RATE = 6.0  # [1/s] wanted turning speed per angle
FASTEST_TURN = 1.5  # [rad/s] maximum wanted turning speed
ONWARD = 0.8  # [m/s] wanted speed of a parcel that turns


@dataclass(frozen=True)
class Target:
    """Target motion of parcels, in arrays (num_envs,)."""

    vx: Numbers  # [m/s]
    vy: Numbers  # [m/s]
    omega: Numbers  # [rad/s]
    turn_weight: float  # [-] weight of the turning speed at half the base's length


Make = Callable[..., ModuleKind]


def towards(distance: Numbers) -> Numbers:
    """Return the signed speed [m/s] from which a parcel stops after a signed distance [m]."""
    far = np.abs(distance)
    speed = np.minimum(np.sqrt(2.0 * STOPPING * base.BRAKING * far), CREEP * far)
    return np.sign(distance) * speed


def _turn_at(angle: Numbers) -> Numbers:
    return np.clip(TURN_RATE * angle, -FASTEST_TURN, FASTEST_TURN)


def aim_aside(seen: Any) -> Target:
    """Return the target motion in Sort. The target is the highest speed to the goal's side."""
    still = np.zeros(len(seen.side))
    return Target(seen.vx * (seen.side != 0.0) + (seen.side == 0.0), seen.side * 10.0, still, 0.0)


def aim_at_ratio(seen: Any) -> Target:
    """Return the target motion in Slow: the goal speed at the zone's end.

    Until the parcel must brake, the target is `BRISK` or the goal speed, whichever is higher.
    """
    # From the last column on, the parcel rolls for half a pitch.
    rolled = 2.0 * base.ROLLING_LOSS * 0.5 * seen.pitch[0]
    asked = np.sqrt((seen.ratio * seen.entry_speed) ** 2 + rolled)
    left = np.maximum(0.0, seen.to_end - 2.0 * seen.half_length)  # of the front
    most = np.sqrt(asked**2 + 2.0 * STOPPING * base.BRAKING * left)
    still = np.zeros(len(asked))
    return Target(np.minimum(most, np.maximum(asked, BRISK)), still, still, 0.01)


def aim_at_place(seen: Any) -> Target:
    """Return the target motion in Stop. At the target speed, the parcel can stop at the goal x."""
    still = np.zeros(len(seen.to_go))
    left = seen.to_go - AHEAD * seen.vx
    return Target(towards(left) * (np.abs(seen.to_go) > NEAR_ENOUGH), still, still, 0.01)


def aim_at_angle(seen: Any) -> Target:
    """Return Orient's target motion: forward, to the line's middle, and to the goal angle."""
    onward = np.full(len(seen.theta), ONWARD)
    return Target(onward, -TO_MIDDLE * seen.offset, _turn_at(seen.angle - seen.theta), 3.0)


def aim_along_path(seen: Any) -> Target:
    """Return the target motion in Track, a motion along the path at the goal speed."""
    slope = seen.slope[:, 0]
    cosine = 1.0 / np.sqrt(1.0 + slope * slope)
    along, across = seen.asked_speed, -TO_PATH * seen.cross_error
    return Target(
        (along - slope * across) * cosine, (slope * along + across) * cosine,
        _turn_at(-seen.theta), 0.1,
    )  # fmt: skip


@dataclass(frozen=True)
class Aim:
    """The target motion of a task, and the kinds of driven modules compared on this task."""

    target: Callable[[Any], Target]  # from the decoded observations of the task
    kinds: dict[str, Make]  # function by name that makes the modules from an acceleration
    alike: bool = False  # whether both halves do the same


def _of_speeds(kind: Make, *speeds: float, **more: Any) -> Make:
    return partial(kind, speeds=speeds, **more)


FINE = (0.0, *(0.01 * k for k in range(1, 61)), *(0.02 * k for k in range(31, 136)))  # [m/s]
SPEEDS = tuple(round(0.1 * k, 1) for k in range(1, 16))  # [m/s] speeds of modules along a path
HEADINGS = tuple(math.radians(15.0 * k) for k in range(-6, 7))  # [rad] along a path
CREEPING = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 2.0)  # [m/s] to bring a parcel to a place
TURNING = (0.0, 0.5, 1.0)  # [m/s] to turn a parcel
SIDEWAYS = (1.0, 2.0, 3.0)  # [m/s] to sort a parcel
BELTS, POP_UP, STEERED, OMNI = "belts", "pop-up", "steered rollers", "omni-wheels"
AIMS: dict[str, Aim] = {
    "sort": Aim(
        aim_aside,
        {
            POP_UP: _of_speeds(PopUp, 2.0),
            STEERED: _of_speeds(SteeredRoller, *SIDEWAYS),
            OMNI: _of_speeds(OmniModule, *SIDEWAYS),
        },
    ),
    "slow": Aim(
        aim_at_ratio,
        {BELTS: _of_speeds(Belt, *FINE, headings=(0.0,), idle_outside=True)},
        alike=True,
    ),
    "stop": Aim(
        aim_at_place,
        {
            BELTS: _of_speeds(Belt, *CREEPING),
            STEERED: _of_speeds(SteeredRoller, *CREEPING, headings=(0.0, math.pi)),
            OMNI: _of_speeds(OmniModule, *CREEPING),
        },
        alike=True,
    ),
    "track": Aim(
        aim_along_path,
        {
            STEERED: _of_speeds(SteeredRoller, *SPEEDS, headings=HEADINGS),
            OMNI: _of_speeds(OmniModule, *SPEEDS, headings=HEADINGS),
        },
        alike=True,
    ),
    "orient": Aim(
        aim_at_angle,
        {
            STEERED: _of_speeds(SteeredRoller, *TURNING),
            OMNI: _of_speeds(OmniModule, *TURNING),
        },
    ),
}


class AimRule(BaseRule):
    """Rule that chooses modes of driven modules, to bring a parcel closest to a target motion.

    The rule chooses a mode for the modules ahead of the parcel's centre, and a mode for the others.
    `config` must have actions "halves" and driven modules.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, tuple(AIMS), ("halves",))
        checks.one_of("modules", config.module_kind.drives, (True,))
        self._aim = AIMS[config.task_name]
        velocity = surface_velocities(config.modes[:-1])
        pairs = list(product(range(len(velocity)), repeat=2))
        if self._aim.alike or len(pairs) > MOST_PAIRS:
            pairs = [(k, k) for k in range(len(velocity))]
        self._pairs: Integers = np.array(pairs)
        self._velocity = velocity[self._pairs]  # (pairs, 2, 2) [m/s] ahead and behind
        self._period = config.control_period

    def _decide(self, observations: Observations, *_: Any) -> Decision:
        seen = self._config.decode(observations)
        motion = np.stack([*seen.velocity, seen.omega])
        cost = self._costs(motion, self._aim.target(seen), np.asarray(seen.half_length))
        return self._pairs[cost.argmin(axis=1)], None

    def _costs(self, motion: Numbers, wanted: Target, half_length: Numbers) -> Numbers:
        """Predict by how much the motion after a period deviates from the motion `wanted`.

        Return squared deviations (num_envs, pairs). A pair is a mode ahead of the centre and a mode
        behind the centre. `motion` (3, num_envs) [m/s, m/s, rad/s] is the velocity now.
        `half_length` has the shape (num_envs,) and the unit [m].
        """
        vx, vy, omega = (each[:, np.newaxis] for each in motion)
        arm = 0.5 * half_length[:, np.newaxis]
        gyration = 2.0 / 3.0 * half_length[:, np.newaxis] ** 2  # [m^2] of a square
        change_x, change_y, turn = 0.0, 0.0, 0.0
        for half, lever in enumerate((arm, -arm)):
            slip_x = self._velocity[:, half, 0] - vx
            slip_y = self._velocity[:, half, 1] - vy - lever * omega
            slip = np.maximum(np.hypot(slip_x, slip_y), 1e-9)
            # Friction removes the slip at most; each half carries half of the parcel.
            share = 0.5 * np.minimum(1.0, base.BRAKING * self._period / slip)
            change_x = change_x + share * slip_x
            change_y = change_y + share * slip_y
            turn = turn + lever * share * slip_y / gyration
        off = (vx + change_x - wanted.vx[:, np.newaxis]) ** 2
        off = off + (vy + change_y - wanted.vy[:, np.newaxis]) ** 2
        edge = half_length[:, np.newaxis] * (omega + turn - wanted.omega[:, np.newaxis])
        return np.asarray(off + wanted.turn_weight * edge**2)
