"""Playing: what keys and mouse do, without a screen."""

import json
import os
import re
import signal
import subprocess
import sys
import urllib.request
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pygame
import pytest

import surface_gym as sg
from surface_gym import play
from surface_gym.flow.state import JAM
from surface_gym.game import (
    FASTEST,
    FIRST_RATE,
    KEY_SIZE,
    RATE_STEP,
    SLOWEST,
    Game,
    StreamGame,
    TaskGame,
)
from surface_gym.registration import PERIODS
from surface_gym.rendering import ink
from surface_gym.state import RUNNING
from surface_gym.web.build import TASKS
from surface_gym.web.scene import unpack
from surface_gym.web.server import Server

MIDDLE = (480, 355)  # [px] about the line's middle, of one parcel
RIGHT_TURN, ROLL = 1, 3  # choices: 45 and 90 deg


def press(game: Game, key: int, held: int = 0) -> None:
    game.take(pygame.event.Event(pygame.KEYDOWN, key=key, mod=held))


def move(game: Game, to: tuple[int, int], pressed: bool) -> None:
    buttons = (int(pressed), 0, 0)
    game.take(pygame.event.Event(pygame.MOUSEMOTION, pos=to, rel=(0, 0), buttons=buttons))


def drag(game: Game, down: tuple[int, int], up: tuple[int, int], button: int = 1) -> None:
    game.take(pygame.event.Event(pygame.MOUSEBUTTONDOWN, pos=down, button=button))
    if up != down:
        move(game, up, pressed=True)
    game.take(pygame.event.Event(pygame.MOUSEBUTTONUP, pos=up, button=button))


def test_letters_of_other_games_do_nothing():
    alone, stream = TaskGame("sort"), StreamGame()
    for game, key in ((alone, pygame.K_PLUS), (stream, pygame.K_TAB)):
        before = game.draw()
        press(game, key)
        assert (game.draw() == before).all()


class TestOneParcel:
    @pytest.fixture
    def game(self) -> TaskGame:
        return TaskGame("sort")

    @staticmethod
    def truth(game: TaskGame) -> np.ndarray:
        return game._batch.parcels.truth[0].copy()

    def test_a_drag_sets_place_and_speed(self, game):
        drag(game, MIDDLE, (MIDDLE[0] + 30, MIDDLE[1] - 30))  # an element is 30 px, y upwards
        x, y, _, vx, vy, omega = self.truth(game)
        assert (x, y) == pytest.approx((1.5, 1.0), abs=0.06)
        assert (vx, vy, omega) == pytest.approx((0.2, 0.2, 0.0))

    @pytest.mark.parametrize("y", [0.4, 1.28, 1.6])
    def test_a_parcel_dropped_beside_the_line_is_no_success(self, game, y):
        game._move_start((2.0, y), (2.0, y))
        game.advance()
        assert game._scene().readings[-1] == ("no start", "off the line")
        assert "end" not in dict(game._scene().readings)

    def test_one_that_leaves_the_line_has_an_end(self, game):
        game._move_start((1.0, 1.0), (1.0, 2.0))
        while game._batch.parcels.outcome[0] == RUNNING:
            game.advance()
        assert dict(game._scene().readings)["end"] == "success"

    def test_it_waits_while_the_mouse_is_pressed(self, game):
        game.take(pygame.event.Event(pygame.MOUSEBUTTONDOWN, pos=MIDDLE, button=1))
        start = self.truth(game)
        game.advance()
        assert (self.truth(game) == start).all()

    def test_keys_turn_the_axes_of_the_zone(self, game):
        drag(game, MIDDLE, (MIDDLE[0] + 30, MIDDLE[1]))
        zone = game._batch.view(0).obeys
        press(game, pygame.K_2)
        game.advance()
        assert game._batch.axes(0)[zone] == pytest.approx(np.pi / 4)
        press(game, pygame.K_1, pygame.KMOD_SHIFT)  # ahead of the parcel's centre alone
        game.advance()
        axes = game._batch.axes(0)
        x = 0.05 + 0.1 * np.arange(axes.shape[1])
        centre = self.truth(game)[0]
        assert axes[zone & (x >= centre)] == pytest.approx(0.0)
        assert axes[zone & (x < centre)] == pytest.approx(np.pi / 4)

    def test_space_pauses_and_r_starts_again(self, game):
        start = self.truth(game)
        game.advance()
        moved = self.truth(game)
        assert len(game._scene().parcels[0].trail) == 2
        press(game, pygame.K_SPACE)
        game.advance()
        assert (self.truth(game) == moved).all()
        press(game, pygame.K_r)
        assert (self.truth(game) == start).all()
        assert len(game._scene().parcels[0].trail) == 1

    def test_tab_turns_the_start_and_letters_choose_the_parcel(self, game):
        press(game, pygame.K_b)
        press(game, pygame.K_TAB)
        assert self.truth(game)[2] == pytest.approx(np.radians(15.0))
        assert np.abs(game._batch.view(0).corners).max() == pytest.approx(0.225)


class TestStream:
    @pytest.fixture
    def game(self) -> StreamGame:
        return StreamGame()

    @staticmethod
    def pixel(x: float, y: float) -> tuple[int, int]:
        """[px] of (x, y) [m]: an element is 16 px, the line's middle 227 px down."""
        return round(96 + 160 * x), round(227 - 160 * (y - 1.0))

    def touch(self, game: StreamGame, x: float, y: float = 1.0, button: int = 1) -> None:
        drag(game, self.pixel(x, y), self.pixel(x, y), button)

    @staticmethod
    def turned(game: StreamGame) -> np.ndarray:
        """(modules, 2) [m] centres of those that are not at 90 deg, as the scene shows them."""
        rows, columns = np.nonzero(~np.isclose(game._scene().axis, np.pi / 2))
        return np.stack([0.05 + 0.1 * columns, 0.05 + 0.1 * rows], axis=-1)

    @pytest.mark.parametrize("task", [name for name, limit in PERIODS.items() if limit is None])
    def test_every_task_of_streams_is_played(self, task):
        game = StreamGame(task)
        for _ in range(50):
            game.advance()
        assert game._scene().title == task.capitalize()
        assert game._scene().parcels
        press(game, pygame.K_PLUS)
        assert str(FIRST_RATE + RATE_STEP) in dict(game._scene().readings).values()

    def test_the_mouse_turns_the_modules_around_it(self, game):
        press(game, pygame.K_2)
        self.touch(game, 2.0)
        centres = self.turned(game)
        assert np.hypot(*(centres - (2.0, 1.0)).T).max() < 0.21
        assert len(centres) == 12  # a disc of 0.2 m
        np.testing.assert_allclose(game._scene().axis[8:12, 19:21], np.pi / 4)
        game.advance()
        np.testing.assert_allclose(game._renderer.scene().axis, game._scene().axis)  # they turned

    def test_drawn_over_the_line_it_turns_all_on_its_way_and_elsewhere_nothing(self, game):
        for touched in ((2.0, 1.0, 3), (2.0, 1.5), (0.2,)):  # the last: the lead-in
            self.touch(game, *touched)
        assert len(self.turned(game)) == 0
        drag(game, self.pixel(2.0, 1.0), self.pixel(3.0, 1.0))
        assert self.turned(game)[:, 0].max() == pytest.approx(3.15)
        move(game, self.pixel(4.0, 1.0), pressed=False)
        assert self.turned(game)[:, 0].max() == pytest.approx(3.15)

    def test_shift_turns_all(self, game):
        press(game, pygame.K_1)
        assert (game._choice == ROLL).all()
        press(game, pygame.K_2, pygame.KMOD_LSHIFT)
        assert (game._choice == RIGHT_TURN).all()
        scene = game._scene()
        np.testing.assert_allclose(scene.axis[scene.obeys], np.pi / 4)

    def test_a_parcel_is_led_to_a_chute(self, game):
        press(game, pygame.K_3, pygame.KMOD_LSHIFT)  # all to the left
        while game._batch.streams.tally[0, 1:3].sum() == 0:
            game.advance()
        assert game._batch.streams.taken[0, 0] == game._config.exits.place("left 1")

    def test_the_rate_follows_plus_and_minus(self, game):
        streams = game._batch.streams
        for _ in range(150):  # 6 s
            game.advance()
        assert streams.due[0] == 1 + int(6.0 * FIRST_RATE / 3600.0)
        press(game, pygame.K_PLUS)
        due, clock = int(streams.due[0]), float(streams.clock[0])
        time = streams.time[0, due:]
        gap = 3600.0 / (FIRST_RATE + RATE_STEP)
        assert clock <= time[0] <= clock + gap
        np.testing.assert_allclose(np.diff(time), gap)
        for key, rate in ((pygame.K_KP_PLUS, FASTEST), (pygame.K_MINUS, SLOWEST)):
            for _ in range(40):
                press(game, key)
            assert dict(game._scene().readings)["coming an hour"] == str(rate)
            np.testing.assert_allclose(np.diff(streams.time[0, due:]), 3600.0 / rate)

    def test_space_pauses_and_one_may_draw_meanwhile(self, game):
        press(game, pygame.K_SPACE)
        clock = game._batch.streams.clock[0]
        game.advance()
        assert game._batch.streams.clock[0] == clock
        before = game.draw()
        self.touch(game, 2.0)
        assert (game.draw() != before).any()

    def test_r_starts_again_with_other_parcels_and_the_same_axes(self, game):
        game.advance()
        self.touch(game, 2.0)
        streams = game._batch.streams
        choice, exits = game._choice.copy(), streams.exit[0].copy()
        press(game, pygame.K_r)
        assert streams.clock[0] == 0.0
        assert (streams.exit[0] != exits).any()
        assert (game._choice == choice).all()
        np.testing.assert_allclose(np.diff(streams.time[0, 1:]), 3600.0 / FIRST_RATE)

    def test_a_jam_stays_until_r(self, game):
        game._batch.streams.outcome[0] = JAM
        game.advance()
        assert dict(game._scene().readings)["end"] == "jam"
        assert game._batch.streams.clock[0] == 0.0
        press(game, pygame.K_r)
        game.advance()
        assert game._batch.streams.clock[0] > 0.0


@pytest.mark.parametrize("make", [lambda: TaskGame("sort"), StreamGame], ids=["parcel", "stream"])
def test_the_keys_stand_on_the_screen(make):
    game = make()
    surface, picture = game._painter.draw(game._scene()), game.draw()
    assert (picture[: len(surface)] == surface).all()  # so the mouse finds the same places
    keys = picture[len(surface) :]
    lines = [keys[26 * k : 26 * (k + 1)] for k in range(len(game.keys))]
    assert all((line[:, 24:] != keys[0, 0]).any() for line in lines)
    assert all(ink.text_width(line, KEY_SIZE) <= keys.shape[1] - 48 for line in game.keys)
    assert "Esc" in game.keys[-1]


@pytest.mark.parametrize("driver", ["offscreen", "dummy", "no such driver"])
def test_without_a_display_it_ends_with_one_line(driver):
    program = "import sys; from surface_gym.cli import main; main(['play', '--window'])"
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        env={**os.environ, "SDL_VIDEODRIVER": driver},
        timeout=120,
    )
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr == (
        "error: play --window needs a display to open its window on, got "
        f"SDL_VIDEODRIVER={driver}\n"
    )


def test_a_display_that_sdl_replaces_unasked_is_none(monkeypatch):
    """Where DISPLAY is not set, or names no server, SDL draws where nobody sees it."""
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)
    given = SimpleNamespace(returncode=0, stdout="pygame-ce 2.5\noffscreen\n")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: given)
    with pytest.raises(
        SystemExit, match=r"^error: play --window needs a display .*, got no DISPLAY$"
    ):
        play.main(["--window"])
    given.stdout = "x11\n"
    play.check_display()


def test_a_display_that_does_not_answer_is_given_up(monkeypatch):
    monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(play, "PROBE", "import time; time.sleep(60)")
    monkeypatch.setattr(play, "ANSWER", 0.2)
    monkeypatch.setenv("DISPLAY", "localhost:7")
    with pytest.raises(
        RuntimeError, match=r"DISPLAY=localhost:7, which does not answer within 0.2"
    ):
        play.check_display()


@pytest.mark.usefixtures("screen")
@pytest.mark.parametrize("arguments", [[], ["--task", "flow"]], ids=["one parcel", "stream"])
def test_escape_ends(arguments, monkeypatch):
    monkeypatch.setattr(play, "check_display", lambda: None)
    escape = pygame.event.Event(pygame.KEYDOWN, key=pygame.K_ESCAPE, mod=0)
    monkeypatch.setattr(pygame.event, "get", lambda *_: [escape] if not _ else [])
    play.main(["--window", *arguments])


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
            (["--task", "examples/reach.py:Nothing"], "task must be a class of .*, got 'Nothing'"),
            (
                ["--window", "--task", "examples/reach.py:Reach"],
                "task must be .*, got 'examples/.*",
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

    def test_a_run_joins_the_package_s_agents_when_these_have_been_written(
        self, opened, monkeypatch, tmp_path
    ):
        written: list[str] = []
        agents = tmp_path / "agents.json"

        def write_run(run: Path, *_: object) -> tuple[str, str]:
            written.append(f"{run} {agents.is_file()}")
            return "merge", "mine"

        def serve(server: Server) -> None:
            server.find("/site.json")
            assert written == ["runs/mine False"]
            agents.write_text("{}")
            for name in ("agents.json", "site.json", "site.json"):
                server.find(f"/{name}")

        agents.unlink()
        monkeypatch.setattr("surface_gym.agents.export.web.write_run", write_run)
        monkeypatch.setattr("surface_gym.web.server.Server.serve_forever", serve)
        monkeypatch.setattr(play, "writing_agents", lambda _: nullcontext())
        play.main(["--port", "0", "--run", "runs/mine"])
        assert written == ["runs/mine False", "runs/mine True"]
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
    """Write what says that a folder has modules and agents of this version."""
    site = {"version": sg.__version__, "tasks": list(TASKS), "agents": True}
    (folder / "site.json").write_text(json.dumps(site))
    (folder / "agents.json").write_text("{}")


def interrupt(_: Server) -> None:
    raise KeyboardInterrupt


def write_class(name: str, folder: Path, own: object = None) -> str:
    (folder / f"{name}.json").write_text(name if own is None else type(own).__name__)
    return name


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C reaches a whole group there")
def test_ctrl_c_ends_the_server(tmp_path):
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
    running.send_signal(signal.SIGINT)
    assert running.communicate(timeout=60) == ("", "")
    assert running.returncode == 0
