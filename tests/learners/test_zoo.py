"""rl-baselines3-zoo: it finds the ids and the YAML, by its own command and on the native vector
env.
"""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.learners.runs import EXAMPLES, run

pytest.importorskip("rl_zoo3")

HYPERPARAMS = EXAMPLES.parents[1] / "agents" / "hyperparams"


def test_it_learns(tmp_path: Path) -> None:
    """Chance sorts next to none."""
    done = run("zoo", 106_496, tmp_path)
    assert done.results["0.3 to 2.7 m/s evenly"]["both"] > 0.4
    assert {"rl_zoo3", "stable_baselines3"} < set(done.kept["versions"])


@pytest.mark.parametrize("algo", ["ppo", "dqn"])
def test_its_command_takes_the_yaml(algo: str, tmp_path: Path) -> None:
    """Of single environments, as it makes them."""
    command = [sys.executable, "-m", "rl_zoo3.train", "--algo", algo]
    command += ["--env", "SmartSurface/Sort-v0", "--gym-packages", "surface_gym"]
    command += ["--conf-file", str(HYPERPARAMS / f"{algo}.yml"), "--n-timesteps", "100"]
    command += ["--eval-freq", "-1", "--log-folder", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / algo / "SmartSurface-Sort-v0_1"
    assert (folder / "SmartSurface-Sort-v0.zip").is_file()
    asked = yaml.safe_load((HYPERPARAMS / f"{algo}.yml").read_text())["SmartSurface/Sort-v0"]
    used = yaml.unsafe_load((folder / "SmartSurface-Sort-v0" / "config.yml").read_text())
    assert dict(used) == asked
