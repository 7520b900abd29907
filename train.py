"""Train an agent and compare it with the paper's fixed layout: `python train.py --help`."""

from surface_gym.agents.train_cli import main

if __name__ == "__main__":
    main()
