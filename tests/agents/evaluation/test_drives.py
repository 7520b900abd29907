"""The comparison of kinds of modules."""

from dataclasses import replace

import numpy as np
import pytest

from surface_gym.agents.evaluation import drives
from surface_gym.agents.evaluation.results import Results, compute
from surface_gym.agents.evaluation.scenario import QUICK
from surface_gym.agents.scheduling.driven import AHEAD_ONLY
from surface_gym.config import EnvConfig
from surface_gym.modules import surface_velocities
from tests.agents.evaluation.made import results, rows

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
    turned = table.groupby("method")["axis_turns"].sum()
    assert turned["idle rotors, event rule"] > 0.0 == turned["pop-up"]
    # A turn's energy counts for axes only.
    (costly,) = drives.drive_tables("sort", Results(table), turn_energy=2.0)
    energy = shown.header.index("energy [J]")
    gained = [
        float(row[energy]) - float(before[energy])
        for row, before in zip(costly.rows, shown.rows, strict=True)
    ]
    assert gained[0] == pytest.approx(2.0 * float(shown.rows[0][energy - 1]), abs=0.25)
    assert gained[1] == 0.0


def test_belts_take_part_where_parcels_need_not_be_led_aside():
    jobs = drives.drive_jobs(["singulate", "merge", "sequence"])
    belts = [job.scenario for job in jobs if job.method.name in AHEAD_ONLY]
    assert {each.name for each in belts} == {"anywhere across"}
    assert {job.scenario.name for job in jobs} == set(drives.BEFORE_TAKE_AWAY)
    driven = next(job for job in jobs if job.method.name == "omni-wheels")
    config = driven.scenario.config(driven.method)
    assert (config.task.tilt, config.task.duration) == (0.0, drives.SECONDS)
    assert config.stream_task.stream.arrivals.rate == drives.OFFERED
    idle = next(job for job in jobs if job.method.name == drives.IDLE)
    assert idle.scenario.config(idle.method).task.tilt > 0.0
    sorter = drives.drive_jobs(["singulate", "flow"])[-1].scenario
    assert (sorter.task, sorter.extent) == ("flow", drives.WHOLE)


def test_a_table_of_surfaces_before_a_take_away():
    made = {
        "counted": 50.0, "correct": [100, 102], "delivered": [101, 102], "jam": 0.0, "sorted": 110,
        "touches_per_1000": 500.0, "motors": 700, "drawn_energy": 4400.0, "axis_turns": 220.0,
        "peak_acceleration": 60.0, "bound": 12_000.0,
    }  # fmt: skip
    key = ("merge", "three lines", "exact", "steered rollers")
    (table,) = drives.drive_tables("merge", results(rows(key, **made)), turn_energy=0.5)
    row = dict(zip(table.header, table.rows[0], strict=True))
    assert row["right [1/h]"].startswith("7272 ±")
    assert (row["turns of axes"], row["energy [J]"], row["motors"]) == ("2.0", "41.0", "700")


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
