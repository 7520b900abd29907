"""Rules for the playground: their compiled functions, and the memory of each as an episode begins.

A rule that is registered is there, and its function is compiled to WebAssembly. Rules that arrange
axes once are there by the layouts that they choose; a rule that searches is not.
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
Runs = list[list[int]]  # a choice, and how many modules in a row have it
WINDOW = "window"  # kind of action that moves with the parcel


def write_rules(task: str, folder: Path) -> dict[str, Card]:
    """Write a task's rules that have a compiled function; describe them by name."""
    found = {}
    for rule in find_rules(task):
        config = configure(rule)
        made = rule.make(config)
        if isinstance(made, CompiledController):
            found[rule.name] = write_rule(rule, folder)
    return found


def configure(rule: Rule, **others: Any) -> EnvConfig:
    """Configure the page's environment of a rule, in which modules obey one by one."""
    actions = rule.actions if rule.actions in (WINDOW, "parcels") else "modules"
    return EnvConfig(rule.task, actions=actions, **others)


def write_rule(rule: Rule, folder: Path) -> Card:
    """Write a rule as it begins an episode."""
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
    """Write a compiled function, and a memory of it, as `page/machine.js` loads them."""
    compile_module(kernel, arguments, folder / f"agent-{code}.wasm")
    image = make_image(kernel, arguments)
    write(folder / f"agent-{name}.bin", image.block)
    write(folder / f"agent-{name}.json", image.to_json().encode())
    return {"code": f"agent-{code}", "machine": f"agent-{name}"}


def find_camera_numbers(rule: Rule) -> dict[str, float]:
    """Find, by name, the numbers of a rule that are others where a camera senses the parcels."""
    exact, camera = (
        name_arguments(made.kernel, made.begin())
        for made in (rule.make(configure(rule)), rule.make(configure(rule, sensors=Camera())))
        if isinstance(made, CompiledController)
    )
    return {name: camera[name] for name in exact if np.any(exact[name] != camera[name])}


def find_layouts(task: str, seeds: int = SEEDS) -> dict[str, list[Runs]]:
    """Collect, by the rule's name, the layouts that rules choose for the starts of the seeds."""
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
    """Write a file, whole or not at all."""
    with replacing(file) as part:
        part.write_bytes(content)
