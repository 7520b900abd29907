"""Trajectories in files: what comes back is the same to the bit, or an error says why not."""

import io
import math
import pickle
import zipfile
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.trajectory import Trajectory

MOTION = ("time", "pose", "velocity", "tipping")
CONTACTS = ("step", "element", "place", "rotor", "normal", "along", "across", "force", "slip")
UNEVEN = sg.Surface(
    axis=np.random.default_rng(0).uniform(-3.0, 3.0, (16, 20)),
    rotor=np.random.default_rng(1).random((16, 20)) < 0.8,
    pitch=(0.11, 0.09),
    origin=(0.2, -0.3),
    mu_max=np.random.default_rng(2).uniform(0.3, 0.6, (16, 20)),
    mu_support=0.02,
    tilt=math.radians(7.0),
    stiffness=np.random.default_rng(3).uniform(0.5, 2.0, (16, 20)),
)
ASKEW = replace(UNEVEN, tilt_direction=2.5)
PARCELS = {
    "rectangle": sg.Parcel(sg.Rectangle(0.3, 0.25), mass=1.0 / 3.0, inertia=0.01),
    "disc": sg.Parcel(sg.Disc(0.2), com_height=0.05, com_offset=(0.01, 0.02)),
    "polygon": sg.Parcel(sg.Polygon([(0.0, 0.0), (0.0, 0.3), (0.4, 0.0)])),
}
AT_REST = (sg.layouts.sorting(), sg.layouts.box("S"), (1.0, 1.0, 0.0))
# 6400 elements, all alike.
LARGE = {
    "axis": np.zeros((80, 80)), "rotor": np.ones((80, 80), dtype=bool),
    "mu_max": 0.5, "stiffness": None,
}  # fmt: skip


def slide(parcel: sg.Parcel = PARCELS["polygon"], **changes: object) -> Trajectory:
    """A short run over an uneven slope, its last step shortened."""
    given = {"duration": 0.1013, **changes}
    return sg.simulate(UNEVEN, parcel, (1.0, 0.2, 0.3), (0.5, 0.2, -1.0), **given)


def saved(run: Trajectory, path: Path) -> Trajectory:
    run.save(path)
    return Trajectory.load(path)


def assert_same(one: object, other: object, names: tuple[str, ...]) -> None:
    for name in names:
        first, second = getattr(one, name), getattr(other, name)
        assert first.dtype == second.dtype
        assert first.tobytes() == second.tobytes()


class TestAllOfOne:
    @pytest.mark.parametrize("method", ["implicit", "explicit"])
    @pytest.mark.parametrize("kind", PARCELS)
    def test_it_comes_back_with_its_contacts(self, kind, method, tmp_path):
        run = slide(PARCELS[kind], method=method)
        back = saved(run, tmp_path / "run.npz")
        assert_same(run, back, MOTION)
        assert back.end == run.end
        assert_same(run.contacts, back.contacts, CONTACTS)
        assert back.acceleration.tobytes() == run.acceleration.tobytes()
        assert back.energy.balance.tobytes() == run.energy.balance.tobytes()

    def test_every_field_of_surface_and_parcel_does(self, tmp_path):
        slide(PARCELS["rectangle"]).save(str(tmp_path / "run.npz"))
        back = Trajectory.load(str(tmp_path / "run.npz")).run
        for name in (field.name for field in fields(UNEVEN)):
            np.testing.assert_array_equal(getattr(back.surface, name), getattr(UNEVEN, name))
        assert back.parcel == PARCELS["rectangle"]
        assert (back.dt, back.method, back.normal_forces) == (0.005, "implicit", "dual")

    def test_a_slope_in_any_direction_does(self, tmp_path):
        run = sg.simulate(ASKEW, PARCELS["disc"], (1.0, 0.2, 0.3), duration=0.1)
        back = saved(run, tmp_path / "run.npz")
        assert (back.run.surface.tilt, back.run.surface.tilt_direction) == (ASKEW.tilt, 2.5)
        assert_same(run.contacts, back.contacts, CONTACTS)
        assert back.energy.potential.tobytes() == run.energy.potential.tobytes()
        assert back.energy.potential[-1] < 0.0

    def test_files_from_before_slopes_had_a_direction_lead_towards_x(self, tmp_path):
        run = slide()
        run.save(tmp_path / "run.npz")
        with np.load(tmp_path / "run.npz") as parts:
            older = {name: parts[name] for name in parts if name != "tilt_direction"}
            assert len(older) == len(parts) - 1
        np.savez_compressed(tmp_path / "older.npz", **older)
        back = Trajectory.load(tmp_path / "older.npz")
        assert back.run.surface.tilt_direction == 0.0
        assert_same(run.contacts, back.contacts, CONTACTS)

    def test_and_what_is_none(self, tmp_path):
        back = saved(sg.simulate(*AT_REST, duration=0.02), tmp_path / "run.npz").run
        assert back.surface.stiffness is None
        assert back.parcel.inertia is None
        assert (back.surface.pitch, back.surface.mu_max) == (0.1, 0.5)
        run = replace(slide(), run=None)
        back = saved(run, tmp_path / "run.npz")
        assert_same(run, back, MOTION)
        assert back.run is None

    @pytest.mark.parametrize("solver", ["osqp", "scipy"])
    def test_with_another_solver(self, solver, tmp_path):
        run = slide(normal_forces=solver, duration=0.02)
        assert_same(run.contacts, saved(run, tmp_path / "run.npz").contacts, CONTACTS)

    def test_classes_of_ones_own_are_not_lost_silently(self, tmp_path):
        kinds = (sg.Rectangle, sg.Surface, sg.Parcel)
        tile, floor, box = (type("Own", (kind,), {}) for kind in kinds)
        ground = floor(np.zeros((20, 20)), np.ones((20, 20), dtype=bool))
        for run, named in (
            (slide(sg.Parcel(tile(0.3, 0.3))), "base must be a Rectangle, a Disc or a Polygon to "),
            (sg.simulate(ground, *AT_REST[1:], duration=0.02), "surface must be a Surface, not "),
            (slide(box(sg.Disc(0.2))), "parcel must be a Parcel, not a user-defined class"),
        ):
            with pytest.raises(ValueError, match=f"^{named}"):
                run.save(tmp_path / "run.npz")
            assert not (tmp_path / "run.npz").exists()


def test_a_motion_without_a_run_that_is_one_row_too_comes_back(tmp_path):
    for run in (
        sg.simulate(*AT_REST, method="explicit"),
        replace(sg.simulate(*AT_REST, method="explicit"), run=None),
    ):
        back = saved(run, tmp_path / "run.npz")
        assert_same(run, back, MOTION)
        assert back.end == "stopped"


@pytest.mark.parametrize("name", ["run.csv", "run", "run.npz.gz", "run.NPZ"])
def test_another_suffix_is_refused(name, tmp_path):
    run = slide()
    for act in (run.save, Trajectory.load):
        with pytest.raises(ValueError, match=rf"^path must end in \.npz, got '.*{name}'"):
            act(tmp_path / name)


def test_a_file_that_is_not_there_is_named_and_an_end_that_is_no_line_not_written(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"lost\.npz"):
        Trajectory.load(tmp_path / "lost.npz")
    for end in ("two\nlines", " ", ""):
        with pytest.raises(ValueError, match=r"^end must be one line of text, got "):
            replace(slide(), end=end).save(tmp_path / "run.npz")


class TestDamagedArrays:
    @staticmethod
    def changed(tmp_path: Path, **changes: object) -> Path:
        """A saved run, some of whose arrays are others; None: missing."""
        slide(PARCELS["disc"]).save(tmp_path / "good.npz")
        with np.load(tmp_path / "good.npz") as archive:
            parts = {name: archive[name] for name in archive.files}
        parts |= {name: np.asarray(value) for name, value in changes.items()}
        for name, value in changes.items():
            if value is None:
                del parts[name]
        np.savez(tmp_path / "run.npz", **parts)
        return tmp_path / "run.npz"

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"time": None}, "it lacks time"),
            ({"states": None, "axis": None}, "it lacks axis, states"),
            ({"time": np.zeros(22)}, "time must begin at 0 and rise"),
            ({"time": np.zeros(0)}, "time must begin at 0 and rise"),
            ({"time": np.zeros((22, 1))}, r"time must have the shape \(any\), got \(22, 1\)"),
            ({"time": np.arange(22)}, "time must be of float64, got int64"),
            ({"pose": np.zeros((3, 3))}, r"pose must have the shape \(22, 3\), got \(3, 3\)"),
            ({"velocity": np.full((22, 3), np.nan)}, "velocity must be finite, got nan"),
            ({"tipping": np.zeros(22)}, r"tipping must be booleans of the shape \(22,\), got f"),
            ({"end": np.zeros(3)}, "end must be one line of text"),
            ({"end": 3}, "end must be one line of text, got 3"),
            ({"states": np.zeros((21, 8))}, r"states must have the shape \(22, 8\)"),
            ({"axis": np.zeros((2, 2))}, "rotor must have the shape of axis"),
            ({"mass": -1.0}, "mass must be greater than 0, got -1.0"),
            ({"base": "cube"}, "base must be one of 'rectangle', 'disc', 'polygon', got 'cube'"),
            ({"base_lengths": [1.0, 2.0]}, "base_lengths must fit a disc"),
            ({"base_lengths": 0.2}, "base_lengths must fit a disc"),
            ({"base_lengths": [20.0], **LARGE}, "base must cover at most 4096 elements"),
            ({"dt": 0.0}, "dt must be greater than 0, got 0.0"),
            ({"dt": "fast"}, "dt must be a finite number, got 'fast'"),
            ({"method": "euler"}, "method must be one of 'implicit', 'explicit', got 'euler'"),
            ({"normal_forces": [1.0]}, "normal_forces must be one of 'dual'"),
        ],
    )
    def test_the_error_says_what_is_wrong(self, changes, message, tmp_path):
        path = self.changed(tmp_path, **changes)
        with pytest.raises(ValueError, match=rf"run\.npz': {message}"):
            Trajectory.load(path)

    @pytest.mark.parametrize("solver", ["dual", "scipy"])
    def test_states_of_no_run_bear_no_contacts(self, solver, tmp_path):
        states = slide(PARCELS["disc"]).run.states.copy()
        states[4, 0] = 99.0
        back = Trajectory.load(self.changed(tmp_path, states=states, normal_forces=solver))
        message = r"states must be over elements .*, got none in step 5"
        with pytest.raises(ValueError, match=message):
            _ = back.contacts

    def test_an_object_is_never_made(self, tmp_path):
        class Trap:
            def __reduce__(self) -> tuple[object, ...]:
                return (Path.touch, (tmp_path / "sprung",))

        path = self.changed(tmp_path, end=np.array(Trap(), dtype=object))
        with pytest.raises(ValueError, match=r"run\.npz': end must hold numbers or text, got obj"):
            Trajectory.load(path)
        path.write_bytes(pickle.dumps(Trap()))
        with pytest.raises(ValueError, match="it is no archive, or only the beginning of one"):
            Trajectory.load(path)
        assert not (tmp_path / "sprung").exists()

    def test_members_that_are_no_arrays_are_refused(self, tmp_path):
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w") as archive:
            archive.writestr("time", "soon")
        (tmp_path / "run.npz").write_bytes(packed.getvalue())
        with pytest.raises(ValueError, match="it lacks time, pose, velocity, tipping, end"):
            Trajectory.load(tmp_path / "run.npz")
