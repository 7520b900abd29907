"""What becomes of boxes that come off the middle or turned to axes at +-45 deg."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from surface_gym import layouts
from surface_gym.paper.alignment import INWARDS, OFFSETS, OUTWARDS, TURNS, Zone, crossing
from surface_gym.paper.drawing import draw_box, draw_surface

COLUMNS = 6
SPEED = 2.5  # [m/s]
SHOWN = 10.0  # [deg] by which the box drawn from above comes turned
COLOURS = ("#1b6ca8", "#e07a1f", "#7a3b8f")


def draw_alignment() -> Figure:
    """From above, off the middle and turned, for rows that push inwards and outwards."""
    figure = Figure(figsize=(11.0, 8.4), layout="constrained")
    panels = figure.subplots(
        3, 2, sharex=True, sharey="row", gridspec_kw={"height_ratios": (1.25, 1.0, 1.0)}
    )
    sides = ((INWARDS, "rows push inwards"), (OUTWARDS, "rows push outwards"))
    for (above, off, turned), (towards, title) in zip(panels.T, sides, strict=True):
        zone = Zone("S", towards, COLUMNS, SPEED, 0.0)
        _draw_above(above, zone)
        above.set_title(title)
        for offset, colour in zip(OFFSETS, COLOURS, strict=True):
            run = crossing(zone, offset, 0.0)
            y = 1000.0 * (run.pose[:, 1] - layouts.LINE_Y)
            label = f"comes {1000.0 * offset:.0f} mm off, straight"
            off.plot(run.pose[:, 0], y, color=colour, linewidth=2.0, label=label)
        for turn, colour in zip(TURNS, COLOURS, strict=False):
            run = crossing(zone, 0.0, turn)
            label = f"comes in the middle, turned by {turn:.0f}°"
            theta = np.degrees(run.pose[:, 2])
            turned.plot(run.pose[:, 0], theta, color=colour, linewidth=2.0, label=label)
        for panel in (off, turned):
            _shade(panel, zone)
        turned.set_xlabel("x [m]")
    above, off, turned = panels[:, 0]
    above.set_ylabel("y [m]")
    off.set_ylabel("off the middle [mm]")
    turned.set_ylabel("turned [°]")
    off.legend(loc="lower left", framealpha=1.0)
    turned.legend(loc="upper left", framealpha=1.0)
    figure.suptitle(
        f"S-box at {SPEED:g} m/s over {COLUMNS} columns at ±45° in alternate rows (shaded), level"
    )
    return figure


def _draw_above(panel: Axes, zone: Zone) -> None:
    """A box in the middle and turned, at equal times on its way."""
    draw_surface(panel, zone.surface)
    run = crossing(zone, 0.0, SHOWN)
    for k in np.linspace(0, len(run.pose) - 1, 5).astype(int):
        shade = 0.25 + 0.75 * k / len(run.pose)
        draw_box(panel, "S", run.pose[k], "limegreen", width=0.8 + 1.4 * shade)
    panel.plot(run.pose[:, 0], run.pose[:, 1], color="green", linewidth=1.2)
    panel.axhline(layouts.LINE_Y, color="0.5", linewidth=0.8, linestyle=":")
    panel.set(ylim=(0.76, 1.24), xlim=(0.0, 1.2), aspect="equal")
    text = f"comes in the middle, turned by {SHOWN:.0f}°"
    panel.text(0.02, 0.795, text, bbox={"facecolor": "white", "edgecolor": "none"})


def _shade(panel: Axes, zone: Zone) -> None:
    """Where the zone's columns are."""
    surface = zone.surface
    first = layouts.LEAD_IN[zone.size]
    edges = surface.x[[first, first + zone.columns - 1]]
    half = 0.5 * surface.pitch_x
    panel.axvspan(edges[0] - half, edges[1] + half, color="0.93", zorder=0)
    panel.axhline(0.0, color="0.5", linewidth=0.8, linestyle=":")
    panel.grid(alpha=0.3)
