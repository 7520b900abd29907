"""`python -m surface_gym.agents.export`, which is `surface-gym export`."""

from surface_gym.cli import run_command

if __name__ == "__main__":
    run_command("export")
