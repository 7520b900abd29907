"""Replays on the site: recorded by `python docs/replays.py`, shown by a Markdown extension.

A recording lies in docs/replays. A paragraph `[replay: NAME]` becomes its page when the site is
built; names joined by `, ` are shown side by side.
"""

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from markdown import Extension, Markdown
from markdown.postprocessors import Postprocessor

from surface_gym import Recording, RecordReplay, replay
from surface_gym.config import EnvConfig

FOLDER = Path(__file__).parent / "replays"
ASKED = re.compile(r"<p>\[replay: ([\w ,-]+)\]</p>")
RATE = 13_000.0  # [parcels/h] offered to both lines of a stream
SECONDS = 20.0  # of a stream, at most


class _ToReplays(Postprocessor):
    def run(self, text: str) -> str:
        return ASKED.sub(_shown, text)


class Replays(Extension):
    """Put replays where a page asks for them."""

    def extendMarkdown(self, md: Markdown) -> None:
        """Replace after all else is HTML."""
        md.postprocessors.register(_ToReplays(md), "replays", 0)


def makeExtension(**kwargs: Any) -> Replays:
    """Make the extension, by the name that Python-Markdown looks for."""
    return Replays(**kwargs)


def _shown(asked: re.Match[str]) -> str:
    files = [FOLDER / f"{name}.replay" for name in asked[1].split(", ")]
    found = [Recording.load(file) for file in files]
    return replay(**{each.title: each for each in found})._repr_html_()


def record_method(task: str, name: str) -> Recording:
    """Record the start that films of a task show, under a rule or an agent that ships."""
    from surface_gym.agents.evaluation.method import rules, shipped
    from surface_gym.agents.evaluation.report import start_player

    method = next(each for each in (*rules(task), *shipped(task)) if each.name == name)
    return _record(start_player(method, np.random.default_rng(0)))


def record_stream(name: str) -> Recording:
    """Record a stream under a method of the comparison."""
    from surface_gym.agents.evaluation.method import all_methods
    from surface_gym.agents.evaluation.report import filmed_scenario, stream_player

    method = next(each for each in all_methods("flow") if each.name == name)
    return _record(stream_player(method, filmed_scenario("flow"), RATE))


def record_agent(task: str, name: str) -> Recording:
    """Record an agent of streams on its own environment."""
    from surface_gym import agents
    from surface_gym.agents.evaluation.pictures import Player

    policy = agents.load(name)
    config = EnvConfig(task, **policy.env_kwargs)
    return _record(Player(name, policy, config, np.random.default_rng(1)))


def _record(player: Any) -> Recording:
    from surface_gym.agents.evaluation.pictures import make_env, play

    env = RecordReplay(make_env(player.config))
    for _, info in play(player, every=sys.maxsize, env=env):
        if info["time"] >= SECONDS:
            break
    return replace(env.recording, title=player.name)


RECORDINGS: dict[str, Callable[[], Recording]] = {
    "sort-fixed": partial(record_method, "sort", "fixed layout"),
    "sort-agent": partial(record_method, "sort", "PPO"),
    "flow-zone": partial(record_stream, "zone, arranged anew"),
    "flow-modules": partial(record_stream, "modules"),
    "merge": partial(record_agent, "merge", "merge-local"),
}


if __name__ == "__main__":
    for name in sys.argv[1:] or RECORDINGS:
        RECORDINGS[name]().save(FOLDER / f"{name}.replay")
