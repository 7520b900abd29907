"""Videos, read back."""

import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
import pytest
from gymnasium.utils.seeding import np_random
from moviepy.config import FFMPEG_BINARY

from surface_gym.agents.evaluation.capacity import Case
from surface_gym.agents.evaluation.report import stream_player
from surface_gym.agents.evaluation.streams import ARRANGED, CURVE, EVENT
from surface_gym.agents.evaluation.video import Player, main, write_comparison, write_episode
from surface_gym.agents.rules.streams import StreamEventRule
from surface_gym.config import EnvConfig
from surface_gym.env import SmartSurfaceEnv
from tests.agents.evaluation.made import RULES
from tests.flow.flows import DENSE, SHORT

GIVEN: dict[str, Any] = {
    "stream": DENSE, "exits": "sides", "actions": "parcels", "duration": 2.0, "line": SHORT,
}  # fmt: skip
CONFIG = EnvConfig("flow", **GIVEN)


def read(file: Path) -> tuple[float, list[np.ndarray]]:
    """[1/s] pictures of a film, and the pictures."""
    asked = [FFMPEG_BINARY, "-i", str(file), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    found = subprocess.run(asked, capture_output=True, check=True)
    described = re.search(rb"Video: .* (\d+)x(\d+).* ([\d.]+) fps", found.stderr)
    width, height = int(described[1]), int(described[2])
    pictures = np.frombuffer(found.stdout, dtype=np.uint8).reshape(-1, height, width, 3)
    return float(described[3]), list(pictures.astype(float))


def film(file: Path, seconds: float, speed: float = 1.0) -> tuple[float, list[np.ndarray]]:
    player = Player("event", StreamEventRule(CONFIG), CONFIG, np_random(3)[0])
    write_episode(player, file, seconds, speed)
    return read(file)


def test_it_shows_what_the_environment_draws(tmp_path) -> None:
    rate, pictures = film(tmp_path / "flow.mp4", 0.4)
    assert rate == 25.0
    assert len(pictures) == 1 + 10 + 25  # the start, the control periods, and the last one stays
    env = SmartSurfaceEnv("flow", render_mode="rgb_array", **GIVEN)
    rule = StreamEventRule(CONFIG)
    observation, _ = env.reset(seed=3)
    for picture in pictures[:11]:
        drawn = env.render()
        assert drawn is not None
        assert np.abs(picture - drawn).mean() < 4.0  # of 255: the codec loses a little
        observation = env.step(rule.predict(observation)[0])[0]
    assert np.abs(pictures[-1] - pictures[10]).mean() < 1.0


@pytest.mark.parametrize(
    ("seconds", "speed", "rate", "count"),
    [
        (0.4, 2.0, 25.0, 1 + 5 + 25),
        (0.4, 1.5, 18.75, 1 + 5 + 19),
        (0.4, 0.5, 12.5, 1 + 10 + 12),
        (2.0, 1.0, 25.0, 1 + 50 + 25),  # to the end of the episode
    ],
)
def test_it_is_as_fast_as_asked_for(tmp_path, seconds, speed, rate, count) -> None:
    found, pictures = film(tmp_path / "flow.mp4", seconds, speed)
    assert found == pytest.approx(rate)
    assert len(pictures) == count


@pytest.mark.parametrize(
    ("file", "seconds", "speed", "named"),
    [
        ("flow.mp4", 0.0, 1.0, "seconds must be .*, got 0.0"),
        ("flow.mp4", 2.1, 1.0, "seconds must be .*, got 2.1"),
        ("flow.mp4", 1.0, 0.0, "speed must be greater than 0, got 0.0"),
        ("nowhere/flow.mp4", 1.0, 1.0, "file must be in a folder that there is"),
    ],
)
def test_what_cannot_be_shown_is_refused(tmp_path, file, seconds, speed, named) -> None:
    with pytest.raises(ValueError, match=named):
        film(tmp_path / file, seconds, speed)


def test_a_slower_decider_is_filmed_no_faster(tmp_path) -> None:
    rule = next(method for method in RULES if method.name == EVENT)
    both = [rule, replace(rule, control_period=0.08)]
    players = [stream_player(method, CURVE, 3000.0) for method in both]
    write_comparison(players, tmp_path / "both.mp4", 0.4)
    with imageio.get_reader(tmp_path / "both.mp4") as video:
        assert video.count_frames() == 10 + 25
        last = video.get_data(9)
    half = last.shape[0] // 2
    # Both show 0.36 s, the second to a period of its own: hardly a pixel differs.
    assert np.abs(last[:half].astype(float) - last[-half:]).mean() < 8.0


def test_a_method_that_cannot_sort_cannot_be_filmed(monkeypatch) -> None:
    monkeypatch.setattr("surface_gym.agents.evaluation.streams.find_best_zone", lambda *_: None)
    zone = next(method for method in RULES if method.name == ARRANGED)
    with pytest.raises(ValueError, match=r"method must be able to sort S, 1\.5 m/s"):
        stream_player(zone, Case("S", 1.5), 3000.0)


def test_the_command_films_a_stream(tmp_path, capsys) -> None:
    """An error is one line, and an unknown controller is refused."""
    file = str(tmp_path / "flow.mp4")
    main([file, "--seconds", "0.2", "--exits", "chutes", "--rate", "3000"])
    rate, pictures = read(Path(file))
    assert (rate, len(pictures)) == (25.0, 1 + 5 + 25)
    with pytest.raises(SystemExit, match="error: file must be in a folder that there is"):
        main([str(tmp_path / "nowhere" / "flow.mp4"), "--seconds", "0.2"])
    with pytest.raises(SystemExit):
        main([file, "--controller", "nobody"])
    assert "controller must be one of" in " ".join(capsys.readouterr().err.split())
