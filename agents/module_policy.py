"""A policy of Sort with one network for all modules under a parcel, in a zone of any length.

Each module observes its position under the parcel, and features that are the same for all modules.
The modules under a parcel share their random draws; see `tensors`.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import nn

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.feature_groups import QUADRANT_SIZE, QUADRANTS, group_features
from surface_gym.tasks import sort

from .base import SIDE, Integers, Singles, find_rest
from .library import PolicyCard, TrainedPolicy, Weights
from .module_places import AHEAD, ASIDE, PLACE_SIZE, find_places, find_shown
from .rules.decoding import look_at_line
from .tensors import GROUPS, SharedNetwork, draw_choices, load_weights, make_layers, make_linear

_NAMES = tuple(feature.name for feature in sort.FEATURES)
# Without the side, since observations are mirrored, and without the time, which depends on the
# lead-in.
SHARED = tuple(k for k, name in enumerate(_NAMES) if name not in ("side", "time"))
_ROTORS = {feature.name for feature in group_features(("rotors",))}


@dataclass(frozen=True, eq=False)
class SortModuleObservations:
    """Observations of modules under parcels, ordered by environment.

    If the goal is at y < 0, the modules' observations are mirrored, so that the goal is at y > 0.
    """

    shared: Singles  # (num_envs, shared) features shared by an environment's modules
    env: Integers  # (modules,) environment of the parcel on the module, now or after a period
    place: Singles  # (modules, place) position relative to the parcel, then the axes around it
    index: Integers  # (modules,) in the action


class SortModuleView:
    """Converts Sort's observations to modules' observations, and modules' choices to actions.

    The environment's feature group "parcel" gives the outline of the base. Without this group, the
    base is assumed to be a rectangle. The rectangle's width is then computed from the observed
    distance between the base and the line's rotors.
    With the feature group "rotors", a module observes the axes under one quadrant of the parcel.
    The module itself lies in this quadrant.
    """

    def __init__(self, config: EnvConfig) -> None:
        checks.one_of("task", config.task_name, ("sort",))
        checks.one_of("actions", config.actions, ("modules",))
        self._size = config.action_kind.size
        self._features = len(config.features)
        self._sight, self._shown = look_at_line(config), find_shown(config)
        self._image = config.images
        self._rest = find_rest(config)
        columns = config.columns
        of_groups = [columns[each.name].place for each in group_features(config.observed_groups)]
        self._shared = np.array([*SHARED, *of_groups])
        # (QUADRANTS, QUADRANT_SIZE) feature columns of each; (QUADRANTS, 0) if not observed.
        rotors = [name for name in columns if name in _ROTORS]
        self._rotors = np.array([columns[name].place for name in rotors], dtype=np.int64)
        self._rotors = self._rotors.reshape(len(QUADRANTS), -1)

    def __call__(self, observations: Singles) -> SortModuleObservations:
        """Compute modules' observations from observations of environments (num_envs, features)."""
        env, index, place = self.room(len(observations))
        count = find_places(observations, self._sight, self._shown, env, index, place)
        env, index, place = env[:count], index[:count], place[:count]
        # A module sees the axes in its own quadrant of the parcel.
        quadrant = 2 * (place[:, AHEAD] < 0.0) + (place[:, ASIDE] < 0.0)
        axes = observations[env[:, np.newaxis], self._rotors[quadrant]]
        place = np.concatenate([place, axes], axis=1)
        return SortModuleObservations(observations[:, self._shared], env, place, index)

    def room(self, num_envs: int) -> tuple[Integers, Integers, Singles]:
        """Allocate the outputs `env`, `index` and `place` that `find_places` writes."""
        modules = num_envs * self._size
        places = np.zeros((modules, PLACE_SIZE), dtype=np.float32)
        return np.zeros(modules, dtype=np.int64), np.zeros(modules, dtype=np.int64), places

    def begin(self) -> tuple[Any, ...]:
        """Return the arguments of `find_places` for one environment."""
        observations = np.zeros((1, self._features), dtype=np.float32)
        return observations, self._sight, self._shown, *self.room(1)

    def actions(
        self, observations: Singles, seen: SortModuleObservations, choices: Integers
    ) -> Integers:
        """Build actions (num_envs, size) from the `choices` of the modules in `seen`.

        All other modules stay at the orientation closest to 90 deg.
        """
        actions = np.full((len(observations), self._size), self._rest)
        mirrored = observations[seen.env, SIDE] < 0.0
        actions[seen.env, seen.index] = np.where(mirrored, self._image[choices], choices)
        return actions


def make_actor(config: EnvConfig, hidden: tuple[int, ...]) -> SharedNetwork:
    """Make the untrained actor of an environment's modules; `hidden` lists the units per layer."""
    groups = config.observed_groups
    shared = len(SHARED) + len(group_features(groups))
    place = PLACE_SIZE + (QUADRANT_SIZE if "rotors" in groups else 0)
    return SharedNetwork(shared, place, hidden, len(config.chosen_orientations))


class ValueNetwork(nn.Module):
    """Critic of an environment. The critic ignores the observed goal side."""

    def __init__(self, hidden: tuple[int, ...], observe: tuple[str, ...] = ()) -> None:
        super().__init__()
        inputs = SIDE + len(group_features(observe))
        self._layers = nn.Sequential(
            *make_layers((inputs, *hidden)), make_linear(hidden[-1], 1, 1.0)
        )

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Compute values (num_envs,) of observations (num_envs, features)."""
        without_side = torch.cat([observations[:, :SIDE], observations[:, SIDE + 1 :]], dim=1)
        return self._layers(without_side)[:, 0]


class ModulePolicy(TrainedPolicy):
    """A trained policy that decides for each module under a parcel. All modules share a network.

    `zone` holds the first and the last controlled column. If `zone` is None, the policy controls
    all columns except the lead-in. The axes of the lead-in stay at 90 deg.
    """

    def __init__(
        self, network: SharedNetwork, card: PolicyCard, zone: tuple[int, int] | None = None
    ) -> None:
        config = replace(card.env_config(), zone=zone)
        super().__init__(card, config)
        self._network = network
        self._view = SortModuleView(config)
        if zone is not None:
            self.env_kwargs["zone"] = zone

    def for_zone(self, zone: tuple[int, int] | None) -> "ModulePolicy":
        return ModulePolicy(self._network, self.card, zone)

    @torch.no_grad()
    def _predict(self, batch: Any, *_: Any, deterministic: bool) -> tuple[Any, None]:
        """Choose actions. All random choices in an environment use the same random number."""
        seen = self._view(batch)
        shared, env, place = map(torch.from_numpy, (seen.shared, seen.env, seen.place))
        log_probability = self._network.log_probability(shared, env, place)
        if deterministic:
            choices = log_probability.argmax(dim=1)
        else:
            uniform = torch.rand(GROUPS * len(batch))
            choices = draw_choices(log_probability, GROUPS * env, uniform)
        return self._view.actions(batch, seen, choices.numpy()), None


def build_modules(card: PolicyCard, weights: Weights, config: EnvConfig) -> ModulePolicy:
    """Build a policy of modules from its card, its weights, and the card's environment."""

    def make() -> SharedNetwork:
        return make_actor(config, card.hidden)

    return ModulePolicy(load_weights(make, card.hidden, weights), card)
