"""Print the model card (README.md) of a run for the Hugging Face Hub, from its card.yaml.

python examples/hub/model_card.py runs/NAME > README.md
"""

import argparse
from pathlib import Path
from typing import Any

import yaml

CARD, POLICY = "card.yaml", "policy.yaml"
USE = """```python
import gymnasium as gym
from surface_gym import agents

policy = agents.read("FOLDER")  # of this repository's files
env = gym.make(policy.env_id, **policy.env_kwargs)
observation, info = env.reset(seed=0)
action, _ = policy.predict(observation)
```"""


def make_card(folder: Path) -> str:
    """Return the model card for the folder of a run or of a shipped agent."""
    run = yaml.safe_load((folder / CARD).read_text())
    policy = yaml.safe_load(next(iter(sorted(folder.rglob(POLICY)))).read_text())
    env_id, algo = policy["env_id"], policy["algo"]
    results: list[dict[str, Any]] = [
        {
            "task": {"type": "reinforcement-learning", "name": "reinforcement-learning"},
            "dataset": {"name": f"{env_id}, {preset}", "type": env_id},
            "metrics": [{"type": "success", "name": "success rate", "value": found["success"]}],
        }
        for preset, found in run["results"].items()
        if "success" in found
    ]
    head: dict[str, Any] = {
        "library_name": "surface_gym",
        "tags": ["reinforcement-learning", "robotics", env_id, algo],
        "model-index": [{"name": f"{algo} on {env_id}", "results": results}],
    }
    rows = [
        f"| {each['dataset']['name']} | {each['metrics'][0]['value']:.3f} |" for each in results
    ]
    parts = (
        f"---\n{yaml.safe_dump(head, sort_keys=False)}---",
        f"# {algo} on {env_id}",
        "An agent for a smart surface that steers parcels by friction, trained with surface_gym.",
        "\n".join(["| environment | success rate |", "|---|---:|", *rows]),
        USE,
        f"Trained by `{run['command']}`: {sum(run['steps'])} control periods, "
        f"{sum(run['seconds'])} s.",
    )
    return "\n\n".join(parts)


def main() -> None:
    """Print the card."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path, help="of the run")
    print(make_card(parser.parse_args().folder))


if __name__ == "__main__":
    main()
