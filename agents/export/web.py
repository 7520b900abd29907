"""Agents for the playground: `python -m surface_gym.agents.export.web FOLDER`.

Beside the pages of `surface-gym web FOLDER` it writes `agents.bin`, the weights of those policies
of the package that see what the page shows, and `agents.json`, their networks, and the layouts that
rules choose for the page's starts; and what the page `home.html` shows.
"""

import argparse
import json
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from surface_gym.cli import typed
from surface_gym.config import EnvConfig
from surface_gym.files import replacing
from surface_gym.flow.task import OWN, PRESENT, WAITS
from surface_gym.registration import FLOW_TASK, env_id
from surface_gym.web.build import AGENTS, SITE
from surface_gym.web.starts import SEEDS

from .. import library
from ..base import Singles, find_axes
from ..rules import RULES
from ..rules.base import FixedRule
from ..rules.sorting import FixedLayout
from ..rules.streams import PAST_START, SIDE
from .home import write_home
from .policy import NetworkDecision, network_decision, shipped

ALGOS = ("ppo", "dqn")
Runs = list[list[int]]  # a choice, and how many modules in a row have it


def describe_policy(decision: NetworkDecision, place: int) -> tuple[dict[str, Any], list[Singles]]:
    """Describe a policy for `page/policy.js`, and list its weights, from a place [floats] on."""
    layers, weights = [], []
    for layer in decision.network.layers:
        outputs, inputs = layer.weights.shape
        layers.append([inputs, outputs, place])
        weights += [layer.weights.ravel(), layer.bias]
        place += layer.weights.size + layer.bias.size
    card = {
        "layers": layers,
        "activation": decision.network.activation,
        "choices": len(decision.angles),
    }
    if decision.symmetry is not None:
        card["side"] = decision.symmetry.side
        card["mirror"] = decision.symmetry.images.tolist()
    return card, weights


def find_policies() -> tuple[dict[str, dict[str, Any]], Singles]:
    """Describe the policies by task and name; with the weights of all, one after the other."""
    found: dict[str, dict[str, Any]] = {}
    weights: list[Singles] = []
    for name in library.names():
        card = library.load(name).card
        if card.algo not in ALGOS or card.observe or card.actions != "halves":
            continue
        place = sum(each.size for each in weights)
        described, more = describe_policy(network_decision(shipped(name)), place)
        found.setdefault(card.task, {})[name] = described
        weights += more
    return found, np.concatenate(weights)


def find_layouts(task: str, seeds: int = SEEDS) -> dict[str, list[Runs]]:
    """Collect, by the rule's name, the layouts that rules choose for the starts of the seeds."""
    env, config = gym.make(env_id(task)), EnvConfig(task)
    starts = np.stack([env.reset(seed=seed)[0] for seed in range(seeds)])
    found = {}
    for rule in RULES:
        if rule.task != task or rule.actions != "modules" or rule.searches:
            continue
        made = rule.make(config)
        if isinstance(made, (FixedRule, FixedLayout)):
            layouts = np.asarray(made.predict(starts)[0])
            found[rule.name] = [_packed(layout.tolist()) for layout in layouts]
    return found


def describe_parcel_rules(policy: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Describe, by name, rules of Flow that decide for each parcel, one of them by a policy."""
    axes = find_axes(EnvConfig(FLOW_TASK))
    card = {
        "present": PRESENT, "waits": WAITS, "past": PAST_START, "side": SIDE, "own": OWN,
        "axes": {"roll": axes.roll, "left": axes.left, "right": axes.right},
    }  # fmt: skip
    return {"event rule": {**card, "policy": None}, "sort-ppo": {**card, "policy": policy}}


def _packed(choices: list[int]) -> Runs:
    return [[choice, len(list(run))] for choice, run in groupby(choices)]


def write_agents(folder: Path) -> None:
    """Write the agents of the tasks that a site has."""
    site = json.loads((folder / SITE).read_text())
    policies, weights = find_policies()
    agents: dict[str, dict[str, Any]] = {}
    for task in site["tasks"]:
        if task in policies:
            agents[task] = {"policies": policies[task], "layouts": find_layouts(task)}
        elif task == FLOW_TASK:
            agents[task] = {"parcels": describe_parcel_rules(policies["sort"]["sort-ppo"])}
    contents = {
        AGENTS[0]: weights.astype("<f4").tobytes(),
        AGENTS[1]: (json.dumps(agents, separators=(",", ":")) + "\n").encode(),
        SITE: (json.dumps({**site, "agents": True}) + "\n").encode(),
    }
    for name, content in contents.items():
        with replacing(folder / name) as part:
            part.write_bytes(content)


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the agents of a site."""
    parser = argparse.ArgumentParser(
        prog=typed("agents.export.web"),
        description="Write agents beside the pages of `surface-gym web`.",
    )
    parser.add_argument("folder", type=Path, help="that `surface-gym web` has written")
    folder = parser.parse_args(arguments).folder
    write_agents(folder)
    write_home(folder)


if __name__ == "__main__":
    main()
