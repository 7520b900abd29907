"""Episodes told of by their totals: tens of thousands end in a rollout."""

from pathlib import Path
from typing import Any

import torch

from ..curve import RECENT_EPISODES, REWARD, Curve

EPISODES = "episodes"  # their number, beside the sums over them


class EpisodeTotals:
    """Sums over the episodes that ended since they were last fetched, kept on the device.

    Args:
        terms: names of the reward terms.
        lanes: their number.
        device: of the lanes.
    """

    def __init__(self, terms: tuple[str, ...], lanes: int, device: torch.device) -> None:
        self._terms = terms
        self._names = (EPISODES, "success", "return", "length", *(REWARD + term for term in terms))
        self._going_on = torch.zeros((2 + len(terms), lanes), dtype=torch.float64, device=device)
        self._ended = torch.zeros(len(self._names), dtype=torch.float64, device=device)

    def restart(self) -> None:
        """Forget the episodes that go on: all lanes start anew."""
        self._going_on.zero_()

    def take(self, rewards: torch.Tensor, ended: torch.Tensor, infos: dict[str, Any]) -> None:
        """Take a control period of all lanes: rewards (lanes,), which episodes ended (lanes,)."""
        final, now = infos["final_info"], infos["reward_terms"]
        paid = [torch.where(ended, final["reward_terms"][term], now[term]) for term in self._terms]
        self._going_on += torch.stack([rewards, torch.ones_like(rewards), *paid])
        sums = torch.where(ended, self._going_on, 0.0).sum(dim=1)
        counts = torch.stack([ended.sum(), (ended & final["is_success"]).sum()])
        self._ended += torch.cat([counts, sums])
        self._going_on = torch.where(ended, 0.0, self._going_on)

    def fetch(self) -> dict[str, float]:
        """Number of the episodes that ended, and the sums over them, by name; then none."""
        totals = dict(zip(self._names, self._ended.tolist(), strict=True))
        self._ended.zero_()
        return totals


class TotalsCurve(Curve):
    """The curve of a run that tells of its episodes by their totals: means over the latest
    rollouts, as few as hold `RECENT_EPISODES`, and one a lane: where all lanes have just begun,
    only the shortest have ended.

    Args:
        folder: of the run.
        terms: names of the reward terms.
        lanes: their number.
        steps: done before; what the files hold beyond is dropped.
        recent: totals of the latest rollouts before.
    """

    def __init__(
        self,
        folder: Path,
        terms: tuple[str, ...],
        lanes: int,
        steps: int,
        recent: list[dict[str, float]],
    ) -> None:
        super().__init__(folder, terms, steps, recent)
        self._least = max(RECENT_EPISODES, lanes)

    def take_totals(self, totals: dict[str, float]) -> None:
        """Take what `EpisodeTotals.fetch` gives."""
        if totals[EPISODES] == 0.0:
            return
        self.recent.append(totals)
        while self._sum(EPISODES) - self.recent[0][EPISODES] >= self._least:
            self.recent.popleft()

    def _mean(self, name: str) -> float:
        return self._sum(name) / self._sum(EPISODES) if self.recent else float("nan")

    def _sum(self, name: str) -> float:
        return sum(rollout[name] for rollout in self.recent)
