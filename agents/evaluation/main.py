"""Compare every controller and agent on every task."""

import sys

import tyro
from rich.console import Console

from surface_gym.sharing import WorkFailed

from ..programs import EVALUATE, typed
from .command import EvaluateConfig, evaluate


def main() -> None:
    """Compare; an error ends it with one line."""
    config = tyro.cli(EvaluateConfig, prog=typed(EVALUATE))
    try:
        evaluate(config, Console())
    except (ValueError, WorkFailed) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("interrupted; --resume goes on with what is there")
