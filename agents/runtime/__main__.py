"""`python -m agents.runtime`."""

from importlib import import_module

from surface_gym.commands import run


def main() -> None:
    """Run the command, or say in one line what to install."""
    run(lambda: import_module(".command", __package__).main(), f"python -m {__package__}", "agents")


if __name__ == "__main__":
    main()
