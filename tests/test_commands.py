import subprocess
import sys
from pathlib import Path

import pytest

NEEDED = ("matplotlib", "rich", "tyro")
COMMANDS = {"paper": "agents", "validation": "validation", "design": "agents"}
# The validation asks for matplotlib when it draws, after its runs.
CASES = [
    (command, missing)
    for command in COMMANDS
    for missing in NEEDED
    if (command, missing) != ("validation", "matplotlib")
]


@pytest.mark.parametrize(("command", "missing"), CASES)
def test_a_missing_library_is_told_in_one_line(command: str, missing: str, tmp_path: Path) -> None:
    program = (
        f"import runpy, sys; sys.modules[{missing!r}] = None; sys.argv = ['it', '--figures', 'f']; "
        f"runpy.run_module('surface_gym.{command}', run_name='__main__')"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 1
    assert done.stderr == (
        f"error: python -m surface_gym.{command} needs {missing}, which is not installed: "
        f"pip install 'surface_gym[{COMMANDS[command]}]'\n"
    )


def test_another_missing_library_is_no_such_case() -> None:
    program = (
        "import runpy, sys; sys.modules['surface_gym.paper.command'] = None; "
        "runpy.run_module('surface_gym.paper', run_name='__main__')"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 1
    assert "ModuleNotFoundError" in done.stderr
