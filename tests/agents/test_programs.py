"""train.py and evaluate.py, from the command line to the folders they leave; users' tasks too."""

import io
import re
import runpy
import subprocess
import sys
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import imageio.v2 as imageio
import pytest
import yaml

from surface_gym import agents
from surface_gym.agents.evaluation import report, run_report
from surface_gym.agents.evaluation.method import Method
from surface_gym.agents.evaluation.scenario import WHOLE, Extent, Scenario, start_scenarios
from surface_gym.agents.library import card_env_id, find_task, task_kind, task_label
from surface_gym.tasks import TASKS

ROOT = Path(__file__).parents[2]


def run_in_process(
    program: str, *arguments: str, folder: Path, cores: int = 1
) -> subprocess.CompletedProcess[str]:
    """Run a program in this process, which has its imports, with some of the processors.

    An error that is raised instead of reported is raised here too.
    """
    shown, errors, code = io.StringIO(), io.StringIO(), 0
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(shown), redirect_stderr(errors):
        patch.chdir(folder)
        patch.setenv("COLUMNS", "100")
        patch.setattr(sys, "argv", [program, *arguments])
        patch.setattr("surface_gym.agents.train_cli.usable_cores", lambda: cores)
        try:
            runpy.run_path(str(ROOT / program), run_name="__main__")
        except SystemExit as end:
            code = int(end.code or 0) if not isinstance(end.code, str) else 1
            if isinstance(end.code, str):
                print(end.code, file=sys.stderr)
    return subprocess.CompletedProcess([program], code, shown.getvalue(), errors.getvalue())


COMPARED = "exact", "friction"  # without cameras, each of which compiles kernels of its own


def few_scenarios(task: str, extent: Extent = WHOLE) -> list[Scenario]:
    return [each for each in start_scenarios(task, extent) if each.preset in COMPARED]


@pytest.fixture(scope="module", autouse=True)
def _few_scenarios() -> Iterator[None]:
    """All that is compared is compared in two presets."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_report, "COMPARED", COMPARED)
        for each in (report, run_report):
            patch.setattr(each, "start_scenarios", few_scenarios)
        yield


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run by several processes, too short to learn anything."""
    folder = tmp_path_factory.mktemp("run")
    flags = (
        "--seeds 2 --name a --steps 512 --num-envs 8 --n-steps 16 "
        "--batch-size 64 --n-epochs 1 --hidden 8 --camera-share 0"
    )
    done = run_in_process("train.py", *flags.split(), folder=folder, cores=2)
    assert done.returncode == 0, done.stderr
    assert "sorting by entry speed" in done.stdout.lower()
    return folder / "runs" / "a"


def test_the_folder_holds_everything(run) -> None:
    config = yaml.safe_load((run / "config.yaml").read_text())
    assert (config["steps"], config["num_envs"], config["seed"]) == (512, 8, 0)
    assert "--seeds 2 --name a" in (run / "command.txt").read_text()
    for seed in ("seed-0", "seed-1"):
        assert list((run / seed / "tensorboard").glob("events.*"))
        for name in ("policy.safetensors", "policy.yaml", "checkpoint.pt", "curve.csv"):
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
        ("seed-1/policy.safetensors", "train.py --resume"),  # which is done
    ],
)
def test_a_run_that_is_compared_or_gone_on_with_again_is_the_same(
    run, file, command, monkeypatch
) -> None:  # fmt: skip
    if command.startswith("train.py"):
        monkeypatch.setattr(run_report, "evaluate_run", lambda *_: {})  # it was compared once
    before = (run / file).read_bytes()
    done = run_in_process(*command.split(), str(run), folder=run)
    assert done.returncode == 0, done.stderr
    assert (run / file).read_bytes() == before


def test_the_comparison_of_a_task(tmp_path) -> None:
    out = tmp_path / "out"
    flags = ("--tasks", "stop", "--out", str(out), "--quick", "--workers", "1")
    done = run_in_process("evaluate.py", *flags, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("loading what compares\n")
    assert done.stdout.count("Quick: few starts") == 1
    for name in ("results.csv", "stop.md", "stop.mp4"):
        assert (out / name).stat().st_size > 0
    text = (out / "report.html").read_text()
    assert "Quick: few starts" in text
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


REACH = str(ROOT / "examples" / "reach.py") + ":Reach"
HASTE = str(ROOT / "examples" / "haste.py") + ":Haste"
SHORT = (
    "--steps 512 --num-envs 8 --n-steps 16 --batch-size 64 --n-epochs 1 --hidden 8 --name a "
    "--camera-share 0"
)


@pytest.mark.parametrize("name", TASKS)
def test_the_packages_are_found(name) -> None:
    assert find_task(name) == TASKS[name]()
    assert (task_kind(name), task_label(name)) == (name, name)
    assert card_env_id(name) == f"SmartSurface/{name.capitalize()}-v0"


def test_a_users_own_is_found() -> None:
    assert type(find_task(REACH)).__name__ == "Reach"
    assert find_task(REACH) == find_task(REACH)  # the file is run once
    names = task_kind(REACH), task_label(REACH), card_env_id(REACH)
    assert names == ("reach", "reach", "Own/Reach")
    assert (task_kind(HASTE), card_env_id(HASTE)) == ("sort", "Own/Haste")


@pytest.mark.parametrize(
    ("name", "named"),
    [
        ("juggle", "task must be one of sort, slow, .*, sequence, .*or your own"),
        ("nowhere.py:Reach", "task must be in a file that exists"),
        (REACH[:-6], "task must be one of"),
        (REACH + "er", "task must be a class that inherits from Task in .*, got 'Reacher'"),
        (REACH.replace(":Reach", ":math"), "task must be a class that inherits from Task"),
        ("broken.py:Reach", "task must be in a file that runs, got broken.py: ZeroDivision"),
    ],
)
def test_others_are_named(name, named, tmp_path, monkeypatch) -> None:
    (tmp_path / "broken.py").write_text("1 / 0\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=named):
        find_task(name)


@pytest.fixture(scope="class")
def own_run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A run of a user's own task, too short to learn anything, and compared in two presets."""
    folder, chosen = tmp_path_factory.mktemp("own"), report.Selection.methods

    def methods(selection: report.Selection, task: str) -> list[Method]:
        return [each.under("exact") for each in chosen(selection, task)]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report.Selection, "methods", methods)
        done = run_in_process("train.py", "--task", REACH, *SHORT.split(), folder=folder)
        assert done.returncode == 0, done.stderr
        yield folder / "runs" / "a"


class TestARun:
    def test_holds_everything_and_plays_where_the_task_is_said(self, own_run) -> None:
        assert yaml.safe_load((own_run / "policy.yaml").read_text())["env_id"] == "Own/Reach"
        table = (own_run / "table.md").read_text()
        assert "fixed layout" in table
        assert "PPO" in table
        assert (own_run / "reach.mp4").stat().st_size > 0
        policy = agents.read(own_run, find_task(REACH))
        assert policy.env_kwargs["task"] == find_task(REACH)
        for other in (None, find_task(HASTE)):
            with pytest.raises(ValueError, match="task must be Reach, a user's own"):
                agents.read(own_run, other)

    def test_no_code_is_run_for_what_its_folder_says(self, own_run) -> None:
        """Whose code is to be run stands on the command line, not in the folder."""
        mark = own_run / "ran"
        trap = own_run / "trap.py"
        trap.write_text(
            f"from pathlib import Path\nPath({str(mark)!r}).touch()\n"
            "from surface_gym.tasks import Sort\nclass Reach(Sort):\n    pass\n"
        )
        config = own_run / "config.yaml"
        whole = config.read_text()
        config.write_text(whole.replace(REACH, f"{trap}:Reach"))
        for arguments in (("train.py", "--resume"), ("evaluate.py", "--run")):
            done = run_in_process(*arguments, str(own_run), folder=own_run)
            assert done.returncode != 0
            assert "task" in done.stderr
            assert "Traceback" not in done.stderr
        assert not mark.exists()
        config.write_text(whole)

    def test_goes_on_where_the_task_is_said(self, own_run, monkeypatch) -> None:
        monkeypatch.setattr(run_report, "evaluate_run", lambda *_: {})  # it was compared once
        before = (own_run / "policy.safetensors").read_bytes()
        done = run_in_process("train.py", "--resume", str(own_run), "--task", REACH, folder=own_run)
        assert done.returncode == 0, done.stderr
        assert (own_run / "policy.safetensors").read_bytes() == before

    def test_is_compared(self, own_run) -> None:
        folder = own_run.parents[1]
        flags = ("--task", REACH, "--out", "out", "--workers", "2")
        done = run_in_process("evaluate.py", *flags, folder=folder)
        assert done.returncode == 0, done.stderr
        table = (folder / "out" / "reach.md").read_text()
        assert "fixed layout" in table
        assert "PPO" in table
        assert (folder / "out" / "report.html").stat().st_size > 0


def test_a_faulty_task_ends_without_a_traceback(tmp_path) -> None:
    code = "from surface_gym.tasks import Sort\nclass Faulty(Sort):\n    outcome = None\n"
    (tmp_path / "faulty.py").write_text(code)
    done = run_in_process("train.py", "--task", "faulty.py:Faulty", *SHORT.split(), folder=tmp_path)
    assert done.returncode != 0
    assert "Faulty.outcome must be a static method and a kernel_function" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "runs" / "a" / "policy.safetensors").exists()
