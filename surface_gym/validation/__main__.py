"""`python -m surface_gym.validation`."""

from surface_gym.commands import start


def main() -> None:
    """Run the command, or say in one line what to install."""
    start("surface_gym.validation", "validation")


if __name__ == "__main__":
    main()
