"""The wheel, which holds one package and no other's name, used outside the checkout."""

import subprocess
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.environments import run_python

ROOT = Path(__file__).parents[1]
BUILD = (
    "import sys; from setuptools import build_meta; "
    "print(getattr(build_meta, f'build_{sys.argv[1]}')(sys.argv[2]))"
)


def build(kind: str, source: Path, folder: Path) -> Path:
    return folder / run_python("-c", BUILD, kind, str(folder), folder=source).splitlines()[-1]


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that git lists, since a build writes beside its sources, and a module."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("not a checkout of git")
    folder = tmp_path_factory.mktemp("checkout")
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes((ROOT / name).read_bytes())
    (folder / "surface_gym/web/modules").mkdir()
    (folder / "surface_gym/web/modules/sort.wasm").write_bytes(b"a module")
    return folder


@pytest.fixture(scope="module")
def sdist(checkout: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sdist")
    with tarfile.open(build("sdist", checkout, folder)) as packed:
        packed.extractall(folder, filter="data")
    (source,) = (each for each in folder.iterdir() if each.is_dir())
    return source


@pytest.fixture(scope="module")
def installed(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds what the wheel brings, which is built from the source distribution."""
    folder = tmp_path_factory.mktemp("wheel")
    with zipfile.ZipFile(build("wheel", sdist, folder)) as packed:
        packed.extractall(folder / "site")
    return folder / "site"


def run_installed(installed: Path, *arguments: str) -> str:
    place = {"folder": installed.parent, "PYTHONPATH": str(installed)}
    return run_python("-W", "error", *arguments, **place)


def test_it_brings_every_file_of_the_packages_and_nothing_else(checkout, installed):
    """So `packages` and `package-data` in pyproject.toml are complete."""
    expected = {
        ("" if folder == "surface_gym" else "surface_gym/") + str(file.relative_to(checkout))
        for folder in ("surface_gym", "agents")
        for file in (checkout / folder).rglob("*")
        if file.is_file()
    }
    found = {str(file.relative_to(installed)) for file in installed.rglob("*") if file.is_file()}
    assert {name for name in found if ".dist-info/" not in name} == expected


def test_the_source_distribution_has_every_file_that_tests_need(checkout, sdist):
    files = [file.relative_to(checkout) for file in checkout.rglob("*") if file.is_file()]
    missing = [str(name) for name in files if not (sdist / name).exists()]
    assert [name for name in missing if not name.startswith(".")] == []


def test_environment_and_shipped_agent_work(installed):
    program = (
        "import gymnasium as gym\n"
        "name = 'surface_gym:SmartSurface/Sort-v0'\n"
        "makes = (gym.make, gym.make_vec)\n"
        "envs = [make(name, actions='halves').unwrapped for make in makes]\n"
        "from surface_gym import agents\n"
        "policy = agents.load('sort-ppo')\n"
        "env = gym.make(policy.env_id, **policy.env_kwargs)\n"
        "seen, _ = env.reset(seed=0)\n"
        "action, _ = policy.predict(seen, deterministic=True)\n"
        "env.step(action)\n"
        "print(*(type(each).__name__ for each in envs), agents.__name__, agents.__file__)\n"
    )
    *names, file = run_installed(installed, "-c", program).split()
    assert names == ["SmartSurfaceEnv", "SmartSurfaceVectorEnv", "surface_gym.agents"]
    assert Path(file).is_relative_to(installed)


def test_no_module_of_it_takes_the_name_of_another_package(installed):
    program = (
        "import importlib, pkgutil, sys\n"
        "sys.modules['agents'] = None  # another package's\n"
        "from surface_gym import agents\n"
        "for module in pkgutil.walk_packages(agents.__path__, 'surface_gym.agents.'):\n"
        "    importlib.import_module(module.name)\n"
    )
    run_installed(installed, "-c", program)


@pytest.mark.parametrize("name", ["train", "evaluate"])
def test_a_command_has_help(name, installed):
    program = "from surface_gym.cli import main; main()"
    printed = run_installed(installed, "-c", program, name, "--help")
    assert f"usage: surface-gym {name}" in printed
