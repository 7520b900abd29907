"""What is particular to parcels of a flow that learn: their lines, and how they begin."""

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from ..flow.imitation import demonstrations, imitate
from ..flow.practice import by_camera, practice_settings, stream_of
from ..flow.seat_policy import SeatPolicy
from ..flow.seats import FlowSeats
from .config import ParcelsConfig
from .model import Model
from .side_by_side import SideBySide


def make_seats(config: ParcelsConfig) -> VecEnv:
    """The lines a configuration asks for, some seen by a camera."""
    exact = practice_settings(config.control_period)
    late = round(config.camera_share * config.lanes)
    parts = [
        FlowSeats(settings, lanes, config.seats, stream_of)
        for settings, lanes in (
            (exact, config.lanes - late),
            (by_camera(exact, config.friction), late),
        )
        if lanes
    ]
    return SideBySide(parts)


def begin(model: Model, config: ParcelsConfig) -> None:
    """Let a new model imitate a reservation, if it is to."""
    assert isinstance(model.policy, SeatPolicy)
    if config.imitation > 0:
        seen, said = demonstrations(config.control_period, config.seed)
        imitate(model.policy, seen, said, config.imitation, config.seed)


class CriticFirst(BaseCallback):
    """Holds the actor until the critic knows what the imitated actor is worth: what an ignorant one
    teaches would undo it.

    Args:
        steps: control periods until then.
    """

    def __init__(self, steps: int) -> None:
        super().__init__()
        self._steps = steps

    def _on_rollout_start(self) -> None:
        policy = self.model.policy
        assert isinstance(policy, SeatPolicy)
        learns = self.num_timesteps >= self._steps
        policy.action_net.requires_grad_(learns)
        policy.mlp_extractor.policy_net.requires_grad_(learns)

    def _on_step(self) -> bool:
        return True
