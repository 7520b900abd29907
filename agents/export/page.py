"""The page of an export: input, output, training and check."""

import math

from surface_gym.actions import ActionKind
from surface_gym.config import Preset
from surface_gym.feature_groups import GROUPS, group_features
from surface_gym.tasks.features import Feature

from ..evaluation.tables import markdown
from . import check, onnx
from .policy import Source

POSE = "the parcel's place and angle: a camera, or switches in the modules, and a filter"
VELOCITY = "the parcel's velocity: a filter's, from its pose over time"
BOTH = "the parcel's pose and velocity, as above, and its goal"
OUTLINE = "the parcel's outline: a scale drawing, or a picture of it"
POSE_AND_OUTLINE = "the parcel's pose and its outline"
GOAL = "the goal of this parcel: the order"
TO_GO = "the parcel's pose, and its goal"
CLOCK = "a clock, started as the parcel enters"
ENTRY = "the parcel's speed as it enters: the conveyor's before the surface"
PATH = "the path to follow, and the parcel's place beside it"
TILT = "the tilt of the surface: measured once"
AXES = "each axis' angle: an encoder, or computed from its commands; and the parcel's pose"
WINDOW = "the parcel's pose and outline, or a switch in each module"
LOAD = "a filter that estimates the place of the load and the friction from the motion"
UNKNOWN = "see its meaning"

# Keys are a feature's name, the beginning of its name, or its group.
_NEED_BY_NAME = {
    "lateral offset": POSE, "sine of theta": POSE, "cosine of theta": POSE,
    "sine of phase x": POSE, "cosine of phase x": POSE,
    "sine of phase y": POSE, "cosine of phase y": POSE,
    "forward speed": VELOCITY, "lateral speed": VELOCITY, "turning speed": VELOCITY,
    "size": OUTLINE, "length": OUTLINE, "width": OUTLINE, "fill": OUTLINE,
    "clearance": POSE_AND_OUTLINE, "distance into zone": POSE_AND_OUTLINE,
    "front in zone": POSE_AND_OUTLINE, "rear to go": POSE_AND_OUTLINE,
    "side": GOAL, "asked ratio": GOAL, "asked angle": GOAL, "asked speed": GOAL,
    "to go": TO_GO, "to go, near": TO_GO, "to go, nearest": TO_GO,
    "angle to turn": TO_GO, "angle to turn, near": TO_GO,
    "excess of speed": BOTH, "fine excess": BOTH, "speed error": BOTH,
    "entry speed": ENTRY, "time": CLOCK, "tilt": TILT,
    "cross error": PATH, "fine cross error": PATH,
}  # fmt: skip
_NEED_BY_PREFIX = {
    "slope ": PATH, "occupied ": WINDOW, "rotors ": AXES, "cosine of rotors ": AXES,
    "sine of rotors ": AXES, "cosine of axis ": AXES, "sine of axis ": AXES,
}  # fmt: skip
_LEARNED = tuple(name for name in GROUPS if name == "load")
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


def find_need(feature: Feature) -> str:
    """Return what a machine must measure for a feature; `UNKNOWN` for features of custom tasks."""
    if feature.name in _NEED_BY_NAME:
        return _NEED_BY_NAME[feature.name]
    if any(feature.name == each.name for each in group_features(_LEARNED)):
        return LOAD
    found = (need for start, need in _NEED_BY_PREFIX.items() if feature.name.startswith(start))
    return next(found, UNKNOWN)


def make_page(source: Source, metadata: dict[str, str], agreement: check.Agreement) -> str:
    """Return the page, in Markdown."""
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
        (
            str(place), each.name, f"{each.low:g}", f"{each.high:g}", each.meaning, each.formula,
            find_need(each),
        )
        for place, each in enumerate(source.config.features)
    )  # fmt: skip
    titles = ("place", "feature", "least", "greatest", "value", "shown", "a machine needs")
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
    """Describe the modules that follow each part of the action."""
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


def _checked(agreement: check.Agreement) -> str:
    return (
        f"{agreement.summary()}.\n\nCompared with the policy on observations of its own episodes "
        f"and random ones, half each. Scores that differ by less than {check.TIE:g} of the largest "
        "are a tie: single precision, summed in another order, may decide either way."
    )
