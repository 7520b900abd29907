"""A log comes back as it was written, or not at all."""

import gzip
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surface_gym.layouts import ROLLING
from surface_gym.lines import Line
from surface_gym.machine import messages as ms
from surface_gym.machine.log import LoggedSurface, LogWriter, read_log
from tests.machine.recorded import BOX, SHAPE, SITE, SURFACE, write_log


def lines_of(file: Path) -> list[dict]:
    return [json.loads(line) for line in gzip.open(file)]


def rewrite(file: Path, lines: list[dict]) -> Path:
    with gzip.open(file, "wt") as stream:
        stream.writelines(json.dumps(line) + "\n" for line in lines)
    return file


def test_a_log_comes_back(tmp_path) -> None:
    log = read_log(write_log(tmp_path / "run.jsonl.gz"))
    assert vars(log.surface) == vars(SURFACE)
    assert len(log.runs) == 2
    assert log.unused == {}
    assert log.delay == pytest.approx(0.03)
    run = log.runs[1]
    np.testing.assert_allclose(run.taken, 102.0 + 0.02 * np.arange(1, 51))
    np.testing.assert_allclose(run.poses[:, 0], 0.2 + 0.02 * np.arange(1, 51))
    assert run.acknowledged
    assert run.sent == pytest.approx([102.002])
    zone = run.axes[0, 9:11, 3:19]
    assert (zone == 0.5).all()
    assert (run.axes[0] == ROLLING).sum() == run.axes[0].size - zone.size
    np.testing.assert_array_equal(run.rotor, SITE.rotor)


def test_a_log_is_a_new_file(tmp_path) -> None:
    file = write_log(tmp_path / "run.jsonl.gz")
    with pytest.raises(ValueError, match="log must be a new file"):
        LogWriter(file, SURFACE)


def test_a_line_of_several_frictions_is_not_logged() -> None:
    line = Line(mu_max=np.linspace(0.4, 0.6, 600).reshape(20, 30))
    with pytest.raises(ValueError, match="one friction of each kind"):
        LoggedSurface.of_line(line, 0.05, (4, 16))


@pytest.mark.parametrize(("behind", "kept"), [(0.30, 40), (0.24, 20)], ids=["apart", "touching"])
def test_parcels_that_share_a_surface_are_told_apart_until_they_may_touch(
    tmp_path, behind: float, kept: int
) -> None:
    """The second of two boxes of 0.25 m comes nearer after 20 pictures."""
    log = LogWriter(tmp_path / "shared.jsonl.gz", SURFACE)
    log.write_site(0.0, SITE, shared=True)
    for number, at in enumerate((0.0, 0.1, 0.2)):  # the last command that every parcel meets
        log.write(at, "out", ms.axes_to_fields(number, np.full(SHAPE, 0.25 * number)))
        log.write(at + 0.04, "in", ms.to_fields(ms.AxesAcknowledgement(number, at + 0.01)))
    for number, x in enumerate((0.6, 0.2)):
        entry = ms.ParcelEntry(number, 1.0, BOX, (x, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        log.write(1.0, "in", ms.to_fields(entry))
        waiting = replace(entry, number=2, waits=True)
        log.write(1.0, "in", ms.to_fields(waiting))
    for k in range(40):
        x, taken = 0.6 + 0.02 * k, 1.0 + 0.02 * k
        poses = {0: np.array([x, 1.0, 0.0]), 1: np.array([x - (0.4 if k < 20 else behind), 1.0, 0])}
        seen = ms.Detections(taken, tuple(map(ms.triple, poses.values())))
        log.write(taken + 0.03, "in", ms.to_fields(seen))
        log.write_tracked(taken + 0.03, taken, poses)
    for number in range(2):
        log.write(3.0, "in", ms.to_fields(ms.ParcelDeparture(number, "success")))
    log.close()
    read = read_log(tmp_path / "shared.jsonl.gz")
    assert [len(run.taken) for run in read.runs] == [kept] * 2
    assert read.delay == pytest.approx(0.03)
    for run in read.runs:
        assert run.sent.tolist() == pytest.approx([0.01, 0.11, 0.21])
        assert run.acknowledged
        assert run.axes.shape == (3, *SITE.rotor.shape)


@pytest.mark.parametrize("kept", [0.2, 0.5, 0.9, 0.999])
def test_a_cut_log_is_refused(tmp_path, kept: float) -> None:
    file = write_log(tmp_path / "run.jsonl.gz")
    content = file.read_bytes()
    file.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(ValueError, match="must be a complete log"):
        read_log(file)


def test_a_log_that_lacks_its_end_is_refused(tmp_path) -> None:
    file = write_log(tmp_path / "run.jsonl.gz")
    for lines in (lines_of(file)[:-1], lines_of(file)[:30] + lines_of(file)[-1:]):
        with pytest.raises(ValueError, match=r"end|lines"):
            read_log(rewrite(file, lines))


def test_another_clock_is_refused(tmp_path) -> None:
    for k, clock in enumerate((3600.0, -3600.0, 0.2, -1.1)):
        with pytest.raises(ValueError, match="another clock"):
            read_log(write_log(tmp_path / f"{k}.jsonl.gz", clock=clock))


def test_a_clock_that_runs_otherwise_is_refused(tmp_path) -> None:
    def drifts(taken: float) -> float:
        return 0.03 + 0.02 * (taken - 100.0)

    with pytest.raises(ValueError, match="changes by"):
        read_log(write_log(tmp_path / "run.jsonl.gz", late=drifts, parcels=4))


def test_runs_that_tell_nothing_are_counted(tmp_path) -> None:
    file = write_log(tmp_path / "run.jsonl.gz", parcels=4)
    lines = lines_of(file)
    entries = [line for line in lines if line.get("message", {}).get("kind") == "entered"]
    entries[3]["message"]["tilt_direction"] = 1.0
    frames = [line for line in lines if line.get("message", {}).get("kind") == "frame"]
    few = [line for line in lines if line not in frames[:45]]
    left = [line for line in few if line.get("message", {}).get("kind") == "left"]
    few.remove(left[1])
    few[-1]["lines"] = len(few) - 1
    found = read_log(rewrite(file, few))
    assert len(found.runs) == 1
    assert found.unused == {
        "parcel has fewer than 8 pictures": 1,
        "parcel was followed by another before it left": 1,
        "parcel is on a surface that is tilted in another direction than +x": 1,
    }


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"passed": -1.0}, "passed must not fall"),
        ({"passed": "soon"}, "passed"),
        ({"way": "sideways"}, "way must be"),
        ({"message": {"kind": "frame"}}, "frame must have"),
        ({"message": {"kind": "site", "rotor": ["1"], "zone": [0, 1, 0, 1]}}, "kind must be"),
        ({"message": 3}, "line 20"),
    ],
)
def test_a_wrong_line_is_named(tmp_path, change: dict, message: str) -> None:
    file = write_log(tmp_path / "run.jsonl.gz")
    lines = lines_of(file)
    lines[19] |= change
    with pytest.raises(ValueError, match=message):
        read_log(rewrite(file, lines))


def test_no_log_is_refused(tmp_path) -> None:
    with pytest.raises(FileNotFoundError):
        read_log(tmp_path / "none.jsonl.gz")
    for content in (b"", b"text", gzip.compress(b"{}\n"), gzip.compress(b"\xff\n")):
        file = tmp_path / "other.jsonl.gz"
        file.write_bytes(content)
        with pytest.raises(ValueError, match="must be a complete log"):
            read_log(file)
