"""Files of every kind, damaged: one error names the file, or what was written comes back."""

import io
import math
import os
import re
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import surface_gym as sg
from surface_gym import files
from surface_gym.agents import library
from surface_gym.agents.evaluation import results
from surface_gym.agents.evaluation.method import of_run
from surface_gym.agents.export.policy import of_run as exported
from surface_gym.agents.learning import config as configs, runs
from surface_gym.agents.tensors import check_like
from surface_gym.agents.tuning import read_sweep
from surface_gym.flow.arrivals import read_trace, write_trace
from surface_gym.flow.exits import chutes
from surface_gym.flow.stream import Stream
from surface_gym.trajectory import Trajectory

ROOT = Path(__file__).parents[1]

ROWS = results.make_rows(
    [
        {"task": "sort", "scenario": "drag 0.7", "preset": "exact", "method": "PPO", "seed": k,
         "kind": "agent", "episode": 0, "success": True, "time": 0.1 + k}
        for k in range(3)
    ]
)  # fmt: skip
STATE = {"steps": 64, "weights": torch.arange(6.0), "recent": [1.0, 2.0]}
LOW = replace(sg.layouts.box("S"), com_height=0.0)  # which never tips


@cache
def short_run() -> Trajectory:
    """A run, made when a test needs it: tests of other files are collected without compiling."""
    start = (0.5, 1.0, 0.0), (1.0, 0.0, 0.0)
    return sg.simulate(sg.layouts.sorting(), LOW, *start, duration=0.05)


@dataclass(frozen=True)
class Kind:
    name: str
    write: Callable[[Path], Any]  # into a folder
    read: Callable[[Path], Any]  # from that folder; what is in the file
    sealed: bool = False  # checksums show every change of a byte that is read


def _trajectory(folder: Path) -> list[Any]:
    back = Trajectory.load(folder / "run.npz")
    motion = [values.tobytes() for values in (back.time, back.pose, back.velocity, back.tipping)]
    return [*motion, back.end, None if back.run is None else back.run.states.tobytes()]


def _trace(file: Path) -> None:
    write_trace(file, Stream().draw(np.random.default_rng(0), 20.0, chutes()), chutes())


def _curve(folder: Path) -> None:
    lines = [f"{64 * k},{k / 9},{-0.5 * k},12,nan" for k in range(6)]
    text = "\r\n".join(["steps,success,return,length,reward_reach", *lines, ""])
    (folder / runs.CURVE).write_bytes(text.encode())


def _policy(folder: Path) -> None:
    for name in (library.WEIGHTS, library.CARD):
        shutil.copyfile(library.SHELF / "sort-modules" / "seed-0" / name, folder / name)


def _weights(folder: Path) -> list[Any]:
    found = library.read(folder)
    return [found.card, *(each.tolist() for each in found._network.state_dict().values())]


def _restore(state: dict[str, Any]) -> str:
    check_like("state", state, STATE)
    return repr(state)


def _run_card(folder: Path) -> dict[str, Any]:
    _ = of_run(folder)
    return vars(exported(folder).training)


def _run(folder: Path) -> None:
    _policy(folder)
    shutil.copyfile(library.SHELF / "sort-modules" / "card.yaml", folder / runs.CARD)


KINDS = [
    Kind("run.npz", lambda at: short_run().save(at / "run.npz"), _trajectory, True),
    Kind("trace.csv", lambda at: _trace(at / "trace.csv"), lambda at: read_trace(at / "trace.csv")),
    Kind(library.WEIGHTS, _policy, _weights, True),
    Kind("policy.yaml", _policy, _weights, True),
    Kind("card.yaml", _run, _run_card),
    Kind(
        "config.yaml",
        lambda at: runs.write_config(configs.defaults("sort", "dqn"), at / "config.yaml"),
        lambda at: runs.read_config(at / "config.yaml"),
    ),
    Kind(
        "own.yml",
        lambda at: configs.write_hyperparams(configs.defaults("stop", "ppo"), at / "own.yml"),
        lambda at: configs.defaults("stop", "ppo", at / "own.yml"),
    ),
    Kind(
        "sweep.yml",
        lambda at: shutil.copyfile(ROOT / "examples/sweep.yml", at / "sweep.yml"),
        lambda at: read_sweep(at / "sweep.yml"),
    ),
    Kind("curve.csv", _curve, lambda at: repr(runs.read_curve(at))),
    Kind(
        "results.csv",
        lambda at: results.write_results(ROWS, at / "results.csv"),
        lambda at: repr(results.read_results(at / "results.csv")),
    ),
    Kind(
        "checkpoint.pt",
        lambda at: runs.write_state(STATE, at),
        lambda at: runs.read_state(at, _restore),
        True,
    ),
]  # fmt: skip


def damages(whole: bytes, rng: np.random.Generator) -> list[bytes]:
    places = sorted(rng.integers(1, len(whole), 8).tolist())
    flipped = [
        whole[:place] + bytes([whole[place] ^ 1 << int(rng.integers(8))]) + whole[place + 1 :]
        for place in places
    ]
    return [
        *(whole[:place] for place in places),
        *flipped,
        *(whole[:place] + b"\0" + whole[place:] for place in places[:4]),
        *(whole[:place] + b"\xff\xfe" + whole[place:] for place in places[:4]),
        whole + b"\0" * 100, b"no such file\n", b"\0" * 5000, b"[" * 20_000, b'{"a": ' * 20_000,
        b"9" * 6000 + b"\n", b"null\n", b"[1, 2]\n", b'{"a": 1}\n', b"&a [*a]\n",
        b"a: &a {b: *a}\n", b"!!python/object/apply:os.getcwd []\n",
        whole.decode("latin1").encode("utf-16"), rng.bytes(3000),
    ]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_damaged_file_is_named_or_reads_the_same(kind: Kind, tmp_path: Path) -> None:
    kind.write(tmp_path)
    file, want = tmp_path / kind.name, kind.read(tmp_path)
    whole, refused = file.read_bytes(), 0
    for content in damages(whole, np.random.default_rng(0)):
        file.write_bytes(content)
        try:
            back, message = kind.read(tmp_path), ""
        except ValueError as error:
            back, message = None, str(error)
        refused += bool(message)
        # Text without a checksum may say something else that is allowed.
        assert str(tmp_path) in message if message else back == want or not kind.sealed
        assert len(message) < 600
        assert "\n" not in message
    assert refused > 20
    file.unlink()
    file.mkdir()
    with pytest.raises(ValueError, match=re.escape(str(tmp_path))):
        kind.read(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "run.npz")
    with pytest.raises(ValueError, match=r"run\.npz': it must be a file, got a pipe or a device"):
        Trajectory.load(tmp_path / "run.npz")


def pack(method: int = zipfile.ZIP_DEFLATED, **others: Any) -> bytes:
    kept = io.BytesIO()
    with zipfile.ZipFile(kept, "w", method) as archive:
        run = short_run()
        parts: dict[str, Any] = {name: getattr(run, name) for name in ("time", "pose", "velocity")}
        for name, values in {**parts, "tipping": run.tipping, "end": run.end, **others}.items():
            content = io.BytesIO()
            np.save(content, b"" if isinstance(values, bytes) else np.asarray(values))
            archive.writestr(
                f"{name}.npy", values if isinstance(values, bytes) else content.getvalue()
            )
    return kept.getvalue()


def header(shape: str, kind: str = "<f8") -> bytes:
    """An array of NumPy's that claims a shape, and holds 160 bytes."""
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + b"\0" * 160


def other_method(content: bytes, method: int) -> bytes:
    """An archive whose members claim another compression."""
    marked = bytearray(content)
    for mark, place in ((b"PK\x03\x04", 8), (b"PK\x01\x02", 10)):
        for found in re.finditer(re.escape(mark), content):
            marked[found.start() + place] = method
    return bytes(marked)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"method": zipfile.ZIP_LZMA}, "'time.npy' must be compressed by stored or deflate, .* 14"),
        ({"pose": header("(100000000000, 3)")}, r"pose must fill its 160 bytes, got \(1000000"),
        ({"pose": header("(-5, 3)")}, "pose must fill its 160 bytes"),
        ({"pose": header("(2, 3.0)")}, "pose is damaged: shape is not valid"),
        ({"pose": header("(20,)", "|O")}, "pose must hold numbers or text, got object"),
        ({"pose": header("(9, 9)", "|S0")}, "pose must hold numbers or text"),
        ({"pose": header("(10,)", "<c16")}, "pose must hold numbers or text, got complex128"),
        ({"pose": b"soon"}, "pose is damaged: "),
        ({"time": header("(20,)")}, "time must begin at 0 and rise"),
        ({f"more{k}": b"" for k in range(1001)}, "must hold at most 1000 members, got m"),
    ],
)  # fmt: skip
def test_an_archive_that_claims_too_much_is_refused(tmp_path, given, message) -> None:
    (tmp_path / "run.npz").write_bytes(pack(**given))
    with pytest.raises(ValueError, match=rf"run\.npz': .*{message}"):
        Trajectory.load(tmp_path / "run.npz")


def test_a_change_that_the_archive_itself_does_not_notice_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "run.npz"
    short_run().save(file)
    whole = file.read_bytes()
    file.write_bytes(whole.replace(b"tilt_direction", b"tilt_directiom"))
    with pytest.raises(ValueError, match="it is not as it was written: its checksum differs"):
        Trajectory.load(file)


def test_an_unknown_compression_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run.npz").write_bytes(other_method(pack(), 99))
    with pytest.raises(ValueError, match="must be compressed by stored or deflate, got method 99"):
        Trajectory.load(tmp_path / "run.npz")


def test_a_bomb_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bomb = io.BytesIO()
    np.save(bomb, np.zeros((200_000, 3)))
    (tmp_path / "run.npz").write_bytes(pack(pose=bomb.getvalue()))
    read: list[str] = []
    unpack = np.lib.format.read_array
    monkeypatch.setattr(
        np.lib.format, "read_array",
        lambda stream, **given: read.append(stream.name) or unpack(stream, **given),
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"pose must be of at most \d+ bytes, got 4800000"):
        Trajectory.load(tmp_path / "run.npz")
    assert "pose.npy" not in read
    time = 1e-3 * np.arange(800_000)  # so many rows may be: but no file of theirs is so small
    (tmp_path / "run.npz").write_bytes(pack(time=time, pose=np.zeros((800_000, 3))))
    with pytest.raises(ValueError, match=r"pose must be of at most 16777216 bytes, got 19200000"):
        Trajectory.load(tmp_path / "run.npz")
    assert "pose.npy" not in read
    monkeypatch.setattr("surface_gym.trajectory.ROWS", 5)
    with pytest.raises(ValueError, match="time must be of at most 40 bytes to be saved"):
        short_run().save(tmp_path / "long.npz")


@pytest.mark.parametrize(
    "text", ["1_0", "\u0661\u0660", "\uff11", "1e400", "nan", "inf", "0x10", "", "1,0", "--1", "1e"]
)
def test_a_number_is_written_in_plain_digits(text: str) -> None:
    with pytest.raises(
        ValueError, match=f"^mass must be a finite number, got {re.escape(repr(text))}"
    ):
        files.parse_number("mass", text)
    with pytest.raises(ValueError, match=r"^seed must be a whole number, got "):
        files.parse_integer("seed", text)


def test_plain_numbers_are_read() -> None:
    for text in ("10", " -1.5e-3 ", "+.5", "2.", "0007"):
        assert files.parse_number("mass", text) == float(text)
    assert files.parse_integer("seed", f"-{2**70}") == -(2**70)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: !!int 1_0", "!!int must be a whole number, got '1_0'"),
        ("a: !!float \u0661", "!!float must be a finite number"),
        ("a: 1\na: 2", "'a' must stand once, got it 2 times"),
        ("a: [" + "[" * 1000, "at most 1000 brackets"),
        ("a: &a [*a]", "an alias must not stand inside of what it names"),
        ("a: " + "b" * 30_000, "at most 30000 characters"),
        ("1: 2", "it must hold names and values"),
        (
            "".join(
                f"a{k}: &a{k} [{', '.join([f'*a{k - 1}' if k else 'x'] * 9)}]\n" for k in range(9)
            ),
            "at most 100000 values, got more by its aliases",
        ),
    ],
    ids=lambda text: text[:12],
)  # fmt: skip
def test_yaml_that_is_damaged_or_grows_is_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        library.parse_yaml(text)


def test_yaml_has_numbers_in_plain_digits_and_others_as_text() -> None:
    text = "a: 1_0\nb: 010\nc: 1:30\nd: 0x1F\ne: -7\nf: 1.5e-3\ng: .inf\nh: !!float 1e6\n"
    text += "i: &x {z: 1}\nj: {<<: *x}"
    assert library.parse_yaml(text) == {
        "a": "1_0", "b": "010", "c": "1:30", "d": "0x1F", "e": -7, "f": 0.0015, "g": math.inf,
        "h": 1e6, "i": {"z": 1}, "j": {"z": 1},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("64,0.5,1.0,nan", "line 3: a row must have 5 entries, got 4"),
        ("0,0.5,1.0,12,0", "line 3: steps must rise, got 0"),
        ("nan,0.5,1.0,12,0", "line 3: steps must be a finite number"),
        ("64,1.5,1.0,12,0", "line 3: success must be between 0 and 1, got 1.5"),
        ("64,0.5,1.0,-12,0", "line 3: length must be at least 0, got -12"),
        ("64,0.5,1_0,12,0", "line 3: return must be a finite number, got '1_0'"),
    ],
)
def test_a_row_of_a_curve_is_named(tmp_path: Path, line: str, message: str) -> None:
    head = "steps,success,return,length,reward_reach\n0,nan,nan,nan,nan\n"
    (tmp_path / runs.CURVE).write_text(f"{head}{line}\n")
    with pytest.raises(ValueError, match=rf"curve\.csv holds no learning curve: {message}"):
        runs.read_curve(tmp_path)
