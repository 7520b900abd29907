"""The wheel, which holds one package and no other's name, used outside the checkout."""

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BUILD = (
    "import sys; from hatchling.builders.wheel import WheelBuilder; "
    "from hatchling.builders.sdist import SdistBuilder; "
    "kinds = {'wheel': WheelBuilder, 'sdist': SdistBuilder}; "
    "print(next(kinds[sys.argv[1]](sys.argv[2]).build(directory=sys.argv[3])))"
)


def build(kind: str, source: Path, folder: Path) -> Path:
    done = subprocess.run(
        [sys.executable, "-c", BUILD, kind, str(source), str(folder)],
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    return Path(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source distribution, unpacked."""
    folder = tmp_path_factory.mktemp("sdist")
    with tarfile.open(build("sdist", ROOT, folder)) as packed:
        packed.extractall(folder)
    (source,) = (each for each in folder.iterdir() if each.is_dir())
    return source


@pytest.fixture(scope="module")
def installed(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds what the wheel brings, which is built from the source distribution."""
    folder = tmp_path_factory.mktemp("wheel")
    with zipfile.ZipFile(build("wheel", sdist, folder)) as packed:
        packed.extractall(folder / "site")
    return folder / "site"


def run(installed: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", *arguments],
        cwd=installed.parent,
        env={**os.environ, "PYTHONPATH": str(installed)},
        capture_output=True,
        text=True,
    )


def test_it_brings_one_package_alone(installed: Path) -> None:
    brought = {each.name for each in installed.iterdir() if each.suffix != ".dist-info"}
    assert brought == {"surface_gym"}
    assert not list(installed.rglob("__pycache__"))


def test_it_brings_every_file_of_the_checkouts_packages(installed: Path) -> None:
    listed = subprocess.run(
        ["git", "ls-files", "surface_gym", "agents"], cwd=ROOT, capture_output=True, text=True
    )
    if listed.returncode:
        pytest.skip("not a checkout of git")
    names = [name for name in listed.stdout.split() if (ROOT / name).exists()]
    places = [
        installed / ("surface_gym" if name.startswith("agents/") else "") / name for name in names
    ]
    assert [str(each) for each in places if not each.is_file()] == []


def test_the_source_distribution_has_what_tests_need(sdist: Path) -> None:
    for name in ("pyproject.toml", "README.md", "train.py", "evaluate.py", "tests", "docs"):
        assert (sdist / name).exists()


def test_environment_and_shipped_agent_work(installed: Path) -> None:
    program = (
        "import gymnasium as gym\n"
        "from surface_gym import agents\n"
        "policy = agents.load('sort-ppo')\n"
        "env = gym.make(f'surface_gym:{policy.env_id}', **policy.env_kwargs)\n"
        "seen, _ = env.reset(seed=0)\n"
        "action, _ = policy.predict(seen, deterministic=True)\n"
        "env.step(action)\n"
        "print(agents.__name__, agents.__file__)\n"
    )
    done = run(installed, "-c", program)
    assert done.returncode == 0, done.stderr
    name, file = done.stdout.split()
    assert name == "surface_gym.agents"
    assert Path(file).is_relative_to(installed)


def test_no_module_of_it_takes_the_name_of_another_package(installed: Path) -> None:
    program = (
        "import importlib, pkgutil, sys\n"
        "sys.modules['agents'] = None  # whoever else has it\n"
        "from surface_gym import agents\n"
        "for module in pkgutil.walk_packages(agents.__path__, 'surface_gym.agents.'):\n"
        "    importlib.import_module(module.name)\n"
    )
    done = run(installed, "-c", program)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["train", "evaluate"])
def test_its_command_has_both_doors(name: str, installed: Path) -> None:
    program = "from surface_gym.cli import main; main()"
    done = run(installed, "-c", program, name, "--help")
    assert done.returncode == 0, done.stderr
    assert f"usage: surface-gym {name}" in done.stdout
