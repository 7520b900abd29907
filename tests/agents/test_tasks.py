"""Tasks by name, a user's own among them, from a file to its training and comparison."""

from pathlib import Path

import pytest
import yaml

from surface_gym import agents
from surface_gym.agents.library import card_env_id, find_task, task_kind, task_label
from surface_gym.tasks import TASKS
from tests.agents.test_programs import ROOT, run_in_process, run_program

REACH = str(ROOT / "examples" / "reach.py") + ":Reach"
HASTE = str(ROOT / "examples" / "haste.py") + ":Haste"
SHORT = "--steps 512 --num-envs 8 --n-steps 16 --batch-size 64 --n-epochs 1 --hidden 8 --name a"


@pytest.mark.parametrize("name", TASKS)
def test_the_packages_are_found(name) -> None:
    assert find_task(name) == TASKS[name]()
    assert (task_kind(name), task_label(name)) == (name, name)
    assert card_env_id(name) == f"SmartSurface/{name.capitalize()}-v0"


def test_a_users_own_is_found() -> None:
    """One that inherits from the package's is of its kind."""
    assert type(find_task(REACH)).__name__ == "Reach"
    assert find_task(REACH) == find_task(REACH)  # the file is run once
    names = task_kind(REACH), task_label(REACH), card_env_id(REACH)
    assert names == ("reach", "reach", "Own/Reach")
    assert (task_kind(HASTE), card_env_id(HASTE)) == ("sort", "Own/Haste")


@pytest.mark.parametrize(
    ("name", "named"),
    [
        ("juggle", "task must be one of sort, slow, stop, track, orient, or your own"),
        ("nowhere.py:Reach", "task must be in a file that exists"),
        (REACH[:-6], "task must be one of"),
        (REACH + "er", "task must be a class of .* that inherits from Task, got 'Reacher'"),
        (REACH.replace(":Reach", ":math"), "task must be a class of"),
        ("broken.py:Reach", "task must be in a file that runs, got broken.py: ZeroDivision"),
    ],
)
def test_others_are_named(name, named, tmp_path, monkeypatch) -> None:
    (tmp_path / "broken.py").write_text("1 / 0\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=named):
        find_task(name)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a user's own task, too short to learn anything."""
    folder = tmp_path_factory.mktemp("own")
    done = run_in_process("train.py", "--task", REACH, *SHORT.split(), folder=folder)
    assert done.returncode == 0, done.stderr
    return folder / "runs" / "a"


class TestARun:
    def test_holds_everything_and_plays_where_the_task_is_said(self, run) -> None:
        assert yaml.safe_load((run / "policy.yaml").read_text())["env_id"] == "Own/Reach"
        table = (run / "table.md").read_text()
        assert "fixed layout" in table
        assert "PPO" in table
        assert (run / "reach.mp4").stat().st_size > 0
        policy = agents.read(run, find_task(REACH))
        assert policy.env_kwargs["task"] == find_task(REACH)
        for other in (None, find_task(HASTE)):
            with pytest.raises(ValueError, match="task must be Reach, a user's own"):
                agents.read(run, other)

    def test_no_code_is_run_for_what_its_folder_says(self, run) -> None:
        """Whose code is to be run stands on the command line, not in the folder."""
        mark = run / "ran"
        trap = run / "trap.py"
        trap.write_text(
            f"from pathlib import Path\nPath({str(mark)!r}).touch()\n"
            "from surface_gym.tasks import Sort\nclass Reach(Sort):\n    pass\n"
        )
        config = run / "config.yaml"
        whole = config.read_text()
        config.write_text(whole.replace(REACH, f"{trap}:Reach"))
        for arguments in (("train.py", "--resume"), ("evaluate.py", "--run")):
            done = run_in_process(*arguments, str(run), folder=run)
            assert done.returncode != 0
            assert "task" in done.stderr
            assert "Traceback" not in done.stderr
        assert not mark.exists()
        config.write_text(whole)

    def test_goes_on_where_the_task_is_said(self, run) -> None:
        before = (run / "policy.pt").read_bytes()
        done = run_in_process("train.py", "--resume", str(run), "--task", REACH, folder=run)
        assert done.returncode == 0, done.stderr
        assert (run / "policy.pt").read_bytes() == before

    def test_is_compared(self, run) -> None:
        """By processes of their own, which find the task's code again."""
        folder, program = run.parents[1], str(ROOT / "evaluate.py")
        done = run_program(program, "--task", REACH, "--out", "out", folder=folder)
        assert done.returncode == 0, done.stderr
        table = (folder / "out" / "comparison.md").read_text()
        assert "fixed layout" in table
        assert "PPO" in table
        assert (folder / "out" / "report.html").stat().st_size > 0


def test_a_faulty_task_ends_without_a_traceback(tmp_path) -> None:
    (tmp_path / "faulty.py").write_text(
        "from surface_gym.tasks import Sort\nclass Faulty(Sort):\n    outcome = None\n"
    )
    done = run_in_process("train.py", "--task", "faulty.py:Faulty", *SHORT.split(), folder=tmp_path)
    assert done.returncode != 0
    assert "Faulty.outcome must be a static method and a kernel_function" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "runs" / "a" / "policy.pt").exists()
