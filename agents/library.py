"""The agents that come with the package: some seeds of each, and a card."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surface_gym import checks

from .policy_files import PolicyFiles

if TYPE_CHECKING:
    from surface_gym.tasks import Task

    from .flow.policy import FlowPolicy
    from .modules.policy import ModulesPolicy
    from .policies.policy import Policy

SHELF = Path(__file__).parent / "shipped"


def names() -> tuple[str, ...]:
    """Names of the agents on the shelf: the task and how it was learned, as "track-dqn"."""
    return tuple(sorted(card.parent.name for card in SHELF.glob("*/card.yaml")))


def seeds(name: str) -> tuple[int, ...]:
    """The seeds an agent was trained with, one policy each.

    Raises:
        ValueError: no agent of that name.
    """
    folder = SHELF / checks.one_of("name", name, names())
    return tuple(sorted(int(each.name.removeprefix("seed-")) for each in folder.glob("seed-*")))


def load(name: str, seed: int | None = None) -> "Policy | ModulesPolicy | FlowPolicy":
    """A trained policy: `predict`, `env_id` and `env_kwargs`. No code in its files is run.

    Args:
        name: one of `names()`.
        seed: one of `seeds(name)`; None: the first.

    Raises:
        ValueError: no agent of that name, or not of that seed.
        ImportError: PyTorch is missing, which the extra `agents` brings.
    """
    trained = seeds(name)
    chosen = trained[0] if seed is None else checks.one_of("seed", seed, trained)
    return read(SHELF / name / f"seed-{chosen}")


def read(folder: str | Path, task: "Task | None" = None) -> "Policy | ModulesPolicy | FlowPolicy":
    """The policy that a run left in a folder, whatever learned it. No code in its files is run.

    Args:
        folder: of the run.
        task: of one's own that it was trained on; None: one of the package.

    Raises:
        ValueError: the folder holds no policy, or a damaged or foreign one, or one of another task.
    """
    return _files().load_policy(Path(folder), task)


def carried(
    files: PolicyFiles, task: "Task | None" = None
) -> "Policy | ModulesPolicy | FlowPolicy":
    """The policy that files hold, wherever they were read; see `read`."""
    return _files().policy_of(files, task)


def _files() -> Any:
    """The module that reads policies, imported only now: it brings PyTorch with it."""
    try:
        return import_module(".policies.files", __package__)
    except ModuleNotFoundError as error:
        raise ImportError(
            f"a policy needs {error.name}, which is not installed: "
            "pip install 'surface_gym[agents]'"
        ) from None
