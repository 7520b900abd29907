"""`python -m surface_gym.paper`, the same as `surface-gym paper`."""

from surface_gym.cli import run_command

if __name__ == "__main__":
    run_command("paper")
