"""What some control periods of all lanes brought, with as many modules each as mattered."""

from dataclasses import dataclass

import torch

from ...modules.view import Integers


@dataclass(frozen=True, eq=False)
class Batch:
    """Samples, one a lane and control period, and the modules of all of them in a row."""

    observations: torch.Tensor  # (samples, features)
    shared: torch.Tensor  # (samples, shared) what all modules of a sample see alike
    likelihood: torch.Tensor  # (samples,) log of the choices' likelihood as they were made
    modules: torch.Tensor  # (samples,) their number
    place: torch.Tensor  # (modules, place)
    group: torch.Tensor  # (modules,) within its sample
    choice: torch.Tensor  # (modules,)

    @property
    def sample(self) -> torch.Tensor:
        """(modules,) each module's."""
        return torch.arange(len(self.modules)).repeat_interleave(self.modules)


def join(batches: list[Batch]) -> Batch:
    """All samples in a row."""
    return Batch(*(torch.cat(each) for each in zip(*map(_fields, batches), strict=True)))


def pick(batch: Batch, samples: Integers) -> Batch:
    """Some samples of a batch, with their modules."""
    chosen = torch.from_numpy(samples)
    counts = batch.modules[chosen]
    first = (batch.modules.cumsum(0) - batch.modules)[chosen]
    skipped = counts.cumsum(0) - counts
    modules = torch.arange(int(counts.sum())) + (first - skipped).repeat_interleave(counts)
    return Batch(
        *(field[chosen] for field in _fields(batch)[:4]),
        *(field[modules] for field in _fields(batch)[4:]),
    )


def _fields(batch: Batch) -> tuple[torch.Tensor, ...]:
    return (
        batch.observations,
        batch.shared,
        batch.likelihood,
        batch.modules,
        batch.place,
        batch.group,
        batch.choice,
    )
