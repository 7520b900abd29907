"""From a computed number to an index: no number that comes in may reach beyond an array."""

from surface_gym.dynamics.compiled import inlined


@inlined
def bounded(value: float, least: float, most: float) -> float:
    """A number within [least, most]; what is not a number becomes the least.

    Every float goes through here before it becomes an index or a count. A processor makes anything
    at all of one that an integer has no room for.

    Args:
        value: to be made an integer.
        least: a whole number; what `value` becomes where it is below or not a number.
        most: a whole number; what it becomes where it is above.
    """
    if not value > least:
        return least
    return most if value > most else value
