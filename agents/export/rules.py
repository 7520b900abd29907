"""Rules for the playground: compiled functions with their initial memory, and fixed layouts.

Every registered rule with a compiled function is exported to WebAssembly. Rules with fixed axes are
exported as layouts. Rules that search are left out.
"""

from itertools import groupby
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from surface_gym.compiler.wasm import compile_module
from surface_gym.compiler.wasm_image import make_image, name_arguments
from surface_gym.config import EnvConfig
from surface_gym.files import replacing
from surface_gym.registration import env_id
from surface_gym.sensors import Camera
from surface_gym.web.starts import SEEDS

from ..rules import Rule, find_rules
from ..rules.base import CompiledController, FixedRule

Card = dict[str, Any]  # as `page/rule.js` reads it
Runs = list[list[int]]  # run-length encoding: a choice, and the number of successive modules
WINDOW = "window"


def write_rules(task: str, folder: Path) -> dict[str, Card]:
    """Write a task's rules that have a compiled function; return their cards by name."""
    found = {}
    for rule in find_rules(task):
        config = configure(rule)
        made = rule.make(config)
        if isinstance(made, CompiledController):
            found[rule.name] = write_rule(rule, folder)
    return found


def configure(rule: Rule, **others: Any) -> EnvConfig:
    """Return the configuration of a rule on the page, where modules obey individually."""
    actions = rule.actions if rule.actions in (WINDOW, "parcels") else "modules"
    return EnvConfig(rule.task, actions=actions, **others)


def write_rule(rule: Rule, folder: Path) -> Card:
    """Write a rule with its memory at the start of an episode; return its card."""
    config = configure(rule)
    made: Any = rule.make(config)
    has_halves = config.actions == "parcels"
    slug = rule.name.lower().replace(" ", "-")
    code = slug if has_halves else f"{rule.task}-{slug}"
    name = f"{rule.task}-{slug}"
    card = {"kind": "rule", **write_machine(code, name, made.kernel, made.begin(), folder)}
    if has_halves:
        card["choices"] = made.choices.tolist()
    elif config.actions == WINDOW:
        card["window"] = list(config.action_kind.shape)
    return {**card, "camera": find_camera_numbers(rule)}


def write_machine(code: str, name: str, kernel: Any, arguments: Any, folder: Path) -> Card:
    """Write a compiled function and its memory, for `page/machine.js`."""
    compile_module(kernel, arguments, folder / f"agent-{code}.wasm")
    image = make_image(kernel, arguments)
    write(folder / f"agent-{name}.bin", image.block)
    write(folder / f"agent-{name}.json", image.to_json().encode())
    return {"code": f"agent-{code}", "machine": f"agent-{name}"}


def find_camera_numbers(rule: Rule) -> dict[str, float]:
    """Return a rule's parameters that differ with a camera, by name."""
    exact, camera = (
        name_arguments(made.kernel, made.begin())
        for made in (rule.make(configure(rule)), rule.make(configure(rule, sensors=Camera())))
        if isinstance(made, CompiledController)
    )
    return {name: camera[name] for name in exact if np.any(exact[name] != camera[name])}


def find_layouts(task: str, seeds: int = SEEDS) -> dict[str, list[Runs]]:
    """Return the layouts that rules choose for the starts of the seeds, by the rule's name."""
    rules = {each.name: each for each in find_rules(task) if each.actions == "modules"}
    made = {name: rule.make(configure(rule)) for name, rule in rules.items() if not rule.searches}
    fixed = {name: rule for name, rule in made.items() if isinstance(rule, FixedRule)}
    env = gym.make(env_id(task))
    starts = np.stack([env.reset(seed=seed)[0] for seed in range(seeds)])
    return {
        name: [_pack(layout.tolist()) for layout in np.asarray(rule.predict(starts)[0])]
        for name, rule in fixed.items()
    }


def _pack(choices: list[int]) -> Runs:
    return [[choice, len(list(run))] for choice, run in groupby(choices)]


def write(file: Path, content: bytes) -> None:
    """Write a file atomically."""
    with replacing(file) as part:
        part.write_bytes(content)
