"""Normal forces by the dual of Eq. (1), with three unknowns for any number of contacts.

N_i is the normal force of the contact at (x_i, y_i). The minimiser of |N|^2 under vertical and
moment balance with N >= 0 is a pressure plane cut off at zero: N_i = max(0, c + cx x_i + cy y_i).
With unequal stiffnesses k_i, the minimiser of sum N_i^2 / k_i is N_i = k_i max(0, c + cx x_i + cy
y_i). The upper bound m g cos(gamma) of Eq. (1) follows from vertical balance and N >= 0, so it
never binds. All forces are per unit mass.
"""

from surface_gym.compiler.jit import inlined
from surface_gym.physics.types import ARM_X, ARM_Y, NORMAL, PRESSURE, STIFFNESS, Scratch

MAX_ITERATIONS = 100
MAX_SEARCHES = 100
# Allowed error of the moment balance per slope of the plane. It gives a solution also if none is
# exact (the parcel tips), and changes an exact solution by about 1e-8 of its value.
SLACK = 1e-8  # [pitch^2]
# [pitch^2] for collinear contacts, where the slope across the line is arbitrary
COLLINEAR_SLACK = 1e-5
BALANCE_TOLERANCE = 1e-12  # residual of the balance [weight] and of the moments [weight * pitch]
TIPPING_TOLERANCE = 1e-6  # [pitch] allowed distance of the load point from the contacts' hull
COLLINEAR_TOLERANCE = 1e-6  # [-] minimum of the product of the two spreads over their sum squared


@inlined
def _minimise_along(
    scratch: Scratch,
    contacts: int,
    c: float,
    cx: float,
    cy: float,
    dc: float,
    dx: float,
    dy: float,
    start: float,
    end: float,
    slack: float,
) -> float:
    """Return the step length in (0, 1) that minimises the dual.

    A step changes the pressure plane. The dual's slope increases with the step length. The slope
    has a kink wherever a contact is loaded or lifted. The slope is linear between two neighbouring
    kinks, so a secant between these kinks is exact.

    Args:
        c, cx, cy: the pressure plane c + cx x + cy y at step length 0.
        dc, dx, dy: change of `c`, `cx` and `cy` at step length 1.
        start: negative slope of the dual at step length 0.
        end: positive slope of the dual at step length 1.
        slack: [m^2] allowed error of the moment balance, divided by the pressure plane's slope.
    """
    table = scratch.table
    low, high = 0.0, 1.0
    at_low, at_high = start, end
    rate = slack * (dx * dx + dy * dy)
    constant = start
    for i in range(contacts):
        pressure = c + cx * table[ARM_X + i] + cy * table[ARM_Y + i]
        change = dc + dx * table[ARM_X + i] + dy * table[ARM_Y + i]
        constant -= table[STIFFNESS + i] * change * max(0.0, pressure)
    for _ in range(MAX_SEARCHES):
        # The kink closest to the middle of the bracket.
        middle = 0.5 * (low + high)
        distance = 0.5 * (high - low) * (1.0 - 1e-9)
        t = -1.0
        for i in range(contacts):
            pressure = c + cx * table[ARM_X + i] + cy * table[ARM_Y + i]
            change = dc + dx * table[ARM_X + i] + dy * table[ARM_Y + i]
            if change != 0.0 and abs(pressure / change + middle) < distance:
                t = -pressure / change
                distance = abs(t - middle)
        if t < 0.0:
            break
        slope = constant + t * rate
        for i in range(contacts):
            pressure = c + cx * table[ARM_X + i] + cy * table[ARM_Y + i]
            change = dc + dx * table[ARM_X + i] + dy * table[ARM_Y + i]
            slope += table[STIFFNESS + i] * change * max(0.0, pressure + t * change)
        if slope < 0.0:
            low, at_low = t, slope
        else:
            high, at_high = t, slope
    return low - at_low * (high - low) / (at_high - at_low)


@inlined
def _loaded_sums(
    scratch: Scratch, contacts: int
) -> tuple[float, float, float, float, float, float]:
    """Return the sums of k, k x, k y, k x^2, k x y, k y^2 over loaded contacts of stiffness k."""
    table = scratch.table
    s = sx = sy = sxx = sxy = syy = 0.0
    for i in range(contacts):
        x = table[ARM_X + i]
        y = table[ARM_Y + i]
        k = table[STIFFNESS + i] if table[PRESSURE + i] > 0.0 else 0.0
        kx = k * x
        ky = k * y
        s += k
        sx += kx
        sy += ky
        sxx += kx * x
        sxy += kx * y
        syy += ky * y
    return s, sx, sy, sxx, sxy, syy


@inlined
def dual_normal_forces(
    scratch: Scratch, contacts: int, weight: float, load_x: float, load_y: float, pitch: float
) -> bool:
    """Write the normal forces of Eq. (1) to `scratch`, by a semismooth Newton method on the dual.

    Args:
        scratch: holds the contacts' arms and stiffnesses, and gets their normal forces.
        contacts: number of contacts, at least one.
        weight: [m/s^2] normal load / mass.
        load_x, load_y: [m] point where the load acts, relative to the centre of mass.
        pitch: [m] scale of the contacts' distances.

    Returns:
        Whether the contacts are degenerate. Contacts are degenerate if they are fewer than three or
        collinear, or if the load point is outside their hull. The forces of degenerate contacts
        balance vertically, and balance the moments as closely as possible.
    """
    table = scratch.table
    slack = SLACK * pitch * pitch
    for i in range(contacts):
        table[PRESSURE + i] = 1.0
    # Start with a uniform pressure, which loads every contact. Then repeat: find the plane that
    # balances the load on the loaded contacts, until no contact is lifted or loaded.
    c, cx, cy = weight / contacts, 0.0, 0.0
    dc = dx = dy = 0.0
    start = 0.0
    step = 0.0
    degenerate = contacts < 3
    for _ in range(MAX_ITERATIONS):
        trial_c = c + step * dc
        trial_cx = cx + step * dx
        trial_cy = cy + step * dy
        changes = 0
        for i in range(contacts):
            pressure = trial_c + trial_cx * table[ARM_X + i] + trial_cy * table[ARM_Y + i]
            changes += (pressure > 0.0) != (table[PRESSURE + i] > 0.0)
            table[PRESSURE + i] = pressure
        if step == 1.0 and changes == 0:
            break
        s, sx, sy, sxx, sxy, syy = _loaded_sums(scratch, contacts)
        if step == 0.0:
            slack *= s / contacts
        # The residual of the balance is the gradient of the dual.
        left = s * trial_c + sx * trial_cx + sy * trial_cy - weight
        left_x = sx * trial_c + (sxx + slack) * trial_cx + sxy * trial_cy - weight * load_x
        left_y = sy * trial_c + sxy * trial_cx + (syy + slack) * trial_cy - weight * load_y
        missing = abs(left) * pitch + abs(left_x) + abs(left_y)
        if step > 0.0 and missing < BALANCE_TOLERANCE * weight * pitch:
            break
        if step == 1.0:
            end = left * dc + left_x * dx + left_y * dy
            if end > -0.5 * start:
                step = _minimise_along(scratch, contacts, c, cx, cy, dc, dx, dy, start, end, slack)
                continue
        c, cx, cy = trial_c, trial_cx, trial_cy
        per_s = 1.0 / s
        mean_x = sx * per_s
        mean_y = sy * per_s
        vxx = sxx - sx * mean_x
        vxy = sxy - sx * mean_y
        vyy = syy - sy * mean_y
        if step == 0.0 and vxx * vyy - vxy * vxy <= COLLINEAR_TOLERANCE * (vxx + vyy) * (vxx + vyy):
            degenerate = True
            slack *= COLLINEAR_SLACK / SLACK
        vxx += slack
        vyy += slack
        rx = weight * (load_x - mean_x)
        ry = weight * (load_y - mean_y)
        inverse = 1.0 / (vxx * vyy - vxy * vxy)
        new_cx = (vyy * rx - vxy * ry) * inverse
        new_cy = (vxx * ry - vxy * rx) * inverse
        dc = weight * per_s - new_cx * mean_x - new_cy * mean_y - c
        dx = new_cx - cx
        dy = new_cy - cy
        start = left * dc + left_x * dx + left_y * dy
        if start >= 0.0:  # only round-off remains
            break
        step = 1.0
    miss = slack * (abs(trial_cx) + abs(trial_cy))
    if miss > TIPPING_TOLERANCE * pitch * weight:
        degenerate = True
    for i in range(contacts):
        table[NORMAL + i] = table[STIFFNESS + i] * max(0.0, table[PRESSURE + i])
    if degenerate:
        # A steep plane leaves round-off in the sum.
        total = 0.0
        for i in range(contacts):
            total += table[NORMAL + i]
        for i in range(contacts):
            table[NORMAL + i] *= weight / total
    return degenerate
