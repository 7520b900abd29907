"""The planner: beam search through the simulator, the near-optimum to hold others against."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.settings import Settings

from .planning.aims import AIMS
from .planning.model import Model
from .planning.search import Plan, lanes_needed, make_plan

BUDGET = 64
AGREES = 0.05  # largest difference, in the observation's units, between what was planned and is

Following = tuple[Plan, int]  # a plan, and how many of its actions were given


class Planner:
    """Searches for the best actions of a front and a rear half, and follows what it found.

    It sees what the sensors say, as agents do, and takes it for true: it puts the parcel it sees on
    lanes of the simulator, at nominal friction, and moves them. A plan is made anew where what is
    seen is not what was planned; on a path, of which only the next 0.35 m are seen, every other
    period too. `state` holds the plan that each lane follows.

    Args:
        settings: of the environment it is to act in, with "halves" for actions; a parcel is taken
            for the one, of those its task draws, that is nearest in size.
        budget: parcels followed at a time, each with every action; what a search costs is in
            proportion.

    Raises:
        ValueError: other actions, or a budget below 1.
    """

    def __init__(self, settings: Settings, budget: int = BUDGET) -> None:
        checks.one_of("actions", settings.actions, ("halves",))
        self._aim = AIMS[settings.task_name]
        self._width = max(1, checks.integer("budget", budget, least=1) // self._aim.share)
        choices = settings.action_kind.choices**2
        self._model = Model(settings, lanes_needed(self._aim, self._width, choices))

    def predict(
        self,
        observation: NDArray[np.float32],
        state: list[Following] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, list[Following]]:
        """Action for an observation (features,), or actions for (lanes, features); and the state.

        See `agents.controller.Controller`; the planner knows no chance, whatever `deterministic`.
        """
        del deterministic
        observations = np.atleast_2d(observation)
        last: list[Following | None] = [None] * len(observations)
        if state is not None:
            begun = np.zeros(len(state), dtype=np.bool_) if episode_start is None else episode_start
            last = [
                None if new else following
                for new, following in zip(np.atleast_1d(begun), state, strict=True)
            ]
        following = [
            self._follow(seen, before) for seen, before in zip(observations, last, strict=True)
        ]
        actions = np.array([plan.actions[given - 1] for plan, given in following])
        return (actions[0] if np.ndim(observation) == 1 else actions), following

    def _follow(self, seen: NDArray[np.float32], last: Following | None) -> Following:
        """The plan to go by, its next action counted as given."""
        if last is not None:
            plan, given = last
            if given < min(len(plan.actions), self._aim.follow) and (
                np.abs(plan.seen[given] - seen).max() <= AGREES
            ):
                return plan, given + 1
        self._model.begin(seen)
        return make_plan(self._model, self._aim, self._width), 1
