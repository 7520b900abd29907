"""train.py and evaluate.py, from the command line to the folders they leave."""

import io
import os
import re
import runpy
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import imageio.v2 as imageio
import pytest
import yaml

ROOT = Path(__file__).parents[2]


def run_program(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a program in a process of its own."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env={**os.environ, "COLUMNS": "100", "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )


def run_in_process(program: str, *arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a program in this process, which has its imports, with one processor.

    An error that is raised instead of reported is raised here too.
    """
    shown, errors, code = io.StringIO(), io.StringIO(), 0
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(shown), redirect_stderr(errors):
        patch.chdir(folder)
        patch.setenv("COLUMNS", "100")
        patch.setattr(sys, "argv", [program, *arguments])
        patch.setattr("surface_gym.agents.train_cli.usable_cores", lambda: 1)
        try:
            runpy.run_path(str(ROOT / program), run_name="__main__")
        except SystemExit as end:
            code = int(end.code or 0) if not isinstance(end.code, str) else 1
            if isinstance(end.code, str):
                print(end.code, file=sys.stderr)
    return subprocess.CompletedProcess([program], code, shown.getvalue(), errors.getvalue())


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run by several processes, too short to learn anything."""
    folder = tmp_path_factory.mktemp("run")
    flags = (
        "--seeds 2 --name a --steps 512 --num-envs 8 --n-steps 16 "
        "--batch-size 64 --n-epochs 1 --hidden 8 --camera-share 0"
    )
    done = run_program(str(ROOT / "train.py"), *flags.split(), folder=folder)
    assert done.returncode == 0, done.stderr
    assert "sorting by entry speed" in done.stdout.lower()
    return folder / "runs" / "a"


def test_the_folder_holds_everything(run) -> None:
    config = yaml.safe_load((run / "config.yaml").read_text())
    assert (config["steps"], config["num_envs"], config["seed"]) == (512, 8, 0)
    assert "--seeds 2 --name a" in (run / "command.txt").read_text()
    for seed in ("seed-0", "seed-1"):
        assert list((run / seed / "tensorboard").glob("events.*"))
        for name in ("policy.pt", "policy.yaml", "checkpoint.pt", "curve.csv"):
            assert (run / seed / name).stat().st_size > 0
    assert (run / "trajectories.png").stat().st_size > 0
    card = yaml.safe_load((run / "card.yaml").read_text())
    assert card["command"].startswith("python train.py --task sort --algo ppo --seeds 2")
    assert card["seeds"] == [0, 1]
    with imageio.get_reader(run / "sort.mp4") as film:
        assert film.count_frames() > 5


@pytest.mark.parametrize(
    ("file", "command"),
    [
        ("table.md", "evaluate.py --workers 1 --run"),
        ("seed-1/policy.pt", "train.py --resume"),  # which is done
    ],
)
def test_a_run_that_is_compared_or_gone_on_with_again_is_the_same(run, file, command) -> None:
    before = (run / file).read_bytes()
    done = run_in_process(*command.split(), str(run), folder=run)
    assert done.returncode == 0, done.stderr
    assert (run / file).read_bytes() == before


def test_the_comparison_of_a_task(tmp_path) -> None:
    """Everything but the waiting: the results are there already, of few starts."""
    from surface_gym.agents.evaluation.benchmark import compute_results
    from surface_gym.agents.evaluation.methods import all_methods

    out = tmp_path / "out"
    out.mkdir()
    compute_results([replace(each, starts=1) for each in all_methods("stop")], 1, out)
    flags = ("--tasks", "stop", "--out", str(out), "--resume", "--workers", "1")
    done = run_in_process("evaluate.py", *flags, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    tables = [f"comparison.{end}" for end in ("md", "csv", "json")]
    for name in (*tables, "decisions.md", "report.html", "stop.mp4"):
        assert (out / name).stat().st_size > 0
    text = (out / "report.html").read_text()
    assert "braking rule" in text
    assert "data:video/mp4;base64," in text
    assert not re.search(r'(?:src|href)="(?!data:|#)', text)


@pytest.mark.parametrize(
    "command", ["evaluate.py --run nowhere", "evaluate.py --tasks juggle", "train.py --steps 0"]
)
def test_bad_input_ends_without_a_traceback(command, tmp_path) -> None:
    done = run_in_process(*command.split(), folder=tmp_path)
    assert done.returncode != 0
    assert command.split()[-1] in done.stderr
    assert "Traceback" not in done.stderr
