"""`python -m surface_gym.design`, the same as `surface-gym design`."""

from surface_gym.cli import run_command

if __name__ == "__main__":
    run_command("design")
