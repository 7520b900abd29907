"""Episodes to be filmed: who acts, from which starts, and what is seen of it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from surface_gym import agents
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.stream import Stream
from surface_gym.rendering import with_caption

from .encoding import Picture

SLIDING = "sliding mode"  # the rule that tracks, by the modules around the parcel
LAST = 12  # pictures for which an episode's end stays before the next begins
BAR = 8  # [px] between two flows, one above the other


@dataclass(frozen=True)
class Scene:
    """Episodes of one environment, one after the other."""

    env_id: str  # as Gymnasium has it
    controller: str  # an agent of `agents.names()`, or SLIDING
    starts: tuple[dict[str, Any], ...]  # `options` of each episode's reset
    every: int = 1  # control periods from picture to picture

    def pictures(self) -> list[Picture]:
        """All of them, each episode's end for some time."""
        env, controller = self._acting()
        shown: list[Picture] = []
        for start in self.starts:
            episode = list(_episode(env, controller, start))
            shown += [*episode[: -1 : self.every], *[episode[-1]] * (LAST // self.every)]
        env.close()
        return shown

    def _acting(self) -> tuple[gym.Env[Any, Any], Any]:
        if self.controller != SLIDING:
            policy = agents.load(self.controller)
            return gym.make(self.env_id, render_mode="rgb_array", **policy.env_kwargs), policy
        from agents.rules.sliding_mode import SlidingMode

        env = gym.make(self.env_id, render_mode="rgb_array", actions="window")
        bare: Any = env.unwrapped
        return env, SlidingMode(bare.settings)


def _episode(env: gym.Env[Any, Any], controller: Any, options: dict[str, Any]) -> Iterator[Picture]:
    observation, _ = env.reset(seed=0, options=options)
    yield _picture(env)
    state, begun, over = None, np.ones(1, dtype=np.bool_), False
    while not over:
        action, state = controller.predict(observation[np.newaxis], state, begun)
        observation, _, terminated, truncated, _ = env.step(action[0])
        yield _picture(env)
        begun, over = np.zeros(1, dtype=np.bool_), terminated or truncated


def _picture(env: gym.Env[Any, Any]) -> Picture:
    picture: Any = env.render()
    return np.asarray(picture, dtype=np.uint8)


def flow_by_chutes() -> list[Picture]:
    """Two chutes a side: a reservation leads a stream of S- and B-boxes for some seconds."""
    from agents.flow.reservation import Reservation

    stream = Stream(Steady(7000.0), ("S", "B"), speeds=1.5)
    env = gym.make(
        "SmartSurface/Flow-v0",
        render_mode="rgb_array",
        stream=stream,
        actions="parcels",
        gate=True,
        duration=12.0,
    )
    bare: Any = env.unwrapped
    reservation, state = Reservation(bare.settings), None
    observation, _ = env.reset(seed=0)
    shown, over, time = [], False, 0.0
    while not over:
        action, state = reservation.predict(observation, state)
        observation, _, terminated, truncated, info = env.step(action)
        over, time = terminated or truncated, info["time"]
        if time > 6.5:
            shown.append(_picture(env))
    env.close()
    return shown[::2]


def zone_and_modules(begin: float = 9.0, end: float = 15.0) -> list[Picture]:
    """One stream twice: under a zone that is arranged as a whole, and under modules that each obey
    the parcel they bear.

    Args:
        begin: [s] of the stream, where the film begins.
        end: [s] where it ends.
    """
    from agents.flow import contenders
    from agents.flow.cases import CURVE
    from agents.flow.showing import pictures_of

    told = {
        contenders.ARRANGED: "One zone, arranged as a whole for each parcel",
        contenders.LEARNED: "Every module obeys the parcel that it bears: flow-ppo",
    }
    named = {each.name: each for each in contenders.contenders()}
    rows = []
    for name, title in told.items():
        contender = named[name]
        period = contender.control_period
        first, last = round(begin / period), round(end / period)
        shown = []
        for place, picture in enumerate(pictures_of(contender, CURVE, rate=8500.0)):
            if first <= place < last and place % round(0.08 / period) == 0:
                shown.append(with_caption(picture, title))
            if place >= last:
                break
        rows.append(shown)
    bar = np.full((BAR, rows[0][0].shape[1], 3), 255, dtype=np.uint8)
    return [np.concatenate([one, bar, other]) for one, other in zip(*rows, strict=True)]
