"""What is asked for, pruned and found important."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

from agents.search.study import FEWEST, Order, Watch, carry_out, importance
from agents.search.sweep import Choices, Span, Sweep
from agents.search.tried import COMPLETE, FAILED, PRUNED, REFUSED, Tried, best_of
from tests.agents.search.cheap import SMALL, cheap_trial


def deaf(told: object) -> None:
    del told


def worked(orders: Sequence[Order]) -> Iterator[Tried]:
    """The last first, as processes may have it."""
    for order in reversed(orders):
        yield replace(cheap_trial(order, deaf), seconds=0.0)


def tried(number: int, values: dict[int, float], state: str = COMPLETE) -> Tried:
    params = {"learning_rate": 1e-3, "n_epochs": 2, "hidden": [8]}
    value = max(values.values()) if state == COMPLETE else None
    return Tried(number, params, state, value, values, {}, "", 0.0)


class TestGenerations:
    def test_all_of_one_are_asked_for_before_any_is_told_of(self) -> None:
        asked: list[list[int]] = []

        def work(orders: Sequence[Order]) -> Iterator[Tried]:
            asked.append([order.number for order in orders])
            assert all(len(order.past) == orders[0].number for order in orders)
            yield from worked(orders)

        trials = carry_out(SMALL, {}, work)
        assert asked == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10, 11], [12, 13]]
        assert [each.number for each in trials] == list(range(14))

    def test_what_is_kept_is_not_done_again_and_changes_nothing(self) -> None:
        whole = carry_out(SMALL, {}, worked)
        kept = {number: whole[number] for number in (0, 1, 2, 3, 5, 6)}
        again: list[int] = []

        def work(orders: Sequence[Order]) -> Iterator[Tried]:
            again.extend(order.number for order in orders)
            yield from worked(orders)

        assert carry_out(SMALL, kept, work) == whole
        assert again == [4, 7, *range(8, 14)]

    def test_values_lie_in_the_space(self) -> None:
        sweep = replace(SMALL, trials=40)
        for each in carry_out(sweep, {}, worked):
            assert 1e-4 <= each.params["learning_rate"] <= 1e-2
            assert each.params["n_epochs"] in range(1, 10)
            assert isinstance(each.params["n_epochs"], int)
            assert each.params["hidden"] in ([8], [8, 8])

    def test_tpe_asks_for_better_ones_as_it_goes(self) -> None:
        sweep = replace(SMALL, trials=40, seed=0, pruner="none")
        values = [each.value for each in carry_out(sweep, {}, worked)]
        assert np.mean(values[-10:]) > 2.0 * np.mean(values[:10])

    @pytest.mark.parametrize("change", [{"seed": 1}, {"sampler": "random"}])
    def test_the_seed_and_the_sampler_decide(self, change: dict[str, object]) -> None:
        other = replace(SMALL, **change)
        first, second = carry_out(SMALL, {}, worked), carry_out(other, {}, worked)
        assert first[-1].params != second[-1].params
        assert second == carry_out(other, {}, worked)

    def test_refused_and_failed_trials_tell_the_sampler_nothing(self) -> None:
        whole = carry_out(SMALL, {}, worked)
        states = (COMPLETE, REFUSED, FAILED, COMPLETE)
        kept = {
            k: whole[k] if state == COMPLETE else replace(whole[k], state=state, value=None)
            for k, state in enumerate(states)
        }
        trials = carry_out(SMALL, kept, worked)
        assert [each.state for each in trials[:4]] == list(states)
        assert all(each.state in (COMPLETE, PRUNED) for each in trials[4:])

    def test_a_trial_that_was_not_asked_for_is_refused(self) -> None:
        other = replace(carry_out(SMALL, {}, worked)[2], params={"learning_rate": 1e-3})
        with pytest.raises(ValueError, match=r"trial 2 must be of .*another version"):
            carry_out(SMALL, {2: other}, worked)


class TestPruning:
    past = tuple(tried(k, {1: 0.1 * k, 2: 0.2 * k, 3: 0.3 * k}) for k in range(4))

    def watch(self, pruner: str, past: tuple[Tried, ...]) -> Watch:
        return Watch(Order(replace(SMALL, pruner=pruner), 4, {}, past))

    @pytest.mark.parametrize("pruner", ["median", "halving", "none"])
    def test_the_first_generation_is_never_pruned(self, pruner: str) -> None:
        watch = self.watch(pruner, ())
        assert not any(watch.prunes(look, 0.0) for look in (1, 2, 3))

    def test_below_the_median_a_trial_ends(self) -> None:
        assert self.watch("median", self.past).prunes(1, 0.14)
        watch = self.watch("median", self.past)
        assert not watch.prunes(1, 0.16)
        assert watch.prunes(2, 0.29)

    def test_pruned_trials_do_not_count_for_the_median(self) -> None:
        pruned = tuple(tried(k, {1: 9.0}, PRUNED) for k in range(4, 8))
        assert not self.watch("median", self.past + pruned).prunes(1, 0.16)

    def test_before_there_are_enough_nothing_is_pruned(self) -> None:
        assert not self.watch("median", self.past[:3]).prunes(1, 0.0)

    def test_halving_lets_the_best_quarter_of_a_rung_on(self) -> None:
        past = tuple(
            replace(each, rungs={"completed_rung_0": each.intermediate[1]}) for each in self.past
        )
        assert self.watch("halving", past).prunes(1, 0.25)
        watch = self.watch("halving", past)
        assert not watch.prunes(1, 0.31)
        assert watch.rungs == {"completed_rung_0": 0.31}

    def test_none_prunes_nothing(self) -> None:
        assert not self.watch("none", self.past).prunes(1, 0.0)

    @pytest.mark.parametrize("pruner", ["median", "halving"])
    def test_a_search_has_pruned_trials_but_none_of_the_first(self, pruner: str) -> None:
        trials = carry_out(replace(SMALL, pruner=pruner), {}, worked)
        assert {each.state for each in trials[:4]} == {COMPLETE}
        assert PRUNED in {each.state for each in trials[4:]}


class TestImportance:
    sweep = Sweep(
        trials=60,
        pruner="none",
        sampler="random",
        space={
            "learning_rate": Span(1e-4, 1e-2),
            "gae_lambda": Span(0.0, 1.0),
            "n_epochs": Span(1, 9),
            "hidden": Choices([[8], [8, 8]]),
        },
    )

    def test_what_counts_has_the_largest_share(self) -> None:
        shares = importance(self.sweep, carry_out(self.sweep, {}, worked))
        assert shares is not None
        assert next(iter(shares)) == "learning_rate"
        assert shares["learning_rate"] > 0.5
        assert sum(shares.values()) == pytest.approx(1.0)
        assert set(shares) == set(self.sweep.space)
        assert list(shares.values()) == sorted(shares.values(), reverse=True)

    def test_there_is_none_of_too_few_trials(self) -> None:
        sweep = replace(self.sweep, trials=FEWEST)
        trials = carry_out(sweep, {}, worked)
        assert importance(sweep, trials) is not None
        assert importance(sweep, trials[1:]) is None

    def test_there_is_none_where_most_are_equally_good(self) -> None:
        trials = carry_out(self.sweep, {}, worked)
        equal = [replace(each, value=0.0) for each in trials]
        assert importance(self.sweep, equal) is None
        assert importance(self.sweep, [replace(equal[0], value=1.0), *equal[1:]]) is None


def test_the_best_is_the_earliest_of_equals() -> None:
    trials = [
        tried(0, {1: 0.2}),
        tried(1, {1: 0.9}, PRUNED),
        tried(2, {1: 0.5}),
        tried(3, {1: 0.5}),
    ]
    assert best_of(trials) == trials[2]
    assert best_of(trials[1:2]) is None
