"""`python -m surface_gym.agents.runtime`, which is `surface-gym runtime`."""

from surface_gym.cli import run_command

if __name__ == "__main__":
    run_command("runtime")
