"""The shared weights as a policy: for any zone, in memory and on disk."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import torch
import yaml
from numpy.typing import NDArray

from agents.modules.draw import GROUPS, draw_choices
from agents.modules.network import SharedNetwork
from agents.modules.view import ModuleView
from surface_gym import checks
from surface_gym.registration import env_id
from surface_gym.settings import Settings

WEIGHTS = "policy.pt"
CARD = "policy.yaml"

# What reading a damaged or foreign file can raise, in PyYAML, in PyTorch and here.
_DAMAGE = (
    yaml.YAMLError,
    UnpicklingError,
    EOFError,
    OSError,
    AttributeError,
    KeyError,
    RuntimeError,
    TypeError,
    ValueError,
)


@dataclass(frozen=True)
class ModulesCard:
    """What shared weights are for."""

    control_period: float  # [s]
    hidden: int  # units of each of two hidden layers
    env_id: str = env_id("sort")
    algo: str = "modules"
    actions: str = "modules"

    def __post_init__(self) -> None:
        checks.positive("control_period", self.control_period)
        checks.integer("hidden", self.hidden, least=1)
        checks.one_of("env_id", self.env_id, (env_id("sort"),))
        for name in ("algo", "actions"):
            checks.one_of(name, getattr(self, name), ("modules",))

    @property
    def task(self) -> str:
        """The task's name."""
        return "sort"

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """Arguments of the environment the weights were trained on."""
        return {"actions": self.actions, "control_period": self.control_period}

    @property
    def settings(self) -> Settings:
        """Those of the environment the weights were trained on."""
        return Settings(task=self.task, **self.env_kwargs)


class ModulesPolicy:
    """Modules that decide by shared weights. `predict` takes and gives what the environment does.

    Attributes:
        env_id: the environment it was trained on.
        env_kwargs: that environment's arguments.

    Args:
        network: the weights.
        card: what they are for.
        zone: first and last column that obey; None: those after the lead-in, as in training.

    Raises:
        ValueError: a zone that is not on the surface.
    """

    def __init__(
        self, network: SharedNetwork, card: ModulesCard, zone: tuple[int, int] | None = None
    ) -> None:
        torch.set_num_threads(1)  # the network is small: more threads only wait for each other
        self._network = network.eval()
        self._view = ModuleView(replace(card.settings, zone=zone))
        self.card = card
        self.env_id = card.env_id
        self.env_kwargs = card.env_kwargs if zone is None else {**card.env_kwargs, "zone": zone}

    def on(self, zone: tuple[int, int] | None) -> "ModulesPolicy":
        """The same weights for another zone."""
        return ModulesPolicy(self._network, self.card, zone)

    @torch.no_grad()
    def predict(
        self,
        observation: NDArray[np.float32],
        state: None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.int64], None]:
        """Action for an observation (features,), or actions for (lanes, features); and no state.

        Where it is not to be deterministic, all modules of a lane share a draw, as they learned to.
        """
        del state, episode_start  # it has no memory
        observations = np.atleast_2d(observation)
        seen = self._view(observations)
        shared, lane, place = map(torch.from_numpy, (seen.shared, seen.lane, seen.place))
        log_probability = self._network(shared, lane, place)
        if deterministic:
            choices = log_probability.argmax(dim=1)
        else:
            uniform = torch.rand(GROUPS * len(observations))
            choices = draw_choices(log_probability, GROUPS * lane, uniform)
        actions = self._view.actions(observations, seen, choices.numpy())
        return (actions[0] if np.ndim(observation) == 1 else actions), None


def save_modules(network: SharedNetwork, card: ModulesCard, folder: Path) -> None:
    """Write weights and card into a folder."""
    torch.save(network.state_dict(), folder / WEIGHTS)
    (folder / CARD).write_text(yaml.safe_dump(asdict(card), sort_keys=False))


def load_modules(folder: Path, zone: tuple[int, int] | None = None) -> ModulesPolicy:
    """Read shared weights. No code in the files is run.

    Args:
        folder: that `save_modules` wrote into.
        zone: first and last column that obey; None: those after the lead-in, as in training.

    Raises:
        ValueError: the folder holds no such policy, or a damaged or foreign one.
    """
    for name in (WEIGHTS, CARD):
        if not (folder / name).is_file():
            raise ValueError(f"{folder} holds no policy: {name} is missing")
    try:
        card = ModulesCard(**yaml.safe_load((folder / CARD).read_text()))
        network = SharedNetwork(len(card.settings.orientations), card.hidden)
        network.load_state_dict(torch.load(folder / WEIGHTS, map_location="cpu", weights_only=True))
    except _DAMAGE as error:
        raise ValueError(f"{folder} holds a damaged or foreign policy: {error}") from error
    return ModulesPolicy(network, card, zone)
