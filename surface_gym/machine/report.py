"""The report of an estimate, as a page of HTML without scripts."""

import math
from html import escape
from pathlib import Path

from surface_gym import files
from surface_gym.machine.estimate import Estimate
from surface_gym.machine.search import PARAMETERS

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 60rem; padding: 0 1rem;
  color-scheme: light dark; }
table { border-collapse: collapse; margin: 1rem 0; }
th, td { padding: .25rem .75rem; text-align: right; border-bottom: 1px solid #8884; }
th:first-child, td:first-child, .text { text-align: left; }
svg { display: block; max-width: 100%; }
.warning { border-left: 4px solid #d97706; padding-left: 1rem; }
"""
BAR = 6.0  # [px] width of a run's bar
HIGH = 120.0  # [px] height of the figure
MOST = 4.0  # [-] misfit at its top


def write_report(found: Estimate, file: Path) -> None:
    """Write a page with values, intervals, correlations and the misfit of each run."""
    warnings = "".join(f'<p class="warning">{escape(each)}</p>' for each in found.warnings())
    content = (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>Identified surface</title>"
        f"<style>{STYLE}</style><h1>Identified surface</h1>"
        f"<p>{len(found.misfits)} runs, {found.frames} pictures with a noise of "
        f"{1e3 * found.noise[0]:.2f} mm and {math.degrees(found.noise[1]):.2f} deg, which arrive "
        f"{1e3 * found.delay:.0f} ms late. Misfit {found.misfit:.2f}.</p>{warnings}"
        f"{_values(found)}<h2>Correlations of the errors</h2>{_correlations(found)}"
        f"<h2>Misfit of each run</h2>{_misfits(found)}"
        "<p>A misfit of 1 is as large as the pictures' noise explains. The line marks 1.</p></html>"
    )
    with files.replacing(file) as part:
        part.write_text(content, encoding="utf-8")


def describe_value(found: Estimate, name: str) -> tuple[str, str]:
    """Return a parameter's value, with its unit, and its interval as text."""
    unit = PARAMETERS[name].unit
    value = f"{found.values[name]:.5g}" + ("" if unit == "-" else f" {unit}")
    if not found.is_determined(name):
        return "-", "not determined"
    low, high = found.intervals[name]
    return value, f"{low:.5g} to {high:.5g}"


def _values(found: Estimate) -> str:
    rows = ""
    for name in found.values:
        value, interval = describe_value(found, name)
        meaning = escape(PARAMETERS[name].meaning)
        rows += f"<tr><td>{name}<td class=text>{meaning}<td>{value}<td>{interval}"
    return f"<table><tr><th>parameter<th class=text>meaning<th>value<th>95 % interval{rows}</table>"


def _correlations(found: Estimate) -> str:
    head = "".join(f"<th>{name}" for name in found.correlated)
    rows = ""
    for name, row in zip(found.correlated, found.correlations, strict=True):
        cells = "".join(
            f'<td style="background: rgb(217 119 6 / {abs(each):.2f})">{each:.2f}' for each in row
        )
        rows += f"<tr><td>{name}{cells}"
    return f"<table><tr><th>{head}{rows}</table>"


def _misfits(found: Estimate) -> str:
    bars = ""
    for k, misfit in enumerate(found.misfits):
        height = HIGH * min(misfit, MOST) / MOST
        bars += (
            f'<rect x="{(BAR + 2.0) * k:g}" y="{HIGH - height:.1f}" width="{BAR:g}" '
            f'height="{height:.1f}" fill="#0d9488"><title>run {k + 1}: {misfit:.2f}</title></rect>'
        )
    width = (BAR + 2.0) * len(found.misfits)
    one = HIGH * (1.0 - 1.0 / MOST)
    return (
        f'<svg width="{width:g}" height="{HIGH:g}" role="img" aria-label="misfit of each run">'
        f'{bars}<line x1="0" x2="{width:g}" y1="{one:g}" y2="{one:g}" stroke="currentColor"/></svg>'
    )
