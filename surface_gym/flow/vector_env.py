"""The native vector environment of flows."""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from surface_gym.faces.lanes import Booleans
from surface_gym.faces.vector import BatchVectorEnv, with_masks
from surface_gym.flow.batch import FlowBatch
from surface_gym.flow.exits import Exits
from surface_gym.flow.infos import episodes_of, infos_of
from surface_gym.flow.rewards import TERMS
from surface_gym.flow.settings import LEVELLING, FlowSettings
from surface_gym.flow.stream import Stream
from surface_gym.lines import BaseLine
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Exact, Sensor
from surface_gym.state import RUNNING


class FlowVectorEnv(BatchVectorEnv):
    """Lanes of `FlowEnv`, moved together by compiled code; what `gym.make_vec` gives.

    Lane i seeded s + i equals the single env seeded s + i to the bit. Arguments are those of
    `FlowEnv` and:

    Args:
        num_envs: number of lanes, each a surface with a stream of its own.
        max_episode_steps: control periods after which a lane is truncated; None: by `duration`.
        threads: that share the lanes; results do not depend on their number.
        autoreset_mode: as in Gymnasium: NEXT_STEP, SAME_STEP or DISABLED.

    `reset(options=...)` takes one dict for all lanes, or a sequence of one dict or None a lane.
    """

    def __init__(
        self,
        num_envs: int = 1,
        stream: Stream = Stream(),
        exits: str | Exits = "chutes",
        actions: str = "modules",
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
        gate: bool = False,
        entry_gap: float = 0.02,
        ahead: float = 0.1,
        patience: float = 2.0,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        threads: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        super().__init__(num_envs, autoreset_mode, max_episode_steps, render_mode)
        self.settings = FlowSettings(
            stream,
            exits,
            actions,
            sensors,
            control_period,
            duration,
            places,
            plant,
            tilt,
            orientations,
            actuators,
            randomisation,
            restitution,
            side_friction,
            gate,
            entry_gap,
            ahead,
            patience,
        )
        self._batch = FlowBatch(self.settings, self.num_envs, self._threads(threads))
        self._drive(
            self._batch,
            self.settings.flow_actions,
            self.settings.observation_space(),
            self.settings.action_space(),
        )
        self._outcomes = np.array(self._batch.outcomes, dtype=object)
        self._albums: dict[int, Any] = {}
        self._painter: Any = None

    def _infos(self, mask: Booleans) -> dict[str, Any]:
        flows = self._batch.streams
        told = infos_of(self._batch)
        infos: dict[str, Any] = {name: values.copy() for name, values in told.items()}
        infos["outcome"] = self._outcomes[flows.outcome]
        infos["reward_terms"] = with_masks(
            {name: flows.terms[:, k].copy() for k, name in enumerate(TERMS)}, mask
        )
        infos = with_masks(infos, mask)
        ended = mask & (flows.outcome != RUNNING)
        if ended.any():
            figures = with_masks(episodes_of(self._batch, ended), ended)
            infos.update(with_masks({"episode_figures": figures}, ended))
        return infos

    def _record(self, lane: int, begins: bool) -> None:
        from surface_gym.scenes import Renderer

        if lane not in self._albums:
            self._albums[lane] = Renderer(self._batch, lane)
        self._albums[lane].record(begins)

    def _picture(self) -> NDArray[np.uint8]:
        from surface_gym.rendering import TilePainter

        if self._painter is None:
            self._painter = TilePainter()
        scenes = [self._albums[lane].scene(f"lane {lane}") for lane in range(self.num_envs)]
        picture: NDArray[np.uint8] = self._painter.draw(scenes)
        return picture
