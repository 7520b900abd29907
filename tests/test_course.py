"""The course: notebooks without outputs, whose exercises are checked and which run."""

import json
from pathlib import Path
from typing import Any

import pytest

COURSE = Path(__file__).parents[1] / "examples/course"
NOTEBOOKS = sorted(COURSE.glob("*.ipynb"))


def cells(file: Path, kind: str) -> list[dict[str, Any]]:
    """Return the cells of a kind, "code" or "markdown"."""
    return [cell for cell in json.loads(file.read_text())["cells"] if cell["cell_type"] == kind]


def texts(file: Path, kind: str) -> list[str]:
    return ["".join(cell["source"]) for cell in cells(file, kind)]


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
class TestNotebooks:
    def test_it_is_short_without_outputs_and_opens_anywhere(self, file: Path) -> None:
        code = cells(file, "code")
        assert 15 <= len(code) + len(cells(file, "markdown")) <= 30
        assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
        assert "%pip install" in texts(file, "code")[0]

    def test_each_exercise_is_followed_by_a_check(self, file: Path) -> None:
        """The solution is folded, and stands in where dots are left."""
        asked = "".join(texts(file, "markdown")).count("**Exercise ")
        checks = [cell for cell in cells(file, "code") if cell["metadata"]]
        assert asked == len(checks) >= 3
        for cell in checks:
            assert cell["metadata"]["jupyter"]["source_hidden"]
            assert "assert " in "".join(cell["source"])


def test_there_are_three_in_order() -> None:
    assert [file.stem for file in NOTEBOOKS] == ["1_friction", "2_rule", "3_agent"]
    page = (COURSE.parents[1] / "docs/course.md").read_text()
    assert all(f"examples/course/{file.name}" in page for file in NOTEBOOKS)


class TestRuns:
    @pytest.fixture(autouse=True)
    def _installed(self) -> None:
        for name in ("nbclient", "ipykernel", "optuna"):
            pytest.importorskip(name, reason=f"{name}, of the extra `course`, is missing")

    def run(self, file: Path, folder: Path, **answers: str) -> None:
        """Run all cells of a notebook, with answers instead of some dots."""
        import nbformat
        from nbclient import NotebookClient

        text = file.read_text()
        for name, answer in answers.items():
            dots = json.dumps(f"{name} = ...")[1:-1]
            assert dots in text
            text = text.replace(dots, f"{name} = {answer}")
        notebook = nbformat.reads(text, 4)
        NotebookClient(
            notebook, timeout=900, kernel_name="python3", resources={"metadata": {"path": folder}}
        ).execute()

    @pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
    def test_it_runs_to_its_end(self, file: Path, tmp_path: Path) -> None:
        self.run(file, tmp_path)

    @pytest.mark.parametrize(
        ("file", "name", "wrong"),
        [
            (NOTEBOOKS[0], "acceleration_y", "3.4"),  # the other side
            (NOTEBOOKS[0], "steepest", "0.41"),
            (NOTEBOOKS[1], "level_2", "4.9"),
            (NOTEBOOKS[2], "ahead_brakes", "12"),
        ],
    )
    def test_a_wrong_answer_is_refused(
        self, file: Path, name: str, wrong: str, tmp_path: Path
    ) -> None:
        from nbclient.exceptions import CellExecutionError

        with pytest.raises(CellExecutionError, match="AssertionError"):
            self.run(file, tmp_path, **{name: wrong})
