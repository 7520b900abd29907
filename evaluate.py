"""Compare every controller and agent on every task: `python evaluate.py --help`."""

from surface_gym.agents.evaluation.cli import main

if __name__ == "__main__":
    main()
