"""Policies with Stable-Baselines3's networks: trained PPO and DQN policies, and `GridPolicy`.

`PPO(agents.GridPolicy, env)` learns one choice per module.
"""

from typing import Any, cast

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common import policies
from stable_baselines3.common.distributions import MultiCategoricalDistribution
from stable_baselines3.dqn.policies import DQNPolicy
from torch import nn
from torch.distributions import Categorical

from surface_gym.config import EnvConfig, ModuleChoices
from surface_gym.tasks.planning import LineObservation

from .base import SIDE, action_mirror, find_rest
from .library import PolicyCard, TrainedPolicy, Weights
from .tensors import GROUPS, SharedNetwork, draw_choices, load_weights, log_likelihood, make_layers

PLACE_SIZE = 6  # number of features of a module's place for GridPolicy
NEAR = 0.3  # [m] scale of distances from the parcel
MARGIN = 0.05  # [m] modules closer to the base than this take part in the likelihood
NEVER = -30.0  # log probability of a choice that is never drawn


class EqualCategoricals(MultiCategoricalDistribution):
    """Independent choices with equally many options, in one `Categorical` of PyTorch.

    Stable-Baselines3 has a distribution for each choice, and loops over the distributions. For tens
    of choices, the loop takes longer than the network.
    """

    def __init__(self, choices: int, options: int) -> None:
        super().__init__([options] * choices)
        self._shape = (choices, options)

    def proba_distribution(self, action_logits: torch.Tensor) -> "EqualCategoricals":
        """Set the logits (num_envs, choices x options), grouped by choice."""
        logits = action_logits.reshape(-1, *self._shape)
        self._each: Any = Categorical(logits=logits, validate_args=False)  # methods are untyped
        return self

    def log_prob(self, actions: torch.Tensor) -> torch.Tensor:
        each: torch.Tensor = self._each.log_prob(actions)
        return each.sum(dim=1)

    def entropy(self) -> torch.Tensor:
        each: torch.Tensor = self._each.entropy()
        return each.sum(dim=1)

    def sample(self) -> torch.Tensor:
        """Draw actions (num_envs, choices) by inverting the cumulative probabilities."""
        edges = self._each.probs.cumsum(dim=2)[:, :, :-1]
        uniform = torch.rand((*edges.shape[:2], 1), device=edges.device)
        return (uniform > edges).sum(dim=2)

    def mode(self) -> torch.Tensor:
        return self._each.logits.argmax(dim=2)


class EqualChoicesPolicy(policies.ActorCriticPolicy):
    """Stable-Baselines3's actor and critic, but faster if all choices have equally many options.

    The policy uses `EqualCategoricals` if all choices of a MultiDiscrete action space have equally
    many options. Names and shapes of parameters are the same as in Stable-Baselines3.
    """

    def _build(self, lr_schedule: Any) -> None:
        space = self.action_space
        if isinstance(space, spaces.MultiDiscrete) and len(set(space.nvec.tolist())) == 1:
            self.action_dist = EqualCategoricals(len(space.nvec), int(space.nvec[0]))
        super()._build(lr_schedule)


NETWORKS = {"ppo": EqualChoicesPolicy, "dqn": DQNPolicy}


def make_network(card: PolicyCard, config: EnvConfig) -> policies.BasePolicy:
    """Build an untrained network for an environment, with the card's algorithm and layers."""
    return NETWORKS[card.algo](
        config.observation_space(),
        config.action_space(),
        lambda _: 0.0,
        net_arch=list(card.hidden),
        # None, since making one would import PyTorch's compiler, which takes 2 s.
        optimizer_class=cast(Any, lambda *_, **__: None),
    )


class Policy(TrainedPolicy):
    """A trained PPO or DQN policy."""

    def __init__(self, network: policies.BasePolicy, card: PolicyCard, config: EnvConfig) -> None:
        super().__init__(card, config)
        self._network = network
        self._mirror = action_mirror(config)

    def _predict(self, batch: Any, *_: Any, deterministic: bool) -> tuple[Any, None]:
        actions = self._network.predict(batch, deterministic=deterministic)[0]
        return (actions if self._mirror is None else self._mirror(actions, batch[:, SIDE])), None


def build_policy(card: PolicyCard, weights: Weights, config: EnvConfig) -> Policy:
    """Build a policy of PPO or DQN from its card, its weights, and the card's environment."""
    network = load_weights(lambda: make_network(card, config), card.hidden, weights)
    return Policy(network, card, config)


class GridPlaces:
    """Positions of modules relative to parcels, computed from observations.

    Raises:
        ValueError: the actions are not "modules", or the task observes no parcel on a line.
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
        """Return the modules' places, the modules' groups, and the mirrors.

        Places have shape (num_envs, modules, PLACE_SIZE). Groups have shape (num_envs, modules): 0
        ahead of the parcel's centre, 1 behind the centre, -1 far from the parcel. Mirrors have
        shape (num_envs,): -1 if the observation and the places are mirrored, else 1.
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


class GridNetwork(SharedNetwork):
    """An actor for all modules and a critic, instead of Stable-Baselines3's two networks."""

    _shown: torch.Tensor  # columns of the features that the networks get
    _image: torch.Tensor  # (choices,) mirror image of each choice
    _same: torch.Tensor  # (choices,)
    _far: torch.Tensor  # (choices,) log probabilities of a module far from the parcel

    def __init__(self, config: EnvConfig, hidden: tuple[int, ...]) -> None:
        names = [feature.name for feature in config.features]
        hides = config.task.mirrored and "side" in names  # it says nothing in the mirror
        shown = [k for k, name in enumerate(names) if not (hides and name == "side")]
        choices = config.choices
        super().__init__(len(shown), PLACE_SIZE, hidden, choices)
        self._places = GridPlaces(config)
        self.register_buffer("_shown", torch.tensor(shown))
        image = config.images if hides else range(choices)
        self.register_buffer("_image", torch.tensor(list(image)))
        self.register_buffer("_same", torch.arange(choices))
        far = torch.full((choices,), NEVER)
        far[find_rest(config)] = 0.0
        self.register_buffer("_far", far)
        self._critic = nn.Sequential(*make_layers((len(shown), *hidden)))
        self.latent_dim_pi, self.latent_dim_vf = config.action_kind.size * (choices + 1), hidden[-1]

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """Return log probabilities and groups of modules (num_envs, modules x (choices + 1)).

        The numbers of a module are the log probabilities of its choices, then the module's group.
        """
        seen = self._places(features.detach().cpu().numpy())
        places, group, mirrors = (torch.from_numpy(each).to(features.device) for each in seen)
        env, module = (group >= 0).nonzero(as_tuple=True)
        near = self.log_probability(features[:, self._shown], env, places[env, module])
        order = torch.where((mirrors[env] < 0.0).unsqueeze(1), self._image, self._same)
        found = self._far.expand(*group.shape, -1).index_put((env, module), near.gather(1, order))
        return torch.cat([found, group.unsqueeze(2).to(found.dtype)], dim=2).flatten(1)

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        latent: torch.Tensor = self._critic(features[:, self._shown])
        return latent


class SharedDraws(MultiCategoricalDistribution):
    """Choices of all modules. The modules of a group (see `GridPlaces`) share one random number.

    The likelihood of a group's choices is the length of the interval of random numbers that give
    these choices. Modules far from the parcel have no part in the likelihood.
    """

    def __init__(self, modules: int, choices: int) -> None:
        super().__init__([choices] * modules)
        self._shape = (modules, choices)

    def proba_distribution_net(self, latent_dim: int) -> nn.Module:
        del latent_dim
        return nn.Identity()

    def proba_distribution(self, action_logits: torch.Tensor) -> "SharedDraws":
        """Take the choices' probabilities from `action_logits`, which `forward_actor` returns."""
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
        """Return `GROUPS` times the mean entropy (num_envs,) of the modules near the parcel."""
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


class GridPolicy(policies.ActorCriticPolicy):
    """Actor and critic for environments with the default actions, one choice per module.

    Plain PPO draws each module's choice independently, so that exploration has no effect (see
    `tensors`). Here one small network decides for every module, from the observation and the
    module's place relative to the parcel. The modules ahead of the parcel's centre share one random
    number. The modules behind the centre share another random number.

    `PPO(GridPolicy, "SmartSurface/Sort-v0")` trains a `GridPolicy`. The class takes the same
    `policy_kwargs` as Stable-Baselines3's `ActorCriticPolicy`, with `net_arch` as one list of
    units.

    Raises:
        ValueError: the actions are not "modules" with given orientations, or the task is a stream.
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
