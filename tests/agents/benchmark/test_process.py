"""A policy in its own process acts as in this one; a bad one leaves a reason, and nothing else."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surface_gym import agents
from surface_gym.agents import library
from surface_gym.agents.benchmark import process, watch
from surface_gym.agents.benchmark.process import PolicyFailure, PolicyLimits, PolicyProcess
from surface_gym.agents.rollout import Episodes, run_episodes
from surface_gym.config import EnvConfig
from tests.agents.benchmark import own

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are watched on Linux")

FILE = Path(own.__file__)
SOON = PolicyLimits(memory=0.75, seconds=1.0, begin=1.0)
LATE = PolicyLimits(memory=0.75, seconds=30.0, begin=30.0)
PROMPT = 30.0  # [s] on a busy machine
STARTS: list[dict[str, Any]] = [{}, {}]
SEED = 7


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of each test's own for folders of own."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


def find_files() -> list[str]:
    """List the folders of policies, and files outside."""
    folders = [str(each) for each in Path(tempfile.gettempdir()).glob("surface-gym-policy-*")]
    return folders + [own.OUTSIDE] * os.path.lexists(own.OUTSIDE)


def play(
    source: str | Path, limits: PolicyLimits | None = None, task: str = "sort"
) -> tuple[Episodes, dict[str, Any]]:
    with PolicyProcess(source, limits) as policy:
        asked = policy.env_kwargs(task, "lab")
        arguments = {"task": task, "preset": "lab", **asked}
        policy.begin(arguments, SEED)
        return run_episodes(policy, EnvConfig(**arguments), STARTS, seed=1), asked


def check_same(found: Episodes, wanted: Episodes) -> None:
    np.testing.assert_array_equal(found.pose, wanted.pose)
    np.testing.assert_array_equal(found.time, wanted.time)
    assert found.outcome == wanted.outcome


def fail(source: str, limits: PolicyLimits = LATE) -> str:
    """Run a policy that fails; return the reason, and check that nothing is left."""
    since, before = time.monotonic(), watch.find_descendants(os.getpid())
    with pytest.raises(PolicyFailure) as failure:
        play(source, limits)
    assert time.monotonic() - since < PROMPT
    assert watch.find_descendants(os.getpid()) <= before
    assert find_files() == []
    reason = str(failure.value)
    assert reason.isprintable()
    return reason


class TestGood:
    def test_a_class_acts_as_here(self) -> None:
        found, asked = play(f"{FILE}:Draws")
        assert asked == own.Draws.env_kwargs
        config = EnvConfig("sort", preset="lab", **asked)
        check_same(found, run_episodes(own.Draws(config, SEED), config, STARTS, seed=1))

    def test_a_class_may_write_to_its_folder(self) -> None:
        found, asked = play(f"{FILE}:Zeros")
        assert asked == {"actions": "halves"}
        assert len(found.outcome) == len(STARTS)
        assert find_files() == []

    def test_each_beginning_is_the_first(self) -> None:
        with PolicyProcess(f"{FILE}:Draws") as policy:
            arguments = {"task": "sort", "preset": "lab", **policy.env_kwargs("sort")}
            config, runs = EnvConfig(**arguments), []
            for _ in range(2):
                policy.begin(arguments, SEED)
                runs.append(run_episodes(policy, config, STARTS, seed=1))
        check_same(*runs)

    def test_a_shipped_agent_acts_as_here(self) -> None:
        here = agents.load("sort-ppo")
        config = EnvConfig("sort", preset="lab", **here.env_kwargs)
        wanted = run_episodes(here, config, STARTS, seed=1)
        for source in ("sort-ppo", library.SHELF / "sort-ppo" / "seed-0"):
            check_same(play(source)[0], wanted)

    def test_an_onnx_model_acts_as_here(self, tmp_path: Path) -> None:
        for name in ("onnx", "onnxruntime"):
            pytest.importorskip(name, reason=f"{name}, of the extra `export`, is missing")
        from surface_gym.agents.export.cli import make_metadata
        from surface_gym.agents.export.onnx import make_model
        from surface_gym.agents.export.policy import network_decision, shipped

        source = shipped("sort-ppo")
        file = tmp_path / "model.onnx"
        file.write_bytes(make_model(network_decision(source), make_metadata(source)))
        found, asked = play(file)
        assert (asked["actions"], asked["control_period"]) == ("halves", 0.04)
        config = EnvConfig("sort", preset="lab", **asked)
        check_same(found, run_episodes(source.policy, config, STARTS, seed=1))

    @pytest.mark.parametrize("name", ["PPO", "DQN"])
    def test_a_zip_file_acts_as_here(self, name: str, tmp_path: Path) -> None:
        import gymnasium as gym
        import stable_baselines3
        import torch

        torch.set_num_threads(1)  # sums in another order differ in their last digits
        config = EnvConfig("sort", preset="lab", actions="halves")
        env = gym.make("SmartSurface/Sort-v0", actions="halves")
        size = {"n_steps": 8, "batch_size": 8} if name == "PPO" else {"buffer_size": 8}
        made = getattr(stable_baselines3, name)("MlpPolicy", env, device="cpu", seed=0, **size)
        made.save(tmp_path / "model.zip")
        with PolicyProcess(tmp_path / "model.zip") as policy:
            assert policy.env_kwargs("sort") == {}
            policy.begin({"task": "sort", "preset": "lab", "actions": "halves"}, SEED)
            found = run_episodes(policy, config, STARTS, seed=1)
        check_same(found, run_episodes(made, config, STARTS, seed=1))
        assert len(np.unique(found.pose)) > 10


LIMIT = "used more than 0.75 GiB of memory"
WROTE = f"wrote to {own.OUTSIDE}"
STARTED = "started a process"
MESSAGE = "sent a message that is not allowed"
ACTIONS = "returned actions that are not allowed"
LATE_BY = "took more than 1 s"
# What a policy does in `predict`, and the reason of its failure.
ACTS = {
    "os.fork()": STARTED,
    'subprocess.run(["touch", OUTSIDE], check=False)': STARTED,
    "LIBC.fork() or time.sleep(100.0) or os._exit(0); time.sleep(10.0)": STARTED,
    'pathlib.Path(OUTSIDE).write_text("text")': WROTE,
    'os.symlink(OUTSIDE, "link"); pathlib.Path("link").write_text("text")': WROTE,
    "os.makedirs(OUTSIDE)": WROTE,
    "os.remove(__file__)": "wrote to FILE",
    'urllib.request.urlopen("http://127.0.0.1:9/")': "used the network",
    "os.kill(os.getppid(), signal.SIGKILL)": "sent a signal to another process",
    "np.ones(2**33)": LIMIT,
    r'print("the last\nline"); os._exit(3)': "ended with exit code 3: line",
    "sys.exit(3)": "raised SystemExit in line",
    "ctypes.string_at(0)": "ended with signal 11 (Segmentation fault)",
    'connection().sendall(b"garbage " * 100)': MESSAGE,
    r'connection().sendall(b"\x40\x00\x00\x00"); time.sleep(100.0)': f"{LATE_BY} to decide",
    """send_message(b'{"fields": {"state": true}, "arrays": [["int64", [3, 4]]]}')""": MESSAGE,
    """send_message(b'{"fields": {"state": true}, "arrays": [["object", [1]]]}')""": MESSAGE,
    """send_message(b'{"fields": {"state": NaN}, "arrays": []}')""": MESSAGE,
    "os.closerange(3, 256); time.sleep(100.0)": "closed its connection",
    "raise StrangeError": "raised StrangeError in line",
    "return np.zeros(3, dtype=np.int64)": f"{ACTIONS}: action must have the shape ()",
    "return np.full(2, 16)": f"{ACTIONS}: action must be between 0 and 15",
    "return [object(), 1]": "returned actions of object, allowed numbers",
    "return [[1, 2], [3]]": "returned actions that are not an array",
    "return np.zeros(2**24)": "raised ValueError: arrays must have at most",
}
# Bodies of classes.
BODIES = {
    "def __init__(self, config, seed): time.sleep(100.0)": f"{LATE_BY} to begin",
    "env_kwargs = lambda task, preset: time.sleep(100.0)": f"{LATE_BY} to load",
    "predict = lambda *_, **__: np.zeros(3)": (
        "returned ndarray from predict, allowed (actions, state)"
    ),
    "predict = None": "must have a method predict, got Own",
    'env_kwargs = {"actions": object()}': "asked for env_kwargs that are not JSON",
    'env_kwargs = {"control_period": float("nan")}': "asked for env_kwargs that are not JSON",
    'env_kwargs = {"randomisation": None}': "asked for env_kwargs 'randomisation', allowed are",
    'env_kwargs = {"actions": "others"}': (
        "asked for env_kwargs that are not allowed: actions must be"
    ),
    'env_kwargs = {"orientations": [0.0] * 100_000}': "raised ValueError: header must have at most",
}
BODIES |= {
    f"def act(self):\n        with suppress(OSError): {act}": reason for act, reason in ACTS.items()
}
NAMED = {
    "Raises": "raised ValueError in line",
    "Loops": f"{LATE_BY} to decide",
    "ForksTwiceNatively": STARTED,
    "WritesLongFile": "raised OSError in line",
    "EatsMemory": LIMIT,
    "Missing": "raised ValueError: own.py must have a class Missing",
}


class TestBad:
    @pytest.mark.parametrize("body", BODIES)
    def test_it_ends_with_a_reason_and_leaves_nothing(self, body: str, tmp_path: Path) -> None:
        file, reason = tmp_path / "bad.py", BODIES[body]
        base = "from tests.agents.benchmark.own import *\nclass Own(Bad):\n    "
        file.write_text(f"{base}{body}\n")
        found = fail(f"{file}:Own", SOON if reason.startswith("took") else LATE)
        assert found.startswith(reason.replace("FILE", str(file)))

    @pytest.mark.parametrize("name", NAMED)
    def test_so_does_a_longer_one(self, name: str) -> None:
        reason = NAMED[name]
        found = fail(f"{FILE}:{name}", SOON if reason.startswith("took") else LATE)
        assert found.startswith(reason)

    @pytest.mark.parametrize(
        ("name", "reason"),
        [
            ("EatsSharedMemory", LIMIT),
            ("FillsDisk", "wrote more than 256 MiB of files"),
            ("PrintsMuch", "printed more than 16 MiB"),
        ],
    )
    def test_the_watch_ends_what_no_resource_limit_does(self, name: str, reason: str) -> None:
        assert fail(f"{FILE}:{name}") == reason

    def test_the_reason_stays(self) -> None:
        with PolicyProcess(f"{FILE}:Raises", SOON) as policy:
            policy.begin({"task": "sort", "actions": "halves"}, 0)
            for _ in range(2):
                with pytest.raises(PolicyFailure, match="raised ValueError in line"):
                    policy.predict(np.zeros((2, 15), dtype=np.float32))
            with pytest.raises(PolicyFailure, match="raised ValueError in line"):
                policy.env_kwargs("sort")

    def test_another_policy_is_not_harmed(self) -> None:
        with PolicyProcess(f"{FILE}:Draws") as policy:
            arguments = {"task": "sort", "preset": "lab", **policy.env_kwargs("sort")}
            policy.begin(arguments, SEED)
            fail_beside = pytest.raises(PolicyFailure)
            with fail_beside, PolicyProcess(f"{FILE}:ForksTwiceNatively", SOON) as other:
                other.begin({"task": "sort", "actions": "halves"}, 0)
                other.predict(np.zeros((2, 15), dtype=np.float32))
            found = run_episodes(policy, EnvConfig(**arguments), STARTS, seed=1)
        assert len(found.outcome) == len(STARTS)

    def test_a_child_of_this_process_is_left_alone(self) -> None:
        with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
            assert fail(f"{FILE}:ForksTwiceNatively") == STARTED
            assert child.poll() is None
            child.kill()

    @pytest.mark.parametrize(
        "text", ["missing.py:Zeros", str(FILE), f"{FILE}:", "missing", "model.onnx", "model.pkl"]
    )
    def test_a_source_that_is_none(self, text: str) -> None:
        with pytest.raises(ValueError, match="policy must be FILE"):
            PolicyProcess(text)

    @pytest.mark.parametrize(
        ("content", "name", "reason"),
        [
            (b"none", "model.zip", "raised BadZipFile: File is not a zip file"),
            (b"raise KeyError(1)", "own.py:Own", "raised KeyError in line 1 of own.py: 1"),
            (b"(", "own.py:Own", "raised SyntaxError: "),
            (b"", "own.py:Own", "raised ValueError: own.py must have a class Own, got none"),
        ],
    )
    def test_a_file_that_is_none(
        self, content: bytes, name: str, reason: str, tmp_path: Path
    ) -> None:
        (tmp_path / name.partition(":")[0]).write_bytes(content)
        with PolicyProcess(tmp_path / name) as policy, pytest.raises(PolicyFailure) as failure:
            policy.env_kwargs("sort")
        assert str(failure.value).startswith(reason)

    def test_a_folder_without_a_policy(self, tmp_path: Path) -> None:
        with (
            PolicyProcess(tmp_path) as policy,
            pytest.raises(PolicyFailure, match="holds no policy: policy"),
        ):
            policy.env_kwargs("sort")

    def test_a_policy_of_another_task(self) -> None:
        with (
            PolicyProcess("stop-ppo") as policy,
            pytest.raises(PolicyFailure, match="task must be one of"),
        ):
            policy.env_kwargs("sort")


WAITS = f"""
import signal
from surface_gym.agents.benchmark.process import PolicyProcess
signal.signal(signal.SIGINT, signal.default_int_handler)
import numpy as np
with PolicyProcess({str(FILE) + ":Loops"!r}) as policy:
    policy.begin({{"task": "sort", "actions": "halves"}}, 0)
    print(policy._process.pid, flush=True)
    policy.predict(np.zeros((2, 15), dtype=np.float32))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_policy_ends_with_its_parent(number: signal.Signals, tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", WAITS],
        env={**os.environ, "TMPDIR": str(tmp_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as parent:
        assert parent.stdout is not None
        policy = int(parent.stdout.readline())
        time.sleep(0.2)
        parent.send_signal(number)
        parent.wait(10.0)
    deadline = time.monotonic() + 10.0
    while Path(f"/proc/{policy}/stat").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not Path(f"/proc/{policy}/stat").exists()
    if number == signal.SIGINT:
        assert list(tmp_path.iterdir()) == []


def test_limits_are_checked() -> None:
    for name in ("memory", "seconds", "begin"):
        with pytest.raises(ValueError, match=f"{name} must be greater than 0, got 0"):
            PolicyLimits(**{name: 0})


def test_calls_in_another_order() -> None:
    policy = PolicyProcess(f"{FILE}:Draws")
    with pytest.raises(ValueError, match="process must be started by"):
        policy.env_kwargs("sort")
    with policy:
        with pytest.raises(ValueError, match="begin must be called before predict"):
            policy.predict(np.zeros((2, 15), dtype=np.float32))
        arguments = {"task": "sort", "preset": "lab", **policy.env_kwargs("sort")}
        policy.begin(arguments, SEED)
        seen = np.zeros((2, 15), dtype=np.float32)
        _, state = policy.predict(seen, None, [True, True])
        policy.predict(seen, state, [False, False])
        with pytest.raises(ValueError, match="state must be the last that predict returned"):
            policy.predict(seen, state, [False, False])
    with pytest.raises(ValueError, match="a process must be started once"):
        policy.__enter__()


def test_a_message_is_read_as_it_was_sent() -> None:
    one, other = socket.socketpair()
    with one, other:
        arrays = [np.arange(6, dtype=np.float32).reshape(2, 3), np.zeros((0, 2), dtype=np.int8)]
        process.send(one, process.to_frame({"kind": "any"}, *arrays))
        fields, found = process.read_message(other)
        assert fields == {"kind": "any"}
        for each, wanted in zip(found, arrays, strict=True):
            np.testing.assert_array_equal(each, wanted)
            assert each.dtype == wanted.dtype
        with pytest.raises(TimeoutError):
            process.read_message(other, time.monotonic() + 0.01)
