"""Reference solvers of the normal forces, and the physics' functions for callers in Python.

All solvers have the arguments and results of `scipy_normal_forces`.
"""

from collections.abc import Callable

import numpy as np

from surface_gym.compiler.jit import compiled
from surface_gym.physics import contacts, friction, normal_forces, step, types as ph
from surface_gym.physics.types import Array, Body, Grid, Scratch, table_row

find_contacts = compiled(contacts.find_contacts.py_func)
dual_normal_forces = compiled(normal_forces.dual_normal_forces.py_func)
implicit_velocity = compiled(friction.implicit_velocity.py_func)
load_point = compiled(step.load_point.py_func)
find_support = compiled(step.find_support.py_func)
explain_unsupported = compiled(step.explain_unsupported.py_func)
step_implicit = compiled(step.step_implicit.py_func)
step_explicit = compiled(step.step_explicit.py_func)
advance_implicit = compiled(step.advance_implicit.py_func)
advance_explicit = compiled(step.advance_explicit.py_func)

Solver = Callable[[Array, float, Array, Array], tuple[Array, bool]]

_MISS = 1e-6  # [arms' scale] residual moment from which contacts are degenerate


def _balance(arms: Array, load: Array) -> tuple[Array, Array]:
    """Return A_eq (3, n) and b_eq (3,) of Eq. (1), normalised by the load and the longest arm."""
    scale = max(float(np.abs(arms).max()), 1e-9)
    matrix = np.vstack([np.ones(len(arms)), arms.T / scale])
    return matrix, np.array([1.0, load[0] / scale, load[1] / scale])


def _is_degenerate(matrix: Array, target: Array, share: Array) -> bool:
    centred = matrix[1:] - matrix[1:].mean(axis=1, keepdims=True)
    flat = np.linalg.matrix_rank(centred, tol=1e-3 * np.linalg.norm(centred)) < 2
    return bool(len(share) < 3 or flat or np.abs(matrix[1:] @ share - target[1:]).max() > _MISS)


def scipy_normal_forces(
    arms: Array, weight: float, load: Array, stiffness: Array | None = None
) -> tuple[Array, bool]:
    """Solve Eq. (1) by SciPy's active-set `nnls`. Large weights enforce the equations of balance.

    Args:
        arms: (n, 2) [m] positions of the contacts relative to the centre of mass.
        weight: [m/s^2] sum of the normal forces / mass.
        load: (2,) [m] point at which the load acts, relative to the centre of mass.
        stiffness: (n,) [-] relative stiffness of the contacts. The default is equal stiffness.

    Returns:
        Normal forces / mass (n,) [m/s^2], and whether the contacts are degenerate (see
        `dual_normal_forces`).
    """
    from scipy.optimize import nnls  # with osqp a third of the package's import time

    matrix, target = _balance(arms, load)
    heavy = np.array([1e9, 1e6, 1e6])[:, np.newaxis]
    root = np.ones(len(arms)) if stiffness is None else np.sqrt(stiffness)
    system = np.vstack([heavy * matrix * root, np.eye(len(arms))])
    scaled, _ = nnls(system, np.concatenate([heavy[:, 0] * target, np.zeros(len(arms))]))
    share = root * scaled
    degenerate = _is_degenerate(matrix, target, share)
    return weight * share / share.sum(), degenerate


def osqp_normal_forces(
    arms: Array, weight: float, load: Array, stiffness: Array | None = None
) -> tuple[Array, bool]:
    """Solve Eq. (1) by OSQP. If there is no solution, make the moments as balanced as possible.

    Arguments and results are as in `scipy_normal_forces`. Raise an ImportError if OSQP is missing,
    and a RuntimeError if OSQP finds no forces.
    """
    matrix, target = _balance(arms, load)
    n = len(arms)
    rows = np.vstack([matrix, np.eye(n)])
    low = np.concatenate([target, np.zeros(n)])
    high = np.concatenate([target, np.ones(n)])
    cost = np.eye(n) if stiffness is None else np.diag(stiffness.mean() / stiffness)
    share = _osqp(cost, np.zeros(n), rows, low, high)
    if share is None or np.abs(matrix @ share - target).max() > _MISS:
        moments = matrix[1:]
        stiff = np.triu(1e8 * moments.T @ moments + cost)
        rows = np.vstack([matrix[:1], np.eye(n)])
        share = _osqp(
            stiff,
            -1e8 * moments.T @ target[1:],
            rows,
            np.delete(low, (1, 2)),
            np.delete(high, (1, 2)),
        )
        if share is None:
            raise RuntimeError(f"OSQP found no normal forces for the contacts {arms.tolist()}")
    share = np.maximum(share, 0.0)
    return weight * share / share.sum(), _is_degenerate(matrix, target, share)


def _osqp(cost: Array, linear: Array, rows: Array, low: Array, high: Array) -> Array | None:
    from scipy import sparse

    try:
        import osqp
    except ModuleNotFoundError as error:
        raise ImportError(
            f"normal_forces='osqp' needs OSQP ({error}): pip install 'surface_gym[validation]'"
        ) from None

    problem = osqp.OSQP()
    problem.setup(
        sparse.csc_matrix(cost),
        linear,
        sparse.csc_matrix(rows),
        low,
        high,
        verbose=False,
        eps_abs=1e-9,
        eps_rel=1e-9,
        max_iter=20_000,
        adaptive_rho_interval=25,  # some contacts never converge with the default
        polishing=True,
    )
    result = problem.solve(raise_error=False)
    return np.asarray(result.x) if result.info.status == "solved" else None


SOLVERS: dict[str, Solver] = {"osqp": osqp_normal_forces, "scipy": scipy_normal_forces}


def support_load_by(
    solver: str, grid: Grid, body: Body, state: Array, scratch: Scratch, count: int
) -> bool:
    """Solve the normal forces of `count` contacts in `scratch` by a solver named in SOLVERS.

    Return whether the contacts are degenerate; see `dual_normal_forces`.
    """
    arms = np.column_stack(
        [table_row(scratch, ph.ARM_X, count), table_row(scratch, ph.ARM_Y, count)]
    )
    load = np.array(load_point(grid, body, state))
    stiffness = table_row(scratch, ph.STIFFNESS, count)
    normal, degenerate = SOLVERS[solver](arms, grid.gravity_normal, load, stiffness)
    table_row(scratch, ph.NORMAL, count)[:] = normal
    return degenerate
