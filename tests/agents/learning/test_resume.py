"""A run that is broken off goes on as if it had not been."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from agents.learning import checkpoint
from agents.learning.config import DQNConfig, PPOConfig
from agents.learning.curve import FILE, read_curve
from agents.learning.hyperparams import write_config
from agents.learning.training import train
from agents.policies.files import WEIGHTS

SMALL: dict[str, PPOConfig | DQNConfig] = {
    "ppo": PPOConfig(
        task="stop", lanes=16, steps=20_000, checkpoint_every=6_000, n_steps=32, batch_size=256,
        n_epochs=1, hidden=(8,),
    ),
    "dqn": DQNConfig(
        task="stop", lanes=16, steps=20_000, checkpoint_every=6_000, buffer_size=10_000,
        learning_starts=1_000, gradient_steps=1, batch_size=32, hidden=(8,),
    ),
}  # fmt: skip
TRAIN = """
import sys
from pathlib import Path
from agents.learning.hyperparams import read_config
from agents.learning.training import train
folder = Path(sys.argv[1])
train(read_config(folder / "config.yaml"), folder)
"""


def weights(folder: Path) -> dict[str, torch.Tensor]:
    state: dict[str, torch.Tensor] = torch.load(folder / WEIGHTS, weights_only=True)
    return state


def assert_same(one: Path, other: Path) -> None:
    assert (one / FILE).read_bytes() == (other / FILE).read_bytes()
    first, second = weights(one), weights(other)
    assert first.keys() == second.keys()
    for name, values in first.items():
        assert torch.equal(values, second[name]), name


@pytest.fixture(scope="module", params=SMALL)
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing breaks off, in a folder by the name of its algorithm."""
    folder = tmp_path_factory.mktemp("whole") / request.param
    folder.mkdir()
    train(SMALL[request.param], folder)
    return folder


def test_killed_and_gone_on_with_it_comes_to_the_same(whole: Path, tmp_path: Path) -> None:
    config, broken = SMALL[whole.name], tmp_path
    write_config(config, broken / "config.yaml")
    process = subprocess.Popen(
        [sys.executable, "-c", TRAIN, str(broken)],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3]), "OMP_NUM_THREADS": "1"},
    )
    while process.poll() is None and not any(row["steps"] > 7_500 for row in read_curve(broken)):
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL  # before it was done
    assert not (broken / WEIGHTS).exists()
    train(config, broken)
    assert_same(whole, broken)


def test_an_interrupt_keeps_what_was_learned(whole: Path, tmp_path: Path) -> None:
    config, broken = SMALL[whole.name], tmp_path

    def interrupt(steps: int, success: float) -> None:
        del success
        if steps > 9_000:
            raise KeyboardInterrupt

    learned = train(config, broken, interrupt)
    assert learned.interrupted
    assert 9_000 < learned.steps < config.steps
    assert weights(broken)
    assert not train(config, broken).interrupted
    assert_same(whole, broken)


def test_the_seed_fixes_the_weights(tmp_path: Path) -> None:
    config = replace(SMALL["ppo"], steps=2_000)
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        (tmp_path / name).mkdir()
        train(replace(config, seed=seed), tmp_path / name)
    assert_same(tmp_path / "a", tmp_path / "b")
    one, other = weights(tmp_path / "a"), weights(tmp_path / "c")
    assert not all(torch.equal(one[name], other[name]) for name in one)


class TestBadCheckpoints:
    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        train(replace(SMALL["ppo"], steps=1_000), tmp_path)
        return tmp_path

    def test_damage_is_named(self, folder: Path) -> None:
        file = folder / checkpoint.FILE
        file.write_bytes(file.read_bytes()[:1000])
        with pytest.raises(ValueError, match="damaged"):
            train(SMALL["ppo"], folder)

    @pytest.mark.parametrize("other", [{"hidden": (16,)}, {"task": "track"}])
    def test_another_configuration_is_refused(self, folder: Path, other: dict[str, Any]) -> None:
        with pytest.raises(ValueError, match="of another run"):
            train(replace(SMALL["ppo"], **other), folder)

    def test_code_is_not_run(self, folder: Path) -> None:
        import pickle

        mark = folder / "ran"

        class Trap:
            def __reduce__(self) -> tuple[object, ...]:
                return (Path.touch, (mark,))

        (folder / checkpoint.FILE).write_bytes(pickle.dumps(Trap(), protocol=2))
        with pytest.raises(ValueError, match="damaged"):
            train(SMALL["ppo"], folder)
        assert not mark.exists()
