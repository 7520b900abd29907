"""What is typed to train and to compare: a file of the checkout, or the command once installed."""

import shlex
from collections.abc import Sequence

CHECKOUT = __name__ == "agents.programs"
TRAIN = ("python", "train.py") if CHECKOUT else ("surface-gym", "train")
EVALUATE = ("python", "evaluate.py") if CHECKOUT else ("surface-gym", "evaluate")


def typed(program: Sequence[str], *arguments: str) -> str:
    """A command line that a shell takes as it stands.

    Args:
        program: TRAIN or EVALUATE.
        arguments: that follow it.
    """
    return shlex.join([*program, *arguments])
