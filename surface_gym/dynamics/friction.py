"""The friction field as a potential, and the implicit step that minimises over it.

The paper's forces, Eq. (2)-(3), are minus the gradient of
    Phi(v) = sum over rotors N_i (mu_max |a_i . u_i| + mu_min |p_i . u_i|)
           + sum over supports N_j mu_support |u_j|
with u the velocity at the contact, a the axis and p its normal. One step is the convex problem
    v+ = argmin 1/2 |v - (v0 + dt g)|_M^2 + dt Phi(v)
in three unknowns. It rests where friction holds and does not chatter.
"""

import math

from surface_gym.dynamics.compiled import compiled, inlined
from surface_gym.dynamics.types import Grid, Scratch

# Phi is rounded (Huber) below this contact speed, a tenth of where the paper's tanh(5000 |V|)
# bends: a parcel held on a slope creeps by less than this.
ROUNDING = 1e-5  # [m/s]
TOLERANCE = 1e-9  # [m/s] left of the optimality condition
MAX_ITERATIONS = 100
MAX_SEARCHES = 60
# A full Newton step may leave this share of the starting slope, a line search the second.
FULL_STEP_SLOPE = 0.5
SEARCH_SLOPE = 0.01


@inlined
def _gradient_and_curvature(
    grid: Grid, scratch: Scratch, contacts: int, dt: float, vx: float, vy: float, omega: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Gradient (3) and upper triangle of the Hessian (6) of dt Phi at a velocity."""
    per_rounding = 1.0 / ROUNDING
    gx = gy = gw = 0.0
    hxx = hxy = hxw = hyy = hyw = hww = 0.0
    for i in range(contacts):
        x = scratch.arm_x[i]
        y = scratch.arm_y[i]
        ux = vx - omega * y
        uy = vy + omega * x
        load = dt * scratch.normal[i]
        if scratch.rotor[i]:
            ax = scratch.axis_x[i]
            ay = scratch.axis_y[i]
            along = (ax * ux + ay * uy) * per_rounding
            across = (ax * uy - ay * ux) * per_rounding
            most = load * grid.mu_max
            least = load * grid.mu_min
            held_along = abs(along) < 1.0
            held_across = abs(across) < 1.0
            f_along = most * min(1.0, max(-1.0, along))
            f_across = least * min(1.0, max(-1.0, across))
            fx = f_along * ax - f_across * ay
            fy = f_along * ay + f_across * ax
            if held_along or held_across:
                k_along = held_along * most * per_rounding
                k_across = held_across * least * per_rounding
                kxx = k_along * ax * ax + k_across * ay * ay
                kxy = (k_along - k_across) * ax * ay
                kyy = k_along * ay * ay + k_across * ax * ax
                held = True
            else:
                held = False
        else:
            speed = math.sqrt(ux * ux + uy * uy)
            k = load * grid.mu_support / max(ROUNDING, speed)
            fx = k * ux
            fy = k * uy
            kxx = kyy = k
            kxy = 0.0
            if speed >= ROUNDING:
                bend = k / (speed * speed)
                kxx -= bend * ux * ux
                kyy -= bend * uy * uy
                kxy -= bend * ux * uy
            held = True
        gx += fx
        gy += fy
        gw += x * fy - y * fx
        if held:
            txw = x * kxy - y * kxx
            tyw = x * kyy - y * kxy
            hxx += kxx
            hxy += kxy
            hyy += kyy
            hxw += txw
            hyw += tyw
            hww += x * tyw - y * txw
    return gx, gy, gw, hxx, hxy, hxw, hyy, hyw, hww


@inlined
def _prepare_search(
    scratch: Scratch,
    contacts: int,
    vx: float,
    vy: float,
    omega: float,
    dx: float,
    dy: float,
    dw: float,
) -> None:
    """Write each contact's velocity and its slope along the search: along and across the axis of
    a rotor, x and y on a support.
    """
    for i in range(contacts):
        x = scratch.arm_x[i]
        y = scratch.arm_y[i]
        ax = scratch.axis_x[i] if scratch.rotor[i] else 1.0
        ay = scratch.axis_y[i] if scratch.rotor[i] else 0.0
        ux = vx - omega * y
        uy = vy + omega * x
        sx = dx - dw * y
        sy = dy + dw * x
        scratch.slide[i, 0] = ax * ux + ay * uy
        scratch.slide[i, 1] = ax * sx + ay * sy
        scratch.slide[i, 2] = ax * uy - ay * ux
        scratch.slide[i, 3] = ax * sy - ay * sx


@inlined
def _slope(grid: Grid, scratch: Scratch, contacts: int, t: float) -> float:
    """Derivative of Phi along the search at t."""
    per_rounding = 1.0 / ROUNDING
    total = 0.0
    for i in range(contacts):
        u = scratch.slide[i, 0] + t * scratch.slide[i, 1]
        v = scratch.slide[i, 2] + t * scratch.slide[i, 3]
        if scratch.rotor[i]:
            along = grid.mu_max * min(1.0, max(-1.0, u * per_rounding))
            across = grid.mu_min * min(1.0, max(-1.0, v * per_rounding))
        else:
            share = grid.mu_support / max(ROUNDING, math.sqrt(u * u + v * v))
            along = share * u
            across = share * v
        total += scratch.normal[i] * (along * scratch.slide[i, 1] + across * scratch.slide[i, 3])
    return total


@inlined
def _kink_nearest_middle(scratch: Scratch, contacts: int, low: float, high: float) -> float:
    """The kink of the slope nearest to the middle of (low, high); negative if there is none.

    A kink is where a contact passes between sliding and held.
    """
    middle = 0.5 * (low + high)
    distance = 0.5 * (high - low) * (1.0 - 1e-9)
    nearest = -1.0
    for i in range(contacts):
        for way in range(0, 4, 2):
            rate = scratch.slide[i, way + 1]
            if rate != 0.0:
                for edge in (-ROUNDING, ROUNDING):
                    t = (edge - scratch.slide[i, way]) / rate
                    if abs(t - middle) < distance:
                        distance = abs(t - middle)
                        nearest = t
    return nearest


@compiled
def _minimise_along(
    grid: Grid, scratch: Scratch, contacts: int, dt: float, start: float, rate: float, end: float
) -> float:
    """Step length in (0, 1) at the minimum along a Newton direction.

    The slope increases and, over rotors, is linear between its kinks: bracket it between two
    kinks and the secant is exact. Over supports it is nearly so, and the secant repeats.

    Args:
        start: slope of the whole objective at 0, negative.
        rate: growth of the inertial part's slope from 0 to 1.
        end: slope at 1, positive.
    """
    low, high = 0.0, 1.0
    at_low, at_high = start, end
    inertial = start - dt * _slope(grid, scratch, contacts, 0.0)
    t = -1.0
    kinks_left = True
    for _ in range(MAX_SEARCHES):
        if kinks_left:
            t = _kink_nearest_middle(scratch, contacts, low, high)
            kinks_left = t >= 0.0
        if not kinks_left:
            t = low - at_low * (high - low) / (at_high - at_low)
        slope = inertial + t * rate + dt * _slope(grid, scratch, contacts, t)
        if abs(slope) <= -SEARCH_SLOPE * start:
            break
        if slope < 0.0:
            low, at_low = t, slope
        else:
            high, at_high = t, slope
    return t


@inlined
def implicit_velocity(
    grid: Grid,
    gyration: float,
    scratch: Scratch,
    contacts: int,
    dt: float,
    vx: float,
    vy: float,
    omega: float,
) -> tuple[float, float, float]:
    """Velocity (vx, vy, omega) of the centre of mass after a step, from the one before it.

    Args:
        gyration: [m^2] inertia / mass.
        scratch: arms, axes, kinds and normal forces of the contacts.
    """
    target_x = vx + dt * grid.gravity_along
    target_y = vy
    target_w = omega
    radius = math.sqrt(gyration)
    dx = dy = dw = 0.0
    start = 0.0
    step = 0.0
    for _ in range(MAX_ITERATIONS):
        new_vx = vx + step * dx
        new_vy = vy + step * dy
        new_omega = omega + step * dw
        gx, gy, gw, hxx, hxy, hxw, hyy, hyw, hww = _gradient_and_curvature(
            grid, scratch, contacts, dt, new_vx, new_vy, new_omega
        )
        gx += new_vx - target_x
        gy += new_vy - target_y
        gw += gyration * (new_omega - target_w)
        end = gx * dx + gy * dy + gw * dw
        if step == 1.0 and end > -FULL_STEP_SLOPE * start:
            rate = dx * dx + dy * dy + gyration * dw * dw
            _prepare_search(scratch, contacts, vx, vy, omega, dx, dy, dw)
            step = _minimise_along(grid, scratch, contacts, dt, start, rate, end)
            continue
        vx, vy, omega = new_vx, new_vy, new_omega
        if abs(gx) + abs(gy) + abs(gw) < TOLERANCE * radius:
            break
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
