"""Scenarios: starts, offered streams, capacities, and what is measured there."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import SmartSurfaceVectorEnv
from surface_gym.agents.base import find_axes
from surface_gym.agents.evaluation import ladder, scenario as sc, stream_scenario as ss
from surface_gym.agents.evaluation.method import (
    Method,
    RollOn,
    all_methods,
    rules,
    start_benchmark,
    stream_benchmark,
)
from surface_gym.agents.evaluation.results import Sample, make_rows
from surface_gym.agents.planning.planner import RecedingHorizon
from surface_gym.agents.scheduling.scheduler import entrance_bound
from surface_gym.config import PRESETS, EnvConfig, Preset
from surface_gym.flow.arrivals import Arrival, Trace
from surface_gym.flow.stream import Stream
from surface_gym.flow.take_away import narrowest
from surface_gym.parcel import Parcel, assortment
from surface_gym.registration import TASKS
from tests.agents.rules.runs import Scripted

LAB = PRESETS["lab"]
PARCELS_ALONE = Preset("parcels", "parcels", "The lab's parcels.", parcels=LAB.parcels)
ONE_PARCEL = [name for name, kind in TASKS.items() if not kind.is_stream]
SLOPES = ("singulate", "merge", "sequence")
SMALL = sc.Extent(replications=4)


def measured(job: sc.ScenarioJob) -> Sample:
    return Sample(make_rows(job()))


def slope(task: str, name: str, preset: str = "exact", **extent: Any) -> ss.StreamScenario:
    return ss.StreamScenario(task, preset, sc.Extent(**extent), name)


def named(task: str, name: str) -> Method:
    return next(each for each in all_methods(task) if each.name == name)


class TestStarts:
    @pytest.mark.parametrize("task", ONE_PARCEL)
    def test_a_preset_with_parcels_leaves_them_open_and_keeps_the_rest(self, task) -> None:
        benchmark = start_benchmark(task)
        assert sc.choose_starts(benchmark, None, PRESETS["camera"]) is benchmark.starts
        opened = sc.choose_starts(benchmark, None, LAB)
        assert len(opened) == len(benchmark.starts) > 480
        for before, after in zip(benchmark.starts, opened, strict=True):
            assert {**after, "parcel": before.get("parcel")} == {"parcel": None, **before}
            assert "parcel" not in after

    def test_some_are_spread_evenly(self) -> None:
        benchmark = start_benchmark("sort")
        some = sc.choose_starts(benchmark, 3, PRESETS["exact"])
        assert [start["parcel"] for start in some] == ["S", "B", "B"]
        assert (some[0], some[-1]) == (benchmark.starts[0], benchmark.starts[-1])
        counts = [
            sc.start_scenarios("sort", extent)[0].episodes(method)
            for extent in (sc.WHOLE, sc.QUICK)
            for method in (named("sort", "fixed layout"), named("sort", "planner"))
        ]
        assert counts == [len(benchmark.starts), 40, 12, 2]

    def test_parcels_are_those_that_the_environment_draws(self) -> None:
        """A parcel enters with its rear at x = 0; a start that names its parcel has it."""
        starts = sc.choose_starts(start_benchmark("sort"), None, LAB)[::7]
        drawn = sc.drawn_parcels(EnvConfig(preset=PARCELS_ALONE), starts, sc.SEED)
        env = SmartSurfaceVectorEnv(len(starts), preset=PARCELS_ALONE)
        _, info = env.reset(seed=sc.SEED, options=list(starts))
        from_rear = [parcel.base.centroid[0] - parcel.base.outline[:, 0].min() for parcel in drawn]
        np.testing.assert_allclose(info["pose"][:, 0], from_rear, atol=1e-12)
        assert len(set(drawn)) > 0.3 * len(starts)
        boxes = sc.drawn_parcels(EnvConfig("sort", preset=LAB), [{"parcel": "S"}] * 3, sc.SEED)
        assert [parcel.rear for parcel in boxes] == [0.125] * 3

    def test_sort_in_the_lab(self) -> None:
        event = next(rule for rule in rules("sort") if rule.name == "event rule")
        sample = measured(sc.ScenarioJob(sc.StartScenario("sort", "lab", sc.WHOLE), event, 0))
        assert sample.success.shape == (1, len(start_benchmark("sort").starts))
        assert sample.rate > 0.9
        assert 3.0 < np.median(sample.metric("columns")) < 16.0


class TestOffers:
    @pytest.mark.parametrize("task", [name for name, kind in TASKS.items() if kind.is_stream])
    def test_every_method_acts_under_every_scenario(self, task) -> None:
        jobs = sc.make_jobs(
            ss.stream_scenarios(task, groups=("sides", "chutes")), all_methods(task)
        )
        assert len({job.key for job in jobs}) == len(jobs)
        for job in jobs:
            at = job.scenario
            assert isinstance(at, ss.StreamScenario)
            config = at.config(job.method)
            assert config.task_name == task
            assert job.method.kind in at.offer.kinds
            sizes = {each.base for each, _ in config.stream_task.stream.parcels}
            assert (len(sizes) == ss.NEVER_SEEN) == (at.preset == "lab")
            knows = job.method.kind == "planner"
            assert (config.sensors == sg.sensors.Exact()) == (knows or at.preset == "exact")

    def test_rungs_have_hardware_of_their_own(self) -> None:
        assert [each.name for each in ladder.ladder()][:10] == [
            ladder.ARRANGED, ladder.FOLLOWED, ladder.SERIES, ladder.TRIPLES, ladder.COLUMNS,
            ladder.SIX_COLUMNS, ladder.MODULES, ladder.SIX_MODULES, ladder.EVENT, ladder.EACH,
        ]  # fmt: skip
        (first, *_) = ss.stream_scenarios("flow")
        for method in ladder.ladder():
            config = first.config(method)
            assert len(config.chosen_orientations) == (6 if "six" in method.name else 4)
            assert config.stream_task.gate == ("gate" in method.arguments)

    def test_no_more_come_than_the_entrance_takes(self) -> None:
        event = named("flow", ladder.EVENT)
        known = {"S, 1.5 m/s, sides": 1.5 / 0.27, "S and B, 1 m/s, chutes": 1.0 / 0.37}
        for offered, rate in known.items():
            config = slope("flow", offered).config(event)
            assert entrance_bound(config) == pytest.approx(3600.0 * rate)
            assert config.stream_task.stream.arrivals.rate == pytest.approx(3600.0 * rate)

    def test_lines_that_no_agent_knows_are_offered_what_the_entrance_takes(self) -> None:
        offers = stream_benchmark("flow").held_out
        assert len({each.name for each in offers}) == len(offers) == 17
        for job in ss.unseen_jobs("flow"):
            config = job.scenario.config(job.method)
            assert config.stream_task.gate
            assert config.stream_task.stream.arrivals.rate == pytest.approx(entrance_bound(config))

    def test_a_quick_comparison_has_the_stream_on_film(self) -> None:
        (only,) = ss.stream_scenarios("flow", sc.QUICK)
        assert (only.name, only.preset) == ("S and B, 1.5 m/s, sides", "exact")

    def test_the_bound_is_the_packing_of_the_take_away(self) -> None:
        config = slope("singulate", "anywhere across").config(named("singulate", "roll on"), 900.0)
        box = Parcel(sg.Rectangle(0.4, 0.2))
        stream = replace(config.stream_task.stream, parcels=((box, 1.0),))
        one, two = (config.replace(stream=stream, exits=exits) for exits in ("end", "mouths"))
        assert one.stream_task.rate_bound(one) == pytest.approx(3600.0 * 2.0 / 0.5)
        assert two.stream_task.rate_bound(two) == pytest.approx(2.0 * 3600.0 * 2.0 / 0.5)
        recorded = Stream(Trace((Arrival(0.0, box, 0.8, config.exits.names[0]),)))
        trace = config.replace(stream=recorded, exits="end")
        assert trace.stream_task.rate_bound(trace) == pytest.approx(3600.0 * 2.0 / 0.5)

    def test_the_narrowest_extent_is_the_least_over_all_angles(self) -> None:
        angles = np.linspace(0.0, math.pi, 20_001)
        ways = np.stack([np.cos(angles), np.sin(angles)])
        for parcel in (*assortment(12, 3, load=0.0), Parcel(sg.Rectangle(0.4, 0.25))):
            least = np.ptp(parcel.base.outline @ ways, axis=0).min()
            if not len(parcel.body.edges):
                least = 2.0 * parcel.base.reach
            assert narrowest(parcel) == pytest.approx(least, rel=2e-4)


class TestMeasurements:
    def test_an_order_is_asked_at_the_highest_rate_at_which_it_holds(self, monkeypatch) -> None:
        at = slope("sequence", "window of 2", replications=2, duration=10.0)
        offer = replace(at.offer, rates=(1200.0, 600.0))
        monkeypatch.setattr(ss.StreamScenario, "offer", offer)
        found = measured(sc.ScenarioJob(at, named("sequence", "pass and park"), 0))
        assert found.share_correct == 1.0
        assert found.throughput > 600.0
        assert (
            measured(sc.ScenarioJob(at, named("sequence", "roll on"), 0)).share_correct
            < ss.IN_ORDER
        )

    def test_a_planner_sees_all_that_comes(self, monkeypatch) -> None:
        monkeypatch.setattr(RecedingHorizon.__init__, "__defaults__", (2, 10, 10, 0))
        at = slope("merge", "three lines", "camera", duration=4.0, replications=2)
        planner = named("merge", "planner")
        assert measured(sc.ScenarioJob(at, planner, 0)).values("delivered").shape == (1, 2)

    def test_a_jam_in_which_parcels_tremble_is_seen(self, monkeypatch) -> None:
        monkeypatch.setattr(ss, "QUIET", 5.0)
        config = slope("merge", "three lines", duration=10.0).config(named("merge", "roll on"))

        class Tremble(RollOn):
            """Brake all, but let them roll for one control period in 25."""

            period = 0

            def predict(self, observation, *_, **__):
                self.period += 1
                rolls, _ = super().predict(observation)
                return rolls * (self.period % 25 == 0), None

        batch = ss.play_stream(config, Tremble(config), 2)
        assert (batch.outcome != ss.JAM).all()
        assert ss.find_jams(batch).all()
        assert not ss.find_jams(ss.play_stream(config, RollOn(config), 2)).any()

    @pytest.mark.parametrize("rate", [500.0, 1234.0, 3600.0, 20000.0])
    def test_what_counts_are_whole_gaps_after_the_warm_up(self, rate) -> None:
        counted = ss.counted_time(30.0, rate, 8.0)
        gaps = counted * rate / 3600.0
        assert gaps == pytest.approx(round(gaps))
        assert 22.0 - 3600.0 / rate < counted <= 22.0 + 1e-9
        # One at least.
        assert ss.counted_time(30.0, 150.0, 8.0) == pytest.approx(24.0)
        assert ss.counted_time(30.0, 10.0, 8.0) == 30.0

    @pytest.mark.parametrize(
        ("least", "correct", "jam", "expected"),
        [
            (0.999, 999, 0, True), (0.999, 998, 0, False), (0.999, 1000, 1, False),
            (0.995, 995, 0, True), (0.995, 994, 0, False), (0.999, 0, 0, False),
        ],
    )  # fmt: skip
    def test_what_is_sustained(self, least, correct, jam, expected) -> None:
        delivered = 1000 if correct else 0
        rows = [{"correct": correct, "delivered": delivered, "jam": jam}]
        assert ss.is_sustained(rows, least) is expected


CASE = slope("flow", "S, 1.5 m/s, sides", replications=4)


def offer(method: Method, rate: float, least: float = 0.0, controller: Any = None) -> Any:
    config = CASE.config(method, rate)
    rows = CASE._measure(method, config, controller or method.controller(config, 0), least)
    return Sample(make_rows([{"seed": 0, **row} for row in rows])) if rows else None


@pytest.mark.parametrize("name", [ladder.EVENT, ladder.ARRANGED])
def test_what_comes_leaves_in_the_long_run(name) -> None:
    """To the parcel, as whole gaps count: every replication delivers what was offered."""
    found = offer(named("flow", name), 3000.0)
    assert (found.share_correct, found.rates) == (1.0, pytest.approx(3000.0, rel=0.12))
    assert (found.throughput, found.jams) == (pytest.approx(3000.0, rel=0.03), 0)


def test_every_method_meets_the_same_stream() -> None:
    """A third of it is to go straight on: so many are right with all axes at 90 deg."""
    event = named("flow", ladder.EVENT)
    config = CASE.config(event, 3000.0)
    roll = Scripted([[[find_axes(config).roll] * config.action_kind.size]] * 4)
    held, rule = offer(event, 3000.0, controller=roll), offer(event, 3000.0)
    delivered = (each.values("delivered")[0] for each in (held, rule))
    assert next(delivered) == pytest.approx(next(delivered), abs=3)
    assert 0.15 < held.share_correct < 0.55
    # A lost rate is broken off; braked parcels jam.
    assert offer(event, 3000.0, 0.999, controller=roll) is None
    brake = Scripted([[[0] * config.action_kind.size]] * 4)
    jammed = offer(event, 9000.0, controller=brake)
    assert (jammed.jams, jammed.throughput, jammed.waiting) == (4, 0.0, pytest.approx(0.0))


def search(
    known: Callable[[float], list[sc.Row]], gate: bool
) -> tuple[list[sc.Row] | None, list[float]]:
    """The greatest rate, and all that were tried, where a measurement is known by its rate."""
    tried: list[float] = []

    def sustained(rate: float) -> list[sc.Row] | None:
        tried.append(rate)
        rows = known(rate)
        return rows if ss.is_sustained(rows, 0.999) else None

    return ss.find_capacity(sustained, 20_000.0, gate), tried


def delivery(rate: float, correct: float, delivered: float) -> list[sc.Row]:
    return [
        {
            "offered": rate,
            "correct": correct,
            "delivered": delivered,
            "counted": 3.6e6,
            "jam": False,
        }
    ]


@pytest.mark.parametrize("carried", [5000.0, 9000.0, 17000.0])
def test_without_a_gate_more_may_be_delivered_where_fewer_come(carried) -> None:
    """Beyond what is carried parcels hinder each other: less is delivered the more come."""

    def known(rate: float) -> list[sc.Row]:
        count = round(1000.0 * (rate if rate <= carried else carried - 0.1 * (rate - carried)))
        return delivery(rate, count, count)

    found, _ = search(known, gate=False)
    assert found is not None
    assert carried / 1.03 <= found[0]["correct"] / 1000.0 <= carried


@pytest.mark.parametrize("share", [math.inf, 0.99, 0.7, 0.3, 0.07, 0.9 * ss.LEAST])
def test_the_greatest_rate_is_found_to_two_in_a_hundred(share) -> None:
    """What the entrance takes comes first; below the least rate there is no capacity."""
    most = share * 20_000.0
    found, tried = search(lambda rate: delivery(rate, 1000 if rate <= most else 500, 1000), True)
    if share < ss.LEAST:
        assert found is None
        assert min(tried) == pytest.approx(ss.LEAST * 20_000.0)
    else:
        assert found is not None
        offered = found[0]["offered"]
        assert tried == [offered] if math.isinf(share) else most / 1.02 <= offered <= most
        assert len(tried) <= 12
