"""`surface-gym play`: what it serves, and how it ends."""

import json
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

import surface_gym as sg
from surface_gym import play
from surface_gym.web.build import TASKS
from surface_gym.web.scene import unpack
from surface_gym.web.server import Server


class TestInABrowser:
    @pytest.fixture(autouse=True)
    def built(self, tmp_path, monkeypatch):
        """The package's folder of modules, as of this version."""
        fill(tmp_path)
        monkeypatch.setattr("surface_gym.web.build.MODULES", tmp_path)

    @pytest.fixture
    def opened(self, monkeypatch) -> list[str]:
        """Addresses that were opened; the server is interrupted then."""
        asked: list[str] = []
        monkeypatch.setattr("webbrowser.open", asked.append)
        monkeypatch.setattr("surface_gym.web.server.Server.serve_forever", interrupt)
        return asked

    @pytest.mark.parametrize("task", ["table", "sort"])
    def test_it_opens_the_page_with_the_task(self, task, opened, capsys):
        play.main(["--port", "0"] if task == "table" else ["--port", "0", "--task", task])
        (address,) = opened
        page, _, scene = address.partition("#")
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/playground\.html", page)
        assert (json.loads(unpack(scene))["task"] if scene else "table") == task
        assert capsys.readouterr().out == (f"the playground is at {address}\nCtrl-C ends it\n")

    def test_an_own_task_is_compiled_beside_those_there_are(self, opened, monkeypatch):
        served: list[tuple[str, str]] = []

        def serve(server: Server) -> None:
            for name in ("site.json", "table.json", "Reach.json", "Reach-camera.json"):
                file = server.find(f"/{name}")
                assert file is not None
                served.append((name, file.read_text()))

        monkeypatch.setattr("surface_gym.web.server.Server.serve_forever", serve)
        monkeypatch.setattr("surface_gym.web.build.write_task", write_class)
        play.main(["--port", "0", "--task", "examples/reach.py:Reach"])
        assert json.loads(unpack(opened[0].partition("#")[2]))["task"] == "Reach"
        assert json.loads(served[0][1])["tasks"] == [*TASKS, "Reach", "Reach-camera"]
        assert served[1:3] == [("table.json", "table"), ("Reach.json", "Reach")]
        assert served[3] == ("Reach-camera.json", "Reach")  # compiled as it is asked for

    @pytest.mark.parametrize(
        ("arguments", "said"),
        [
            (["--task", "juggle"], "task must be one of sort, .*, got 'juggle'"),
            (
                ["--task", "examples/reach.py:Nothing"],
                "task must be a class that .*, got 'Nothing'",
            ),
        ],
    )
    def test_a_task_that_there_is_not_is_refused(self, arguments, said, opened):
        with pytest.raises(SystemExit, match=f"^error: {said}$"):
            play.main(["--port", "0", *arguments])
        assert opened == []

    def test_it_opens_no_browser_unless_it_may(self, opened):
        play.main(["--port", "0", "--no-browser"])
        assert opened == []

    def test_agents_that_are_missing_are_made_beside_the_server(
        self, opened, monkeypatch, tmp_path, capsys
    ):
        (tmp_path / "agents.json").unlink()
        asked: list[str] = []

        class Writing:
            def __init__(self, command: list[str], **_: object) -> None:
                asked.extend(command[1:])

            def terminate(self) -> None:
                asked.append("terminated")

            def wait(self) -> None: ...

        monkeypatch.setattr(subprocess, "Popen", Writing)
        play.main(["--port", "0"])
        module = "surface_gym.agents.export.web"
        assert asked == ["-m", module, str(tmp_path), "terminated"]
        assert "agents are made meanwhile" in capsys.readouterr().out
        monkeypatch.setattr(play, "find_spec", lambda _: None)
        play.main(["--port", "0"])
        assert "no agents: torch is missing" in capsys.readouterr().out
        assert len(opened) == 2

    def test_the_policy_of_a_run_acts_at_first(self, opened, monkeypatch):
        monkeypatch.setattr("surface_gym.agents.export.web.read_run", lambda *_: None)
        monkeypatch.setattr("surface_gym.agents.export.web.write_run", lambda *_: ("merge", "mine"))
        play.main(["--port", "0", "--run", "runs/mine"])
        scene = json.loads(unpack(opened[0].partition("#")[2]))
        assert (scene["task"], scene["agent"]) == ("merge", "mine")

    def test_a_port_that_is_taken_or_none_is_refused_in_one_line(self, opened):
        with Server([]) as server, pytest.raises(SystemExit) as end:
            play.main(["--port", str(server.server_port)])
        assert re.fullmatch(
            rf"error: port must be one that is free, .*, got {server.server_port} \(.*\)",
            str(end.value.code),
        )
        with pytest.raises(SystemExit, match=r"^error: port must be from 0 to 65535, got 65536$"):
            play.main(["--port", "65536"])
        assert opened == []


def fill(folder: Path) -> None:
    site = {"version": sg.__version__, "tasks": list(TASKS), "agents": True}
    (folder / "site.json").write_text(json.dumps(site))
    (folder / "agents.json").write_text("{}")


def interrupt(_: Server) -> None:
    raise KeyboardInterrupt


def write_class(name: str, folder: Path, own: object = None) -> str:
    (folder / f"{name}.json").write_text(name if own is None else type(own).__name__)
    return name


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C reaches a whole group there")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_a_request_to_end_end_the_server(number, tmp_path):
    program = (
        "import sys; from pathlib import Path; from surface_gym import play; "
        "from surface_gym.web import build; build.MODULES = Path(sys.argv[1]); "
        "play.main(['--port', '0', '--no-browser'])"
    )
    fill(tmp_path)
    running = subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert running.stdout is not None
    address = running.stdout.readline().split()[-1]
    with urllib.request.urlopen(address) as answer:
        assert answer.status == 200
    assert running.stdout.readline() == "Ctrl-C ends it\n"
    running.send_signal(number)
    assert running.communicate(timeout=60) == ("", "")
    assert running.returncode == 0
