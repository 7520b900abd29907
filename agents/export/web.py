"""Agents for the playground: `python -m surface_gym.agents.export.web FOLDER`.

It adds files to the pages of `surface-gym web FOLDER`:

- `agents.bin`: weights of all policies for single parcels;
- `agents.json`: cards, which describe all agents. A policy's card describes the network. The card
  of a rule with fixed axes has the layouts for the page's starts;
- files for an agent with a compiled function, loaded when the agent is chosen, for example
  `agent-TimeSlots.wasm` (the function), `agent-merge-time-slots.bin` (the function's memory) and
  `agent-merge-parcels.bin` (weights);
- data of the page `home.html`: `home.bin`, a stream before its first arrival, and `home.json`, the
  layout of `home.bin`.

Registered rules with a compiled function are exported to WebAssembly. Rules that search, and rules
with actions of "quadrants", are left out.
"""

import argparse
import json
import shutil
from collections.abc import Sequence
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from surface_gym.cli import typed
from surface_gym.compiler.wasm import compile_module
from surface_gym.compiler.wasm_image import make_image, name_arguments
from surface_gym.config import EnvConfig
from surface_gym.env import make_batch
from surface_gym.files import replacing
from surface_gym.flow import take_away as ta
from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.batch import StreamBatch, stream_functions
from surface_gym.flow.kernel import make_assigning_kernel
from surface_gym.flow.module_view import ModuleView, view_modules
from surface_gym.flow.task import COLUMN
from surface_gym.registration import DEFAULT_STREAM, TASKS, env_id
from surface_gym.sensors import Camera
from surface_gym.tasks import Task
from surface_gym.web.build import AGENTS, SITE, make_config
from surface_gym.web.starts import SEEDS, describe, goal_marks

from .. import library, module_policy, slope_policy
from ..base import SIDE, Singles, find_rest
from ..evaluation.method import Method, policy_folders, stream_benchmark
from ..evaluation.report import filmed_scenario
from ..evaluation.streams import ARRANGED, MODULES, TASK, ladder
from ..module_places import find_places
from ..module_policy import ModulePolicy
from ..rules import Rule, find_prior, find_rules
from ..rules.base import CompiledController, FixedRule
from ..rules.sorting import OWN, SortEach
from ..scheduling.leading import schedule
from ..scheduling.scheduler import Scheduler
from ..slope_policy import LocalPolicy, ParcelPolicy
from .policy import Source, network_decision, of_run, shipped

Card = dict[str, Any]  # description of an agent, as `page/rule.js` and others read it
Runs = list[list[int]]  # run-length encoding: a choice, and the number of successive modules
WINDOW = "window"
HOME = ("home.bin", "home.json")
BOXES = 1000  # number of boxes in an hour; the home page scales the arrival rate
SEED = 0  # seed of the boxes' kinds and exits
ALGOS = {  # kind of decision by algorithm
    "ppo": ("halves", "quadrants"), "dqn": ("halves", "quadrants"), "modules": ("modules",),
}  # fmt: skip
SLOPE_ALGOS = ("parcels", "local")
# Inputs of the assignment of modules that vary within a stream.
OBEYING_READS = (
    "parcels.sensed",
    "parcels.body",
    "streams.present",
    "bodies.body",
    "bodies.edges",
    "bodies.corners",
)
RUN = "run"  # in place of a run's name, which may be invalid in a URL
CONTROL_PERIOD = EnvConfig().control_period  # [s] of all tasks in the page


def write_rules(task: str, folder: Path) -> dict[str, Card]:
    """Write the rules of a task that a page can run. Return the rules' cards by rule name."""
    found = {}
    for rule in find_rules(task):
        if rule.actions == "quadrants":  # the page has no such command
            continue
        made = rule.make(configure(rule))
        if isinstance(made, CompiledController):
            found[rule.name] = write_rule(rule, folder)
    return found


def configure(rule: Rule, **others: Any) -> EnvConfig:
    """Return the configuration of a rule's environment on the page.

    The kind of action is the rule's kind if this is "window" or "parcels", else "modules". The
    arguments `others` are passed on to `EnvConfig`.
    """
    actions = rule.actions if rule.actions in (WINDOW, "parcels") else "modules"
    return EnvConfig(rule.task, actions=actions, **others)


def write_rule(rule: Rule, folder: Path) -> Card:
    """Write a rule's function, and the rule's memory at an episode's start; return the card."""
    config = configure(rule)
    made: Any = rule.make(config)
    is_stream = config.task.is_stream
    name = f"{rule.task}-{rule.name.lower().replace(' ', '-')}"
    # On streams all tasks of a class share its function; two classes may have rules of one name.
    code = type(made).__name__ if is_stream else name
    card = {"kind": "rule", **write_machine(code, name, made.kernel, made.begin(), folder)}
    if is_stream:
        card |= {"choices": made.choices.tolist(), "modules": config.actions == "modules"}
    elif config.actions == WINDOW:
        card["window"] = list(config.action_kind.shape)
    return {**card, "camera": find_camera_numbers(rule)}


def write_machine(code: str, name: str, kernel: Any, arguments: Any, folder: Path) -> Card:
    """Write a compiled function and its memory for `page/machine.js`; return the files' names.

    Args:
        code: the function is written to the file agent-CODE.wasm, where CODE is this text.
        name: the memory is written to agent-NAME.bin and agent-NAME.json, where NAME is this text.
        kernel: the compiled function.
        arguments: the function's arguments at the start of an episode. They become the memory.
    """
    compile_module(kernel, arguments, folder / f"agent-{code}.wasm")
    image = make_image(kernel, arguments)
    write(folder / f"agent-{name}.bin", image.block)
    write(folder / f"agent-{name}.json", image.to_json().encode())
    return {"code": f"agent-{code}", "machine": f"agent-{name}"}


def find_camera_numbers(rule: Rule) -> dict[str, float]:
    """Return {name: value with a camera} for a rule's parameters that differ without a camera."""
    exact, camera = (
        name_arguments(made.kernel, made.begin())
        for made in (rule.make(configure(rule)), rule.make(configure(rule, sensors=Camera())))
        if isinstance(made, CompiledController)
    )
    return {name: camera[name] for name in exact if np.any(exact[name] != camera[name])}


def find_layouts(task: str, seeds: int = SEEDS) -> dict[str, list[Runs]]:
    """Return the layouts of rules with fixed axes, by the rule's name. A seed has one layout."""
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


class Weights:
    """The weights of networks, one after the other in one array."""

    def __init__(self) -> None:
        self._arrays: list[Singles] = []
        self._size = 0

    def add(self, values: Any) -> int:
        """Add an array; return the index of the array's first number."""
        self._arrays.append(np.asarray(values, dtype="<f4").ravel())
        self._size += self._arrays[-1].size
        return self._size - self._arrays[-1].size

    def add_layer(self, weights: Any, bias: Any) -> list[int]:
        """Add a layer's weights (outputs, inputs) and bias.

        Return the number of inputs, the number of outputs, and the index of the first weight.
        """
        outputs, inputs = weights.shape
        place = self.add(weights)
        self.add(bias)
        return [inputs, outputs, place]

    def add_layers(self, tensors: dict[str, Any], name: str) -> list[list[int]]:
        """Add all layers of the network `name`; return a result of `add_layer` for each layer."""
        found = [each.removesuffix(".weight") for each in tensors if each.endswith(".weight")]
        layers = [each for each in found if each.partition(".")[0] == name]
        return [
            self.add_layer(tensors[f"{each}.weight"], tensors[f"{each}.bias"])
            for each in sorted(layers, key=lambda each: int(each.partition(".")[2] or 0))
        ]

    def to_bytes(self) -> bytes:
        """Return all weights as bytes."""
        return b"".join(each.tobytes() for each in self._arrays)


def describe_policy(source: Source, weights: Weights) -> Card:
    """Add a policy's weights to `weights`; return the policy's card for `page/policy.js`."""
    decision, config = network_decision(source), source.config
    card = {
        "layers": [weights.add_layer(each.weights, each.bias) for each in decision.network.layers],
        "activation": decision.network.activation,
        "options": decision.options.tolist(),
    }
    shown = make_config(config.task).features
    columns = [shown.index(feature) for feature in config.features]
    if columns != list(range(len(columns))):
        card["columns"] = columns
    if decision.symmetry is not None:
        card["side"] = decision.symmetry.side
        card["mirror"] = decision.symmetry.images.tolist()
        card["parts"] = decision.symmetry.parts.tolist()
    return card


def describe_modules_policy(source: Source, weights: Weights, folder: Path) -> Card:
    """Return the card of a policy for Sort that all modules share. `page/policy.js` reads the card.

    Adds the policy's weights to `weights`. Writes a compiled function to the folder. This function
    computes the modules' observations.
    """
    config, tensors = source.config, source.weights
    view = module_policy.SortModuleView(config)
    first = torch.cat([tensors["_alike.weight"], tensors["_apart.weight"]], dim=1)
    return {
        "kind": "modules",
        **write_machine("module-places", "module-places", find_places, view.begin(), folder),
        "layers": [
            weights.add_layer(first, tensors["_alike.bias"]),
            *weights.add_layers(tensors, "_between"),
            *weights.add_layers(tensors, "_logits"),
        ],
        "shared": module_policy.SHARED,
        "mirror": config.images.tolist(),
        "rest": find_rest(config), "side": SIDE,
    }  # fmt: skip


def describe_source(source: Source, weights: Weights, folder: Path) -> Card:
    """Add the weights of a single-parcel policy to `weights`; return the policy's card."""
    if isinstance(source.policy, ModulePolicy):
        return describe_modules_policy(source, weights, folder)
    return describe_policy(source, weights)


def write_policies(
    tasks: Sequence[str], weights: Weights, folder: Path
) -> dict[str, dict[str, Card]]:
    """Return the cards of shipped single-parcel policies by task and name.

    Adds the policies' weights to `weights`. A policy that observes optional groups of features has
    a larger network, so its weights get a separate file.
    """
    found: dict[str, dict[str, Card]] = {}
    for name in library.names():
        card = library.load(name).card
        if not is_shown(card) or (card.observe and card.task not in tasks):
            continue
        own = Weights() if card.observe else weights
        described = describe_source(shipped(name), own, folder)
        if card.observe:
            described["weights"] = f"agent-{name}.bin"
            write(folder / described["weights"], own.to_bytes())
        found.setdefault(card.task, {})[name] = described
    return found


def is_shown(card: library.PolicyCard) -> bool:
    """Return whether the page can run a single-parcel policy.

    A policy that all modules share must not observe optional groups of features. Other policies may
    observe these groups.
    """
    return card.actions in ALGOS.get(card.algo, ()) and (card.algo != "modules" or not card.observe)


def write_run(
    run: Path,
    policy: library.TrainedPolicy,
    name: str | None,
    task: str | None,
    folder: Path,
    package: Path,
) -> tuple[str, str]:
    """Write the package's agents and a run's policy to `folder`; return names of task and policy.

    Args:
        run: folder of a training run.
        policy: the run's policy, from `read_run`.
        name: base name of the task's files. None stands for the name of the run's task.
        task: task on the command line.
        package: folder with the package's agents.
    """
    of_task, agent = name or policy.card.task, run.resolve().name
    weights, agents = read_agents(package)
    there = agents.setdefault(of_task, {})
    if isinstance(policy, ParcelPolicy | LocalPolicy):
        for module in package.glob("agent-*.wasm"):  # avoids a second compilation
            shutil.copyfile(module, folder / module.name)
        there["obeying"] = write_obeying(of_task, folder)
        described = write_slope_policy(RUN, policy, _first_seed(run), folder)
        there.setdefault("streams", {})[agent] = described
    else:
        described = describe_source(of_run(run, task=_own_task(task)), weights, folder)
        there.setdefault("policies", {})[agent] = described
    _write_beside(agents, weights, folder, package)
    return of_task, agent


def read_run(run: Path, task: str | None) -> library.TrainedPolicy:
    """Read the policy of a run's first seed; raise a ValueError if the page cannot run the policy.

    `task` is the task on the command line. If the task is in a file, the file is executed.
    """
    own = _own_task(task)
    policy = library.read(_first_seed(run), None if own is None else library.find_task(own))
    _check_run(policy.card)
    if own is not None and isinstance(policy, ParcelPolicy | LocalPolicy):
        raise ValueError(
            "run must hold a policy of one parcel for a custom task, since the page knows only the "
            f"package's streams, got {policy.card.algo} on {policy.card.task}"
        )
    if own is None and task not in (None, policy.card.task):
        raise ValueError(f"task must be the run's, {policy.card.task!r}, got {task!r}")
    return policy


def _own_task(task: str | None) -> str | None:
    return task if task is not None and ":" in task else None


def _first_seed(run: Path) -> Path:
    return next(iter(policy_folders(run).values()))


def write_own_rules(task: Task, name: str, folder: Path, package: Path) -> None:
    """Write the rules of a custom task, and the package's agents, to a folder.

    If the task is not registered or has no rules, nothing is written. `name` is the base name of
    the task's files. `package` is the folder with the package's agents.
    """
    rules = write_rules(task.name, folder) if task.name in TASKS else {}
    if not rules:
        return
    weights, agents = read_agents(package)
    kind = "streams" if task.is_stream else "rules"
    agents[name] = {kind: rules}
    if task.is_stream:
        agents[name]["obeying"] = write_obeying(task.name, folder)
    _write_beside(agents, weights, folder, package)


def read_agents(package: Path) -> tuple[Weights, dict[str, Any]]:
    """Read weights and cards of a folder's agents. Without agents, weights and cards are empty."""
    weights = Weights()
    if not (package / AGENTS[1]).is_file():
        return weights, {}
    weights.add(np.frombuffer((package / AGENTS[0]).read_bytes(), dtype="<f4"))
    return weights, json.loads((package / AGENTS[1]).read_text())


def _write_beside(agents: dict[str, Any], weights: Weights, folder: Path, package: Path) -> None:
    site = folder if (folder / SITE).is_file() else package
    _write_all(json.loads((site / SITE).read_text()), agents, weights, folder)


def _check_run(card: library.PolicyCard) -> None:
    """Raise a ValueError if the page cannot run the policy of `card`.

    The page runs only some kinds of policies, and only with the page's own control period.
    """
    if not (is_shown(card) or card.algo in SLOPE_ALGOS):
        raise ValueError(
            f"run must hold a policy of {', '.join((*SLOPE_ALGOS, *ALGOS))}, on halves or "
            "quadrants, or on modules that observe the task's own features alone, "
            f"got {card.algo}, {card.actions}, {list(card.observe)}"
        )
    if card.control_period != CONTROL_PERIOD:
        raise ValueError(
            f"control_period must be {CONTROL_PERIOD:g} s, as in the page, "
            f"got {card.control_period:g}"
        )


def describe_each(rule: SortEach) -> Card:
    """Return the card of a rule that uses a single-parcel policy for every parcel of a stream.

    The policy's weights are in the files of the single-parcel task.
    """
    return {
        "kind": "each", "present": COLUMN.present.place, "waits": COLUMN.waits.place,
        "side": COLUMN.side.place, "own": OWN, "roll": int(rule.choices[0]),
        "policy": {"task": rule.policy.card.task, "name": rule.name},
    }  # fmt: skip


def write_obeying(task: str, folder: Path) -> Card:
    """Write the compiled function that finds the parcel that each module of a surface obeys.

    The function has the same arguments as the task's WebAssembly code. So a page can copy the
    task's memory, and run the function on the copy. Return the function's card.
    """
    batch = make_batch(EnvConfig(task), 1, compiles=False)
    kernel, name = make_assigning_kernel(stream_functions(batch.config)), f"agent-{task}-obeying"
    module = compile_module(kernel, batch.arguments, folder / f"{name}.wasm")
    return {"code": name, "signature": module.signature, "reads": OBEYING_READS}


def describe_parcel_network(tensors: dict[str, Any], rule: Card, weights: Weights) -> Card:
    """Return the card of a policy that decides for one parcel, and corrects a rule's decision.

    The function adds the policy's weights `tensors` to `weights`. `rule` is the rule's card.
    """
    return {
        **rule,
        "kind": "parcels",
        **{name: weights.add_layers(tensors, name) for name in ("encoder", "actor")},
        **{name: weights.add_layers(tensors, name)[0] for name in ("attend", "pair")},
        "heads": library.HEADS, "prior": slope_policy.PRIOR, "apart": slope_policy.PAIR_RANGE,
        "most": slope_policy.MOST, "present": ta.COLUMN.present.place,
        "time": ta.COLUMN.time.place, "end": ta.COLUMN.to_the_end.place,
        "offset": ta.COLUMN.offset.place, "forward": ta.COLUMN.forward_speed.place,
    }  # fmt: skip


def describe_module_network(tensors: dict[str, Any], config: EnvConfig, weights: Weights) -> Card:
    """Return the card of a policy that decides for one module.

    The function adds the policy's weights `tensors` to `weights`. The function also adds the
    constant table of random numbers, from which all modules draw their choices.
    """
    return {
        "kind": "modules",
        "actor": weights.add_layers(tensors, "actor"),
        "numbers": [weights.add(slope_policy.find_numbers()), slope_policy.NUMBERS],
        "hold": slope_policy.HOLD, "apart": slope_policy.ROW_OFFSET, "most": slope_policy.MOST,
        "period": config.control_period, "rest": find_rest(config),
        "time": ta.COLUMN.time.place,
    }  # fmt: skip


def write_stream_agents(task: str, folder: Path) -> dict[str, Card]:
    """Write the rules and shipped agents of a stream task; return their cards by name."""
    found = write_rules(task, folder)
    for rule in find_rules(task):
        made = rule.make(configure(rule))
        if isinstance(made, SortEach):
            found[rule.name] = describe_each(made)
    for name in library.names():
        policy = library.load(name)
        if policy.card.task == task and isinstance(policy, ParcelPolicy | LocalPolicy):
            first = library.SHELF / name / f"seed-{library.seeds(name)[0]}"
            found[name] = write_slope_policy(name, policy, first, folder)
    return found


def write_slope_policy(
    name: str, policy: ParcelPolicy | LocalPolicy, source: Path, folder: Path
) -> Card:
    """Write a slope policy with the weights from the folder `source`; return the policy's card."""
    task, weights = policy.card.task, Weights()
    tensors = library.read_weights(library.read_files(source))
    config = EnvConfig(task, actions=policy.card.actions)
    if isinstance(policy, ParcelPolicy):
        prior = find_prior(task)
        assert prior is not None
        rule = write_rule(prior, folder)
        card = describe_parcel_network(tensors, rule, weights)
    else:
        tables = np.zeros((1, config.rows, len(config.features)), dtype=np.float32)
        view = write_machine(
            "module-view", f"{task}-module-view", view_modules,
            ModuleView(config).arguments(tables), folder,
        )  # fmt: skip
        card = {**view, **describe_module_network(tensors, config, weights)}
    write(folder / f"agent-{name}.bin", weights.to_bytes())
    return {**card, "weights": f"agent-{name}.bin"}


def write_agents(folder: Path) -> dict[str, dict[str, Any]]:
    """Write the agents for the tasks of a site; return the agents' cards by task."""
    site = json.loads((folder / SITE).read_text())
    weights = Weights()
    policies = write_policies(site["tasks"], weights, folder)
    agents: dict[str, dict[str, Any]] = {}
    for task in site["tasks"]:
        if "-" in task:  # a variant, with a camera or driven modules
            continue
        if make_config(task).task.is_stream:
            found = write_stream_agents(task, folder)
            agents[task] = {"obeying": write_obeying(task, folder), "streams": found}
        else:
            agents[task] = {
                "policies": policies.get(task, {}),
                "rules": write_rules(task, folder),
                "layouts": find_layouts(task),
            }
    _write_all(site, agents, weights, folder)
    return agents


def _write_all(
    site: dict[str, Any], agents: dict[str, dict[str, Any]], weights: Weights, folder: Path
) -> None:
    """Write the weights and the cards. Add to the site's description that the site has agents.

    `site` is the description as read from the description's file. `agents` are the cards by task.
    """
    write(folder / AGENTS[0], weights.to_bytes())
    write(folder / AGENTS[1], (json.dumps(agents, separators=(",", ":")) + "\n").encode())
    write(folder / SITE, (json.dumps({**site, "agents": True}) + "\n").encode())


def find_methods() -> list[Method]:
    """Return the two methods that the home page compares, for the upper and for the lower line."""
    named = {each.name: each for each in ladder()}
    return [named[ARRANGED], named[MODULES]]


def make_home_config(method: Method) -> EnvConfig:
    """Return the configuration of the line that `method` controls on the home page."""
    return filmed_scenario(TASK).config(method, BOXES).replace(duration=HOUR)


@lru_cache(maxsize=1)
def make_schedulers() -> tuple[Scheduler, ...]:
    """Make the schedulers of the home page's lines. This takes seconds."""
    made = [method.controller(make_home_config(method), 0) for method in find_methods()]
    return tuple(each for each in made if isinstance(each, Scheduler))


def place_stream(config: EnvConfig) -> StreamBatch:
    """Make the stream of the home page. On every line, the same boxes arrive at the same times."""
    batch = StreamBatch(config, 1)
    batch.seed(0, np.random.default_rng(SEED))
    batch.place_drawn(np.zeros(1, dtype=np.int64))
    return batch


def write_home(folder: Path, obeying: dict[str, Any]) -> None:
    """Write the home page's comparison of two schedulers, which lead the same stream of boxes.

    The page runs the physics in the kernel `flow.wasm`. This kernel works with all exits, gates
    and boxes. The two schedulers share one file of code, but each has a memory of its own.
    The argument `obeying` is the result of `write_obeying`.
    """
    batch = place_stream(make_home_config(find_methods()[0]))
    image = make_image(batch.make_kernel(), batch.arguments)
    layout = {
        **image.layout(),
        "scene": describe(batch),
        "starts": {"fields": [], "marks": [goal_marks(batch)]},  # the image is the only start
        "warmUp": stream_benchmark(TASK).warm_up,
        "obeying": obeying,
        "lines": [
            {
                **write_machine(
                    "schedule", f"home-{place}", schedule, each.start_arguments(), folder
                ),
                "byGroups": each.library.lead.groups is not None,
            }
            for place, each in enumerate(make_schedulers())
        ],
    }
    written = (json.dumps(layout, separators=(",", ":"), allow_nan=False) + "\n").encode()
    for name, content in zip(HOME, (image.block, written), strict=True):
        write(folder / name, content)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command that writes the agents of a site."""
    parser = argparse.ArgumentParser(
        prog=typed("agents.export.web"),
        description="Write agents beside the pages of `surface-gym web`.",
    )
    parser.add_argument("folder", type=Path, help="that `surface-gym web` has written")
    folder = parser.parse_args(arguments).folder
    if not (folder / SITE).is_file():
        parser.error(f"folder must be one that `surface-gym web` has written, got {folder}")
    agents = write_agents(folder)
    if DEFAULT_STREAM in agents:  # the home page runs its module
        write_home(folder, agents[DEFAULT_STREAM]["obeying"])


if __name__ == "__main__":
    main()
