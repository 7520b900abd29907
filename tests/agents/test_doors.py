"""train.py and evaluate.py, from the command line to the run's folder."""

import os
import subprocess
import sys
from pathlib import Path

import imageio.v2 as imageio
import pytest
import yaml

ROOT = Path(__file__).parents[2]


def door(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env={**os.environ, "COLUMNS": "100", "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run too short to learn anything."""
    folder = tmp_path_factory.mktemp("run")
    flags = "--name a --steps 512 --lanes 8 --rollout 16 --batch-size 64 --epochs 1 --hidden 8"
    done = door(str(ROOT / "train.py"), *flags.split(), folder=folder)
    assert done.returncode == 0, done.stderr
    assert "Sorting by entry speed" in done.stdout
    return folder / "runs" / "a"


def test_the_folder_holds_everything(run: Path) -> None:
    config = yaml.safe_load((run / "config.yaml").read_text())
    assert (config["steps"], config["lanes"], config["seed"]) == (512, 8, 0)
    assert "train.py --name a" in (run / "command.txt").read_text()
    assert list((run / "tensorboard").glob("events.*"))
    for name in ("policy.pt", "policy.yaml", "table.md", "table.json", "trajectories.png"):
        assert (run / name).stat().st_size > 0
    with imageio.get_reader(run / "sort.mp4") as film:
        assert film.count_frames() > 5


def test_evaluate_gives_the_same_table_twice(run: Path) -> None:
    for name in ("once", "twice"):
        done = door(
            str(ROOT / "evaluate.py"), "--run", str(run), "--out", str(run / name), folder=run
        )
        assert done.returncode == 0, done.stderr
    for name in ("table.md", "table.json"):
        assert (run / name).read_bytes() == (run / "once" / name).read_bytes()
        assert (run / name).read_bytes() == (run / "twice" / name).read_bytes()


@pytest.mark.parametrize("name", ["train.py", "evaluate.py"])
def test_help(name: str, tmp_path: Path) -> None:
    done = door(str(ROOT / name), "--help", folder=tmp_path)
    assert done.returncode == 0
    assert {"train.py": "--learning-rate", "evaluate.py": "--run"}[name] in done.stdout


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("evaluate.py", "--run", "nowhere"), "nowhere"),
        (("train.py", "--steps", "0"), "steps"),
        (("train.py", "--gamma", "1.5"), "gamma"),
    ],
)
def test_bad_input_ends_in_one_line(arguments: tuple[str, ...], named: str, tmp_path: Path) -> None:
    done = door(str(ROOT / arguments[0]), *arguments[1:], folder=tmp_path)
    assert done.returncode != 0
    assert named in done.stderr
    assert "Traceback" not in done.stderr
