"""A reward of your own: Sort with a reward only for success, and more for an early success.

python train.py --task examples/haste.py:Haste
"""

from surface_gym.extend import SUCCESS, EnvState, kernel_function
from surface_gym.tasks import Sort


class Haste(Sort):
    """Leave the line on the requested side, as early as possible."""

    terms = ("success", "haste")

    @staticmethod
    @kernel_function
    def reward(state: EnvState, outcome: int) -> None:
        state.terms[0] = 1.0 if outcome == SUCCESS else 0.0
        state.terms[1] = 0.5 / state.clock if outcome == SUCCESS else 0.0
