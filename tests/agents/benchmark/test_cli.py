"""The command `surface-gym benchmark`."""

from pathlib import Path

import pytest

from surface_gym.agents.benchmark.cli import main
from surface_gym.agents.benchmark.entry import CELLS, Row, read_entry

BROKEN = """
class Policy:
    env_kwargs = {"zone": [4, 5]}
"""


def test_a_policy_that_fails_leaves_an_entry_with_the_reason(tmp_path: Path, capsys) -> None:
    file = tmp_path / "own.py"
    file.write_text(BROKEN)
    arguments = ["--policy", f"{file}:Policy", "--tasks", "sort", "--out", str(tmp_path)]
    with pytest.raises(SystemExit, match=r"error: policy must run, got .*'zone'"):
        main([*arguments, "--name", "My Own", "--by", "me", "--workers", "1"])
    entry = read_entry(tmp_path / "my-own.json")
    assert (entry.name, entry.by, entry.source) == ("My Own", "me", "own.py:Policy")
    assert [row.cell for row in entry.rows] == list(CELLS)
    assert all("asked for env_kwargs 'zone'" in row.failure for row in entry.rows)
    main(["table", "--results", str(tmp_path), "--out", str(tmp_path / "board.md")])
    assert "| My Own |" in (tmp_path / "board.md").read_text()
    capsys.readouterr()


def test_a_task_run_again_replaces_its_own_rows(tmp_path: Path, capsys) -> None:
    def enter(*tasks: str) -> tuple[Row, ...]:
        policy = f"{tmp_path}/own-{{task}}.py:Policy"
        with pytest.raises(SystemExit, match="policy must run"):
            main(["--policy", policy, "--tasks", *tasks, "--out", str(tmp_path), "--name", "own"])
        return read_entry(tmp_path / "own.json").rows

    for task in ("sort", "stop"):
        (tmp_path / f"own-{task}.py").write_text(BROKEN)
    first = enter("sort", "stop")
    (tmp_path / "own-sort.py").write_text(BROKEN.replace("[4, 5]", "[5, 6]"))
    rows = enter("sort")
    assert [row.task for row in rows] == ["stop"] * 4 + ["sort"] * 4
    assert rows[:4] == first[4:]
    assert len({row.source_digest for row in first + rows}) == 2 + 1
    capsys.readouterr()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--policy", "nowhere.zip"], r"policy must be FILE\.py:Class, .* got 'nowhere.zip'"),
        (["--policy", "sort-ppo", "--tasks", "fly"], "tasks must be one of 'sort', .* got 'fly'"),
        (["--policy", "sort-ppo", "--memory", "0.1"], "memory must be .* got 0.1"),
        (["table", "--results", "nowhere"], "results must be a folder with entries, got nowhere"),
    ],
)
def test_bad_input_is_named_in_one_line(arguments: list[str], message: str) -> None:
    with pytest.raises(SystemExit, match=f"error: {message}"):
        main(arguments)
