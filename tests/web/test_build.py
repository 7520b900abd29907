"""What is written for pages, and when a module is compiled anew."""

import json
import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from surface_gym import __version__
from surface_gym.modules import MODULES
from surface_gym.web import build
from surface_gym.web.build import AGENTS, ALL, PAGE, SITE, TASKS, PackageModules, main


@pytest.fixture
def package(tmp_path, monkeypatch) -> Path:
    """The package's folder of modules, which is empty; to write a task is to write its name."""
    folder = tmp_path / "package" / "modules"
    folder.parent.mkdir()
    monkeypatch.setattr(build, "MODULES", folder)
    monkeypatch.setattr(build, "IN_CHECKOUT", False)
    monkeypatch.setattr(build, "write_task", write_name)
    return folder


def write_name(task: str, folder: Path, _: Any = None) -> str:
    file = folder / f"{task}.wasm"
    there = file.exists()
    for each in (file, file.with_suffix(".json")):
        each.write_text(task)
    return f"{task} kept" if there else f"{task} compiled"


def names(folder: Path) -> set[str]:
    return {each.name for each in folder.iterdir()}


def prepare_all() -> PackageModules:
    found = PackageModules()
    for task in ALL:
        found.prepare(f"{task}.json")
    return found


def test_the_package_gets_a_module_once_when_it_is_asked_for(package, capsys):
    modules = PackageModules()
    assert modules.folder == package
    assert names(package) == {SITE}
    for name in ("sort.json", "sort.wasm", "playground.js", "table.js", SITE, "sort.bin"):
        modules.prepare(name)
    assert names(package) == {"sort.wasm", "sort.json", SITE}
    assert capsys.readouterr().out.splitlines()[1:] == ["sort compiled"]
    PackageModules().prepare("sort.wasm")
    assert capsys.readouterr().out == ""


@pytest.mark.usefixtures("package")
def test_browsers_that_ask_at_once_wait_for_one_another(monkeypatch, capsys):
    def write_slowly(task: str, folder: Path, _: Any) -> str:
        time.sleep(0.05)
        return write_name(task, folder)

    monkeypatch.setattr(build, "write_task", write_slowly)
    modules = PackageModules()
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(modules.prepare, ["sort.json", "sort.bin", "sort.wasm", "sort.starts"]))
    assert capsys.readouterr().out.count("sort compiled") == 1


def test_modules_of_another_version_are_written_again(package, capsys):
    prepare_all()
    for name in AGENTS:
        (package / name).write_text("of before")
    site = json.loads((package / SITE).read_text())
    assert site == {"version": __version__, "tasks": list(TASKS), "agents": False}
    for text in (json.dumps({**site, "version": "0.0.1"}), "[]", "cut sho"):
        (package / SITE).write_text(text)
        capsys.readouterr()
        prepare_all()
        assert "table kept" in capsys.readouterr().out
        assert json.loads((package / SITE).read_text()) == site
    assert not (package / AGENTS[-1]).exists()


def test_agents_that_were_written_before_a_module_are_written_again(package, monkeypatch):
    monkeypatch.setattr(build, "write_task", lambda task, _: task)
    main([])
    module, agents = package / "sort.wasm", package / AGENTS[-1]
    for name, age in ((module, 10.0), (agents, 0.0)):
        name.write_text("compiled")
        os.utime(name, (1e9 - age, 1e9 - age))
    main([])
    assert agents.exists()
    os.utime(module, (1e9 + 10.0, 1e9 + 10.0))
    main([])
    assert not agents.exists()


@pytest.mark.usefixtures("package")
def test_a_checkout_looks_whether_its_source_was_edited(monkeypatch, capsys):
    monkeypatch.setattr(build, "IN_CHECKOUT", True)
    prepare_all()
    capsys.readouterr()
    prepare_all()
    assert "sequence kept" in capsys.readouterr().out


def test_where_the_package_cannot_be_written_the_home_folder_is(package, monkeypatch, tmp_path):
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    assert PackageModules().folder.is_relative_to(tmp_path / ".cache")
    assert not package.exists()


def test_a_folder_gets_pages_and_what_the_package_has(package, tmp_path, capsys):
    prepare_all()
    agents = {*AGENTS, "agent-time-slots.wasm"}
    for name in agents:
        (package / name).write_text("agents")
    capsys.readouterr()
    folder = tmp_path / "deep" / "site"
    main([str(folder), "--tasks", "sort", "flow"])
    assert capsys.readouterr().out.splitlines() == [
        "1/4  table kept", "2/4  noise kept", "3/4  sort kept", "4/4  flow kept",
    ]  # fmt: skip
    written = ("table", "noise", "sort", "flow")
    files = {f"{task}.{kind}" for task in written for kind in ("wasm", "json")}
    assert names(folder) == names(PAGE) | files | {SITE, *agents}
    site = json.loads((folder / SITE).read_text())
    assert site == {"version": __version__, "tasks": ["sort", "flow"], "agents": True}


def test_without_a_folder_the_package_gets_modules_and_no_pages(package):
    main(["--tasks", "sort"])
    written = ("table", "noise", "sort")
    files = {f"{task}.{kind}" for task in written for kind in ("wasm", "json")}
    assert names(package) == files | {SITE}


def test_every_kind_of_driven_modules_is_on_offer():
    driven = [
        f"-{name}"
        for name, kind in MODULES.items()
        if kind.drives and type(kind).__module__ == "surface_gym.modules"  # not of an example
    ]
    assert list(build.DRIVEN) == driven
    assert build.make_config("sort", "omni").modules == "omni"
    assert not build.make_config("sort").module_kind.drives


def test_an_unknown_task_is_refused(package, capsys):
    with pytest.raises(SystemExit):
        main(["--tasks", "juggle"])
    assert "invalid choice: 'juggle'" in capsys.readouterr().err
    assert not package.exists()
