"""The friction law: anisotropic Coulomb friction as a convex potential, and an implicit step.

The paper's forces, Eq. (2)-(3), are minus the gradient of
    Phi(v) = sum over rotors N_i (mu_max |a_i . u_i| + mu_min |p_i . u_i|)
           + sum over supports N_j mu_support |u_j| + sum over driven modules N_k mu_max |u_k|
with N the normal force of a contact, u its slip (the base's velocity relative to the element's
surface), a the axis and p the axis' normal. Only driven modules have moving surfaces. A step is the
convex problem
    v+ = argmin 1/2 |v - (v0 + dt g)|_M^2 + dt Phi(v)
in three unknowns. A parcel that friction holds does not chatter: it stays at rest, or moves with
the surfaces below.

Each loop below either treats every contact independently, or sums in the order of the contacts. The
compiler vectorises loops of the first kind only, so no sum depends on the vector width.
"""

import math

from surface_gym.compiler.jit import inlined
from surface_gym.physics import types as ph
from surface_gym.physics.types import Array, Contacts, Grid, Scratch

MAX_SEARCHES = 60
SEARCH_SLOPE = 0.01  # [-] remaining share of the starting slope at which a line search ends


@inlined
def _prepare(
    scratch: Scratch,
    contacts: Contacts,
    vx: float,
    vy: float,
    omega: float,
    dx: float,
    dy: float,
    dw: float,
    rounding: float,
) -> None:
    """Write each contact's slip, the slip's change along the search, and the contact's kinks.

    The search starts at the velocity (vx, vy, omega) and goes along (dx, dy, dw). Friction holds a
    contact if the contact's slip is at most `rounding` [m/s]. A kink is a step length at which
    friction begins or ceases to hold the contact.
    """
    table = scratch.table
    for i in range(contacts.total):
        x = table[ph.ARM_X + i]
        y = table[ph.ARM_Y + i]
        ax = table[ph.AXIS_X + i]
        ay = table[ph.AXIS_Y + i]
        ux = vx - omega * y
        uy = vy + omega * x
        sx = dx - dw * y
        sy = dy + dw * x
        along = ax * ux + ay * uy - table[ph.DRIVE_ALONG + i]
        along_rate = ax * sx + ay * sy
        across = ax * uy - ay * ux - table[ph.DRIVE_ACROSS + i]
        across_rate = ax * sy - ay * sx
        table[ph.SLIDE_ALONG + i] = along
        table[ph.RATE_ALONG + i] = along_rate
        table[ph.SLIDE_ACROSS + i] = across
        table[ph.RATE_ACROSS + i] = across_rate
        # At a rate of 0 these are infinite or NaN, so they lie in no bracket.
        table[ph.KINK_1 + i] = (-rounding - along) / along_rate
        table[ph.KINK_2 + i] = (rounding - along) / along_rate
        table[ph.KINK_3 + i] = (-rounding - across) / across_rate
        table[ph.KINK_4 + i] = (rounding - across) / across_rate


@inlined
def _slope(scratch: Scratch, contacts: Contacts, t: float, rounding: float) -> float:
    """Return the derivative of the potential Phi by the step length `t`, which is in [0, 1].

    The step goes along the search direction of `_prepare`. Phi is smooth below a contact speed of
    `rounding` [m/s].
    """
    table = scratch.table
    per_rounding = 1.0 / rounding
    for i in range(contacts.total):
        u = table[ph.SLIDE_ALONG + i] + t * table[ph.RATE_ALONG + i]
        v = table[ph.SLIDE_ACROSS + i] + t * table[ph.RATE_ACROSS + i]
        along = table[ph.MU_ALONG + i] * min(1.0, max(-1.0, u * per_rounding))
        across = table[ph.MU_ACROSS + i] * min(1.0, max(-1.0, v * per_rounding))
        table[ph.SLOPE + i] = table[ph.NORMAL + i] * (
            along * table[ph.RATE_ALONG + i] + across * table[ph.RATE_ACROSS + i]
        )
    for k in range(contacts.isotropic):
        i = scratch.marks[ph.ISOTROPIC + k]
        u = table[ph.SLIDE_ALONG + i] + t * table[ph.RATE_ALONG + i]
        v = table[ph.SLIDE_ACROSS + i] + t * table[ph.RATE_ACROSS + i]
        share = table[ph.MU_ALONG + i] / max(rounding, math.sqrt(u * u + v * v))
        along = share * u
        across = share * v
        table[ph.SLOPE + i] = table[ph.NORMAL + i] * (
            along * table[ph.RATE_ALONG + i] + across * table[ph.RATE_ACROSS + i]
        )
    total = 0.0
    for i in range(contacts.total):
        total += table[ph.SLOPE + i]
    return total


@inlined
def _keep_kinks(scratch: Scratch, count: int) -> int:
    """List the kinks between 0 and 1 of the first `count` contacts; return the number of kinks.

    A kink is a step length [-] at which a contact starts or stops sliding.
    """
    table = scratch.table
    found = 0
    for i in range(count):
        for kink in (ph.KINK_1, ph.KINK_2, ph.KINK_3, ph.KINK_4):
            t = table[kink + i]
            table[ph.KINKS + found] = t
            found += (t > 0.0) & (t < 1.0)
    return found


@inlined
def _kink_nearest_middle(scratch: Scratch, kinks: int, low: float, high: float) -> float:
    """Return the kink nearest to the middle of the interval (low, high). Without a kink, return -1.

    A kink is a step length at which friction begins or ceases to hold a contact.
    """
    middle = 0.5 * (low + high)
    distance = 0.5 * (high - low) * (1.0 - 1e-9)
    nearest = -1.0
    for k in range(kinks):
        t = scratch.table[ph.KINKS + k]
        if abs(t - middle) < distance:
            distance = abs(t - middle)
            nearest = t
    return nearest


@inlined
def step_length(
    scratch: Scratch,
    contacts: Contacts,
    dt: float,
    vx: float,
    vy: float,
    omega: float,
    dx: float,
    dy: float,
    dw: float,
    start: float,
    rate: float,
    end: float,
    rounding: float,
) -> float:
    """Return the step length in (0, 1) that minimises the objective along a Newton direction.

    The objective's slope along the direction (dx, dy, dw) increases monotonically. Over rotors the
    slope is linear between its kinks, so a secant between two neighbouring kinks is exact. Over
    supports the slope is almost linear, and the secant is repeated.

    Args:
        vx, vy, omega: velocity at step length 0.
        start: slope of the objective at step length 0, negative.
        rate: growth of the slope's inertial part from step length 0 to 1.
        end: slope of the objective at step length 1, positive.
        rounding: [m/s] contact speed below which a rotor is held.
    """
    _prepare(scratch, contacts, vx, vy, omega, dx, dy, dw, rounding)
    kinks = _keep_kinks(scratch, contacts.total)
    low, high = 0.0, 1.0
    at_low, at_high = start, end
    inertial = start - dt * _slope(scratch, contacts, 0.0, rounding)
    t = -1.0
    kinks_left = True
    for _ in range(MAX_SEARCHES):
        if kinks_left:
            t = _kink_nearest_middle(scratch, kinks, low, high)
            kinks_left = t >= 0.0
        if not kinks_left:
            t = low - at_low * (high - low) / (at_high - at_low)
        slope = inertial + t * rate + dt * _slope(scratch, contacts, t, rounding)
        if abs(slope) <= -SEARCH_SLOPE * start:
            break
        if slope < 0.0:
            low, at_low = t, slope
        else:
            high, at_high = t, slope
    return t


# Phi is rounded (Huber) below this contact speed. It is a tenth of the speed at which the paper's
# tanh(5000 |V|) bends. A held contact creeps more slowly than this.
ROUNDING = 1e-5  # [m/s]
TOLERANCE = 1e-9  # [m/s] maximum residual of the optimality condition
MAX_ITERATIONS = 100
# A full Newton step is accepted if at most this share of the starting slope remains.
FULL_STEP_SLOPE = 0.5


@inlined
def load_contacts(scratch: Scratch, contacts: Contacts, dt: float) -> None:
    """Write each contact's largest friction impulses to `scratch`, for a step of `dt` [s]."""
    table = scratch.table
    for i in range(contacts.total):
        load = dt * table[ph.NORMAL + i]
        table[ph.MOST_ALONG + i] = load * table[ph.MU_ALONG + i]
        table[ph.MOST_ACROSS + i] = load * table[ph.MU_ACROSS + i]


@inlined
def _rotors(contacts: Contacts) -> int:
    """Return the number of contacts in the loop that computes the friction of rotors.

    The number is 0 if all contacts are isotropic, i.e. have the same friction in all directions.
    Otherwise the loop runs over all contacts, and a second loop overwrites the results of isotropic
    contacts. These two loops are faster than a separate list per kind of contact.
    """
    return contacts.total if contacts.isotropic < contacts.total else 0


@inlined
def _drag(table: Array, i: int, vx: float, vy: float, omega: float) -> None:
    """Write slip and isotropic friction of contact `i` to `table` at a centre-of-mass velocity."""
    x = table[ph.ARM_X + i]
    y = table[ph.ARM_Y + i]
    ux = vx - omega * y - table[ph.DRIVE_ALONG + i]
    uy = vy + omega * x - table[ph.DRIVE_ACROSS + i]
    speed = math.sqrt(ux * ux + uy * uy)
    share = table[ph.MOST_ALONG + i] / max(ROUNDING, speed)
    fx = share * ux
    fy = share * uy
    table[ph.SLIP_ALONG + i] = ux
    table[ph.SLIP_ACROSS + i] = uy
    table[ph.SLIP_SPEED + i] = speed
    table[ph.SHARE + i] = share
    table[ph.FORCE_X + i] = fx
    table[ph.FORCE_Y + i] = fy
    table[ph.TORQUE + i] = x * fy - y * fx


@inlined
def friction_gradient(
    scratch: Scratch, contacts: Contacts, vx: float, vy: float, omega: float
) -> tuple[float, float, float, bool]:
    """Return the gradient of dt Phi, the time step times the friction potential.

    Also return whether the Hessian is 0. Gradient and Hessian are taken at (vx, vy, omega).
    """
    table = scratch.table
    per_rounding = 1.0 / ROUNDING
    held = 0
    for i in range(_rotors(contacts)):
        x = table[ph.ARM_X + i]
        y = table[ph.ARM_Y + i]
        ax = table[ph.AXIS_X + i]
        ay = table[ph.AXIS_Y + i]
        ux = vx - omega * y
        uy = vy + omega * x
        along = (ax * ux + ay * uy - table[ph.DRIVE_ALONG + i]) * per_rounding
        across = (ax * uy - ay * ux - table[ph.DRIVE_ACROSS + i]) * per_rounding
        f_along = table[ph.MOST_ALONG + i] * min(1.0, max(-1.0, along))
        f_across = table[ph.MOST_ACROSS + i] * min(1.0, max(-1.0, across))
        fx = f_along * ax - f_across * ay
        fy = f_along * ay + f_across * ax
        table[ph.SLIP_ALONG + i] = along
        table[ph.SLIP_ACROSS + i] = across
        table[ph.FORCE_X + i] = fx
        table[ph.FORCE_Y + i] = fy
        table[ph.TORQUE + i] = x * fy - y * fx
        held += (abs(along) < 1.0) | (abs(across) < 1.0)
    if contacts.isotropic == contacts.total:
        for i in range(contacts.total):
            _drag(table, i, vx, vy, omega)
    else:
        for k in range(contacts.isotropic):
            _drag(table, scratch.marks[ph.ISOTROPIC + k], vx, vy, omega)
    gx = gy = gw = 0.0
    for i in range(contacts.total):
        gx += table[ph.FORCE_X + i]
        gy += table[ph.FORCE_Y + i]
        gw += table[ph.TORQUE + i]
    return gx, gy, gw, held + contacts.isotropic == 0


@inlined
def _write_curvature(table: Array, i: int, kxx: float, kxy: float, kyy: float) -> None:
    """Write contact `i`'s part of the Hessian of the potential.

    `kxx`, `kxy` and `kyy` are the potential's second derivatives with respect to the velocity
    (x, y) of the parcel at the contact.
    """
    x = table[ph.ARM_X + i]
    y = table[ph.ARM_Y + i]
    kxw = x * kxy - y * kxx
    kyw = x * kyy - y * kxy
    table[ph.CURVE_XX + i] = kxx
    table[ph.CURVE_XY + i] = kxy
    table[ph.CURVE_XW + i] = kxw
    table[ph.CURVE_YY + i] = kyy
    table[ph.CURVE_YW + i] = kyw
    table[ph.CURVE_WW + i] = x * kyw - y * kxw


@inlined
def _bend(table: Array, i: int) -> None:
    """Write the part of the Hessian that belongs to contact i, which has isotropic friction."""
    ux = table[ph.SLIP_ALONG + i]
    uy = table[ph.SLIP_ACROSS + i]
    speed = table[ph.SLIP_SPEED + i]
    share = table[ph.SHARE + i]
    # Rounded friction grows with the slip; full friction only turns with it.
    turn = (speed >= ROUNDING) * share / max(ROUNDING * ROUNDING, speed * speed)
    _write_curvature(table, i, share - turn * ux * ux, -turn * ux * uy, share - turn * uy * uy)


@inlined
def friction_curvature(
    scratch: Scratch, contacts: Contacts
) -> tuple[float, float, float, float, float, float]:
    """Return the upper triangle of the Hessian of dt * Phi. Phi is the potential of friction.

    The Hessian is taken at the velocity of the last call of `friction_gradient`.
    """
    table = scratch.table
    per_rounding = 1.0 / ROUNDING
    for i in range(_rotors(contacts)):
        ax = table[ph.AXIS_X + i]
        ay = table[ph.AXIS_Y + i]
        held_along = abs(table[ph.SLIP_ALONG + i]) < 1.0
        held_across = abs(table[ph.SLIP_ACROSS + i]) < 1.0
        k_along = held_along * table[ph.MOST_ALONG + i] * per_rounding
        k_across = held_across * table[ph.MOST_ACROSS + i] * per_rounding
        kxx = k_along * ax * ax + k_across * ay * ay
        kxy = (k_along - k_across) * ax * ay
        kyy = k_along * ay * ay + k_across * ax * ax
        _write_curvature(table, i, kxx, kxy, kyy)
    if contacts.isotropic == contacts.total:
        for i in range(contacts.total):
            _bend(table, i)
    else:
        for k in range(contacts.isotropic):
            _bend(table, scratch.marks[ph.ISOTROPIC + k])
    hxx = hxy = hxw = hyy = hyw = hww = 0.0
    for i in range(contacts.total):
        hxx += table[ph.CURVE_XX + i]
        hxy += table[ph.CURVE_XY + i]
        hxw += table[ph.CURVE_XW + i]
        hyy += table[ph.CURVE_YY + i]
        hyw += table[ph.CURVE_YW + i]
        hww += table[ph.CURVE_WW + i]
    return hxx, hxy, hxw, hyy, hyw, hww


@inlined
def implicit_velocity(
    grid: Grid,
    gyration: float,
    scratch: Scratch,
    contacts: Contacts,
    dt: float,
    vx: float,
    vy: float,
    omega: float,
) -> tuple[float, float, float]:
    """Return the velocity (vx, vy, omega) of the centre of mass after an implicit step.

    Args:
        gyration: [m^2] inertia / mass.
        scratch: arms, axes, friction and normal forces of the contacts.
        vx, vy, omega: velocity before the step.
    """
    load_contacts(scratch, contacts, dt)
    target_x = vx + dt * grid.gravity_x
    target_y = vy + dt * grid.gravity_y
    target_w = omega
    radius = math.sqrt(gyration)
    dx = dy = dw = 0.0
    start = 0.0
    step = 0.0
    for _ in range(MAX_ITERATIONS):
        new_vx = vx + step * dx
        new_vy = vy + step * dy
        new_omega = omega + step * dw
        gx, gy, gw, flat = friction_gradient(scratch, contacts, new_vx, new_vy, new_omega)
        gx += new_vx - target_x
        gy += new_vy - target_y
        gw += gyration * (new_omega - target_w)
        end = gx * dx + gy * dy + gw * dw
        if step == 1.0 and end > -FULL_STEP_SLOPE * start:
            rate = dx * dx + dy * dy + gyration * dw * dw
            step = step_length(
                scratch, contacts, dt, vx, vy, omega, dx, dy, dw, start, rate, end, ROUNDING
            )
            continue
        vx, vy, omega = new_vx, new_vy, new_omega
        if abs(gx) + abs(gy) + abs(gw) < TOLERANCE * radius:
            break
        hxx = hxy = hxw = hyy = hyw = hww = 0.0
        if not flat:
            hxx, hxy, hxw, hyy, hyw, hww = friction_curvature(scratch, contacts)
        # Newton's direction: the symmetric 3 x 3 solve by cofactors.
        hxx += 1.0
        hyy += 1.0
        hww += gyration
        cxx = hyy * hww - hyw * hyw
        cxy = hxw * hyw - hxy * hww
        cxw = hxy * hyw - hxw * hyy
        cyy = hxx * hww - hxw * hxw
        cyw = hxy * hxw - hxx * hyw
        cww = hxx * hyy - hxy * hxy
        inverse = -1.0 / (hxx * cxx + hxy * cxy + hxw * cxw)
        dx = (cxx * gx + cxy * gy + cxw * gw) * inverse
        dy = (cxy * gx + cyy * gy + cyw * gw) * inverse
        dw = (cxw * gx + cyw * gy + cww * gw) * inverse
        start = gx * dx + gy * dy + gw * dw
        step = 1.0
    return vx, vy, omega


@inlined
def friction_work(
    scratch: Scratch, contacts: Contacts, vx: float, vy: float, omega: float
) -> tuple[float, float, float]:
    """Return the drives' work, the friction heat and the energy that the drives use in a step.

    The energies are per mass of the parcel [J/kg]. The work minus the heat is the change of the
    parcel's kinetic energy by friction. A drive that brakes returns no energy. Therefore the used
    energy is the sum of the positive work of all drives.

    Args:
        scratch: holds the friction impulses that the last call of `friction_gradient` has written.
        vx, vy, omega: mean velocity of the centre of mass in the step.
    """
    table = scratch.table
    work = heat = drawn = 0.0
    for i in range(contacts.total):
        ax, ay = table[ph.AXIS_X + i], table[ph.AXIS_Y + i]
        wx = ax * table[ph.DRIVE_ALONG + i] - ay * table[ph.DRIVE_ACROSS + i]
        wy = ay * table[ph.DRIVE_ALONG + i] + ax * table[ph.DRIVE_ACROSS + i]
        ux = vx - omega * table[ph.ARM_Y + i] - wx
        uy = vy + omega * table[ph.ARM_X + i] - wy
        own = -(table[ph.FORCE_X + i] * wx + table[ph.FORCE_Y + i] * wy)
        work += own
        drawn += max(0.0, own)
        heat += table[ph.FORCE_X + i] * ux + table[ph.FORCE_Y + i] * uy
    return work, heat, drawn
