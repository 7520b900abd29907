"""Tasks, learning algorithms and trained policies by name; the package or a user defines them.
A policy is a safetensors file of weights and a card, which describes environment and network.

A card is a YAML file. Reading a policy executes no code from its files. PyTorch is imported only
when a policy is loaded. The size of YAML files is limited, and their numbers are plain decimals.
"""

import hashlib
import importlib.util
import json
import re
import sys
from abc import ABC
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import yaml

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.feature_groups import GROUPS
from surface_gym.files import (
    DAMAGE,
    describe_damage,
    parse_integer,
    parse_number,
    read_bytes,
    read_text,
    replacing,
)
from surface_gym.registration import TASKS, env_id
from surface_gym.registry import Registry
from surface_gym.tasks.base import Task
from surface_gym.tasks.features import compute_digest

from .base import BatchController

SHELF = Path(__file__).parent / "shipped"
WEIGHTS = "policy.safetensors"
OLD_WEIGHTS = "policy.pt"  # weights of older policies
ZIP = b"PK"  # first bytes of older weights
POLICY = 2**27  # [bytes] maximum size of weights; the largest here has 0.2 million
YAML = 30_000  # [bytes] maximum size, parsed in a second; the largest here has 6000
NODES = 100_000  # maximum nodes of a YAML file, with aliases expanded
BRACKETS = 1000
CARD = "policy.yaml"
DIGEST = "digest"  # card's field with the digest of its other fields and the weights
OWN = "Own/"  # prefix of custom tasks and algorithms; cards do not name their files
QUEUE = 4  # waiting parcels visible to a policy on a schedule
MOST_LAYERS = 16  # maximum layers of a network
HEADS = 4  # heads of attention of PPO per parcel, which share its units

Weights = Mapping[str, Any]  # arrays of a policy by name


@dataclass(frozen=True)
class Algorithm:
    """A learning algorithm: configuration, training, and requirements of its policies."""

    label: str  # label in tables
    config: type[Any]  # options of a run: a subclass of agents.learning.config's `TrainConfig`
    # called with the options, the run's folder and `on_progress`; returns a `TrainResult` of
    # agents.learning.runs, and leaves a policy in the folder by `save_policy`
    train: Callable[..., Any]
    # called with a policy's card, its weights and the configuration of its environment
    build: Callable[..., "TrainedPolicy"]
    actions: tuple[str, ...]  # supported kinds of action
    serves: Callable[[Task], bool] = lambda task: not task.is_stream  # whether it supports a task
    served: str = "one of a single parcel"  # description of supported tasks
    # arguments of its environments beside task, actions, control period and observed groups
    env_kwargs: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    # arguments of `load` that `build` also takes; None: unknown
    build_options: tuple[str, ...] | None = None

    def check(self, task: Task, actions: str) -> None:
        """Raise a ValueError if the algorithm does not support the task or the kind of action."""
        if not self.serves(task):
            raise ValueError(f"task must be {self.served} for {self.label}, got {task.name!r}")
        checks.one_of("actions", actions, self.actions)


ALGORITHMS: Registry[Algorithm] = Registry("algo", "surface_gym.agents.learning.algorithms")
_NAMED: list[str] = []  # custom algorithms loaded from files in this process


def find_algorithm(name: str) -> Algorithm:
    """Return an algorithm by name. If the name is path/to/file.py:NAME, execute that file."""
    if ":" not in name:
        return ALGORITHMS.find(name)
    found = _find_in_file("algo", name, lambda value: isinstance(value, Algorithm), "an Algorithm")
    if name not in _NAMED:
        _NAMED.append(name)
    registered: Algorithm = ALGORITHMS.register(card_algo(name), found)
    return registered


def is_known(algo: str) -> bool:
    """Return whether an algorithm is registered, or was loaded from a file in this process."""
    return algo in ALGORITHMS or algo in _NAMED


def find_task(name: str) -> Task:
    """Make a task by name. If the name is path/to/file.py:Class, execute that file."""
    if name in TASKS:
        return TASKS[name]()

    def is_task(value: Any) -> bool:
        return isinstance(value, type) and issubclass(value, Task)

    task: Task = _find_in_file("task", name, is_task, "a class that inherits from Task")()
    return task


def task_kind(name: str) -> str:
    """Return the name under which a task or its base class is registered, else the task's name."""
    return name if name in TASKS else EnvConfig(task=find_task(name)).task_name


def task_label(name: str) -> str:
    """Return a short name of a task or algorithm for tables and file names."""
    return name.rpartition(":")[2].lower()


def card_env_id(name: str) -> str:
    """Return a task's environment id for a policy's card. A custom task has the id "Own/CLASS"."""
    return env_id(name) if name in TASKS else OWN + name.rpartition(":")[2]


def card_algo(name: str) -> str:
    """Return an algorithm's name for a policy's card. For "FILE:NAME", the name is "Own/NAME"."""
    return OWN + name.rpartition(":")[2] if ":" in name else name


def task_files(*names: str | None) -> tuple[Path, ...]:
    """List the files of custom tasks and algorithms. Other machines need copies of these files.

    A name in `names` is custom if it has the form path/to/file.py:Name.
    """
    return tuple(
        Path(name.rpartition(":")[0]) for name in names if name is not None and ":" in name
    )


def _find_in_file(kind: str, name: str, fits: Callable[[Any], bool], wanted: str) -> Any:
    """Execute a file, and return an object of the file. `name` is path/to/file.py:Name.

    The function `fits` checks the object. If the check fails, raise a ValueError. The text `wanted`
    describes a valid object.
    """
    file, colon, called = name.rpartition(":")
    if not colon or not file.endswith(".py"):
        known = TASKS if kind == "task" else ALGORITHMS
        raise ValueError(
            f"{kind} must be one of {', '.join(known)}, or your own as path/to/file.py:Name, "
            f"got {name!r}"
        )
    found = getattr(_load_module(kind, Path(file)), called, None)
    if not fits(found):
        raise ValueError(f"{kind} must be {wanted} in {file}, got {called!r}")
    return found


def _load_module(kind: str, file: Path) -> Any:
    """Execute a file as a module, once per process."""
    if not file.is_file():
        raise ValueError(f"{kind} must be in a file that exists, got {file}")
    place = str(file.resolve())
    name = f"_own_{file.stem}_{hashlib.sha256(place.encode()).hexdigest()[:8]}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, place)
        assert spec is not None
        assert spec.loader is not None
        module = sys.modules[name] = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except Exception as error:
            del sys.modules[name]
            raise ValueError(
                f"{kind} must be in a file that runs, got {file}: {type(error).__name__}: {error}"
            ) from error
    return sys.modules[name]


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader. Numbers must be decimal, and aliases must not expand to many nodes."""

    yaml_implicit_resolvers = {
        first: [each for each in some if not each[0].endswith((":int", ":float"))]
        for first, some in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node. If aliases expand the node to over `NODES` nodes, raise a ValueError."""
        named: Any = self.check_event(yaml.AliasEvent)
        node: Any = super().compose_node(parent, index)
        if named:
            if not hasattr(node, "total"):
                raise ValueError("an alias must not stand inside of what it names")
            return node
        parts = node.value if isinstance(node.value, list) else []
        if isinstance(node, yaml.MappingNode):
            names = [name.value for name, _ in parts if isinstance(name, yaml.ScalarNode)]
            for name, times in Counter(names).items():
                if times > 1:
                    raise ValueError(f"{name!r:.60} must stand once, got it {times} times")
            parts = [part for pair in parts for part in pair]
        node.total = 1 + sum(part.total for part in parts)
        if node.total > NODES:
            raise ValueError(f"it must hold at most {NODES} values, got more by its aliases")
        return node

    def construct_whole(self, node: Any) -> int:
        """Parse an integer with digits 0 to 9. Python would also accept 1_0 and other digits."""
        return parse_integer("!!int", str(self.construct_scalar(node)))

    def construct_real(self, node: Any) -> float:
        """Parse a number with digits 0 to 9, or .inf or .nan. Other texts raise a ValueError."""
        text = str(self.construct_scalar(node))
        named = text.lower().lstrip("+-").removeprefix(".")
        return (
            float(text.replace(".", ""))
            if named in ("inf", "nan")
            else parse_number("!!float", text)
        )


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:int", re.compile(r"[+-]?(?:0|[1-9][0-9]*)\Z"), list("+-0123456789")
)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"(?:[+-]?(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][+-][0-9]+)?|[+-]?\.inf|\.nan)\Z"),
    list("+-.0123456789"),
)
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_whole)
_Loader.add_constructor("tag:yaml.org,2002:float", _Loader.construct_real)


def parse_yaml(text: str) -> dict[str, Any]:
    """Parse names and values from YAML. If the text is invalid, raise a ValueError that says why.

    No code is executed. Numbers are plain decimals; PyYAML would read 1_0 as ten and 010 as eight.
    """
    if len(text) > YAML:
        raise ValueError(f"it must have at most {YAML} characters, got {len(text)}")
    if text.count("[") + text.count("{") > BRACKETS:
        raise ValueError(f"it must have at most {BRACKETS} brackets, got more")
    try:
        found = yaml.load(text, _Loader)
    except (yaml.YAMLError, *DAMAGE) as error:
        raise ValueError(describe_damage(error)) from None
    if not isinstance(found, dict) or not all(isinstance(name, str) for name in found):
        raise ValueError(f"it must hold names and values, got {found!r:.60}")
    return found


def read_yaml(file: Path, by_hand: bool = False) -> dict[str, Any]:
    """Read the names and values of a YAML file; see `parse_yaml`.

    Args:
        by_hand: whether a person wrote the file. Otherwise its last line must end in a line break,
            which shows that the file is complete.

    Raises:
        ValueError: the file is invalid; the message says why.
        FileNotFoundError: the file does not exist.
    """
    text = read_text(file, YAML)
    if not by_hand and not text.endswith("\n"):
        raise ValueError("it is cut: its last line must end in a line break")
    return parse_yaml(text)


@dataclass(frozen=True)
class PolicyCard:
    """Description of a policy: its environment and its network."""

    env_id: str  # id of the package, or "Own/Class" for a custom task
    algo: str  # name of the algorithm, or "Own/NAME" for a custom one
    actions: str  # kind of action
    control_period: float  # [s]
    hidden: tuple[int, ...]  # units of the hidden layers
    observe: tuple[str, ...] = ()  # additional groups of features in the observation
    features: str = ""  # digest of the features' names and scales; "": an older card

    def __post_init__(self) -> None:
        if not str(self.env_id).startswith(OWN):
            checks.one_of("env_id", self.env_id, [env_id(name) for name in TASKS])
        if self.algo.startswith(OWN) and self.algo not in ALGORITHMS:
            name = self.algo.removeprefix(OWN)
            raise ValueError(
                f"algo must be loaded from its file first, by --algo path/to/file.py:{name} or by "
                f"find_algorithm, got {self.algo!r}"
            )
        ALGORITHMS.find(self.algo)
        checks.positive("control_period", self.control_period)
        for units in self.hidden:
            checks.integer("hidden", units, least=1)
        if not 1 <= len(self.hidden) <= MOST_LAYERS:
            raise ValueError(f"hidden must be 1 to {MOST_LAYERS} layers, got {len(self.hidden)}")
        checks.some_of("observe", self.observe, tuple(GROUPS))

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """Arguments of the environment the policy was trained on."""
        more = {"observe": self.observe} if self.observe else {}
        own = {"actions": self.actions, "control_period": self.control_period}
        return {**own, **ALGORITHMS.find(self.algo).env_kwargs, **more}

    @property
    def task(self) -> str:
        """Name of the task; for a custom task, the name of its class."""
        known = {env_id(name): name for name in TASKS}
        return known.get(self.env_id, self.env_id.removeprefix(OWN))

    def env_config(self, task: Task | None = None) -> EnvConfig:
        """Configure the policy's environment; `task` is the custom task of training, or None."""
        own = self.env_id.startswith(OWN)
        if own and type(task).__name__ != self.task:
            raise ValueError(
                f"task must be {self.task}, a user's own, which the policy was trained on, "
                f"got {None if task is None else type(task).__name__}"
            )
        config = EnvConfig(task=task if own and task is not None else self.task, **self.env_kwargs)
        shown = compute_digest(config.features)
        if self.features not in ("", shown):
            raise ValueError(
                f"features must be {self.features!r}, by whose names and scales the policy was "
                f"trained, got {shown!r} of {self.task} as it is now; train the policy again"
            )
        return config


class TrainedPolicy(BatchController, ABC):
    """A trained policy, with the environment in which it was trained."""

    def __init__(self, card: PolicyCard, config: EnvConfig) -> None:
        self.card = card
        self._config = config
        self.env_id = card.env_id
        own = {"task": config.task} if card.env_id.startswith(OWN) else {}
        self.env_kwargs = {**own, **card.env_kwargs}
        features = len(config.features)
        self._shape = (None, features) if config.task.is_stream else (features,)


def check_heads(hidden: tuple[int, ...]) -> None:
    """Raise a ValueError unless `hidden` has exactly one number, a multiple of `HEADS`."""
    if len(hidden) != 1 or hidden[0] % HEADS:
        raise ValueError(f"hidden must be one multiple of {HEADS}, got {hidden}")


@dataclass(frozen=True)
class PolicyFiles:
    """Content of a policy's files, which can be sent to other machines."""

    folder: Path
    weights: bytes
    card: bytes
    # Custom algorithms by their files, for other processes.
    algorithms: tuple[str, ...] = field(default_factory=lambda: tuple(_NAMED))


def read_files(folder: Path) -> PolicyFiles:
    """Read the files of a policy without decoding them."""
    is_old = (folder / OLD_WEIGHTS).is_file() and not (folder / WEIGHTS).exists()
    found = []
    for name, most in ((OLD_WEIGHTS if is_old else WEIGHTS, POLICY), (CARD, YAML)):
        try:
            found.append(read_bytes(folder / name, most))
        except FileNotFoundError:
            raise ValueError(f"{folder} holds no policy: {name} is missing") from None
        except ValueError as error:
            raise ValueError(f"{folder} holds no policy: {name}: {error}") from None
    weights, card = found
    return PolicyFiles(folder, weights, card)


def save_policy(weights: Weights, card: PolicyCard, folder: Path) -> None:
    """Write weights and card to a folder, atomically."""
    from safetensors.numpy import save

    content = save({name: np.ascontiguousarray(value) for name, value in weights.items()})
    with replacing(folder / WEIGHTS) as part:
        part.write_bytes(content)
    fields = {**asdict(card), "hidden": list(card.hidden), "observe": list(card.observe)}
    fields[DIGEST] = _digest(fields, content)
    with replacing(folder / CARD) as part:
        part.write_text(yaml.safe_dump(fields, sort_keys=False))


def read_card(files: PolicyFiles) -> PolicyCard:
    """Decode the card among a policy's files.

    Raises:
        ValueError: card or weights are damaged, or not of this package.
    """
    fields = parse_yaml(files.card.decode())
    if fields.pop(DIGEST) != _digest(fields, files.weights):
        raise ValueError(f"{WEIGHTS} or {CARD} is not as it was written: its digest differs")
    for name in {"hidden", "observe"} & fields.keys():
        fields[name] = tuple(fields[name])
    return PolicyCard(**fields)


def read_weights(files: PolicyFiles) -> dict[str, Any]:
    """Decode the weights among a policy's files: safetensors, or an older PyTorch archive."""
    if files.weights.startswith(ZIP):
        from io import BytesIO

        from .tensors import load_tensors

        return {name: each.numpy() for name, each in load_tensors(BytesIO(files.weights)).items()}
    from safetensors import SafetensorError
    from safetensors.numpy import load as decode

    try:
        return decode(files.weights)
    except SafetensorError as error:
        raise ValueError(f"{WEIGHTS}: {error}") from None


def _digest(fields: dict[str, Any], weights: bytes) -> str:
    return hashlib.sha256(json.dumps(fields, sort_keys=True).encode() + weights).hexdigest()


def names() -> tuple[str, ...]:
    """List the names of the shipped agents: task and algorithm, e.g. "track-dqn"."""
    return tuple(sorted(card.parent.name for card in SHELF.glob("*/card.yaml")))


def seeds(name: str) -> tuple[int, ...]:
    """List the seeds of a shipped agent; there is one trained policy for each seed."""
    folder = SHELF / checks.one_of("name", name, names())
    return tuple(sorted(int(each.name.removeprefix("seed-")) for each in folder.glob("seed-*")))


def load(
    name: str,
    seed: int | None = None,
    config: EnvConfig | None = None,
    most_touches: float = 0.0,
) -> TrainedPolicy:
    """Load a shipped policy, with `predict`, `env_id` and `env_kwargs`.

    Args:
        seed: a seed in `seeds(name)`. The default is the first seed.
        config: environment for a policy of a stream. The default is the environment of training.
            The policy "flow-schedule" needs an environment with a gate.
        most_touches: [-] allowed touches between parcels, per delivery. Only "flow-schedule"
            uses the number.

    Raises:
        ValueError: there is no agent with the name or the seed.
        ImportError: PyTorch is missing; install the extra `agents`.
    """
    trained = seeds(name)
    chosen = trained[0] if seed is None else checks.one_of("seed", seed, trained)
    return from_files(read_files(SHELF / name / f"seed-{chosen}"), None, config, most_touches)


def read(folder: str | Path, task: Task | None = None) -> TrainedPolicy:
    """Read the policy of any learning algorithm from the folder of a training run.

    Raises:
        ValueError: the policy is missing, damaged, not of this package, or for another task.
    """
    return from_files(read_files(checks.path("folder", folder)), task)


def from_files(
    files: PolicyFiles,
    task: Task | None = None,
    config: EnvConfig | None = None,
    most_touches: float = 0.0,
) -> TrainedPolicy:
    """Build a policy from the content of its files. Other arguments are as in `load` and `read`."""
    if task is not None:
        checks.instance("task", task, Task, "a task")
    if config is not None:
        checks.instance("config", config, EnvConfig, "an EnvConfig")
    given = {
        "config": config, "most_touches": checks.not_negative("most_touches", most_touches) or None,
    }  # fmt: skip
    options = {name: value for name, value in given.items() if value is not None}
    for name in files.algorithms:
        find_algorithm(name)
    try:
        card = read_card(files)
        own, algorithm = card.env_config(task), ALGORITHMS.find(card.algo)
        algorithm.check(own.task, card.actions)
        taken = algorithm.build_options
        unused = [name for name in options if taken is not None and name not in taken]
        if not unused:
            return algorithm.build(card, read_weights(files), own, **options)
    except ModuleNotFoundError as error:
        raise ImportError(
            f"a policy needs {error.name}, which is not installed: "
            "pip install 'surface_gym[agents]'"
        ) from None
    except DAMAGE as error:
        raise ValueError(
            f"{files.folder} holds a damaged or foreign policy: {describe_damage(error)}"
        ) from None
    raise ValueError(f"{unused[0]} must be left out for {algorithm.label}")
