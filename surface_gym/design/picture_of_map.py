"""A map of success as a picture, by matplotlib."""

from matplotlib.figure import Figure

from surface_gym.design.case import WORST
from surface_gym.design.pictures import new_picture
from surface_gym.design.size_map import SuccessMap
from surface_gym.design.telling import base_told, purpose_met, surface_told


def draw_map(found: SuccessMap) -> Figure:
    """Success over entry speed and size."""
    case = found.arrangement.case
    figure, axes = new_picture(
        f"Which speeds and sizes can {purpose_met(case.purpose)}?",
        f"{base_told(case.parcel.base)} at size 1; {surface_told(found.arrangement)}",
    )
    image = axes.pcolormesh(
        found.speeds, found.sizes, 100.0 * found.share, cmap="cividis", vmin=0.0, vmax=100.0,
        shading="nearest", rasterized=True,
    )  # fmt: skip
    figure.colorbar(image, ax=axes, label="success [% of the draws]")
    if min(found.share.shape) > 1:
        for values, level, style, colour in (
            (found.share, 1.0 - WORST, "-", "black"),
            (found.nominal.astype(float), 0.5, "--", "white"),
        ):
            if values.min() < level < values.max():
                axes.contour(
                    found.speeds, found.sizes, values, [level], colors=colour, linestyles=style,
                    linewidths=1.5,
                )  # fmt: skip
    axes.plot([], [], color="black", label=f"{1.0 - WORST:.0%} of the draws")
    axes.plot([], [], color="white", linestyle="--", label="nothing unknown")
    axes.plot(case.speed, 1.0, "*", color="white", markeredgecolor="black", markersize=13,
              label="as it comes")  # fmt: skip
    axes.set(xlabel="entry speed [m/s]", ylabel="size of the parcel over the case's [-]")
    axes.grid(False)
    legend = axes.legend(loc="upper right", fontsize="small", framealpha=0.9)
    legend.get_frame().set_facecolor("#b0b0b0")
    return figure
