"""Tasks and trained policies by name: the package's, and a user's own.

Reading a policy runs no code from its files. Nothing here imports PyTorch until a policy is loaded.
"""

import hashlib
import importlib.util
import sys
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.core.actions import GROUPS
from surface_gym.files import read_bytes
from surface_gym.registration import FLOW, FLOW_TASK, ON_SLOPES, PERIODS, env_id
from surface_gym.tasks import TASKS, Task

from .yaml_file import YAML

if TYPE_CHECKING:
    from .policy import AnyPolicy

SHELF = Path(__file__).parent / "shipped"
WEIGHTS = "policy.safetensors"
OLD_WEIGHTS = "policy.pt"  # of policies that were written before
CARD = "policy.yaml"
ALGOS = ("ppo", "dqn", "modules", "schedule", "parcels", "local")
QUEUE = 4  # parcels that wait, which a policy on a schedule looks at
MOST_PARCELS = 12  # on a slope at once, for a policy of parcels or modules
MOST_LAYERS = 16  # of a network
HEADS = 4  # of attention, of a policy of parcels
OWN = "Own/"  # before the class of a user's task, in place of an id
_NAMES = {env_id(name): name for name in PERIODS}


def find_task(name: str) -> Task:
    """Make the task of a name; a file in the name is run."""
    if name in TASKS:
        return TASKS[name]()
    file, colon, kind = name.rpartition(":")
    if not colon or not file.endswith(".py"):
        raise ValueError(
            f"task must be one of {', '.join(TASKS)}, or your own as path/to/file.py:Class, "
            f"got {name!r}"
        )
    found = getattr(_load_module(Path(file)), kind, None)
    if not (isinstance(found, type) and issubclass(found, Task)):
        raise ValueError(f"task must be a class of {file} that inherits from Task, got {kind!r}")
    return found()


def task_kind(name: str) -> str:
    """Name the package's task that a task is or inherits from; else the task itself."""
    return name if name in TASKS else EnvConfig(task=find_task(name)).task_name


def task_label(name: str) -> str:
    """Shorten a task's name for tables and names of files."""
    return name.rpartition(":")[2].lower()


def card_env_id(name: str) -> str:
    """Name the environment of a task for a policy's card: its id, or "Own/Class"."""
    return env_id(name) if name in PERIODS else OWN + name.rpartition(":")[2]


def task_files(name: str | None) -> tuple[Path, ...]:
    """List the file of a user's own task, which other machines need; none for the package's."""
    return (Path(name.rpartition(":")[0]),) if name is not None and ":" in name else ()


def _load_module(file: Path) -> Any:
    """Run a file's module, once in a process."""
    if not file.is_file():
        raise ValueError(f"task must be in a file that exists, got {file}")
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
                f"task must be in a file that runs, got {file}: {type(error).__name__}: {error}"
            ) from error
    return sys.modules[name]


POLICY = 2**27  # [bytes] of weights: the largest here has 0.2 million


@dataclass(frozen=True)
class PolicyCard:
    """The environment and the network that a policy's weights are for."""

    env_id: str  # of the package, or "Own/Class" for a user's task
    algo: str  # "ppo", "dqn"; PPO per "modules", "parcels" or "local" module; on a "schedule"
    actions: str  # kind of action
    control_period: float  # [s]
    hidden: tuple[int, ...]  # units of the hidden layers
    observe: tuple[str, ...] = ()  # groups of features in the observation beside the task's

    def __post_init__(self) -> None:
        if not str(self.env_id).startswith(OWN):
            checks.one_of("env_id", self.env_id, _NAMES)
        checks.one_of("algo", self.algo, ALGOS)
        checks.positive("control_period", self.control_period)
        for units in self.hidden:
            checks.integer("hidden", units, least=1)
        if not 1 <= len(self.hidden) <= MOST_LAYERS:
            raise ValueError(f"hidden must be 1 to {MOST_LAYERS} layers, got {len(self.hidden)}")
        if self.algo == "modules":
            checks.one_of("env_id", self.env_id, (env_id("sort"),))
            checks.one_of("actions", self.actions, ("modules",))
        checks.some_of("observe", self.observe, tuple(GROUPS))
        slopes = tuple(map(env_id, ON_SLOPES))
        for algos, ids in ((("schedule",), (FLOW,)), (("parcels", "local"), slopes)):
            if (self.algo in algos) != (self.env_id in ids):
                raise ValueError(
                    f"algo must be {' or '.join(map(repr, algos))} for {', '.join(ids)} alone, "
                    f"got {self.algo!r}"
                )
            if self.algo in algos:
                only = "modules" if self.algo == "local" else "parcels"
                checks.one_of("actions", self.actions, (only,))
        if self.algo == "parcels":
            check_heads(self.hidden)

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """Arguments of the environment the policy was trained on."""
        of_schedule = self.algo == "schedule"
        more: dict[str, Any] = {"gate": True, "queue": QUEUE} if of_schedule else {}
        if self.algo in ("parcels", "local"):
            more["max_parcels"] = MOST_PARCELS
        if self.observe:
            more["observe"] = self.observe
        return {"actions": self.actions, "control_period": self.control_period, **more}

    @property
    def task(self) -> str:
        """The name of the package's task, or of the class of a user's task."""
        return _NAMES.get(self.env_id, self.env_id.removeprefix(OWN))

    def env_config(self, task: Task | None = None) -> EnvConfig:
        if self.task == FLOW_TASK or self.task in ON_SLOPES:
            raise ValueError(f"env_id must be that of single parcels, got {self.env_id!r}")
        own = self.env_id.startswith(OWN)
        if own and type(task).__name__ != self.task:
            raise ValueError(
                f"task must be {self.task}, a user's own, which the policy was trained on, "
                f"got {None if task is None else type(task).__name__}"
            )
        return EnvConfig(task=task if own and task is not None else self.task, **self.env_kwargs)


def check_heads(hidden: tuple[int, ...]) -> None:
    """Raise a ValueError unless heads of attention can share the one number of units."""
    if len(hidden) != 1 or hidden[0] % HEADS:
        raise ValueError(f"hidden must be one multiple of {HEADS}, got {hidden}")


@dataclass(frozen=True)
class PolicyFiles:
    """Content of a policy's files; other machines need not see its folder."""

    folder: Path
    weights: bytes
    card: bytes


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
    return PolicyFiles(folder, *found)


def names() -> tuple[str, ...]:
    """List the shipped agents, each by its task and its algorithm, as "track-dqn"."""
    return tuple(sorted(card.parent.name for card in SHELF.glob("*/card.yaml")))


def seeds(name: str) -> tuple[int, ...]:
    """List the seeds a shipped agent was trained with, one policy each."""
    folder = SHELF / checks.one_of("name", name, names())
    return tuple(sorted(int(each.name.removeprefix("seed-")) for each in folder.glob("seed-*")))


def load(
    name: str,
    seed: int | None = None,
    config: EnvConfig | None = None,
    most_touches: float = 0.0,
) -> "AnyPolicy":
    """Load a shipped policy, with `predict`, `env_id` and `env_kwargs`.

    Args:
        seed: one of `seeds(name)`; None: the first.
        config: of the environment that a policy of streams is for, with a gate for "flow-schedule";
            None: its `env_kwargs`.
        most_touches: [-] per delivery that "flow-schedule" allows in its trial.

    Raises:
        ValueError: no agent of that name, or not of that seed.
        ImportError: PyTorch is missing, which the extra `agents` brings.
    """
    trained = seeds(name)
    chosen = trained[0] if seed is None else checks.one_of("seed", seed, trained)
    return from_files(read_files(SHELF / name / f"seed-{chosen}"), None, config, most_touches)


def read(folder: str | Path, task: Task | None = None) -> "AnyPolicy":
    """Read the policy that a run of any algorithm left in a folder.

    Raises:
        ValueError: the folder holds no policy, or a damaged or foreign one, or one of another task.
    """
    return from_files(read_files(checks.path("folder", folder)), task)


def from_files(
    files: PolicyFiles,
    task: Task | None = None,
    config: EnvConfig | None = None,
    most_touches: float = 0.0,
) -> "AnyPolicy":
    """Build a policy from the content of its files, wherever they were read; see `read` and
    `load`.
    """
    try:  # only now: it imports PyTorch
        policy: Any = import_module(".policy", __package__)
    except ModuleNotFoundError as error:
        raise ImportError(
            f"a policy needs {error.name}, which is not installed: "
            "pip install 'surface_gym[agents]'"
        ) from None
    return policy.build_policy(files, task, config, most_touches)
