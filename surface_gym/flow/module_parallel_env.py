"""Streams in PettingZoo: each module is an agent with local observations."""

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.config import with_arguments
from surface_gym.env import SmartSurfaceEnv
from surface_gym.flow.module_view import ModuleView, module_space
from surface_gym.flow.parallel_env import Infos, Observations, Returned, StreamParallelEnv
from surface_gym.flow.state import JAM, NOBODY
from surface_gym.registration import DEFAULT_SLOPE
from surface_gym.state import OUT_OF_TIME, RUNNING

REWARDS = ("parcel", "team")


class ModuleParallelEnv(StreamParallelEnv):
    """`SmartSurfaceEnv` of a stream on a slope with `actions="modules"`, with one agent per module.

    All modules with a rotor exist for the whole episode, 700 by default. "module_3_7" is in row 3
    and column 7, with rows from y < 0. Each sees only its own state and messages of neighbours: see
    `surface_gym.flow.module_view`.

    ## Agents

    - observation: (60,) float32: the module's position; the parcel on it (now or soon) and the
      module's position under it; the nearest parcels in eight directions within 1 m.
    - action: choice of the axis; with `orientations="any"`, an array (1,) with the angle.
    - reward: the reward of the parcel on the module at the action, 0 without one; with
      `reward="team"`, the reward of the whole surface for all.
    - terminated: all agents, after a jam. Truncated: at the time limit.
    - info: `parcel`, the arrival number of the parcel on the module (now or soon), else -1; at the
      end of the episode also `outcome`: "jam" or "out of time".

    Takes the arguments of `SmartSurfaceEnv` and of the task except `actions`, `gate` and `queue`,
    and `reward`. The task is "singulate" (default), "merge" or "sequence".
    `reset(options={"stream": ...})` sets the stream of an episode; other options are ignored, as
    PettingZoo's tests require.

    >>> env = ModuleParallelEnv(duration=4.0)
    >>> observations, infos = env.reset(seed=0)
    >>> right = 0
    >>> while env.agents:  # every module lets parcels roll on
    ...     roll = dict.fromkeys(env.agents, 3)
    ...     observations, rewards, terminated, truncated, infos = env.step(roll)
    >>> len(observations), infos["module_0_0"]
    (700, {'parcel': -1, 'outcome': 'out of time'})
    """

    metadata = {**SmartSurfaceEnv.metadata, "name": "smart_surface_modules_v0"}

    @with_arguments
    def __init__(
        self, render_mode: str | None = None, reward: str = "parcel", **config: Any
    ) -> None:
        super().__init__(render_mode, "modules", {"task": DEFAULT_SLOPE, **config})
        self._team = checks.one_of("reward", reward, REWARDS) == "team"
        self._view = ModuleView(self.config)
        self._owner = np.full(self._view.modules, NOBODY)
        kind = self.config.action_kind
        places = {
            f"module_{row}_{column}": row * kind.columns + column
            for row, column in np.argwhere(self._view.rotor).tolist()
        }
        self._places = np.array(list(places.values()))
        self.possible_agents = list(places)
        self._observation_space = module_space()
        self._action_space = spaces.Discrete(kind.choices or 1)
        if kind.continuous:
            whole = kind.space()
            assert isinstance(whole, spaces.Box)
            self._action_space = spaces.Box(whole.low[:1], whole.high[:1], dtype=np.float32)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        observation = self._begin(seed, options)
        self.agents = list(self.possible_agents)
        return self._look(observation)

    def step(self, actions: dict[str, Any]) -> Returned:
        """Step by one control period with the actions of all modules."""
        self._check_agents(actions)
        said = np.array([actions[agent] for agent in self.agents])
        action = np.zeros(self._view.modules, said.dtype)
        if self.agents:
            if said.size != len(self.agents):
                raise ValueError(f"actions must be one number each, got {said[0].tolist()!r}")
            action[self._places] = said.reshape(-1)
        observation, reward, terminated, truncated, _ = self._env.step(action)
        agents, owner = self.agents, self._owner[self._places]
        earned = np.full(len(owner), reward)
        if not self._team:
            earned = np.where(owner == NOBODY, 0.0, self.batch.parcels.reward[owner])
        observations, infos = self._look(observation)
        if terminated or truncated:
            self.agents = []
        return (
            observations,
            dict(zip(agents, earned.tolist(), strict=True)),
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            infos,
        )

    def _look(self, observation: NDArray[np.float32]) -> tuple[Observations, Infos]:
        """Return the observation and the info of each module."""
        seen = self._view(observation[np.newaxis])
        self._owner = seen.owner[0]
        owner = self._owner[self._places]
        number = np.where(owner == NOBODY, NOBODY, self.batch.streams.number[0, owner])
        infos: Infos = {
            agent: {"parcel": each}
            for agent, each in zip(self.agents, number.tolist(), strict=True)
        }
        outcome = self.batch.outcome.item(0)
        if outcome != RUNNING:
            assert outcome in (JAM, OUT_OF_TIME)
            for info in infos.values():
                info["outcome"] = self.batch.outcomes[outcome]
        return dict(zip(self.agents, seen.of_modules()[0, self._places], strict=True)), infos
