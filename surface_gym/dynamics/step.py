"""One step of a parcel on a surface: what every caller of the physics calls."""

from surface_gym.dynamics.compiled import inlined, linked
from surface_gym.dynamics.contacts import find_contacts
from surface_gym.dynamics.explicit import explicit_acceleration
from surface_gym.dynamics.friction import implicit_velocity
from surface_gym.dynamics.normal_forces import dual_normal_forces
from surface_gym.dynamics.types import (
    AX,
    AY,
    OMEGA,
    THETA,
    VX,
    VY,
    Array,
    Body,
    Contacts,
    Grid,
    Scratch,
    X,
    Y,
)

# What a step reports. From OFF_SURFACE on, it left the state as it was.
BALANCED, TIPPING, OFF_SURFACE, UNBORNE, STOPPED = range(5)


@inlined
def load_point(grid: Grid, body: Body, state: Array) -> tuple[float, float]:
    """Where the load acts, from the centre of mass: b_eq of Eq. (1) over m g cos(gamma)."""
    per_weight = body.com_height / grid.gravity_normal
    return (grid.gravity_along - state[AX]) * per_weight, -state[AY] * per_weight


@inlined
def on_surface(grid: Grid, x: float, y: float) -> bool:
    """Whether a point is over the grid, half a pitch around its outer elements included."""
    rows, columns = grid.rotor.shape
    right = 0.5 * grid.pitch_x * columns
    up = 0.5 * grid.pitch_y * rows
    beyond_x = abs(x - grid.x0 + 0.5 * grid.pitch_x - right)
    beyond_y = abs(y - grid.y0 + 0.5 * grid.pitch_y - up)
    return beyond_x <= right and beyond_y <= up


@inlined
def find_support(grid: Grid, body: Body, state: Array, scratch: Scratch, lead: float) -> Contacts:
    """Contacts at the pose the parcel has `lead` seconds on; none if it is off the surface."""
    x = state[X] + lead * state[VX]
    y = state[Y] + lead * state[VY]
    if not on_surface(grid, x, y):
        return Contacts(0, 0)
    return find_contacts(grid, body, x, y, state[THETA] + lead * state[OMEGA], scratch)


@inlined
def why_unborne(grid: Grid, state: Array, lead: float) -> int:
    """What to report where `find_support` has found nothing: off the surface, or over it but on no
    element.
    """
    over = on_surface(grid, state[X] + lead * state[VX], state[Y] + lead * state[VY])
    return UNBORNE if over else OFF_SURFACE


@inlined
def bear_load(grid: Grid, body: Body, state: Array, scratch: Scratch, contacts: Contacts) -> bool:
    """Normal forces of the contacts in `scratch`; whether they are degenerate."""
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
    """Move the state over one step, contacts and normal forces given in `scratch`."""
    vx, vy, omega = implicit_velocity(
        grid, body.gyration, scratch, contacts, dt, state[VX], state[VY], state[OMEGA]
    )
    half = 0.5 * dt
    per_dt = 1.0 / dt
    state[X] += half * (state[VX] + vx)
    state[Y] += half * (state[VY] + vy)
    state[THETA] += half * (state[OMEGA] + omega)
    state[AX] = (vx - state[VX]) * per_dt
    state[AY] = (vy - state[VY]) * per_dt
    state[VX] = vx
    state[VY] = vy
    state[OMEGA] = omega


@inlined
def advance_explicit(
    grid: Grid, body: Body, state: Array, scratch: Scratch, contacts: Contacts, dt: float
) -> None:
    """The paper's two integrations of Eq. (4): the velocity, then the position with it."""
    ax, ay, aw, vx = explicit_acceleration(
        grid, body.gyration, scratch, contacts, state[VX], state[VY], state[OMEGA]
    )
    state[VX] = vx + dt * ax
    state[VY] += dt * ay
    state[OMEGA] += dt * aw
    state[X] += dt * state[VX]
    state[Y] += dt * state[VY]
    state[THETA] += dt * state[OMEGA]
    state[AX] = ax
    state[AY] = ay


@linked
def step_implicit(
    grid: Grid, body: Body, state: Array, scratch: Scratch, dt: float
) -> tuple[int, Contacts]:
    """One implicit step: its report and how many contacts bore it, which `scratch` holds.

    The contacts are those of the pose half a step on.
    """
    contacts = find_support(grid, body, state, scratch, 0.5 * dt)
    if contacts.total == 0:
        return why_unborne(grid, state, 0.5 * dt), contacts
    tipping = bear_load(grid, body, state, scratch, contacts)
    advance_implicit(grid, body, state, scratch, contacts, dt)
    return (TIPPING if tipping else BALANCED), contacts


@inlined
def step_explicit(
    grid: Grid, body: Body, state: Array, scratch: Scratch, dt: float
) -> tuple[int, Contacts]:
    """One step of the paper's loop, Figure 5a, its stopping rule included."""
    if state[VX] <= 0.0 and grid.gravity_along == 0.0:
        return STOPPED, Contacts(0, 0)
    contacts = find_support(grid, body, state, scratch, 0.0)
    if contacts.total == 0:
        return why_unborne(grid, state, 0.0), contacts
    tipping = bear_load(grid, body, state, scratch, contacts)
    advance_explicit(grid, body, state, scratch, contacts, dt)
    return (TIPPING if tipping else BALANCED), contacts
