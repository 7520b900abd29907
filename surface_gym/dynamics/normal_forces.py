"""Normal forces, Eq. (1), by its dual: three unknowns however many contacts there are.

The minimiser of |N|^2 under vertical and moment balance with N >= 0 is a pressure plane cut off
at zero, N_i = max(0, c + cx x_i + cy y_i). Elements of unequal stiffness k_i weigh the squares,
sum N_i^2 / k_i, and then N_i = k_i max(0, c + cx x_i + cy y_i). The upper bound m g cos(gamma) of
Eq. (1) follows from vertical balance and N >= 0, so it never binds on its own. Forces are per unit
mass throughout.
"""

from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import Scratch

MAX_ITERATIONS = 100
# The moment balance may miss by this times the plane's slope. That leaves a solution where none is
# exact (the parcel tips), and moves an exact one by about 1e-9 of itself.
SLACK = 1e-9  # [pitch^2]
TIPPING_TOLERANCE = 1e-6  # [pitch] by which the load point may miss what the contacts can carry
COLLINEAR_TOLERANCE = 1e-6  # [-] least product of the two spreads, over their sum squared


@inlined
def dual_normal_forces(
    scratch: Scratch, contacts: int, weight: float, load_x: float, load_y: float, pitch: float
) -> bool:
    """Solve Eq. (1) into `scratch.normal` by a semismooth Newton on its dual.

    Args:
        scratch: arms and stiffnesses of the contacts in, normal forces out.
        contacts: their number, at least one.
        weight: [m/s^2] normal load / mass.
        load_x: [m] where the load acts, from the centre of mass.
        load_y: [m].
        pitch: [m] scale of the contacts' distances.

    Returns:
        Whether the set is degenerate: fewer than three contacts, collinear, or the load point
        outside their hull. Then vertical balance holds and the moments come as near as they can.
    """
    slack = SLACK * pitch * pitch
    for i in range(contacts):
        scratch.normal[i] = 1.0
    # From a uniform pressure, which loads every contact, to the plane that balances the load on
    # the contacts now loaded, and again until that lifts or loads none.
    c, cx, cy = weight / contacts, 0.0, 0.0
    new_c, new_cx, new_cy = c, cx, cy
    value = 0.0
    step = 0.0
    degenerate = contacts < 3
    for _ in range(MAX_ITERATIONS):
        trial_c = c + step * (new_c - c)
        trial_cx = cx + step * (new_cx - cx)
        trial_cy = cy + step * (new_cy - cy)
        # Sums of k, k x, k y, k x^2, k x y and k y^2 over the loaded contacts.
        s = sx = sy = sxx = sxy = syy = 0.0
        changes = 0
        for i in range(contacts):
            x = scratch.arm_x[i]
            y = scratch.arm_y[i]
            pressure = trial_c + trial_cx * x + trial_cy * y
            loaded = pressure > 0.0
            changes += loaded != (scratch.normal[i] > 0.0)
            k = scratch.stiffness[i]
            scratch.normal[i] = k * pressure if loaded else 0.0
            if loaded:
                kx = k * x
                ky = k * y
                s += k
                sx += kx
                sy += ky
                sxx += kx * x
                sxy += kx * y
                syy += ky * y
        if step == 1.0 and changes == 0:
            break
        quadratic = (
            s * trial_c * trial_c
            + 2.0 * trial_c * (sx * trial_cx + sy * trial_cy)
            + (sxx + slack) * trial_cx * trial_cx
            + 2.0 * sxy * trial_cx * trial_cy
            + (syy + slack) * trial_cy * trial_cy
        )
        trial_value = 0.5 * quadratic - weight * (trial_c + load_x * trial_cx + load_y * trial_cy)
        if step > 0.0 and trial_value > value:
            step *= 0.5
            continue
        value = trial_value
        c, cx, cy = trial_c, trial_cx, trial_cy
        per_s = 1.0 / s
        mean_x = sx * per_s
        mean_y = sy * per_s
        vxx = sxx - sx * mean_x
        vxy = sxy - sx * mean_y
        vyy = syy - sy * mean_y
        if step == 0.0 and vxx * vyy - vxy * vxy <= COLLINEAR_TOLERANCE * (vxx + vyy) * (vxx + vyy):
            degenerate = True
        vxx += slack
        vyy += slack
        rx = weight * (load_x - mean_x)
        ry = weight * (load_y - mean_y)
        inverse = 1.0 / (vxx * vyy - vxy * vxy)
        new_cx = (vyy * rx - vxy * ry) * inverse
        new_cy = (vxx * ry - vxy * rx) * inverse
        new_c = weight * per_s - new_cx * mean_x - new_cy * mean_y
        step = 1.0
    miss = slack * (abs(trial_cx) + abs(trial_cy))
    if miss > TIPPING_TOLERANCE * pitch * weight:
        degenerate = True
    if degenerate:
        # A steep plane leaves round-off in the sum.
        total = 0.0
        for i in range(contacts):
            total += scratch.normal[i]
        for i in range(contacts):
            scratch.normal[i] *= weight / total
    return degenerate
