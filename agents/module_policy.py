"""One policy shared by all modules: what each sees, its networks, shared draws, and the policy for
any zone.

Each module sees its own place under the parcel and features that all share. The parcel's outline,
and the rows of its line, are inferred from the environment's observation.

Under a parcel lie 6 to 25 modules. If each drew its axis by itself, their deviations would cancel
and none would ever be seen to pay. Instead the modules of a group look up one uniform number in
their own cumulative probabilities: similar modules choose alike, and each still follows its own
probabilities. The likelihood of a group's choices has a closed form: the uniform numbers that lead
to just these choices make an interval, and its length is the likelihood.
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
from surface_gym.core.actions import QUADRANT_SIZE, QUADRANTS, group_features
from surface_gym.lines import BaseLine, Line
from surface_gym.tasks import planning, sort

from .base import SIDE, Integers, Numbers, Singles, mirrored_orientations
from .library import PolicyCard, TrainedPolicy, Weights
from .tensors import load_weights

EXACT = 1e-6  # [m] lengths that differ by less are equal: observations are single precision
ELLIPSE = np.pi / 4.0  # share of a rectangle that the ellipse in it fills
ROUND = 0.08  # pitches that a disc, turned, may look narrower than a square; half a gap in rows
LEAST_ROWS = 2.0  # of a line amid supports
MARGIN = 0.01  # [m] a module this near to the base may bear it

BESIDE, ACROSS = 0.3, 0.15  # [m] scales of a module's place beside the parcel and the line
_NAMES = tuple(feature.name for feature in sort.FEATURES)
# The side is mirrored away. The time would tie the policy to one length of lead-in.
SHARED = tuple(k for k, name in enumerate(_NAMES) if name not in ("side", "time"))
_ROTORS = {feature.name for feature in group_features(("rotors",))}
_PLACE_SIZE = 9  # features of a module's place


def shared_size(observe: tuple[str, ...]) -> int:
    """Count the features that all modules of an environment share."""
    return len(SHARED) + len(group_features(observe))


def place_size(observe: tuple[str, ...]) -> int:
    """Count the features of a single module."""
    return _PLACE_SIZE + (QUADRANT_SIZE if "rotors" in observe else 0)


@dataclass(frozen=True, eq=False)
class Outline:
    """Outlines of bases between a rectangle and the ellipse in it."""

    half: Numbers  # (2, num_envs) [m] of length and width
    roundness: Numbers  # (num_envs,) [-] 0: a rectangle, 1: an ellipse
    rows: Numbers  # (num_envs,) of the line that the parcel runs on

    def select(self, env: Integers) -> "Outline":
        return Outline(self.half[:, env], self.roundness[env], self.rows[env])

    def reach(self, theta: Numbers) -> Numbers:
        """Compute the half extent [m] along x of bases turned by theta (num_envs,) [rad]."""
        cosine, sine = np.abs([np.cos(theta), np.sin(theta)])
        length, width = self.half
        straight = length * (cosine + sine) + (width - length) * sine
        bent = np.hypot(length * cosine, width * sine)
        return (1.0 - self.roundness) * straight + self.roundness * bent

    def distance(self, place: Numbers) -> Numbers:
        """Compute signed distances (num_envs,) [m] of places (2, num_envs) in the base's frame.

        Negative under the base. Beyond an ellipse that is no disc it is an upper bound.
        """
        straight = (np.abs(place) - self.half).max(axis=0)
        bent = (np.hypot(*(place / self.half)) - 1.0) * self.half.min(axis=0)
        return (1.0 - self.roundness) * straight + self.roundness * bent


def outline_from_features(
    length: Numbers, width: Numbers, fill: Numbers, line: BaseLine
) -> Outline:
    """Compute the outlines of bases from their half length and width [m] and how full they are."""
    half = np.stack([length, width])
    return Outline(
        half,
        np.clip((1.0 - fill) / (1.0 - ELLIPSE), 0.0, 1.0),
        _count_rows(line, half[1] / line.pitch_y + EXACT),
    )


def outline_from_clearance(
    see: planning.LineObservation, clearance: Numbers, line: BaseLine
) -> Outline:
    """Infer the outlines of bases from their half length alone, as rectangles or discs.

    The clearance lacks the half line and the half extent of the base across it. A wider base has a
    wider line, so that both follow.
    """
    length, pitch = see.half_length, line.pitch_y
    cosine, sine = np.abs([np.cos(see.theta), np.sin(see.theta)])
    total = see.offset - clearance  # half line and half extent
    across = total - length * sine  # half line and the half width's part
    rows = _count_rows(line, (across / pitch + 1.5 - ROUND) / (1.0 + cosine))
    half_line = 0.5 * pitch * (rows - 1.0)
    extent = across - half_line
    as_wide = np.abs(extent - length * cosine) < EXACT
    is_disc = np.abs(total - half_line - length) < EXACT
    width = np.divide(extent, cosine, out=length.copy(), where=cosine > 0.0)
    width = np.where(as_wide | is_disc, length, np.clip(width, 0.5 * length, 2.0 * length))
    return Outline(np.stack([length, width]), np.zeros_like(length), rows)


def _count_rows(line: BaseLine, pairs: Numbers) -> Numbers:
    """Count the rows (num_envs,) of a line under which `pairs` of rows fit; else the layout's."""
    least = LEAST_ROWS if isinstance(line, Line) else line.zone_rows
    return np.clip(2.0 * np.floor(pairs), least, line.zone_rows)


@dataclass(frozen=True, eq=False)
class ModuleObservations:
    """Observations of modules, the goal at y > 0; modules in the order of their environments."""

    shared: Singles  # (num_envs, shared) features of all modules of an environment
    env: Integers  # (modules,) environment whose parcel the module bears, now or a period later
    place: Singles  # (modules, place) under the parcel and beside it; then the axes around it
    index: Integers  # (modules,) in the action


class ModuleView:
    """Conversion of Sort's observations to those of modules, and of their choices to actions.

    Where the observation has the group "parcel", it gives the outline of the base; else the base is
    taken for a rectangle as wide as the clearance implies. Where it has "rotors", a module sees the
    axes of its own quadrant of the parcel.
    """

    def __init__(self, config: EnvConfig) -> None:
        checks.one_of("task", config.task_name, ("sort",))
        checks.one_of("actions", config.actions, ("modules",))
        self._config = config
        kind = config.action_kind
        self._size = kind.size
        self._line = config.chosen_line
        # [m] from the zone's first edge, and from the line's middle.
        self._column = self._line.pitch_x * (np.arange(kind.columns) + 0.5)
        self._row = self._line.pitch_y * (np.arange(kind.rows) - (kind.rows - 1) / 2.0)
        self._image = mirrored_orientations(config.chosen_orientations)
        angles = np.array(config.chosen_orientations)
        self._rest = int(np.abs(np.sin(angles)).argmax())  # the choice nearest to 90 deg
        columns = config.columns
        of_groups = [columns[each.name].place for each in group_features(config.observe)]
        self._shared = np.array([*SHARED, *of_groups])
        exact = "parcel" in config.observe
        self._locate = self._locate_exactly if exact else self._locate_by_clearance
        # (QUADRANTS, QUADRANT_SIZE) feature columns of each; (QUADRANTS, 0) if not observed.
        rotors = [name for name in columns if name in _ROTORS]
        self._rotors = np.array([columns[name].place for name in rotors], dtype=np.int64)
        self._rotors = self._rotors.reshape(len(QUADRANTS), -1)

    def __call__(self, observations: Singles) -> ModuleObservations:
        """Compute the modules' observations from those of environments (num_envs, features)."""
        shown = self._config.observed(observations)
        see = _mirrored_to_left(planning.decode_line(shown))
        outlines, into_zone = self._locate(see, shown)
        env, index, x, y = self._find_near(see, outlines, into_zone)
        outline = outlines.select(env)
        period = self._config.control_period
        now = _in_parcel_frame(x, y, see.theta[env])
        later = _in_parcel_frame(
            x - period * see.vx[env],
            y - period * see.vy[env],
            (see.theta + period * see.omega)[env],
        )
        distance = np.stack([outline.distance(now), outline.distance(later)])
        beside = np.stack([x / BESIDE, y / BESIDE, (y + see.offset[env]) / ACROSS])
        parts = (now / outline.half, later / outline.half, distance <= 0.0, beside)
        place = np.concatenate([*parts, self._axes(observations, env, x, y)]).T
        bears = distance.min(axis=0) <= MARGIN
        return ModuleObservations(
            observations[:, self._shared], env[bears], place[bears].astype(np.float32), index[bears]
        )

    def _locate_by_clearance(
        self, see: planning.LineObservation, shown: planning.Observed
    ) -> tuple[Outline, Numbers]:
        """Infer outlines, and x [m] of the bases' centres (num_envs,) past the zone's edge."""
        outline = outline_from_clearance(see, shown["clearance"], self._line)
        return outline, see.into_zone + (outline.reach(see.theta) - see.reach)

    def _locate_exactly(
        self, see: planning.LineObservation, shown: planning.Observed
    ) -> tuple[Outline, Numbers]:
        """Compute the same from an observed outline: the phase in a pitch makes x exact."""
        names = ("length", "width", "fill", "sine of phase x", "cosine of phase x")
        length, width, fill, sine, cosine = (shown[name] for name in names)
        outline = outline_from_features(length, width, fill, self._line)
        pitch = self._line.pitch_x
        into_zone = see.into_zone + (outline.reach(see.theta) - see.reach)
        in_pitch = 0.5 + np.arctan2(sine, cosine) / (2.0 * np.pi)  # from a column's first edge
        return outline, pitch * (np.round(into_zone / pitch - in_pitch) + in_pitch)

    def _axes(self, observations: Singles, env: Integers, x: Numbers, y: Numbers) -> Singles:
        """Select features (features, modules) of the axes in each module's quadrant.

        A module is at x and y [m] from the parcel's centre.
        """
        quadrant = 2 * (x < 0.0) + (y < 0.0)
        return observations[env[:, np.newaxis], self._rotors[quadrant]].T

    def _find_near(
        self, see: planning.LineObservation, outline: Outline, into_zone: Numbers
    ) -> tuple[Integers, Integers, Numbers, Numbers]:
        """Find modules that the parcel may reach in a period.

        Returns:
            Environment, index in the action, and x and y [m] from the parcel's centre (modules,).
        """
        mirror = np.where(see.side < 0.0, -1.0, 1.0)[:, np.newaxis]
        row = mirror * self._row
        x = self._column - into_zone[:, np.newaxis]
        y = row - see.offset[:, np.newaxis]
        moved = self._config.control_period * (np.abs(see.vx) + np.abs(see.vy))
        close = (np.hypot(*outline.half) + moved + 2.0 * MARGIN)[:, np.newaxis]
        # Only the line's rotors bear.
        line = np.abs(row) < 0.5 * self._line.pitch_y * outline.rows[:, np.newaxis]
        rows = line & (np.abs(y) < close)
        columns = np.abs(x) < close
        env, place, column = np.nonzero(rows[:, :, np.newaxis] & columns[:, np.newaxis, :])
        index = place * len(self._column) + column
        return env, index, x[env, column], y[env, place]

    def actions(
        self, observations: Singles, seen: ModuleObservations, choices: Integers
    ) -> Integers:
        """Build actions (num_envs, size) from choices (modules,); other modules stay at 90 deg."""
        actions = np.full((len(observations), self._size), self._rest)
        mirrored = observations[seen.env, SIDE] < 0.0
        actions[seen.env, seen.index] = np.where(mirrored, self._image[choices], choices)
        return actions


def _mirrored_to_left(see: planning.LineObservation) -> planning.LineObservation:
    """Mirror the parcels that are to go to y < 0."""
    mirror = np.where(see.side < 0.0, -1.0, 1.0)
    return replace(
        see,
        offset=mirror * see.offset,
        theta=mirror * see.theta,
        vy=mirror * see.vy,
        omega=mirror * see.omega,
    )


def _in_parcel_frame(x: Numbers, y: Numbers, theta: Numbers) -> Numbers:
    """Rotate x and y [m] to (2, modules) [m] along and across the parcel."""
    cosine, sine = np.cos(theta), np.sin(theta)
    return np.stack([cosine * x + sine * y, cosine * y - sine * x])


GROUPS = 2  # of modules in an environment
_SMALLEST = 1e-6  # length below which an interval counts as empty: single precision ends there
_FARTHEST = 0.7  # half lengths from the parcel's centre that a line between groups may pass


def draw_groups(
    env: Integers, place: Singles, num_envs: int, probability: float, rng: np.random.Generator
) -> Integers:
    """Draw the group of each module (modules,): 2 i or 2 i + 1 in environment i.

    Args:
        place: (modules, ...) first along and across the parcel, in half lengths.
        probability: that a random line through the parcel splits its modules into two groups.
    """
    splits = rng.random(num_envs) < probability
    angle = 2.0 * np.pi * rng.random(num_envs)
    distance = rng.uniform(-_FARTHEST, _FARTHEST, num_envs)
    across = np.cos(angle)[env] * place[:, 0] + np.sin(angle)[env] * place[:, 1]
    return GROUPS * env + (splits[env] & (across > distance[env]))


def draw_choices(
    log_probability: torch.Tensor, group: torch.Tensor, uniform: torch.Tensor
) -> torch.Tensor:
    """Choose for each module (modules,) by its group's uniform number."""
    edges = log_probability.exp().cumsum(dim=1)[:, :-1]
    return (uniform[group].unsqueeze(1) > edges).sum(dim=1)


def log_likelihood(
    log_probability: torch.Tensor, choice: torch.Tensor, group: torch.Tensor, groups: int
) -> torch.Tensor:
    """Compute the log likelihood (num_envs,) of an environment's choices (modules,) together.

    It is 0 for an environment without modules. Where no uniform number leads to the choices any
    more, it has its lowest value and no gradient.
    """
    edges = log_probability.exp().cumsum(dim=1)[:, :-1]
    below = torch.nn.functional.pad(edges, (1, 0), value=0.0).gather(1, choice.unsqueeze(1))
    above = torch.nn.functional.pad(edges, (0, 1), value=1.0).gather(1, choice.unsqueeze(1))
    first = below.new_zeros(groups).scatter_reduce(0, group, below.squeeze(1), "amax")
    last = above.new_ones(groups).scatter_reduce(0, group, above.squeeze(1), "amin")
    return (last - first).clamp(min=_SMALLEST).log().reshape(-1, GROUPS).sum(dim=1)


def _linear(inputs: int, outputs: int, gain: float = math.sqrt(2.0)) -> nn.Linear:
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


def _layers(units: tuple[int, ...]) -> list[nn.Module]:
    return [layer for sizes in pairwise(units) for layer in (_linear(*sizes), nn.Tanh())]


class SharedNetwork(nn.Module):
    """Actor of all modules: from the shared features and a module's own place to its logits.

    Weights of the place start at zero: modules learn to act together before they learn to differ.
    Otherwise they settle for the fixed layout.
    """

    def __init__(
        self, choices: int, hidden: tuple[int, ...], observe: tuple[str, ...] = ()
    ) -> None:
        super().__init__()
        # The names stand in files of weights.
        self._alike = _linear(shared_size(observe), hidden[0])
        self._apart = nn.Linear(place_size(observe), hidden[0], bias=False)
        nn.init.zeros_(self._apart.weight)
        self._between = nn.Sequential(*_layers(hidden))
        self._logits = _linear(hidden[-1], choices, 0.01)

    def forward(self, shared: torch.Tensor, env: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
        """Compute log probabilities (modules, choices)."""
        first = torch.tanh(self._alike(shared)[env] + self._apart(place))
        logits: torch.Tensor = self._logits(self._between(first))
        return logits.log_softmax(dim=1)


class ValueNetwork(nn.Module):
    """Critic: the value of an environment's observation without the asked side."""

    def __init__(self, hidden: tuple[int, ...], observe: tuple[str, ...] = ()) -> None:
        super().__init__()
        inputs = SIDE + len(group_features(observe))
        self._layers = nn.Sequential(*_layers((inputs, *hidden)), _linear(hidden[-1], 1, 1.0))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Compute values (num_envs,) of observations (num_envs, features)."""
        without_side = torch.cat([observations[:, :SIDE], observations[:, SIDE + 1 :]], dim=1)
        return self._layers(without_side)[:, 0]


class ModulePolicy(TrainedPolicy):
    """A policy of modules with shared weights.

    Args:
        zone: first and last column of controlled modules; None: those after the lead-in, as in
            training.
    """

    def __init__(
        self, network: SharedNetwork, card: PolicyCard, zone: tuple[int, int] | None = None
    ) -> None:
        torch.set_num_threads(1)  # the network is small: more threads only wait for each other
        config = replace(card.env_config(), zone=zone)
        super().__init__(card, config)
        self._network = network.eval()
        self._view = ModuleView(config)
        if zone is not None:
            self.env_kwargs["zone"] = zone

    def for_zone(self, zone: tuple[int, int] | None) -> "ModulePolicy":
        return ModulePolicy(self._network, self.card, zone)

    @torch.no_grad()
    def _predict(self, batch: Any, *_: Any, deterministic: bool) -> tuple[Any, None]:
        """Choose; random choices of an environment's modules share a draw, as in training."""
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
