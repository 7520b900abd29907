"""Comparison of an export's decisions with the policy's, and the page that describes an export.

Sums in single precision depend on the order of summation, so scores differ in their last digits. If
the best two scores differ by only this much (a tie), either choice is correct. Differences in ties
are counted. Any other difference is an error.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import gymnasium as gym
import numpy as np

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.actions import ActionKind
from surface_gym.config import Preset

from ..base import Integers, Numbers, Singles
from ..evaluation.tables import markdown
from . import onnx
from .policy import NetworkDecision, Source

Decide = Callable[[Singles], tuple[Integers, Numbers]]  # choices, and angles [rad]

TIE = 1e-6  # [-] scores that differ by less, relative to the largest (or 1), are a tie
MAX_TIES = 1e-3  # [-] allowed share of decisions that differ by round-off
NUM_ENVS = 50  # environments for the policy's episodes
FARTHEST = 3.0  # [-] maximum absolute value of a random number
WHOLE_SHARE = 0.1  # [-] share of random numbers that are integers, where comparisons may jump
_PLACES = {
    "halves": ("ahead of the parcel's centre", "behind it"),
    "quadrants": (
        "ahead of the parcel's centre and left of it (y greater)",
        "ahead and right",
        "behind and left",
        "behind and right",
    ),
}
_MIRRORED = (
    'A parcel that is to go to y < 0 is shown in a mirror: features that say "towards the asked '
    'side" are y times -1 for it. What comes out is turned back already.'
)


@dataclass(frozen=True)
class Agreement:
    """Result of a comparison, as counts of decisions. Each part of an action is one decision."""

    observations: int
    parts: int  # number of choices per observation
    ties: int  # decisions that differ, all in ties
    close: int  # all decisions in ties

    def summary(self) -> str:
        same = "the same" if not self.ties else f"{self.ties} of them otherwise, all ties"
        return (
            f"{self.observations} observations, {self.observations * self.parts} choices: {same} "
            f"({self.close} too close to call in single precision)"
        )


def compare(
    decision: NetworkDecision, source: Source, observations: Singles, decide: Decide
) -> Agreement:
    """Compare the decisions of an ONNX file with the policy's decisions.

    A decision is a tie if the scores of its two best options are almost equal.

    Args:
        decision: how the policy decides, as arrays; it finds the ties.
        source: the policy, and the configuration of its environment.
        observations: (count, features). Decisions for these observations are compared.
        decide: function that runs the ONNX file.

    Raises:
        ValueError: a decision that is no tie differs, too many ties differ, or an angle differs.
    """
    actions, _ = source.policy.predict(observations, deterministic=True)
    wanted = source.config.action_kind.commands(actions, len(observations))
    choices, angles = decide(observations)
    differs = choices != wanted
    close = decision.in_doubt(observations, TIE)
    if (differs & ~close).any():
        first = int(np.argmax((differs & ~close).any(axis=1)))
        raise ValueError(
            f"the ONNX file must decide as the policy of {source.name} does, got "
            f"{int((differs & ~close).any(axis=1).sum())} of {len(observations)} observations "
            f"otherwise; of the first, {observations[first].tolist()}, choices "
            f"{choices[first].tolist()} in place of {wanted[first].tolist()}"
        )
    ties = int((differs & close).sum())
    if ties > math.ceil(MAX_TIES * differs.size):
        raise ValueError(
            f"the ONNX file must decide as the policy of {source.name} does, got {ties} of "
            f"{differs.size} choices otherwise, though all where scores are close"
        )
    if not np.array_equal(angles, np.array(decision.angles)[choices]):
        raise ValueError("the ONNX file must give the angles of what it chooses, got others")
    return Agreement(len(observations), decision.parts, ties, int(close.sum()))


def run_onnx(model: bytes) -> Decide:
    """Return a function that runs an ONNX model by onnxruntime on one core."""
    onnxruntime = onnx.need("onnxruntime")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])

    def decide(observations: Singles) -> tuple[Integers, Numbers]:
        choices, angles = session.run([onnx.CHOICES, onnx.ANGLES], {onnx.OBSERVATION: observations})
        return choices, angles

    return decide


def make_observations(source: Source, count: int, seed: int = 0) -> Singles:
    """Return observations (count, features). Half are random, half from the policy's episodes."""
    presets = source.training.presets
    each = count // 2 // len(presets)
    met = [_from_episodes(source, preset, each, seed) for preset in presets]
    return np.concatenate([*met, random_observations(source, count - sum(map(len, met)), seed)])


def _from_episodes(source: Source, preset: Preset, count: int, seed: int) -> Singles:
    """Return observations (count, features) of episodes that the policy plays in a preset."""
    num_envs = min(NUM_ENVS, count)
    given = {**source.config.arguments(), "preset": preset}
    for name in ("sensors", "actuators", "randomisation"):
        del given[name]  # set by the preset
    env = SmartSurfaceVectorEnv(
        num_envs=num_envs,
        max_episode_steps=source.config.task.periods,
        autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
        **given,
    )
    observations, _ = env.reset(seed=seed)
    kept = [observations]
    while len(kept) * num_envs < count:
        action, _ = source.policy.predict(observations, deterministic=True)
        observations, *_ = env.step(action)
        kept.append(observations)
    env.close()
    return np.concatenate(kept)[:count]


def random_observations(source: Source, count: int, seed: int) -> Singles:
    """Return random observations, shape (count, features).

    All numbers lie in the observation space, and between -`FARTHEST` and `FARTHEST`.
    """
    space = source.config.observation_space()
    low, high = np.maximum(space.low, -FARTHEST), np.minimum(space.high, FARTHEST)
    rng = np.random.default_rng(seed)
    drawn = rng.uniform(low, high, (count, len(low)))
    drawn = np.where(rng.random(drawn.shape) < WHOLE_SHARE, np.round(drawn), drawn)
    return drawn.astype(np.float32)


def make_page(source: Source, metadata: dict[str, str], agreement: Agreement) -> str:
    """Return the page that describes an export, in Markdown."""
    name, config = source.name, source.config
    parts = (
        f"# {name}, seed {source.seed}",
        f"Decides axes for `{source.policy.env_id}` every {config.control_period * 1e3:g} ms. "
        f"Made by surface_gym from a trained policy. `{name}.onnx` decides as the policy does: a "
        f"graph for any ONNX runtime, opset {onnx.OPSET}.",
        "## In",
        f"`{onnx.OBSERVATION}`: float32, {len(config.features)} numbers a parcel; as many rows "
        "as there are parcels.",
        _features(source),
        *((_MIRRORED,) if config.task.mirrored else ()),
        "Outside of least and greatest the policy was never trained: stop there, or let a rule "
        "take over.",
        "## Out",
        _out(source),
        f"- The control period is {config.control_period:g} s: sense, decide, set the axes, "
        "wait. A decision holds until the next one.\n- Only modules of the zone obey. Every other "
        f"keeps its axis.\n- The surface is {_surface(source)}.",
        "## Trained in",
        _training(source),
        "## Checked",
        _checked(agreement),
        "## Metadata of the ONNX file",
        markdown(("key", "value"), ((f"`{key}`", f"`{value}`") for key, value in metadata.items())),
    )
    return "\n\n".join(parts) + "\n"


def _features(source: Source) -> str:
    rows = (
        (str(place), each.name, f"{each.low:g}", f"{each.high:g}", each.meaning, each.formula)
        for place, each in enumerate(source.config.features)
    )
    titles = ("place", "feature", "least", "greatest", "value", "shown")
    return markdown(titles, rows)


def _out(source: Source) -> str:
    kind = source.config.action_kind
    angles = source.config.chosen_orientations
    offered = markdown(
        ("choice", "axis angle [rad]", "[deg]"),
        ((str(k), f"{angle:.9g}", f"{math.degrees(angle):g}") for k, angle in enumerate(angles)),
    )
    return (
        f"- `{onnx.CHOICES}`: int64, {kind.size} numbers, the orientation that each part takes\n"
        f"- `{onnx.ANGLES}`: float64 [rad], {kind.size} numbers, its axis angle; 0 along the line, "
        "anti-clockwise; a module brakes along its axis and lets roll across it\n\n"
        f"{offered}\n\n{_parts(kind)}"
    )


def _parts(kind: ActionKind) -> str:
    """Return a text in Markdown that says which modules follow each part of the action."""
    if kind.name in _PLACES:
        rows = ((str(k), f"modules {place}") for k, place in enumerate(_PLACES[kind.name]))
        return markdown(("part", "followed by"), rows) + (
            "\n\nThe centre is the one that is sensed. A module just at it is ahead and left."
        )
    if kind.name == "window":
        rows_, columns = kind.shape
        return (
            f"Part k is followed by the module in row k // {columns} and column k % {columns} of "
            f"the {rows_} x {columns} modules around the sensed centre, rows from y < 0 to y > 0, "
            "columns along the line. Modules beyond these keep their axes."
        )
    return (
        f"Part k is followed by the module in row k // {kind.columns} and column "
        f"k % {kind.columns} of the zone, rows from y < 0 to y > 0, columns along the line. There "
        f"are {kind.rows} rows of the widest zone; a narrower one is the middle ones of these."
    )


def _surface(source: Source) -> str:
    line = source.config.chosen_line
    return (
        f"`{type(line).__name__}`: {line.rows} x {line.columns} elements, "
        f"{line.pitch_x:g} m x {line.pitch_y:g} m apart, {line.zone_columns} columns of which "
        "obey"
    )


def _training(source: Source) -> str:
    training = source.training
    lines = [f"Preset: {training.preset}. Its environments were:"]
    lines.append("\n".join(f"- {_preset(each)}" for each in training.presets))
    if training.command is not None:
        lines.append(f"Trained by `{training.command}`.")
    if training.results:
        rows = ((name, f"{success:.3f}") for name, success in training.results)
        lines.append(markdown(("preset", "success"), rows))
    return "\n\n".join(lines)


def _preset(preset: Preset) -> str:
    return f"**{preset.label}**: {preset.meaning} Sensors: `{preset.sensors!r}`."


def _checked(agreement: Agreement) -> str:
    return (
        f"{agreement.summary()}.\n\nCompared with the policy on observations of its own episodes "
        f"and random ones, half each. Scores that differ by less than {TIE:g} of the largest "
        "are a tie: single precision, summed in another order, may decide either way."
    )
