"""The start of a command whose libraries come with an extra."""

import sys
from collections.abc import Callable
from importlib import import_module

OPTIONAL = ("matplotlib", "moviepy", "mujoco", "rich", "stable_baselines3", "torch", "tyro", "yaml")


def start(package: str, extra: str) -> None:
    """Run the `main` of a package's module `command`, or say in one line what to install.

    Args:
        package: its name.
        extra: of surface_gym, which brings what the command needs.
    """
    run(lambda: import_module(f"{package}.command").main(), f"python -m {package}", extra)


def run(main: Callable[[], None], program: str, extra: str) -> None:
    """Run a command, or say in one line what to install.

    Args:
        main: imports what it needs, and runs.
        program: how it was called.
        extra: of surface_gym, which brings what the command needs.
    """
    try:
        main()
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library not in OPTIONAL:
            raise
        sys.exit(
            f"error: {program} needs {library}, which is not installed: "
            f"pip install 'surface_gym[{extra}]'"
        )
