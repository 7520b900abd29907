"""A case, a surface and what was found, in words."""

import math

from surface_gym.design.best_layout import BestLayout
from surface_gym.design.case import TOGETHER, WORST, Case, enough
from surface_gym.design.columns import MOST, Columns
from surface_gym.design.limits import FACTOR_RANGE, FrictionRange, Limits, Span
from surface_gym.design.purposes import Purpose, Slow, Sort, Stop, Turn
from surface_gym.design.sensitivity import Bar, Sensitivity
from surface_gym.design.size_map import SuccessMap
from surface_gym.design.sweep import NOMINAL, Arrangement
from surface_gym.parcel import Base, Disc, Polygon, Rectangle

MOST_DRAWS = f"{1.0 - WORST:.0%} of the draws"
MASS = (
    "Mass cancels out of the motion: these answers hold for any mass. Only the inertia over the "
    "mass counts, and by itself it goes with the base."
)


def base_told(base: Base) -> str:
    """A base in a few words."""
    if isinstance(base, Rectangle):
        return f"{base.length:g} x {base.width:g} m parcel"
    if isinstance(base, Disc):
        return f"round parcel of {base.radius:g} m radius"
    if isinstance(base, Polygon):
        return f"parcel of {len(base.vertices)} corners"
    return f"{type(base).__name__} parcel"


def purpose_told(purpose: Purpose) -> str:
    """What is to be done, as after "to"."""
    if isinstance(purpose, Sort):
        return "sort it"
    if isinstance(purpose, Slow):
        near = "or less" if purpose.tolerance is None else f"+- {purpose.tolerance:g}"
        return f"slow it to {purpose.ratio:g} {near} of its speed"
    if isinstance(purpose, Stop):
        if purpose.place is None:
            return "stop it"
        return f"stop it within {purpose.tolerance:g} m of {purpose.place:g} m into the zone"
    if isinstance(purpose, Turn):
        angle, tolerance = math.degrees(purpose.angle), math.degrees(purpose.tolerance)
        return f"turn it by {angle:g} +- {tolerance:g} deg"
    return purpose.name


def purpose_met(purpose: Purpose) -> str:
    """What is to become of the parcel, as after "to" or "may"."""
    told = purpose_told(purpose)
    verb, _, rest = told.partition(" it")
    done = {"sort": "sorted", "slow": "slowed", "stop": "stopped", "turn": "turned"}
    return f"be {done[verb]}{rest}" if verb in done else told


def coming_told(case: Case) -> str:
    """How the parcel comes."""
    tilt = f" down {math.degrees(case.tilt):g} deg" if case.tilt else ""
    return f"at {case.speed:g} m/s{tilt}"


def surface_told(arrangement: Arrangement) -> str:
    """The surface, as after "on"."""
    rows = arrangement.line.rows
    return f"{_counted(arrangement.columns, 'column')} of {rows} rows, {arrangement.layout.name}"


def columns_told(case: Case, found: Columns) -> str:
    """The answer to how many columns."""
    asked = f"to {purpose_told(case.purpose)}"
    who = f"a {base_told(case.parcel.base)} that comes {coming_told(case)}"
    if found.columns is None:
        return f"No number of columns up to {MOST} is enough {asked}, {who}, by the study's layouts"
    needs = (
        f"{_counted(found.columns, 'column')} of {found.rows} rows ({found.modules} modules at "
        f"{found.layout}) are what it takes {asked}, {who}"
    )
    together = next((each for each in found.worst if each.group == TOGETHER), None)
    if together is None:
        return needs
    if together.columns is None:
        return f"{needs}; no number does it in {MOST_DRAWS} ({together.success:.0%} do it here)"
    return f"{needs}; for {MOST_DRAWS}, {together.columns}"


def limits_told(limits: Limits) -> str:
    """The answer to how slow, or how flat."""
    arrangement = limits.arrangement
    case = arrangement.case
    known, worst = limits.spans[0], limits.spans[-1]
    told = (
        f"On {surface_told(arrangement)} ({arrangement.chosen}), {limits.varied} may be "
        f"{span_told(limits, known)} for a {base_told(case.parcel.base)} to "
        f"{purpose_met(case.purpose)}"
    )
    if worst.group != NOMINAL:
        told += f"; {span_told(limits, worst)} for {MOST_DRAWS} of what is unknown"
    ends = (f"{limits.scale * known.values[k]:.3g}" for k in (0, -1))
    return f"{told}. Tried: {' to '.join(ends)} {limits.unit}"


def span_told(limits: Limits, span: Span) -> str:
    """From the least to the most, in the quantity's unit."""
    if span.least is None or span.most is None:
        return f"nothing near {limits.own * limits.scale:.4g}"
    low, high = (f"{limits.scale * value:.3g}" for value in (span.least, span.most))
    unit = f" {limits.unit}" if limits.unit != "-" else ""
    if span.least == span.values[0] and span.most == span.values[-1]:
        return "anything tried"
    if span.most == span.values[-1]:
        return f"{low}{unit} or more"
    if span.least == span.values[0]:
        return f"{high}{unit} or less"
    return f"{low} to {high}{unit}"


def friction_told(found: FrictionRange) -> str:
    """The answer to how far friction may be off."""
    arrangement = found.along.arrangement
    case = arrangement.case
    told = (
        f"On {surface_told(arrangement)} ({arrangement.chosen}), for a "
        f"{base_told(case.parcel.base)} that comes {coming_told(case)} to "
        f"{purpose_met(case.purpose)}, "
    )
    both = ((found.along, "mu_max", case.mu_max), (found.across, "mu_min", case.mu_min))
    told += " and ".join(
        f"{name} may be {span_told(limits, limits.spans[0])} times {own:g}"
        for limits, name, own in both
    )
    if found.along.spans[-1].group != NOMINAL:
        spans = (f"{name} {span_told(limits, limits.spans[-1])}" for limits, name, _ in both)
        told += f"; for {MOST_DRAWS} of what else is unknown, {' and '.join(spans)}"
    return f"{told}. Tried: 1/{FACTOR_RANGE:g} to {FACTOR_RANGE:g} times"


def map_told(found: SuccessMap) -> str:
    """The answer of a map."""
    case = found.arrangement.case
    share = float(enough(found.share).mean())
    best = int(enough(found.share).sum(axis=1).argmax())
    asked = f"On {surface_told(found.arrangement)}, made for a {base_told(case.parcel.base)}"
    speeds = found.speeds[enough(found.share[best])]
    if len(speeds) == 0:
        return f"{asked}, no speed and size here do it in {MOST_DRAWS}"
    return (
        f"{asked}, {share:.0%} of these speeds and sizes do it in {MOST_DRAWS}; most for "
        f"{found.sizes[best]:.2g} times its size, within {speeds[0]:.3g} to {speeds[-1]:.3g} m/s"
    )


def sensitivity_told(found: Sensitivity) -> str:
    """The answer to what matters most."""
    case = found.arrangement.case
    unit = f" {case.purpose.unit}" if case.purpose.unit != "-" else ""
    spread = [bar for bar in found.bars if not math.isnan(bar.high - bar.low)]
    asked = f"On {surface_told(found.arrangement)}, to {purpose_told(case.purpose)}"
    if not spread:
        return f"{asked} {coming_told(case)}, no draw comes as far as a measure"
    widest = max(spread, key=lambda bar: bar.high - bar.low)
    worst = min(found.bars, key=lambda bar: bar.success)
    low, high = (f"{case.purpose.scale * value:.3g}" for value in (widest.low, widest.high))
    return (
        f"{asked} {coming_told(case)}, {case.purpose.measured} is spread most by "
        f"{field_told(widest)}: {low} to {high}{unit} in nine draws of ten; "
        + (
            f"success suffers most from {field_told(worst)}, {worst.success:.0%}"
            if worst.success < 1.0
            else "all succeed"
        )
    )


def field_told(bar: Bar) -> str:
    """A field of `Unknown` with its spread."""
    name, scale, unit = {
        "friction": ("friction along axes", 100.0, " %"),
        "rolling": ("friction across axes", 100.0, " %"),
        "com_offset": ("centre of mass", 100.0, " %"),
        "mass": ("mass at its inertia", 100.0, " %"),
        "stiffness": ("unevenness", 1.0, ""),
        "lateral": ("place across", 1000.0, " mm"),
        "heading": ("heading", 180.0 / math.pi, " deg"),
        "speed": ("entry speed", 1.0, " m/s"),
        "tilt": ("tilt", 180.0 / math.pi, " deg"),
    }[bar.field]
    return f"{name} +-{scale * bar.spread:.3g}{unit}"


def sentence(told: str) -> str:
    """With a full stop."""
    return told if told.endswith(".") else f"{told}."


def layout_told(found: BestLayout) -> str:
    """The answer to which fixed layout."""
    case, best, study = found.case, found.best, found.study
    first, last = best.speeds[0], best.speeds[-1]
    return (
        f"The best fixed layout found for {_counted(found.line.columns, 'column')} of "
        f"{found.line.rows} rows can {purpose_told(case.purpose)}, a "
        f"{base_told(case.parcel.base)}, at {best.successes:.1%} of {len(best.speeds)} speeds from "
        f"{first:g} to {last:g} m/s, the study's at {study.successes:.1%}; without a failure "
        f"{_least_told(best.least_speed)}, the study's {_least_told(study.least_speed)}"
    )


def _least_told(speed: float) -> str:
    return "at none" if math.isnan(speed) else f"from {speed:.3g} m/s on"


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"
