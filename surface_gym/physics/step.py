"""One step of one parcel: normal forces, friction, motion."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from surface_gym.compiler.jit import compiled, inlined
from surface_gym.physics import types as ph
from surface_gym.physics.contacts import find_contacts
from surface_gym.physics.friction import implicit_velocity
from surface_gym.physics.normal_forces import dual_normal_forces
from surface_gym.physics.types import Array, Body, Contacts, Grid, Scratch

EIGHTH = 0.25 * math.pi  # [rad] 45 deg
HALF_ROOT = math.sqrt(0.5)
ROUND_OFF = 1e-15  # [-] relative round-off of a multiple of 45 deg in float64


@inlined
def axis_direction(angle: float) -> tuple[float, float]:
    """Return cosine and sine of an axis angle [rad], without error at multiples of 45 deg.

    math.cos(pi / 2) is 6e-17. With this value, a rotor across the motion would drag the parcel
    sideways.
    """
    eighths = math.floor(angle / EIGHTH + 0.5)
    if abs(angle - eighths * EIGHTH) > ROUND_OFF * abs(angle):
        return math.cos(angle), math.sin(angle)
    octant = eighths % 8.0
    cosine = sine = HALF_ROOT
    if octant % 2.0 == 0.0:
        cosine = (octant == 0.0) * 1.0 - (octant == 4.0) * 1.0
        sine = (octant == 2.0) * 1.0 - (octant == 6.0) * 1.0
        return cosine, sine
    if 2.0 < octant < 6.0:
        cosine = -cosine
    if octant > 4.0:
        sine = -sine
    return cosine, sine


@compiled
def _write_directions(angles: Array, directions: Array) -> None:
    for i in range(angles.shape[0]):
        directions[i, 0], directions[i, 1] = axis_direction(angles[i])


def axis_directions(angles: Array) -> Array:
    """Return cosine and sine (angles, 2) of axis angles (angles,) [rad]."""
    directions = np.empty((len(angles), 2))
    _write_directions(np.array(angles, dtype=np.float64), directions)
    return directions


def map_floats(function: Callable[[float], float], values: Any) -> Any:
    """Apply a function of Python's math module to a number, or to each number of an array (count,).

    NumPy's functions differ in the last digit between machines.
    """
    if np.ndim(values) == 0:
        return function(values)
    return np.array([function(value) for value in values.tolist()])


def split_gravity(tilt: Any, direction: Any = 0.0) -> tuple[Any, Any, Any]:
    """Return gravity [m/s^2] along x, along y and normal to a tilted surface.

    Args:
        tilt: [rad] one number, or (count,).
        direction: [rad] downhill direction, anti-clockwise from +x: one number, or (count,).
    """
    downhill = ph.GRAVITY * map_floats(math.sin, tilt)
    directions = axis_directions(np.atleast_1d(direction))
    cosine, sine = directions.T if np.ndim(direction) else directions[0].tolist()
    return downhill * cosine, downhill * sine, ph.GRAVITY * map_floats(math.cos, tilt)


def tilt_of_gravity(x: float, y: float, normal: float) -> tuple[float, float]:
    """Return a surface's tilt and downhill direction [rad]. `split_gravity` is the inverse.

    `x`, `y` and `normal` are gravity [m/s^2] along x, along y and normal to the surface.
    """
    if y == 0.0:
        return math.atan2(x, normal), 0.0
    return math.atan2(math.hypot(x, y), normal), math.atan2(y, x)


def com_states(centre: Array, pose: Array, velocity: Array) -> Array:
    """Return states (count, STATE_SIZE) of centres of mass. The acceleration in a state is 0.

    Args:
        centre: (count, 2) [m] centre of mass in the base's frame.
        pose: (count, 3) [m, m, rad] of the frame.
        velocity: (count, 3) [m/s, m/s, rad/s] of the frame.
    """
    state = np.zeros((len(pose), ph.STATE_SIZE))
    state[:, ph.X : ph.THETA + 1] = pose
    state[:, ph.VX : ph.OMEGA + 1] = velocity
    if centre.any():
        cosine, sine = map_floats(math.cos, pose[:, 2]), map_floats(math.sin, pose[:, 2])
        arm_x = cosine * centre[:, 0] - sine * centre[:, 1]
        arm_y = sine * centre[:, 0] + cosine * centre[:, 1]
        state[:, ph.X] += arm_x
        state[:, ph.Y] += arm_y
        state[:, ph.VX] -= velocity[:, 2] * arm_y
        state[:, ph.VY] += velocity[:, 2] * arm_x
    return state


STEEPNESS = 5000.0  # [s/m] k of Eq. (2), Section 6.1
RESTART_SPEED = 1e-4  # [m/s] speed given to a parcel that stands or reverses, Figure 5b


@inlined
def _sign(value: float) -> float:
    return (value > 0.0) * 1.0 - (value < 0.0) * 1.0


@inlined
def held_share(along_x: float, other_x: float) -> float:
    """Return which share of the forces along the axes is enough to hold a parcel at rest.

    The share solves sum F_x + m g sin(gamma) = 0. The result is limited to [0, 1], because friction
    along an axis cannot push and cannot exceed sliding friction.

    Args:
        along_x: [m/s^2] x component of the forces along the axes, divided by the mass.
        other_x: [m/s^2] x component of all other forces, including gravity.
    """
    return min(1.0, max(0.0, -other_x / along_x)) if along_x < 0.0 else 0.0


@inlined
def is_driven(grid: Grid) -> bool:
    """Return whether a surface has driven modules, to which the paper's rules do not apply."""
    driven = False
    for axis in range(grid.drive.shape[0]):
        driven |= grid.drive[axis, 2] > 0.0
    return driven


@inlined
def explicit_acceleration(
    grid: Grid,
    gyration: float,
    scratch: Scratch,
    contacts: Contacts,
    vx: float,
    vy: float,
    omega: float,
) -> tuple[float, float, float, float]:
    """Return the acceleration (x, y, theta) at a velocity (vx, vy, omega) by Eq. (2)-(4).

    If `vx` <= 0 and no module is driven, the rule of the paper's Figure 5b applies. The rule sets
    `vx` to `RESTART_SPEED`, or to 0 if friction holds the parcel. `gyration` [m^2] is inertia /
    mass.

    Returns:
        The acceleration, and `vx` after the rule.
    """
    standing = vx <= 0.0 and not is_driven(grid)
    if standing:
        vx = RESTART_SPEED
    # The forces along the axes, which the rule may scale, and all others, per unit mass.
    along_x = along_y = along_w = 0.0
    other_x = other_y = other_w = 0.0
    table = scratch.table
    for i in range(contacts.total):
        x = table[ph.ARM_X + i]
        y = table[ph.ARM_Y + i]
        ax = table[ph.AXIS_X + i]
        ay = table[ph.AXIS_Y + i]
        wx = ax * table[ph.DRIVE_ALONG + i] - ay * table[ph.DRIVE_ACROSS + i]
        wy = ay * table[ph.DRIVE_ALONG + i] + ax * table[ph.DRIVE_ACROSS + i]
        ux = vx - omega * y - wx
        uy = vy + omega * x - wy
        speed = math.sqrt(ux * ux + uy * uy)
        smooth = table[ph.NORMAL + i] * math.tanh(STEEPNESS * speed)
        if scratch.marks[ph.KIND + i] == ph.ROTOR:
            # cos(alpha) = a . V / |V|, and sin(alpha).
            f_par = table[ph.MU_ALONG + i] * smooth * _sign(ax * ux + ay * uy)
            f_perp = table[ph.MU_ACROSS + i] * smooth * _sign(ay * ux - ax * uy)
            along_x -= f_par * ax
            along_y -= f_par * ay
            along_w -= f_par * (x * ay - y * ax)
            fx = -f_perp * ay
            fy = f_perp * ax
        else:
            share = table[ph.MU_ALONG + i] * smooth / speed if speed > 0.0 else 0.0
            fx = -share * ux
            fy = -share * uy
        other_x += fx
        other_y += fy
        other_w += x * fy - y * fx
    other_x += grid.gravity_x
    other_y += grid.gravity_y
    if standing and along_x + other_x <= 0.0:
        scale = held_share(along_x, other_x)
        return 0.0, scale * along_y + other_y, (scale * along_w + other_w) / gyration, 0.0
    return along_x + other_x, along_y + other_y, (along_w + other_w) / gyration, vx


# Reports of a step. From OFF_SURFACE on, the state does not change.
BALANCED, TIPPING, OFF_SURFACE, UNSUPPORTED, STOPPED = range(5)


@inlined
def load_point(grid: Grid, body: Body, state: Array) -> tuple[float, float]:
    """Return where the load acts [m], relative to the centre of mass: b_eq / (m g cos(gamma))."""
    per_weight = body.com_height / grid.gravity_normal
    load_x = (grid.gravity_x - state[ph.AX]) * per_weight
    load_y = (grid.gravity_y - state[ph.AY]) * per_weight
    return load_x, load_y


@inlined
def on_surface(grid: Grid, x: float, y: float) -> bool:
    """Return whether (x, y) [m] is at most half a pitch beyond the grid's outer elements."""
    rows, columns = grid.rotor.shape
    right = 0.5 * grid.pitch_x * columns
    up = 0.5 * grid.pitch_y * rows
    beyond_x = abs(x - grid.x0 + 0.5 * grid.pitch_x - right)
    beyond_y = abs(y - grid.y0 + 0.5 * grid.pitch_y - up)
    return beyond_x <= right and beyond_y <= up


@inlined
def find_support(grid: Grid, body: Body, state: Array, scratch: Scratch, lead: float) -> Contacts:
    """Find the contacts after `lead` [s] at constant velocity. Off the surface, there are none."""
    x = state[ph.X] + lead * state[ph.VX]
    y = state[ph.Y] + lead * state[ph.VY]
    if not on_surface(grid, x, y):
        return Contacts(0, 0, 0)
    return find_contacts(grid, body, x, y, state[ph.THETA] + lead * state[ph.OMEGA], scratch)


@inlined
def explain_unsupported(grid: Grid, state: Array, lead: float) -> int:
    """Return the report of a parcel without contacts: off the surface, or on no element.

    `lead` [s] is the time from the state to the pose without contacts.
    """
    over = on_surface(grid, state[ph.X] + lead * state[ph.VX], state[ph.Y] + lead * state[ph.VY])
    return UNSUPPORTED if over else OFF_SURFACE


@inlined
def support_load(
    grid: Grid, body: Body, state: Array, scratch: Scratch, contacts: Contacts
) -> bool:
    """Write normal forces to `scratch`. Return whether the contacts are degenerate."""
    load_x, load_y = load_point(grid, body, state)
    return dual_normal_forces(
        scratch,
        contacts.total,
        grid.gravity_normal,
        load_x,
        load_y,
        max(grid.pitch_x, grid.pitch_y),
    )


@inlined
def advance_implicit(
    grid: Grid, body: Body, state: Array, scratch: Scratch, contacts: Contacts, dt: float
) -> None:
    """Move the state by one step. `scratch` holds the normal forces of the contacts."""
    vx, vy, omega = implicit_velocity(
        grid, body.gyration, scratch, contacts, dt, state[ph.VX], state[ph.VY], state[ph.OMEGA]
    )
    half = 0.5 * dt
    per_dt = 1.0 / dt
    state[ph.X] += half * (state[ph.VX] + vx)
    state[ph.Y] += half * (state[ph.VY] + vy)
    state[ph.THETA] += half * (state[ph.OMEGA] + omega)
    state[ph.AX] = (vx - state[ph.VX]) * per_dt
    state[ph.AY] = (vy - state[ph.VY]) * per_dt
    state[ph.VX] = vx
    state[ph.VY] = vy
    state[ph.OMEGA] = omega


@inlined
def advance_explicit(
    grid: Grid, body: Body, state: Array, scratch: Scratch, contacts: Contacts, dt: float
) -> None:
    """Integrate Eq. (4) twice as in the paper: update the velocity, then move at this velocity."""
    ax, ay, aw, vx = explicit_acceleration(
        grid, body.gyration, scratch, contacts, state[ph.VX], state[ph.VY], state[ph.OMEGA]
    )
    state[ph.VX] = vx + dt * ax
    state[ph.VY] += dt * ay
    state[ph.OMEGA] += dt * aw
    state[ph.X] += dt * state[ph.VX]
    state[ph.Y] += dt * state[ph.VY]
    state[ph.THETA] += dt * state[ph.OMEGA]
    state[ph.AX] = ax
    state[ph.AY] = ay


@inlined
def step_implicit(
    grid: Grid, body: Body, state: Array, scratch: Scratch, dt: float
) -> tuple[int, Contacts]:
    """Do one implicit step. Return a code (`BALANCED`, ...) and the step's contacts in `scratch`.

    Contacts are found at the pose after half the step.
    """
    contacts = find_support(grid, body, state, scratch, 0.5 * dt)
    if contacts.total == 0:
        return explain_unsupported(grid, state, 0.5 * dt), contacts
    tipping = support_load(grid, body, state, scratch, contacts)
    advance_implicit(grid, body, state, scratch, contacts, dt)
    return (TIPPING if tipping else BALANCED), contacts


@inlined
def step_explicit(
    grid: Grid, body: Body, state: Array, scratch: Scratch, dt: float
) -> tuple[int, Contacts]:
    """Do one step of the paper's loop (Figure 5a), including its stopping rule."""
    if state[ph.VX] <= 0.0 and grid.gravity_x == 0.0 and not is_driven(grid):
        return STOPPED, Contacts(0, 0, 0)
    contacts = find_support(grid, body, state, scratch, 0.0)
    if contacts.total == 0:
        return explain_unsupported(grid, state, 0.0), contacts
    tipping = support_load(grid, body, state, scratch, contacts)
    advance_explicit(grid, body, state, scratch, contacts, dt)
    return (TIPPING if tipping else BALANCED), contacts
