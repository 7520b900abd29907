"""What a training run of the shared weights is made of."""

from dataclasses import dataclass

from surface_gym import checks


@dataclass(frozen=True, kw_only=True)
class ModulesConfig:
    """Train modules that decide for themselves to sort, by PPO with draws they share.

    Raises:
        ValueError: a field is out of its range; the message names it.
    """

    seed: int = 0
    """Of the starts, the network and the draws."""
    steps: int = 2_500_000
    """Control periods to learn from, all lanes together."""
    control_period: float = 0.04
    """[s] between decisions."""
    lanes: int = 64
    """Parcels at a time."""
    camera_share: float = 0.5
    """[-] of lanes seen by a camera, late and noisy, with varied friction; the others exact."""
    friction: float = 0.2
    """[-] spread of the friction in these lanes."""
    haste: float = 8.0
    """Paid at success beside the environment's reward, times 1 s over the time it took: the pay by
    the second alone is lost in the noise of what a parcel earns."""
    parted: float = 0.3
    """[-] probability that a line through the parcel parts its modules into two sides, each with a
    draw of its own; otherwise all modules share one."""
    hidden: int = 64
    """Units of each of two hidden layers, of the modules' network and of the value's."""
    n_steps: int = 64
    """Control periods of each lane between updates."""
    batch_size: int = 1024
    """Control periods of a gradient step."""
    n_epochs: int = 5
    """Passes over a rollout."""
    learning_rate: float = 1e-3
    """At the start; it falls to 0 over the run."""
    gamma: float = 0.99
    """Discount a control period."""
    gae_lambda: float = 0.95
    """Of the generalised advantage estimate."""
    clip_range: float = 0.2
    """[-] by which the likelihood of a lane's choices may change and still earn."""
    ent_coef: float = 0.02
    """Weight of the modules' mean entropy."""
    max_grad_norm: float = 0.5
    """Gradients longer than this are shortened."""
    checkpoint_every: int = 250_000
    """Control periods from checkpoint to checkpoint, where all lanes start anew."""

    def __post_init__(self) -> None:
        checks.integer("seed", self.seed, least=0)
        for name in (
            "steps", "lanes", "hidden", "n_steps", "batch_size", "n_epochs", "checkpoint_every",
        ):  # fmt: skip
            checks.integer(name, getattr(self, name), least=1)
        for name in ("control_period", "learning_rate", "clip_range", "max_grad_norm"):
            checks.positive(name, getattr(self, name))
        for name in ("haste", "ent_coef"):
            checks.not_negative(name, getattr(self, name))
        for name in ("camera_share", "parted", "gamma", "gae_lambda"):
            checks.within(name, getattr(self, name), 0.0, 1.0)
        if checks.within("friction", self.friction, 0.0, 1.0) == 1.0:
            raise ValueError(f"friction must be less than 1, got {self.friction!r}")
