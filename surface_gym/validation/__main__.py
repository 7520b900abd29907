"""`python -m surface_gym.validation`, the same as `surface-gym validation`."""

from surface_gym.cli import run_command

if __name__ == "__main__":
    run_command("validation")
