"""The comparison of kinds of modules."""

from dataclasses import replace

import numpy as np
import pytest

from surface_gym.agents.evaluation import drives
from surface_gym.agents.evaluation.results import Results, compute
from surface_gym.agents.evaluation.scenario import QUICK
from surface_gym.config import EnvConfig
from surface_gym.modules import surface_velocities

FEW = replace(QUICK, starts=3, duration=12.0)


def test_each_kind_of_a_task_beside_idle_rotors():
    names = ("event rule", "pop-up", "omni-wheels")
    every = drives.drive_jobs(["sort"], FEW)
    assert {job.scenario.preset for job in every} == set(drives.DRIVE_PRESETS)
    delayed = [job for job in every if job.scenario.preset == drives.DELAYED.name]
    table = compute([job for job in delayed if job.method.name.endswith(names)], 1)
    (shown,) = drives.drive_tables("sort", Results(table))
    assert [row[:2] for row in shown.rows] == [
        (name, "yes") for name in ("idle rotors, event rule", "pop-up", "omni-wheels")
    ]
    driven = table[~table["method"].str.startswith(drives.IDLE)]
    assert (driven["drawn_energy"] > 0.0).all()
    assert (table["drawn_energy"][table["method"].str.startswith(drives.IDLE)] == 0.0).all()
    assert table["peak_acceleration"].between(0.5, 7.0).all()


@pytest.mark.parametrize("name", drives.STREAM_KINDS)
def test_modules_of_a_stream_keep_its_speed_along_the_line(name):
    module = drives.STREAM_KINDS[name](speed=1.5, acceleration=np.inf)
    velocity = surface_velocities(EnvConfig("flow", actions="parcels", modules=module).modes)
    assert velocity[-1] == pytest.approx([1.5, 0.0])
    aside = velocity[np.abs(velocity[:, 1]) > 1e-6]
    assert len(aside) >= 2
    if name != "pop-up":
        assert aside[:, 0].max() == pytest.approx(1.5)


def test_a_stream_is_carried_by_driven_modules(tmp_path):
    jobs = [
        job
        for job in drives.drive_jobs(["flow"], FEW)
        if job.method.name in (drives.IDLE, "steered rollers, 30 deg")
        and job.scenario.preset == "exact"
    ]
    table = compute(jobs, 1)
    drives.write_tables(["flow"], table, tmp_path, drives.Console(quiet=True))
    assert (tmp_path / "modules.png").is_file()
    assert "steered rollers, 30 deg" in (tmp_path / "modules.md").read_text()
    assert (table["correct"] > 5).all()
