"""Replays: what makes one, what is refused, and what the page holds."""

import re
from importlib.resources import files

import gymnasium as gym
import numpy as np
import pytest

import surface_gym as sg
from surface_gym.player import SCRIPTS, Replay, replay
from tests.test_recording import BOX, recording


def test_a_trajectory_is_saved_as_a_page(tmp_path):
    run = sg.simulate(sg.layouts.sorting(), BOX, (0.125, 1.0, 0.0), (1.5, 0.0, 0.0))
    run.save_html(tmp_path / "run.html")
    assert (tmp_path / "run.html").read_text() == replay(run).html()


def test_an_environment_is_replayed_through_its_wrappers():
    env = gym.wrappers.TimeLimit(
        sg.RecordReplay(gym.make("SmartSurface/Sort-v0", actions="halves")), 3
    )
    env.reset(seed=0)
    env.step(0)
    assert len(replay(env).recordings["Sort"]) == 2


def test_runs_of_the_same_title_get_names_of_their_own():
    made = sg.replay(recording(), recording(), other=recording())
    assert list(made.recordings) == ["Test", "Test 2", "other"]


def test_the_page_asks_no_other_host_and_names_cannot_break_it():
    text = replay(**{'</script><b a="': recording()}).html()
    assert not re.search(r"(src|href)=\"(?!data:)", text)
    assert "<b a=" not in text
    assert text.count("default-src 'none'") == 1
    assert not re.search(r"^(import|export) ", text, re.MULTILINE)
    assert all(name in text for name in ("class Picture", "class Recording", "class Player"))


def test_each_script_comes_after_those_that_it_needs():
    page = files("surface_gym.web") / "page"
    before, names = set(), []
    for script in SCRIPTS:
        text = (page / script).read_text("utf-8")
        assert set(re.findall(r'^import .* from "\./(.+)";$', text, re.MULTILINE)) <= before
        before.add(script)
        declared = r"^(?:export )?(?:async )?(?:const|let|class|function) (\w+)"
        names += re.findall(declared, text, re.MULTILINE)
    assert len(names) == len(set(names))


def test_a_minute_of_a_stream_of_24_parcels_is_small():
    rng = np.random.default_rng(0)
    count = 1501
    time = 0.04 * np.arange(count)
    parcels = tuple(
        sg.recording.RecordedParcel(
            BOX.base.outline,
            0,
            np.column_stack([0.05 * time, 0.1 * np.sin(time + k), 0.1 * np.cos(time)])
            + 1e-3 * rng.standard_normal((count, 3)),  # [m] as if each was pushed all the time
            0.01 * rng.standard_normal((count, 3)),
        )
        for k in range(24)
    )
    axis = np.repeat(rng.integers(2, size=(count // 4 + 1, 12, 60), dtype=np.uint8), 4, axis=0)
    # Each stands on ten modules, and slides on some of them; each frame, two push each other.
    element = rng.integers(720, size=(1, 24, 1)) + np.arange(10)
    element = np.minimum(element + np.arange(count)[:, None, None] // 10, 719)
    load = 9.81 + 2.0 * np.sin(time)[:, None, None] + 0.1 * rng.standard_normal(element.shape)
    slides = rng.random((1, 24, 10)) < 0.3
    contacts = np.stack([element, load, 0.36 * load * slides, 0.01 * load], axis=-1)
    pushes = np.zeros((count, 6))
    pushes[:, 1] = 1.0
    pushes[:, 2:] = rng.standard_normal((count, 4))
    found = recording(
        frames=count,
        first_contact=240 * np.arange(count + 1),
        contacts=contacts.reshape(-1, 4),
        bearer=np.tile(np.repeat(np.arange(24), 10), count),
        first_push=np.arange(count + 1),
        pushes=pushes,
        rotor=np.ones((12, 60), dtype=bool),
        axis=axis[:count],
        parcels=parcels,
        time=time,
    )
    assert len(replay(found).html()) < 2_000_000


def test_other_things_are_refused_by_name(tmp_path):
    env = gym.make("SmartSurface/Sort-v0")
    with pytest.raises(ValueError, match=r"runs\[1\] must be a Recording, .*RecordReplay"):
        replay(recording(), env)
    with pytest.raises(ValueError, match=r"mine must be a Recording"):
        replay(mine=3)
    with pytest.raises(ValueError, match="runs must be 1 to 8, got 0"):
        replay()
    with pytest.raises(ValueError, match=r"path must end in \.html"):
        Replay({"a": recording()}).save(tmp_path / "run.htm")
