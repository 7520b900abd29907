"""What a training run is made of; every field is a flag of `train.py`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from surface_gym import checks


@dataclass(frozen=True)
class TrainConfig:
    """Train PPO on Sort, then compare it with the paper's fixed layout."""

    seed: int = 0
    """Of the starts, the network and the sampling."""
    steps: int = 3_000_000
    """Control periods to learn from, all lanes together."""
    actions: Literal["halves", "modules"] = "halves"
    """Kind of action: front and rear half of the modules under the parcel, or each on its own."""
    control_period: float = 0.04
    """[s] between decisions."""
    slow_share: float = 0.5
    """[-] of starts drawn from the low band of entry speeds, where sorting is hard."""
    lanes: int = 64
    """Parcels at a time."""
    rollout: int = 64
    """Control periods of each lane between updates."""
    batch_size: int = 1024
    """Of a gradient step."""
    epochs: int = 5
    """Passes over a rollout."""
    learning_rate: float = 1e-3
    """At the start; it falls to 0 over the run."""
    gamma: float = 0.99
    """Discount a control period."""
    gae_lambda: float = 0.95
    """Of the generalised advantage estimate."""
    entropy: float = 0.005
    """Weight of the entropy bonus."""
    hidden: tuple[int, ...] = (64, 64)
    """Units of the hidden layers, of policy and value alike."""
    out: Path = Path("runs")
    """Folder that run folders are made in."""
    name: str | None = None
    """Of the run's folder; by default the task, the algorithm, the seed and the time."""

    def __post_init__(self) -> None:
        checks.integer("seed", self.seed, least=0)
        for name in ("steps", "lanes", "rollout", "batch_size", "epochs"):
            checks.integer(name, getattr(self, name), least=1)
        checks.positive("control_period", self.control_period)
        checks.positive("learning_rate", self.learning_rate)
        for name in ("slow_share", "gamma", "gae_lambda"):
            checks.within(name, getattr(self, name), 0.0, 1.0)
        checks.not_negative("entropy", self.entropy)
        for units in self.hidden:
            checks.integer("hidden", units, least=1)
