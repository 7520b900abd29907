"""A study as plain data, for JSON."""

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym.validation.adams import printed
from surface_gym.validation.cases import displacement
from surface_gym.validation.comparison import Summary, paper_errors
from surface_gym.validation.report import LIMITS
from surface_gym.validation.study import Study
from surface_gym.validation.touching import STEPS


def as_data(study: Study) -> dict[str, Any]:
    """A study as numbers, strings, lists and mappings; displacements in m and degrees."""
    paper = paper_errors()
    return {
        "table7": [_summary_data(summary) for summary in (paper.table7, *study.summaries)],
        "runs": [
            {
                "tilt_deg": run.case.tilt,
                "speed_m_per_s": run.case.speed,
                "duration_s": run.case.duration,
                "mujoco": displacement(run.mujoco).tolist(),
                "implicit": displacement(run.implicit).tolist(),
                "explicit": displacement(run.explicit).tolist(),
            }
            for run in (*study.sweep, study.pushed, study.long)
        ],
        "targets": [{**asdict(target), "reached": target.is_reached} for target in study.targets],
        "sorts_from_deg": {"Adams, as printed": paper.sorts_from, **study.sorts_from},
        "adams_displacements": {
            run: {"low": printed(run).low.tolist(), "high": printed(run).high.tolist()}
            for run in ("gamma10", "v09")
        },
        "convergence": [
            {
                "case": variant.case.name,
                "change": variant.change,
                "shift_mm_mm_deg": variant.shift.tolist(),
                "error_mm_mm_deg": variant.error.tolist(),
            }
            for variant in study.convergence
        ],
        "meetings": [
            {
                "seed": run.meeting.seed,
                "tips_in_mujoco": run.tips,
                "step_s": list(STEPS),
                "error_mm_mm_deg": run.analytic.tolist(),
                "mujoco_shift_mm_mm_deg": run.harder.tolist(),
            }
            for run in study.meetings
        ],
        "speed": [asdict(speed) for speed in study.speeds],
        "uneven_supports": [
            {
                "case": spread.case.name,
                "height_m": spread.unevenness.height,
                "log_stiffness": spread.unevenness.stiffness,
                "mujoco_mm_mm_deg": spread.mujoco.tolist(),
                "analytic_mm_mm_deg": spread.analytic.tolist(),
            }
            for spread in study.spreads
        ],
        "limits": LIMITS,
    }


def _summary_data(summary: Summary) -> dict[str, Any]:
    def rows(values: NDArray[np.float64]) -> dict[str, list[float]]:
        return {"mean": values[0].tolist(), "sd": values[1].tolist()}

    return {
        "title": summary.title,
        "percent": rows(summary.percent),
        "mm_mm_deg": rows(summary.absolute),
    }
