"""`python -m agents.export`, and `python -m surface_gym.agents.export` once installed."""

from surface_gym.commands import start


def main() -> None:
    """Run the command, or say in one line what to install."""
    start(str(__package__), "agents")


if __name__ == "__main__":
    main()
