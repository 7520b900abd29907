"""`python -m surface_gym.design`."""

from importlib import import_module

from surface_gym.commands import run


def main() -> None:
    """Run the command, or say in one line what to install."""
    run(
        lambda: import_module("surface_gym.design.cli").main(),
        "python -m surface_gym.design",
        "agents",
    )


if __name__ == "__main__":
    main()
