"""Decisions of one network for all parts of an action: PPO's and DQN's."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import nn

from surface_gym.settings import Settings
from surface_gym.tasks import Sort

from ..mirror import SIDE, mirrored_orientations
from ..policies.policy import make_network
from .arrays_in_c import table_of_integers
from .decision import Integers, Singles, close_scores
from .graph import OBSERVATION, Graph
from .network import Network, network_of
from .source import Source


@dataclass(frozen=True, eq=False)
class Mirror:
    """Turns what was chosen for y > 0 back into the world where the asked side is y < 0."""

    side: int  # place of the side in the observation
    images: Integers  # (choices,) each orientation's
    places: Integers  # (parts,) each part's


@dataclass(frozen=True, eq=False)
class WholeDecision:
    """The best of each group of scores says what some parts choose."""

    network: Network
    says: Integers  # (options, parts of a group) what the options of a group say
    groups: int
    angles: tuple[float, ...]  # [rad] of the orientations on offer
    mirror: Mirror | None  # None: seen as it is

    @property
    def features(self) -> int:
        return self.network.inputs

    @property
    def parts(self) -> int:
        return self.groups * self.says.shape[1]

    def in_doubt(self, observations: Singles, tie: float) -> NDArray[np.bool_]:
        scores = self.network.scores(observations.astype(np.float64))
        close = close_scores(scores.reshape(len(observations), self.groups, -1), tie)
        parts = close.repeat(self.says.shape[1], axis=1)
        if self.mirror is None:
            return parts
        mirrored = observations[:, self.mirror.side : self.mirror.side + 1] < 0.0
        turned: NDArray[np.bool_] = np.where(mirrored, parts[:, self.mirror.places], parts)
        return turned

    def add_to(self, graph: Graph) -> str:
        scores = graph.network(self.network, OBSERVATION)
        grouped = graph.add("Reshape", scores, graph.whole(-1, self.groups, len(self.says)))
        best = graph.add("ArgMax", grouped, axis=2, keepdims=0)
        said = graph.add("Gather", graph.array(self.says), best)
        seen = graph.add("Reshape", said, graph.whole(-1, self.parts))
        if self.mirror is None:
            return seen
        flipped = graph.add("Gather", seen, graph.array(self.mirror.places), axis=1)
        image = graph.add("Gather", graph.array(self.mirror.images), flipped)
        side = graph.add("Gather", OBSERVATION, graph.whole(self.mirror.side), axis=1)
        mirrored = graph.add("Less", side, graph.array(np.array(0.0, dtype=np.float32)))
        return graph.add("Where", mirrored, image, seen)

    def in_c(self, prefix: str) -> tuple[str, str]:
        options, width = self.says.shape
        tables = table_of_integers(f"{prefix}_says", self.says)
        to = "choices" if self.mirror is None else "seen"
        lines = [
            f"float scores[{self.network.outputs}];",
            f"{prefix}_scores(observation, scores);",
            f"for (int group = 0; group < {self.groups}; ++group) {{",
            f"    const int option = {prefix}_best(scores + {options} * group, {options});",
            f"    for (int k = 0; k < {width}; ++k)",
            f"        {to}[{width} * group + k] = {prefix}_says[{width} * option + k];",
            "}",
        ]
        if self.mirror is not None:
            tables += table_of_integers(f"{prefix}_images", self.mirror.images)
            tables += table_of_integers(f"{prefix}_places", self.mirror.places)
            lines = [
                f"int seen[{self.parts}];",
                *lines,
                f"const int mirrored = observation[{self.mirror.side}] < 0.0f;",
                f"for (int part = 0; part < {self.parts}; ++part)",
                f"    choices[part] = mirrored ? {prefix}_images[seen[{prefix}_places[part]]] "
                ": seen[part];",
            ]
        return tables, "\n".join(lines)


def whole_decision(source: Source) -> WholeDecision:
    """That of a policy of one of Stable-Baselines3's networks.

    Raises:
        ValueError: its network or its actions are of a kind that is not exported.
    """
    settings, card = source.settings, source.policy.card
    kind = settings.action_kind
    if kind.continuous:
        raise ValueError("orientations must be some to choose from, to be exported, got any angle")
    network = make_network(card, settings)
    network.load_state_dict(source.weights)
    if card.algo == "dqn":
        found = network_of(network.get_submodule("q_net.q_net"))
    else:
        hidden = network.get_submodule("mlp_extractor.policy_net")
        found = network_of(nn.Sequential(hidden, network.get_submodule("action_net")))
    single = kind.space().shape == ()  # one number says all parts
    says = kind.commands(np.arange(found.outputs), found.outputs) if single else _each(kind.choices)
    return WholeDecision(
        found, says, 1 if single else kind.size, settings.chosen_orientations, _mirror(settings)
    )


def _each(choices: int) -> Integers:
    """Each option says the choice of its number."""
    return np.arange(choices)[:, np.newaxis]


def _mirror(settings: Settings) -> Mirror | None:
    """As `Policy` has it: Sort shows its parcel in a mirror where it is to go to y < 0."""
    if not isinstance(settings.task, Sort):
        return None
    kind = settings.action_kind
    places = kind.flip(np.arange(kind.size)[np.newaxis])[0]
    return Mirror(SIDE, mirrored_orientations(settings.chosen_orientations), places)
