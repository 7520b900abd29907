"""Seats: each follows one parcel from the gate until it has left."""

from itertools import pairwise

import numpy as np
import pytest
import torch

from agents.flow.event import EventRule
from agents.flow.parcel_rule import SIDE
from agents.flow.practice import densest, practice_settings
from agents.flow.seat_policy import SeatPolicy
from agents.flow.seats import FlowSeats, SeatActions, seat_space
from surface_gym.flow.batch import FlowBatch
from surface_gym.flow.features import PRESENT, WAITS
from surface_gym.flow.memory import RIGHT
from surface_gym.flow.settings import FlowSettings

SETTINGS = practice_settings(0.04)
SEATS = 14


def seats(lanes: int = 2, seed: int = 0) -> FlowSeats:
    env = FlowSeats(SETTINGS, lanes, SEATS, lambda _: densest(1.5, ("S", "B")))
    env.seed(seed)
    return env


@pytest.fixture(scope="module")
def run() -> list[tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, object]]]]:
    """Observations, rewards, ends and infos of 150 periods; everybody obeys the event rule."""
    env = seats()
    rule = EventRule(FlowSettings(exits="sides", actions="parcels"))
    seen = np.asarray(env.reset())
    steps = []
    for _ in range(150):
        said = np.ones((env.num_envs, 3), dtype=np.int64)
        there = (seen[:, PRESENT] > 0.5) & (seen[:, WAITS] < 0.5)
        if there.any():
            said[there, :2] = rule._halves(seen[there])
        after, rewards, ends, infos = env.step(said)
        steps.append((seen, rewards, ends, infos))
        seen = np.asarray(after)
    return steps


def test_a_parcel_keeps_its_seat_until_it_has_left(run: list[tuple]) -> None:
    for (seen, _, ends, _), (after, *_) in pairwise(run):
        sat, sits = seen[:, PRESENT] > 0.5, after[:, PRESENT] > 0.5
        # Nobody changes seats: who stays has come on by no more than a period's way.
        stays = sat & sits & ~ends
        way = np.abs(after[stays, 13] - seen[stays, 13])
        assert way.max(initial=0.0) < 0.25
        assert not (sat & ~sits & ~ends).any()


def test_every_parcel_that_leaves_by_its_exit_is_a_success(run: list[tuple]) -> None:
    ended = [info for *_, infos in run for info in infos if info]
    assert len(ended) > 20
    assert all(info["is_success"] for info in ended if not info["TimeLimit.truncated"])


def test_what_a_free_seat_does_counts_for_nothing(run: list[tuple]) -> None:
    for seen, rewards, _, _ in run:
        free = seen[:, PRESENT] < 0.5
        assert not seen[free].any()
        assert not rewards[free].any()


def test_a_seat_sees_no_side_but_the_mirrored_one(run: list[tuple]) -> None:
    assert all((seen[:, SIDE] >= 0.0).all() for seen, *_ in run)


def test_the_same_seed_gives_the_same_parcels() -> None:
    one, other = seats(seed=4), seats(seed=4)
    rng = np.random.default_rng(0)
    assert np.array_equal(one.reset(), other.reset())
    for _ in range(30):
        said = rng.integers(0, [4, 4, 9], (one.num_envs, 3))
        for first, second in zip(one.step(said)[:3], other.step(said)[:3], strict=True):
            assert np.array_equal(first, second)


def test_mirrored_choices_come_back_as_they_were() -> None:
    batch = FlowBatch(SETTINGS, 2)
    for lane in range(2):
        batch.seed(lane, np.random.default_rng(lane))
    batch.start(np.arange(2))
    tables = batch.observation.copy()
    tables[..., SIDE] = np.random.default_rng(0).integers(-1, 2, tables.shape[:2])
    actions = SeatActions(SETTINGS)
    said = np.random.default_rng(1).integers(0, [4, 4, 9], (*tables.shape[:2], 3))
    back = actions.said(tables, actions(tables, said))
    assert np.array_equal(back[:, :-1, :2], said[:, :-1, :2])
    assert np.array_equal(back[:, -1, 2], said[:, -1, 2])


def test_an_event_rule_seen_in_seats_delivers_as_one_outside() -> None:
    """Seats change nothing: the same choices by seats and by tables deliver the same."""
    plain = FlowSettings(stream=SETTINGS.stream, exits="sides", actions="parcels", gate=True)
    batch = FlowBatch(plain, 1)
    batch.seed(0, np.random.default_rng(3))
    batch.start(np.arange(1))
    rule, state = EventRule(plain), None
    mirror = SeatActions(plain)
    for _ in range(120):
        tables = batch.observation.copy()
        action, state = rule.predict(tables, state)
        said = mirror.said(tables, action)
        assert np.array_equal(mirror(tables, said), action)
        batch.advance(plain.flow_actions.commands(action, 1))
    assert batch.streams.tally[0, RIGHT] > 0


@pytest.fixture
def policy() -> SeatPolicy:
    torch.manual_seed(0)
    return SeatPolicy(*seat_space(SETTINGS), lambda _: 0.0, net_arch=[8])


class TestPolicy:
    @staticmethod
    def rows(present: float, waits: float) -> torch.Tensor:
        seen = torch.rand((5, seat_space(SETTINGS)[0].shape[0]))
        seen[:, PRESENT], seen[:, WAITS] = present, waits
        return seen

    @pytest.mark.parametrize(
        ("present", "waits", "counts"), [(1.0, 0.0, [0, 1]), (1.0, 1.0, [2]), (0.0, 0.0, [])]
    )
    def test_only_the_choices_that_a_parcel_has_count(
        self, policy: SeatPolicy, present: float, waits: float, counts: list[int]
    ) -> None:
        seen = self.rows(present, waits)
        for place, part in enumerate(policy.choices(seen)):
            even = part.probs.allclose(torch.full_like(part.probs, 1.0 / part.probs.shape[1]))
            assert even == (place not in counts)
        actions = torch.zeros((5, 3))
        policy.zero_grad()
        _, likelihood, _ = policy.evaluate_actions(seen, actions)
        likelihood.sum().backward()
        assert bool(policy.action_net.weight.grad.any()) == bool(counts)

    def test_the_likeliest_is_chosen_where_chance_is_not_asked_for(
        self, policy: SeatPolicy
    ) -> None:
        seen = self.rows(1.0, 0.0)
        chosen, _, likelihood = policy(seen, deterministic=True)
        _, again, _ = policy.evaluate_actions(seen, chosen)
        assert torch.allclose(likelihood, again)
        for place, part in enumerate(policy.choices(seen)):
            assert torch.equal(part.probs.argmax(dim=1), chosen[:, place])
