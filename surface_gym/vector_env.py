"""The native vector environment: many lanes in one batch."""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from surface_gym.conditions import Condition
from surface_gym.core.batch import Batch
from surface_gym.faces.lanes import Booleans
from surface_gym.faces.vector import BatchVectorEnv, with_masks
from surface_gym.lines import BaseLine
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Exact, Sensor
from surface_gym.settings import Settings
from surface_gym.state import SUCCESS
from surface_gym.tasks import Task


class SmartSurfaceVectorEnv(BatchVectorEnv):
    """Lanes of `SmartSurfaceEnv`, moved together by compiled code; what `gym.make_vec` gives.

    Lane i seeded s + i equals the single env seeded s + i to the bit. Arguments are those of
    `SmartSurfaceEnv` and:

    Args:
        num_envs: number of lanes.
        max_episode_steps: control periods after which a lane is truncated; None for no limit.
        threads: that share the lanes; results do not depend on their number.
        autoreset_mode: as in Gymnasium: NEXT_STEP, SAME_STEP or DISABLED.

    `reset(options=...)` takes one dict for all lanes, or a sequence of one dict or None a lane.
    """

    def __init__(
        self,
        num_envs: int = 1,
        task: str | Task = "sort",
        actions: str = "modules",
        sensors: Sensor = Exact(),
        control_period: float = 0.04,
        zone: tuple[int, int] | None = None,
        orientations: tuple[float, ...] | str | None = None,
        actuators: Actuators = Actuators(),
        randomisation: Randomisation = Randomisation(),
        plant: BaseLine | None = None,
        observe_axes: bool = False,
        info: tuple[str, ...] = (),
        observe: tuple[str, ...] = (),
        condition: str | Condition | None = None,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        threads: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        super().__init__(num_envs, autoreset_mode, max_episode_steps, render_mode)
        self.settings = Settings(
            task,
            actions,
            sensors,
            control_period,
            zone,
            orientations,
            actuators,
            randomisation,
            plant,
            observe_axes,
            info,
            observe,
            condition,
        )
        self._batch = Batch(self.settings, self.num_envs, self._threads(threads))
        self._drive(
            self._batch,
            self.settings.action_kind,
            self.settings.observation_space(),
            self.settings.action_space(),
        )
        self._task = self._batch.task
        self._outcomes = np.array(self._batch.outcomes, dtype=object)
        self._trails: list[list[NDArray[np.float64]]] = [[] for _ in range(self.num_envs)]
        self._painter: Any = None

    def _record(self, lane: int, begins: bool) -> None:
        if begins:
            self._trails[lane].clear()
        self._trails[lane].append(self._batch.parcels.truth[lane, :2].copy())

    def _picture(self) -> NDArray[np.uint8]:
        from surface_gym.picture import scene_of
        from surface_gym.rendering import TilePainter

        if self._painter is None:
            self._painter = TilePainter()
        clock = self._batch.parcels.clock
        scenes = [
            scene_of(
                self._batch,
                lane,
                np.array(self._trails[lane]),
                f"lane {lane}  {clock[lane]:.2f} s",
            )
            for lane in range(self.num_envs)
        ]
        picture: NDArray[np.uint8] = self._painter.draw(scenes)
        return picture

    def _infos(self, mask: Booleans) -> dict[str, Any]:
        """Infos of the lanes in the mask, as Gymnasium lays them out: arrays and their masks."""
        lanes = self._batch.parcels
        terms = {name: lanes.terms[:, k].copy() for k, name in enumerate(self._task.terms)}
        infos = {
            "is_success": lanes.outcome == SUCCESS,
            "outcome": self._outcomes[lanes.outcome],
            "time": lanes.clock.copy(),
            "pose": lanes.truth[:, :3].copy(),
            "velocity": lanes.truth[:, 3:].copy(),
            **{name: lanes.metrics[:, k].copy() for k, name in enumerate(self._task.metrics)},
            **self._batch.on_request(),
            "reward_terms": with_masks(terms, mask),
        }
        return with_masks(infos, mask)
