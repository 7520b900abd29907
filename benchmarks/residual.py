"""`python -m benchmarks.residual`: does PPO improve the rule "patterns" through a mouth in the lab?

The rule and the rule as PPO corrects it (`benchmarks/corrections.py`) get the same streams, which
were not used for training or tuning.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import tyro
from rich.console import Console
from rich.progress import Progress


@dataclass(frozen=True)
class ResidualOptions:
    """Train corrections of the rule, and compare them with the rule on the same streams."""

    rollouts: int = 60
    """Number of rollouts in training, each 6.4 s in 32 environments."""
    streams: int = 16
    """Number of compared streams, each 200 s."""
    seed: int = 0
    """Seed of the training."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, and print both rates and their paired difference."""
    options = tyro.cli(ResidualOptions, prog="python -m benchmarks.residual", args=arguments)
    with Progress(console=Console(stderr=True), transient=True) as bars:
        training = bars.add_task("training", total=options.rollouts)
        # Imported with the bar on the screen, since PyTorch takes seconds.
        from benchmarks.corrections import play, train
        from surface_gym.agents.evaluation.results import half_interval

        network = train(options.rollouts, options.seed, partial(bars.advance, training))
        (rule, jams, _), (learned, more, share) = (
            play(each, options.streams, partial(bars.advance, bars.add_task(name, total=1.0)))
            for name, each in (("rule", None), ("rule with PPO", network))
        )
    change = learned - rule
    print(
        f"patterns {rule.mean():.0f} an hour, {jams} jams; with PPO {learned.mean():.0f}, {more} "
        f"jams, {share:.1%} of decisions corrected; difference {change.mean():.0f} "
        f"±{half_interval(change):.0f}"
    )


if __name__ == "__main__":
    main()
