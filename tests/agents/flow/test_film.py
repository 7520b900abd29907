"""Films of flows, read back."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from moviepy.config import FFMPEG_BINARY

from agents.flow.event import EventRule
from agents.flow.film import main, write_flow_film
from surface_gym.flow.env import FlowEnv
from surface_gym.flow.settings import FlowSettings
from tests.flow.flows import DENSE, SHORT

SETTINGS = FlowSettings(DENSE, exits="sides", actions="parcels", duration=2.0, plant=SHORT)


def read(file: Path) -> tuple[float, list[np.ndarray]]:
    """[1/s] pictures of a film, and the pictures."""
    asked = [FFMPEG_BINARY, "-i", str(file), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    found = subprocess.run(asked, capture_output=True, check=True)
    told = re.search(rb"Video: .* (\d+)x(\d+).* ([\d.]+) fps", found.stderr)
    assert told is not None
    width, height = int(told[1]), int(told[2])
    pictures = np.frombuffer(found.stdout, dtype=np.uint8).reshape(-1, height, width, 3)
    return float(told[3]), list(pictures.astype(float))


def film(file: Path, seconds: float, speed: float = 1.0) -> tuple[float, list[np.ndarray]]:
    write_flow_film(EventRule(SETTINGS), SETTINGS, 3, file, seconds, speed)
    return read(file)


def test_it_shows_what_the_environment_draws(tmp_path: Path) -> None:
    rate, pictures = film(tmp_path / "flow.mp4", 0.4)
    assert rate == 25.0
    assert len(pictures) == 1 + 10 + 25  # the start, the control periods, and the last one stays
    env = FlowEnv(
        DENSE, exits="sides", actions="parcels", duration=2.0, plant=SHORT, render_mode="rgb_array"
    )
    rule = EventRule(SETTINGS)
    observation, _ = env.reset(seed=3)
    for picture in pictures[:11]:
        drawn = env.render()
        assert drawn is not None
        assert np.abs(picture - drawn).mean() < 4.0  # of 255: the codec loses a little
        observation = env.step(rule.predict(observation)[0])[0]
    assert np.abs(pictures[-1] - pictures[10]).mean() < 1.0


@pytest.mark.parametrize(
    ("speed", "rate", "count"),
    [(2.0, 25.0, 1 + 5 + 25), (1.5, 18.75, 1 + 5 + 19), (0.5, 12.5, 1 + 10 + 12)],
)
def test_it_is_as_fast_as_asked_for(tmp_path: Path, speed: float, rate: float, count: int) -> None:
    found, pictures = film(tmp_path / "flow.mp4", 0.4, speed)
    assert found == pytest.approx(rate)
    assert len(pictures) == count


def test_it_ends_with_the_episode(tmp_path: Path) -> None:
    _, pictures = film(tmp_path / "flow.mp4", 2.0)
    assert len(pictures) == 1 + 50 + 25


@pytest.mark.parametrize("seconds", [0.0, 2.1])
def test_more_than_the_episode_cannot_be_shown(tmp_path: Path, seconds: float) -> None:
    with pytest.raises(ValueError, match=f"seconds must be .*, got {seconds}"):
        film(tmp_path / "flow.mp4", seconds)


def test_a_film_cannot_stand_still(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"speed must be greater than 0, got 0\.0"):
        film(tmp_path / "flow.mp4", 1.0, 0.0)


def test_there_must_be_a_folder(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="file must be in a folder that there is"):
        film(tmp_path / "nowhere" / "flow.mp4", 1.0)


class TestCommand:
    def test_it_films_a_stream(self, tmp_path: Path) -> None:
        file = tmp_path / "flow.mp4"
        main([str(file), "--seconds", "0.2", "--exits", "chutes", "--rate", "3000"])
        rate, pictures = read(file)
        assert (rate, len(pictures)) == (25.0, 1 + 5 + 25)

    def test_an_error_is_told(self, tmp_path: Path) -> None:
        with pytest.raises(SystemExit, match="error: file must be in a folder that there is"):
            main([str(tmp_path / "nowhere" / "flow.mp4"), "--seconds", "0.2"])

    def test_an_unknown_controller_is_refused(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        with pytest.raises(SystemExit):
            main([str(tmp_path / "flow.mp4"), "--controller", "nobody"])
        assert "controller must be one of" in " ".join(capsys.readouterr().err.split())
