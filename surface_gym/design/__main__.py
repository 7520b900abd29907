"""`python -m surface_gym.design`."""

import sys

OPTIONAL = ("matplotlib", "rich", "tyro")


def main() -> None:
    """Run the command, or say in one line what to install."""
    try:
        from surface_gym.design import command

        command.main()
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library not in OPTIONAL:
            raise
        sys.exit(
            f"error: python -m surface_gym.design needs {library}, which is not installed: "
            "pip install 'surface_gym[agents]'"
        )


if __name__ == "__main__":
    main()
