"""One policy shared by all modules, for any zone: observations, networks and shared draws.

Each module observes its position under the parcel, and features shared by all. The parcel's outline
and the rows of its line are inferred from the environment's observation.

There are 6 to 25 modules under a parcel. With independent draws, their deviations would cancel, and
exploration would have no effect. Instead, the modules of a group look up one uniform number in
their own cumulative probabilities. Similar modules choose alike, and each follows its own
probabilities. The likelihood of a group's choices has a closed form: the length of the interval of
uniform numbers that give these choices.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import nn

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.feature_groups import QUADRANT_SIZE, QUADRANTS, group_features
from surface_gym.tasks import sort

from .base import SIDE, Integers, Singles
from .library import PolicyCard, TrainedPolicy, Weights
from .module_places import AHEAD, ASIDE, PLACE_SIZE, find_places, find_shown
from .rules.decoding import look_at_line
from .tensors import load_weights

_NAMES = tuple(feature.name for feature in sort.FEATURES)
# Without the side, since observations are mirrored, and without the time, which depends on the
# lead-in.
SHARED = tuple(k for k, name in enumerate(_NAMES) if name not in ("side", "time"))
_ROTORS = {feature.name for feature in group_features(("rotors",))}


def shared_size(observe: tuple[str, ...]) -> int:
    """Return the number of features shared by all modules of an environment."""
    return len(SHARED) + len(group_features(observe))


def place_size(observe: tuple[str, ...]) -> int:
    """Return the number of features of a single module."""
    return PLACE_SIZE + (QUADRANT_SIZE if "rotors" in observe else 0)


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
    """Conversion of Sort's observations to modules' observations, and of choices to actions.

    With the group "parcel", the observation gives the outline of the base. Otherwise the base is
    assumed to be a rectangle with a width from the clearance. With "rotors", a module observes the
    axes in its quadrant of the parcel.
    """

    def __init__(self, config: EnvConfig) -> None:
        checks.one_of("task", config.task_name, ("sort",))
        checks.one_of("actions", config.actions, ("modules",))
        self._size = config.action_kind.size
        self._features = len(config.features)
        self._sight, self._shown = look_at_line(config), find_shown(config)
        self._image = config.images
        angles = np.array(config.chosen_orientations)
        self._rest = int(np.abs(np.sin(angles)).argmax())  # choice closest to 90 deg
        columns = config.columns
        of_groups = [columns[each.name].place for each in group_features(config.observe)]
        self._shared = np.array([*SHARED, *of_groups])
        # (QUADRANTS, QUADRANT_SIZE) feature columns of each; (QUADRANTS, 0) if not observed.
        rotors = [name for name in columns if name in _ROTORS]
        self._rotors = np.array([columns[name].place for name in rotors], dtype=np.int64)
        self._rotors = self._rotors.reshape(len(QUADRANTS), -1)

    def __call__(self, observations: Singles) -> SortModuleObservations:
        """Compute modules' observations from observations (num_envs, features)."""
        env, index, place = self.room(len(observations))
        count = find_places(observations, self._sight, self._shown, env, index, place)
        env, index, place = env[:count], index[:count], place[:count]
        # A module sees the axes in its own quadrant of the parcel.
        quadrant = 2 * (place[:, AHEAD] < 0.0) + (place[:, ASIDE] < 0.0)
        axes = observations[env[:, np.newaxis], self._rotors[quadrant]]
        place = np.concatenate([place, axes], axis=1)
        return SortModuleObservations(observations[:, self._shared], env, place, index)

    def room(self, num_envs: int) -> tuple[Integers, Integers, Singles]:
        """Allocate arrays for the modules that may be under a parcel."""
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
        """Build actions (num_envs, size) from choices (modules,); other modules stay at 90 deg."""
        actions = np.full((len(observations), self._size), self._rest)
        mirrored = observations[seen.env, SIDE] < 0.0
        actions[seen.env, seen.index] = np.where(mirrored, self._image[choices], choices)
        return actions


GROUPS = 2  # groups of modules per environment
_SMALLEST = 1e-6  # shorter intervals count as empty in single precision
# maximum distance of a line between groups from the parcel's centre, in half lengths
_FARTHEST = 0.7


def draw_groups(
    env: Integers, place: Singles, num_envs: int, probability: float, rng: np.random.Generator
) -> Integers:
    """Draw the group of each module (modules,): 2 i or 2 i + 1 in environment i.

    Args:
        place: (modules, ...) begins with the positions along and across the parcel, in half
            lengths.
        probability: probability that a random line through the parcel splits its modules into two
            groups.
    """
    splits = rng.random(num_envs) < probability
    angle = 2.0 * np.pi * rng.random(num_envs)
    distance = rng.uniform(-_FARTHEST, _FARTHEST, num_envs)
    across = np.cos(angle)[env] * place[:, 0] + np.sin(angle)[env] * place[:, 1]
    return GROUPS * env + (splits[env] & (across > distance[env]))


def draw_choices(
    log_probability: torch.Tensor, group: torch.Tensor, uniform: torch.Tensor
) -> torch.Tensor:
    """Choose for each module (modules,) by the uniform number of its group."""
    edges = log_probability.exp().cumsum(dim=1)[:, :-1]
    return (uniform[group].unsqueeze(1) > edges).sum(dim=1)


def log_likelihood(
    log_probability: torch.Tensor, choice: torch.Tensor, group: torch.Tensor, groups: int
) -> torch.Tensor:
    """Compute the joint log likelihood (num_envs,) of each environment's choices (modules,).

    It is 0 without modules. If no uniform number gives the choices, it has its minimum and no
    gradient.
    """
    edges = log_probability.exp().cumsum(dim=1)[:, :-1]
    below = torch.nn.functional.pad(edges, (1, 0), value=0.0).gather(1, choice.unsqueeze(1))
    above = torch.nn.functional.pad(edges, (0, 1), value=1.0).gather(1, choice.unsqueeze(1))
    first = below.new_zeros(groups).scatter_reduce(0, group, below.squeeze(1), "amax")
    last = above.new_ones(groups).scatter_reduce(0, group, above.squeeze(1), "amin")
    return (last - first).clamp(min=_SMALLEST).log().reshape(-1, GROUPS).sum(dim=1)


def make_linear(inputs: int, outputs: int, gain: float = math.sqrt(2.0)) -> nn.Linear:
    """Make a layer with orthogonal weights, as Stable-Baselines3's networks begin."""
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


def make_layers(units: tuple[int, ...]) -> list[nn.Module]:
    """Make layers with tanh between numbers of units."""
    return [layer for sizes in pairwise(units) for layer in (make_linear(*sizes), nn.Tanh())]


class SharedNetwork(nn.Module):
    """Actor of all modules: from shared features and a module's position to logits.

    Weights of the position start at zero, so that modules learn to act together before they learn
    to differ. Otherwise training converges to the fixed layout.
    """

    def __init__(
        self, choices: int, hidden: tuple[int, ...], observe: tuple[str, ...] = ()
    ) -> None:
        super().__init__()
        # Files of weights contain these names.
        self._alike = make_linear(shared_size(observe), hidden[0])
        self._apart = nn.Linear(place_size(observe), hidden[0], bias=False)
        nn.init.zeros_(self._apart.weight)
        self._between = nn.Sequential(*make_layers(hidden))
        self._logits = make_linear(hidden[-1], choices, 0.01)

    def forward(self, shared: torch.Tensor, env: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
        """Compute log probabilities (modules, choices)."""
        first = torch.tanh(self._alike(shared)[env] + self._apart(place))
        logits: torch.Tensor = self._logits(self._between(first))
        return logits.log_softmax(dim=1)


class ValueNetwork(nn.Module):
    """Critic: value of an environment's observation without the goal side."""

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
    """A policy of modules with shared weights.

    Args:
        zone: first and last column of controlled modules; None: the columns after the lead-in, as
            in training.
    """

    def __init__(
        self, network: SharedNetwork, card: PolicyCard, zone: tuple[int, int] | None = None
    ) -> None:
        torch.set_num_threads(1)  # the network is small: more threads only wait for each other
        config = replace(card.env_config(), zone=zone)
        super().__init__(card, config)
        self._network = network.eval()
        self._view = SortModuleView(config)
        if zone is not None:
            self.env_kwargs["zone"] = zone

    def for_zone(self, zone: tuple[int, int] | None) -> "ModulePolicy":
        return ModulePolicy(self._network, self.card, zone)

    @torch.no_grad()
    def _predict(self, batch: Any, *_: Any, deterministic: bool) -> tuple[Any, None]:
        """Choose actions; random choices of one environment share a draw, as in training."""
        seen = self._view(batch)
        shared, env, place = map(torch.from_numpy, (seen.shared, seen.env, seen.place))
        log_probability = self._network(shared, env, place)
        if deterministic:
            choices = log_probability.argmax(dim=1)
        else:
            uniform = torch.rand(GROUPS * len(batch))
            choices = draw_choices(log_probability, GROUPS * env, uniform)
        return self._view.actions(batch, seen, choices.numpy()), None


def build_modules(card: PolicyCard, weights: Weights, config: EnvConfig) -> ModulePolicy:
    """Build a policy of modules from its weights."""

    def make() -> SharedNetwork:
        return SharedNetwork(len(config.chosen_orientations), card.hidden, card.observe)

    return ModulePolicy(load_weights(make, card.hidden, weights), card)
