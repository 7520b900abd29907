"""A group's direction of search, against NumPy's solver."""

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.dynamics import solving
from surface_gym.dynamics.company import make_together_scratch
from surface_gym.dynamics.compiled import compiled
from surface_gym.dynamics.sides import Group
from surface_gym.together import bodies_of

clear_matrix = compiled(solving.clear_matrix.py_func)
solve = compiled(solving.solve.py_func)
PARCELS = 7


def group_of(touching: list[tuple[int, int]], member: list[int]) -> Group:
    """Some of seven parcels, which touch at a point each two; its matrix is full of old numbers."""
    scratch = make_together_scratch(PARCELS)
    group = Group(
        members=len(member),
        contacts=len(touching),
        bodies=bodies_of([sg.layouts.box("S")] * PARCELS),
        site=np.arange(PARCELS),
        **{
            name: getattr(scratch, name)
            for name in Group._fields
            if name not in ("members", "contacts", "bodies", "site")
        },
    )
    group.member[: len(member)] = member
    group.slot[member] = np.arange(len(member))
    group.contact[: len(touching)] = np.arange(len(touching))
    group.ends[: len(touching), :2] = np.reshape(touching, (-1, 2))
    group.matrix.fill(np.nan)
    return group


@pytest.mark.parametrize(
    "touching",
    [
        [],
        [(0, 1)],
        [(2, 0), (1, 3), (3, 4)],  # two apart, in a row that is not theirs
        [(0, 4), (4, 1), (1, 3), (3, 2)],  # a chain
        [(0, 1), (0, 2), (0, 3), (0, 4)],  # all about one
        [(i, j) for i in range(5) for j in range(i)],
    ],
)
@pytest.mark.parametrize("member", [[0, 1, 2, 3, 4], [6, 4, 3, 1, 0]])
def test_it_solves_what_those_who_touch_share(
    touching: list[tuple[int, int]], member: list[int]
) -> None:
    rng = np.random.default_rng(len(touching))
    size = 3 * len(member)
    # What each adds by itself, and what two who touch add: all of it positive definite.
    matrix = np.zeros((size, size))
    for part in [(k,) for k in range(len(member))] + touching:
        rows = np.concatenate([3 * k + np.arange(3) for k in part])
        root = rng.normal(size=(len(rows), len(rows)))
        matrix[np.ix_(rows, rows)] += root @ root.T + 0.1 * np.eye(len(rows))
    group = group_of([(member[i], member[j]) for i, j in touching], member)
    clear_matrix(group)
    kept = np.tril(~np.isnan(group.matrix[:size, :size]))
    assert (kept | (np.tril(matrix) == 0.0)).all()
    group.matrix[:size, :size][kept] = matrix[kept]
    group.gradient[member] = rng.normal(size=(len(member), 3))
    solve(group)
    expected = np.linalg.solve(matrix, -group.gradient[member].ravel())
    np.testing.assert_allclose(group.direction[member].ravel(), expected, rtol=1e-9, atol=1e-12)
