"""The best fixed layout beside the study's as tables."""

import numpy as np

from surface_gym.design.best_layout import BestLayout
from surface_gym.design.tables import IN_DRAWS, Table


def layout_tables(found: BestLayout) -> tuple[Table, ...]:
    """Of the best fixed layout beside the study's: over all speeds, at each, and its axes."""
    both = (found.best, found.study)
    axes = np.degrees(found.best.axis)
    columns = (f"column {k + 1} [deg]" for k in range(axes.shape[1]))
    measured = f"{found.case.purpose.measured} [{found.case.purpose.unit}]"
    return (
        Table(
            "layout",
            f"{found.changed} of {found.best.axis.size} modules differ from the study's",
            ("layout", "speeds that succeed", "all from [m/s]", f"in {IN_DRAWS} from [m/s]",
             "mean time [s]"),
            tuple(
                (each.name, each.successes, each.least_speed, each.least_sure_speed, each.mean_time)
                for each in both
            ),
        ),
        Table(
            "layout_speeds",
            "By entry speed",
            ("layout", "speed [m/s]", "nothing unknown", "success", measured),
            tuple(
                (each.name, float(speed), bool(done), float(share),
                 found.case.purpose.scale * float(measure))
                for each in both
                for speed, done, share, measure in zip(
                    each.speeds, each.success, each.share, each.measure, strict=True
                )
            ),
            shown=False,
        ),
        Table(
            "layout_axes",
            "Axes, the row at the greatest y first",
            ("row", *columns),
            tuple((len(axes) - k, *row) for k, row in enumerate(axes[::-1].tolist())),
            shown=False,
        ),
    )  # fmt: skip
