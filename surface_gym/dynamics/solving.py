"""Newton's direction of a group: a symmetric system by Cholesky's factors.

Parcels far from each other share no derivatives. Each member's rows begin at the first member that
it or its like touches, `Group.low`, and the factors fill no more than that.
"""

import math

from surface_gym.dynamics.compiled import inlined, linked
from surface_gym.dynamics.sides import Group


@inlined
def clear_matrix(group: Group) -> None:
    """Find where each member's rows begin, and make them zero from there on."""
    low = group.low
    for n in range(group.members):
        low[n] = n
    for m in range(group.contacts):
        c = group.contact[m]
        i = group.slot[group.ends[c, 0]]
        j = group.slot[group.ends[c, 1]]
        low[max(i, j)] = min(low[max(i, j)], min(i, j))
    for row in range(3 * group.members):
        for column in range(3 * low[row // 3], row + 1):
            group.matrix[row, column] = 0.0


@inlined
def _factorise(group: Group) -> None:
    """Cholesky's factor in the place of the lower triangle."""
    matrix, low = group.matrix, group.low
    for row in range(3 * group.members):
        first = 3 * low[row // 3]
        for column in range(first, row + 1):
            value = matrix[row, column]
            for k in range(max(first, 3 * low[column // 3]), column):
                value -= matrix[row, k] * matrix[column, k]
            if row == column:
                matrix[row, row] = math.sqrt(value)
            else:
                matrix[row, column] = value / matrix[column, column]


@linked
def solve(group: Group) -> None:
    """Write the direction along which the gradient would vanish; the matrix is used up."""
    matrix, low, direction, member = group.matrix, group.low, group.direction, group.member
    _factorise(group)
    size = 3 * group.members
    for row in range(size):
        value = -group.gradient[member[row // 3], row % 3]
        for k in range(3 * low[row // 3], row):
            value -= matrix[row, k] * direction[member[k // 3], k % 3]
        direction[member[row // 3], row % 3] = value / matrix[row, row]
    for row in range(size - 1, -1, -1):
        value = direction[member[row // 3], row % 3] / matrix[row, row]
        direction[member[row // 3], row % 3] = value
        for k in range(3 * low[row // 3], row):
            direction[member[k // 3], k % 3] -= matrix[row, k] * value
