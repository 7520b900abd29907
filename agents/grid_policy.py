"""A policy of Stable-Baselines3 for one choice per module: `PPO(agents.GridPolicy, env)`.

Plain PPO draws the choice of each module independently. The deviations of the 6 to 25 modules under
a parcel cancel, so exploration has no effect. Here one small network decides for every module, from
the observation and the module's place relative to the parcel. The modules ahead of the parcel's
centre share one random number, and the modules behind it another: each looks it up in its own
cumulative probabilities. Modules with similar places choose alike.
"""

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.distributions import MultiCategoricalDistribution
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

from surface_gym.config import EnvConfig, ModuleChoices
from surface_gym.tasks.planning import LineObservation

from .module_policy import GROUPS, draw_choices, log_likelihood, make_layers, make_linear

PLACE_SIZE = 6  # number of features of a module's place
NEAR = 0.3  # [m] scale of distances from the parcel
MARGIN = 0.05  # [m] modules closer to the base than this take part in the likelihood
_NEVER = -30.0  # log probability of a choice that is never drawn


class GridPlaces:
    """Places of modules relative to parcels, from observations.

    Raises:
        ValueError: the actions are of another kind, or the task observes no parcel on a line.
    """

    def __init__(self, config: EnvConfig) -> None:
        kind = config.action_kind
        if kind.name != "modules" or kind.continuous or config.task.is_stream:
            raise ValueError(
                f"actions must be 'modules' with given orientations, of a task of one parcel, for "
                f"GridPolicy, got {config.actions!r} of {config.task.name!r}"
            )
        self._config = config
        line, (rows, columns) = config.chosen_line, kind.shape
        self._x = line.pitch_x * (np.arange(columns) + 0.5)
        self._y = line.pitch_y * (np.arange(rows) - 0.5 * (rows - 1))
        self._is_mirrored = config.task.mirrored

    def __call__(self, observations: Any) -> tuple[Any, Any, Any]:
        """Return places (num_envs, modules, PLACE_SIZE), groups (num_envs, modules) and mirrors.

        A module far from the parcel has the group -1. Observations of a mirrored task show the goal
        at y > 0, so places are mirrored, too, where the mirror (num_envs,) is -1.
        """
        seen = self._config.decode(observations)
        if not isinstance(seen, LineObservation):
            raise ValueError(
                f"task must observe a parcel on a line for GridPolicy, got {self._config.task.name}"
            )
        mirror = np.where(self._is_mirrored & (seen.side < 0.0), -1.0, 1.0)
        x = self._x - seen.into_zone[:, np.newaxis]
        y = mirror[:, np.newaxis] * (self._y - seen.offset[:, np.newaxis])
        x, y = np.broadcast_arrays(x[:, np.newaxis, :], y[:, :, np.newaxis])
        x, y = x.reshape(len(mirror), -1), y.reshape(len(mirror), -1)
        theta, half = (mirror * seen.theta)[:, np.newaxis], seen.half_length[:, np.newaxis]
        along = np.cos(theta) * x + np.sin(theta) * y
        across = np.cos(theta) * y - np.sin(theta) * x
        distance = np.maximum(np.abs(along), np.abs(across)) - half
        ahead = np.abs(seen.vx)[:, np.newaxis] * self._config.control_period
        group = np.where(distance <= MARGIN + ahead, (x < 0.0).astype(np.int64), -1)
        places = (
            along / half, across / half, x / NEAR, y / NEAR, distance <= 0.0,
            (y + (mirror * seen.offset)[:, np.newaxis]) / NEAR,
        )  # fmt: skip
        return np.stack(places, axis=-1).astype(np.float32), group, mirror


class GridNetwork(nn.Module):
    """Actor of all modules, and critic; in the place of Stable-Baselines3's two networks.

    Weights of the places start at zero, so that modules learn to act together before they learn to
    differ.
    """

    _shown: torch.Tensor  # columns of the features that the networks get
    _image: torch.Tensor  # (choices,) mirror image of each choice
    _same: torch.Tensor  # (choices,)
    _far: torch.Tensor  # (choices,) log probabilities of a module far from the parcel

    def __init__(self, config: EnvConfig, hidden: tuple[int, ...]) -> None:
        super().__init__()
        self._places = GridPlaces(config)
        names = [feature.name for feature in config.features]
        hides = config.task.mirrored and "side" in names  # it says nothing in the mirror
        shown = [k for k, name in enumerate(names) if not (hides and name == "side")]
        choices = config.choices
        self.register_buffer("_shown", torch.tensor(shown))
        image = config.images if hides else range(choices)
        self.register_buffer("_image", torch.tensor(list(image)))
        self.register_buffer("_same", torch.arange(choices))
        # Modules far from the parcel turn to the angle at which it will roll on.
        rest = int(np.abs(np.sin(config.chosen_orientations)).argmax())
        far = torch.full((choices,), _NEVER)
        far[rest] = 0.0
        self.register_buffer("_far", far)
        self._alike = make_linear(len(shown), hidden[0])
        self._apart = nn.Linear(PLACE_SIZE, hidden[0], bias=False)
        nn.init.zeros_(self._apart.weight)
        self._between = nn.Sequential(*make_layers(hidden))
        self._logits = make_linear(hidden[-1], choices, 0.01)
        self._critic = nn.Sequential(*make_layers((len(shown), *hidden)))
        self.latent_dim_pi, self.latent_dim_vf = config.action_kind.size * (choices + 1), hidden[-1]

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """Return each module's log probabilities and group: (num_envs, modules x (choices + 1))."""
        seen = self._places(features.detach().cpu().numpy())
        places, group, mirrors = (torch.from_numpy(each).to(features.device) for each in seen)
        env, module = (group >= 0).nonzero(as_tuple=True)
        alike = self._alike(features[:, self._shown])[env]
        near = self._logits(self._between(torch.tanh(alike + self._apart(places[env, module]))))
        order = torch.where((mirrors[env] < 0.0).unsqueeze(1), self._image, self._same)
        found = self._far.expand(*group.shape, -1).index_put(
            (env, module), near.log_softmax(dim=1).gather(1, order)
        )
        return torch.cat([found, group.unsqueeze(2).to(found.dtype)], dim=2).flatten(1)

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        latent: torch.Tensor = self._critic(features[:, self._shown])
        return latent


class SharedDraws(MultiCategoricalDistribution):
    """Choices of all modules, where the modules of a group share a random number.

    The likelihood of a group's choices is the length of the interval of random numbers that give
    them. Modules far from the parcel do not count.
    """

    def __init__(self, modules: int, choices: int) -> None:
        super().__init__([choices] * modules)
        self._shape = (modules, choices)

    def proba_distribution_net(self, latent_dim: int) -> nn.Module:
        del latent_dim
        return nn.Identity()

    def proba_distribution(self, action_logits: torch.Tensor) -> "SharedDraws":
        """Set the output of `GridNetwork.forward_actor`."""
        modules, choices = self._shape
        each = action_logits.reshape(-1, modules, choices + 1)
        self._log_probability = each[:, :, :choices]
        self._group = each[:, :, choices].long()
        self._near = (self._group >= 0).nonzero(as_tuple=True)
        # Index of each near module's group among all environments' groups.
        self._index = GROUPS * self._near[0] + self._group[self._near]
        return self

    def log_prob(self, actions: torch.Tensor) -> torch.Tensor:
        choices = actions.long()[self._near]
        groups = GROUPS * len(self._group)
        return log_likelihood(self._log_probability[self._near], choices, self._index, groups)

    def entropy(self) -> torch.Tensor:
        """Return the mean entropy of the modules near the parcel, for each group."""
        each = -(self._log_probability.exp() * self._log_probability).sum(dim=2)
        near = (self._group >= 0).to(each.dtype)
        return GROUPS * (each * near).sum(dim=1) / near.sum(dim=1).clamp(min=1.0)

    def sample(self) -> torch.Tensor:
        uniform = torch.rand(GROUPS * len(self._group), device=self._group.device)
        choices = self.mode()
        near = draw_choices(self._log_probability[self._near], self._index, uniform)
        return choices.index_put(self._near, near)

    def mode(self) -> torch.Tensor:
        return self._log_probability.argmax(dim=2)


class GridPolicy(ActorCriticPolicy):
    """Actor and critic for environments with the default actions, one choice per module.

    `PPO(GridPolicy, "SmartSurface/Sort-v0")` trains it. It takes the same `policy_kwargs` as
    Stable-Baselines3's `ActorCriticPolicy`, with `net_arch` as one list of units.

    Raises:
        ValueError: the actions are not "modules" with given orientations, or of a stream.
    """

    action_space: ModuleChoices

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        lr_schedule: Any,
        net_arch: list[int] | None = None,
        **more: Any,
    ) -> None:
        if not isinstance(action_space, ModuleChoices):
            raise ValueError(
                f"action_space must be of an environment of surface_gym with actions='modules', "
                f"got {action_space}"
            )
        hidden = [64, 64] if net_arch is None else net_arch
        super().__init__(
            observation_space, action_space, lr_schedule, net_arch=hidden, ortho_init=False, **more
        )

    def _build_mlp_extractor(self) -> None:
        hidden: Any = self.net_arch
        self.mlp_extractor: Any = GridNetwork(self.action_space.config, tuple(hidden)).to(
            self.device
        )

    def _build(self, lr_schedule: Any) -> None:
        space = self.action_space
        self.action_dist = SharedDraws(len(space.nvec), int(space.nvec[0]))
        super()._build(lr_schedule)
