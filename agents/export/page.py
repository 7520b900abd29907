"""The page that goes with an export: what goes in, what comes out, and what it was trained in."""

import math
from collections.abc import Iterable, Sequence

from surface_gym.conditions import Condition
from surface_gym.core.actions import ActionKind
from surface_gym.tasks import Sort

from .checking import TIE, Agreement
from .graph import ANGLES, CHOICES, OBSERVATION, OPSET
from .header import prefix_of
from .needs import need_of
from .source import Source

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


def page_of(source: Source, told: dict[str, str], checked: dict[str, Agreement | None]) -> str:
    """The page, in Markdown.

    Args:
        source: of the policy.
        told: metadata.
        checked: how each form agrees with the policy; None: it was not tried.
    """
    name = source.name
    parts = (
        f"# {name}, seed {source.seed}",
        f"Decides axes for `{source.policy.env_id}` every "
        f"{source.settings.control_period * 1e3:g} ms. Made by surface_gym from a trained policy; "
        "each file decides as the policy does.",
        _table(
            ("file", "is"),
            (
                (f"`{name}.onnx`", f"a graph for any ONNX runtime, opset {OPSET}"),
                (f"`{name}.h`", f"a C99 header: `{prefix_of(name)}_decide(observation, angles)`"),
            ),
        ),
        "## In",
        f"`{OBSERVATION}`: float32, {len(source.settings.features)} numbers a parcel; in ONNX as "
        "many rows as there are parcels.",
        _features(source),
        *((_MIRRORED,) if isinstance(source.settings.task, Sort) else ()),
        "Outside of least and greatest the policy was never trained: stop there, or let a rule "
        "take over.",
        "## Out",
        _out(source),
        f"- The control period is {source.settings.control_period:g} s: sense, decide, set the "
        "axes, wait. A decision holds until the next one.\n- Only modules of the zone obey. Every "
        f"other keeps its axis.\n- The plant is {_plant(source)}.",
        "## Trained in",
        _training(source),
        "## Checked",
        _checked(checked),
        "## What the ONNX file says of itself",
        _table(("key", "value"), ((f"`{key}`", f"`{value}`") for key, value in told.items())),
    )
    return "\n\n".join(parts) + "\n"


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _features(source: Source) -> str:
    rows = (
        (str(place), each.name, f"{each.low:g}", f"{each.high:g}", each.meaning, need_of(each))
        for place, each in enumerate(source.settings.features)
    )
    return _table(("place", "feature", "least", "greatest", "meaning", "a machine needs"), rows)


def _out(source: Source) -> str:
    kind = source.settings.action_kind
    angles = source.settings.chosen_orientations
    offered = _table(
        ("choice", "axis angle [rad]", "[deg]"),
        ((str(k), f"{angle:.9g}", f"{math.degrees(angle):g}") for k, angle in enumerate(angles)),
    )
    return (
        f"- `{CHOICES}`: int64, {kind.size} numbers, which orientation each part takes\n"
        f"- `{ANGLES}`: float64 [rad], {kind.size} numbers, its axis angle; 0 along the line, "
        "anti-clockwise; a module brakes along its axis and lets roll across it\n\n"
        f"{offered}\n\n{_parts(kind)}"
    )


def _parts(kind: ActionKind) -> str:
    """Which modules follow which part."""
    if kind.name in _PLACES:
        rows = ((str(k), f"modules {place}") for k, place in enumerate(_PLACES[kind.name]))
        return _table(("part", "followed by"), rows) + (
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


def _plant(source: Source) -> str:
    plant = source.settings.chosen_plant
    return (
        f"`{type(plant).__name__}`: {plant.rows} x {plant.columns} elements, "
        f"{plant.pitch_x:g} m x {plant.pitch_y:g} m apart, {plant.zone_columns} columns of which "
        "obey"
    )


def _training(source: Source) -> str:
    training = source.training
    lines = [f"Condition: {training.condition}. Its lanes were:"]
    lines.append("\n".join(f"- {_condition(each)}" for each in training.practised))
    if training.command is not None:
        lines.append(f"Trained by `{training.command}`.")
    if training.results:
        rows = ((name, f"{success:.3f}") for name, success in training.results)
        lines.append(_table(("condition", "success"), rows))
    return "\n\n".join(lines)


def _condition(condition: Condition) -> str:
    return f"**{condition.label}**: {condition.meaning} Sensors: `{condition.sensors!r}`."


def _checked(checked: dict[str, Agreement | None]) -> str:
    lines = [
        f"- {what}: " + ("not tried, there was no compiler" if each is None else each.told())
        for what, each in checked.items()
    ]
    return "\n".join(lines) + (
        "\n\nCompared with the policy, half along its own episodes, half at random. Scores that "
        f"differ by less than {TIE:g} of the largest are a tie: single precision, summed in "
        "another order, may decide either way."
    )
