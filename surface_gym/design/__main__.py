"""`python -m surface_gym.design`."""

from surface_gym.commands import start


def main() -> None:
    """Run the command, or say in one line what to install."""
    start("surface_gym.design", "agents")


if __name__ == "__main__":
    main()
