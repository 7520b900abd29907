"""Streams in PettingZoo: each parcel is an agent, or each module with local observations."""

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.actions import ActionKind
from surface_gym.config import with_arguments
from surface_gym.env import SmartSurfaceEnv
from surface_gym.flow.base import HALVES
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.module_view import MOST, SIZE, ModuleView
from surface_gym.flow.state import JAM, NOBODY
from surface_gym.registration import DEFAULT_SLOPE, DEFAULT_STREAM
from surface_gym.state import OUT_OF_TIME, RUNNING

try:
    from pettingzoo import ParallelEnv
except ImportError as error:
    raise ImportError(
        f"the environment of agents needs PettingZoo ({error}): pip install 'surface_gym[multi]'"
    ) from None

Observations = dict[str, NDArray[np.float32]]
Infos = dict[str, dict[str, Any]]
Returned = tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]


class StreamParallelEnv(ParallelEnv):
    """Base class of environments of streams. All agents of an environment have equal spaces.

    Args:
        render_mode: see `SmartSurfaceEnv`.
        actions: the only kind of action that the class allows.
        config: other arguments of `SmartSurfaceEnv`.
    """

    _observation_space: spaces.Box
    _action_space: spaces.Space[Any]

    def __init__(self, render_mode: str | None, actions: str, config: dict[str, Any]) -> None:
        for name, only in (("actions", actions), ("gate", False)):
            if config.setdefault(name, only) != only:
                raise ValueError(f"{name} must be {only!r} with agents, got {config[name]!r}")
        self._env = SmartSurfaceEnv(**config, render_mode=render_mode)
        self.config = self._env.config
        self.task = self.config.stream_task
        self.render_mode = render_mode
        batch = self._env.batch
        assert isinstance(batch, StreamBatch)
        self.batch = batch
        self.agents: list[str] = []

    def observation_space(self, agent: str) -> spaces.Box:
        del agent
        return self._observation_space

    def action_space(self, agent: str) -> spaces.Space[Any]:
        del agent
        return self._action_space

    def render(self) -> NDArray[np.uint8] | None:
        return self._env.render()

    def close(self) -> None:
        self._env.close()

    def _begin(self, seed: int | None, options: dict[str, Any] | None) -> NDArray[np.float32]:
        """Begin an episode and return the observation (rows, features); ignore unknown options."""
        if isinstance(options, dict):
            options = {name: options[name] for name in self.batch.options if name in options}
        observation, _ = self._env.reset(seed=seed, options=options)
        return observation

    def _check_agents(self, actions: dict[str, Any]) -> None:
        asked = f"actions must be one for each of {len(self.agents)} agents"
        if not isinstance(actions, dict):
            raise ValueError(f"{asked}, got {actions!r}")
        others = sorted(set(actions) ^ set(self.agents))
        if others:
            named = ", ".join(others[:5])
            raise ValueError(f"{asked}, got {len(actions)}, which lack or have besides {named}")


class FlowParallelEnv(StreamParallelEnv):
    """`SmartSurfaceEnv` of a stream with `actions="parcels"`, with one agent per parcel.

    An agent exists from the control period in which its parcel enters until its parcel departs.
    "parcel_0" is the first parcel; ids are unique in an episode. If no parcel is on the line and
    more will arrive, time advances until the next entry. So an empty list of agents means that the
    episode is over.

    ## Agents

    - observation: (features,) the parcel's row of the table.
    - action: two choices, for the modules ahead of the parcel's centre and behind it; with
      `orientations="any"`, two angles.
    - reward: the parcel's reward, without `waiting` and `jam`.
    - terminated: the parcel has departed, or there is a jam.
    - truncated: the time limit is reached.
    - info: `time` [s], `exit` (name of the goal exit); at the end also `outcome`: "correct" or
      "wrong" after a departure, else "jam" or "out of time". In tasks with a take-away, "correct"
      also requires the correct gap, angle and order.

    `possible_agents` are all agents that have arrived or may still arrive in this episode. Before
    the first reset, `possible_agents` are the parcels of a random stream.

    Takes the arguments of `SmartSurfaceEnv` and of the task, except `actions`, `gate` and `queue`.
    The task is Flow by default, or "singulate", "merge" or "sequence". `reset(options={"stream":
    ...})` sets the stream of an episode; other options are ignored, as PettingZoo's tests require.

    >>> env = FlowParallelEnv(duration=4.0)
    >>> observations, infos = env.reset(seed=0)
    >>> while env.agents:  # every parcel straight on
    ...     straight_on = dict.fromkeys(env.agents, (3, 3))
    ...     observations, rewards, terminated, truncated, infos = env.step(straight_on)
    >>> infos["parcel_1"]["outcome"], env.possible_agents
    ('out of time', ['parcel_0', 'parcel_1'])
    """

    metadata = {**SmartSurfaceEnv.metadata, "name": "smart_surface_flow_v0"}

    @with_arguments
    def __init__(self, render_mode: str | None = None, **config: Any) -> None:
        super().__init__(render_mode, "parcels", {"task": DEFAULT_STREAM, **config})
        self._kind = ActionKind("modules", self.config.action_kind.choices, 1, HALVES)
        self._observation_space = self.config.row_space()
        self._action_space = self._kind.space()
        probe = np.random.default_rng(0)
        drawn = self.task.stream.draw(
            probe, self.task.duration, self.config.exits, self.config.inlets
        )
        self._possible = list(range(len(drawn)))

    @property
    def possible_agents(self) -> list[str]:
        """Ids of all agents that have arrived or may still arrive in this episode."""
        return [_name(number) for number in self._possible]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        observation = self._begin(seed, options)
        returned: Returned = ({}, {}, {}, {}, {})
        self._report(returned, observation)
        self._wait(returned)
        return returned[0], returned[4]

    def step(self, actions: dict[str, Any]) -> Returned:
        """Step once, and on until there is an agent or the episode ends. Report new agents, too."""
        returned: Returned = ({}, {}, {}, {}, {})
        observation, *_ = self._env.step(self._action(actions))
        self._report(returned, observation)
        self._wait(returned)
        return returned

    def _action(self, actions: dict[str, Any]) -> NDArray[Any]:
        """Merge the agents' actions into one action. Slots without a parcel get zeros."""
        self._check_agents(actions)
        all_slots = np.zeros((self.task.max_parcels, HALVES), self.batch.surfaces.command.dtype)
        if actions:
            slot = {_name(n): k for k, n in enumerate(self.batch.streams.number[0]) if n != NOBODY}
            said = self._kind.commands(list(actions.values()), len(actions))
            all_slots[[slot[agent] for agent in actions]] = said
        return all_slots.reshape(-1)

    def _wait(self, returned: Returned) -> None:
        """Step until a parcel enters or the episode is over; add the results to `returned`."""
        while not self.agents and self.batch.outcome[0] == RUNNING:
            observation, *_ = self._env.step(self._action({}))
            self._report(returned, observation)

    def _report(self, returned: Returned, observation: NDArray[np.float32]) -> None:
        """Add the last control period's results to `returned`, and update the list of agents.

        `observation` is the table (rows, features) of the surface.
        """
        observations, rewards, terminated, truncated, infos = returned
        streams, reward = self.batch.streams, self.batch.parcels.reward
        outcome = streams.outcome[0]
        there = []
        for slot in np.nonzero(streams.number[0] != NOBODY)[0].tolist():
            number = int(streams.number[0, slot])
            agent = _name(number)
            if outcome != RUNNING and agent not in self.agents:
                continue  # it entered as the episode ended, so it was never an agent
            asked = int(streams.exit[0, number])
            departed = not streams.present[0, slot]
            info = {"time": float(streams.clock[0]), "exit": self.config.exits.names[asked]}
            if departed:
                info["outcome"] = "correct" if streams.correct[0, number] else "wrong"
            elif outcome == RUNNING:
                there.append(number)
            else:
                info["outcome"] = self.batch.outcomes[outcome]
            observations[agent] = observation[slot]
            rewards[agent] = float(reward[slot])
            terminated[agent] = bool(departed or outcome == JAM)
            truncated[agent] = bool(not departed and outcome == OUT_OF_TIME)
            infos[agent] = info
        self.agents = [_name(number) for number in sorted(there)]
        coming = np.arange(streams.arrivals[0])
        if outcome != RUNNING:  # parcels that have not entered cannot enter any more
            coming = coming[~np.isnan(streams.entered[0, : len(coming)])]
        self._possible = coming.tolist()


def _name(number: int) -> str:
    """Return the id of a parcel's agent. `number` is the parcel's place in the order of arrival."""
    return f"parcel_{number}"


REWARDS = ("parcel", "team")


class ModuleParallelEnv(StreamParallelEnv):
    """`SmartSurfaceEnv` of a stream on a slope with `actions="modules"`, with one agent per module.

    All modules with a rotor, 700 by default, are agents for the whole episode. "module_3_7" is in
    row 3 and column 7; row 0 has the lowest y. A module sees only its own state and messages of
    neighbours: see `surface_gym.flow.module_view`.

    ## Agents

    - observation: (60,) float32. It has the module's position on the surface, and the parcel that
      is on the module now or soon. It also has the module's position relative to the centre of this
      parcel, and the nearest parcels within 1 m, in eight directions.
    - action: choice of the axis; with `orientations="any"`, an array (1,) with the angle.
    - reward: the reward of the parcel that `info` named before the action, or 0 if the
      module had no parcel. With `reward="team"`, all agents get the reward of the whole surface.
    - terminated: true for all agents after a jam. Truncated: true for all at the time limit.
    - info: `parcel` is the arrival number of the parcel on the module (now or soon), or -1 without
      a parcel. At the end of the episode, `info` also has `outcome`: "jam" or "out of time".

    Takes `reward`, and the arguments of `SmartSurfaceEnv` and of the task, except `actions`, `gate`
    and `queue`. The task is "singulate" (default), "merge" or "sequence".
    `reset(options={"stream": ...})` sets the stream of an episode; other options are ignored, as
    PettingZoo's tests require.

    >>> env = ModuleParallelEnv(duration=4.0)
    >>> observations, infos = env.reset(seed=0)

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
        self._observation_space = spaces.Box(-MOST, MOST, (SIZE,), dtype=np.float32)
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
        """Return the observations and the infos of all modules, by agent."""
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
            for info in infos.values():
                info["outcome"] = self.batch.outcomes[outcome]
        return dict(zip(self.agents, seen.of_modules()[0, self._places], strict=True)), infos
