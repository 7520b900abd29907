"""The start of a command whose libraries come with an extra."""

import sys
from importlib import import_module

OPTIONAL = ("matplotlib", "rich", "tyro")


def start(package: str, extra: str) -> None:
    """Run the `main` of a package's module `command`, or say in one line what to install.

    Args:
        package: its name.
        extra: of surface_gym, which brings what the command needs.
    """
    try:
        import_module(f"{package}.command").main()
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library not in OPTIONAL:
            raise
        sys.exit(
            f"error: python -m {package} needs {library}, which is not installed: "
            f"pip install 'surface_gym[{extra}]'"
        )
