"""A flow in PettingZoo: each parcel an agent."""

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surface_gym.core.actions import ActionKind
from surface_gym.flow.env import FlowEnv
from surface_gym.flow.exits import Exits
from surface_gym.flow.memory import JAM, NOBODY
from surface_gym.flow.obeying import HALVES
from surface_gym.flow.settings import LEVELLING
from surface_gym.flow.stream import Stream
from surface_gym.lines import BaseLine
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Exact, Sensor
from surface_gym.state import OUT_OF_TIME, RUNNING

try:
    from pettingzoo import ParallelEnv
except ImportError as error:
    raise ImportError(
        f"the environment of agents needs PettingZoo ({error}): pip install 'surface_gym[multi]'"
    ) from None

Observations = dict[str, NDArray[np.float32]]
Infos = dict[str, dict[str, Any]]
Told = tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]


class FlowParallelEnv(ParallelEnv):
    """`FlowEnv` with `actions="parcels"`, each parcel an agent that acts for itself.

    An agent is there from the control period in which its parcel enters to the one in which it
    leaves; "parcel_0" comes first, and no id comes twice in an episode. Where nobody is on the line
    and more are to come, time runs on until the next has entered: no agents means that the
    episode is over.

    ## Agents

    - observation: (features,) its row of the table.
    - action: its two choices, for the modules ahead of its centre and for those behind; with
      `orientations="any"` two angles.
    - reward: what is paid for its parcel, so without `waiting` and `jam`.
    - terminated: its parcel has left, or all are jammed. Truncated: the time is over.
    - info: `time` [s], `exit` the name of the one asked; and as it ends `outcome`: "right" or
      "wrong" where it left, else "jam" or "out of time".

    `possible_agents` are all that come or may still come in this episode; before the first reset,
    as many as one draw of the stream has.

    Arguments are those of `FlowEnv` but `actions` and `gate`. `reset(options={"stream": ...})`
    gives an episode a stream of its own; other options are let pass, as PettingZoo's tests have it.

    >>> env = FlowParallelEnv(duration=4.0)
    >>> observations, infos = env.reset(seed=0)
    >>> while env.agents:  # everybody straight on
    ...     straight_on = dict.fromkeys(env.agents, (3, 3))
    ...     observations, rewards, terminated, truncated, infos = env.step(straight_on)
    >>> infos["parcel_1"]["outcome"], env.possible_agents
    ('out of time', ['parcel_0', 'parcel_1'])
    """

    metadata = {**FlowEnv.metadata, "name": "smart_surface_flow_v0"}

    def __init__(
        self,
        stream: Stream = Stream(),
        exits: str | Exits = "chutes",
        sensors: Sensor = Exact(),
        control_period: float = 0.04,
        duration: float = 60.0,
        places: int = 24,
        plant: BaseLine | None = None,
        tilt: float = LEVELLING,
        orientations: tuple[float, ...] | str | None = None,
        actuators: Actuators = Actuators(),
        randomisation: Randomisation = Randomisation(),
        restitution: float = 0.0,
        side_friction: float = 0.3,
        entry_gap: float = 0.02,
        ahead: float = 0.1,
        patience: float = 2.0,
        render_mode: str | None = None,
    ) -> None:
        self._env = FlowEnv(
            stream=stream,
            exits=exits,
            actions="parcels",
            sensors=sensors,
            control_period=control_period,
            duration=duration,
            places=places,
            plant=plant,
            tilt=tilt,
            orientations=orientations,
            actuators=actuators,
            randomisation=randomisation,
            restitution=restitution,
            side_friction=side_friction,
            entry_gap=entry_gap,
            ahead=ahead,
            patience=patience,
            render_mode=render_mode,
        )
        self.settings = self._env.settings
        self.render_mode = render_mode
        self._batch = self._env._batch
        self._kind = ActionKind("modules", self.settings.action_kind.choices, 1, HALVES)
        self._observation_space = self.settings.row_space()
        self._action_space = self._kind.space()
        probe = stream.draw(np.random.default_rng(0), self.settings.duration, self.settings.exits)
        self._possible = len(probe)
        self.agents: list[str] = []

    @property
    def possible_agents(self) -> list[str]:
        """The ids of all that come or may still come in this episode."""
        return [_name(number) for number in range(self._possible)]

    def observation_space(self, agent: str) -> spaces.Box:  # noqa: ARG002
        """The same space for every agent."""
        return self._observation_space

    def action_space(self, agent: str) -> spaces.Space[Any]:  # noqa: ARG002
        """The same space for every agent."""
        return self._action_space

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        known = options
        if isinstance(options, dict):
            known = {name: options[name] for name in self._batch.options if name in options}
        observation, _ = self._env.reset(seed=seed, options=known)
        told: Told = ({}, {}, {}, {}, {})
        self._tell(told, observation)
        self._wait(told)
        return told[0], told[4]

    def step(self, actions: dict[str, Any]) -> Told:
        """Move all parcels over a control period.

        Args:
            actions: of every agent, by its id.

        Returns:
            Observations, rewards, terminated, truncated and infos of those that were there and of
            those that have entered since.

        Raises:
            ValueError: an action is missing, is of nobody there, or is not allowed.
            ResetNeeded: the episode has ended, or none has begun.
        """
        told: Told = ({}, {}, {}, {}, {})
        observation, *_ = self._env.step(self._action(actions))
        self._tell(told, observation)
        self._wait(told)
        return told

    def render(self) -> NDArray[np.uint8] | None:
        """As `FlowEnv` does."""
        return self._env.render()

    def close(self) -> None:
        self._env.close()

    def _action(self, actions: dict[str, Any]) -> NDArray[Any]:
        """The action of all places: what agents say in theirs, and anything where nobody is."""
        if not isinstance(actions, dict) or set(actions) != set(self.agents):
            raise ValueError(f"actions must be one for each of {self.agents}, got {actions!r}")
        all_places = np.zeros((self.settings.places, HALVES), self._batch.surfaces.command.dtype)
        if actions:
            place = {
                _name(n): k for k, n in enumerate(self._batch.streams.number[0]) if n != NOBODY
            }
            said = self._kind.commands(list(actions.values()), len(actions))
            all_places[[place[agent] for agent in actions]] = said
        return all_places.reshape(-1)

    def _wait(self, told: Told) -> None:
        """Let time run on while nobody is there and somebody may come."""
        while not self.agents and self._batch.outcome[0] == RUNNING:
            observation, *_ = self._env.step(self._action({}))
            self._tell(told, observation)

    def _tell(self, told: Told, observation: NDArray[np.float32]) -> None:
        """Add what the last control period came to for each who was there in it, or came."""
        observations, rewards, terminated, truncated, infos = told
        flows, reward = self._batch.streams, self._batch.parcels.reward
        outcome = flows.outcome[0]
        there = []
        for place in np.nonzero(flows.number[0] != NOBODY)[0].tolist():
            number = int(flows.number[0, place])
            agent = _name(number)
            asked = int(flows.exit[0, number])
            left = not flows.present[0, place]
            info = {"time": float(flows.clock[0]), "exit": self.settings.exits.names[asked]}
            if left:
                info["outcome"] = "right" if flows.taken[0, number] == asked else "wrong"
            elif outcome == RUNNING:
                there.append(number)
            else:
                info["outcome"] = self._batch.outcomes[outcome]
            observations[agent] = observation[place]
            rewards[agent] = float(reward[place])
            terminated[agent] = bool(left or outcome == JAM)
            truncated[agent] = bool(not left and outcome == OUT_OF_TIME)
            infos[agent] = info
        self.agents = [_name(number) for number in sorted(there)]
        counted = flows.arrivals if outcome == RUNNING else flows.coming
        self._possible = int(counted[0])


def _name(number: int) -> str:
    """The id of the parcel that comes after so many others."""
    return f"parcel_{number}"
