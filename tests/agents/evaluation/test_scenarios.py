"""Scenarios: starts, changed ones, offered streams, capacities, and what is measured there."""

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import SmartSurfaceVectorEnv
from surface_gym.agents.base import find_axes
from surface_gym.agents.evaluation import scenario as sc, streams as ss
from surface_gym.agents.evaluation.method import (
    Method,
    RollOn,
    all_methods,
    rules,
    shipped,
    start_benchmark,
    stream_benchmark,
)
from surface_gym.agents.evaluation.results import Sample, make_rows
from surface_gym.agents.planning.planner import RecedingHorizon
from surface_gym.agents.rollout import run_episodes
from surface_gym.agents.scheduling.maneuvers import ColumnGroups
from surface_gym.agents.scheduling.scheduler import entrance_bound
from surface_gym.config import PRESETS, EnvConfig, Preset
from surface_gym.core.batch import BaseBatch
from surface_gym.flow.arrivals import Arrival, Trace
from surface_gym.flow.stream import Stream
from surface_gym.flow.take_away import narrowest
from surface_gym.lines import Line
from surface_gym.parcel import Disc, Parcel, Rectangle, assortment
from surface_gym.registration import TASKS
from surface_gym.tasks import Slow
from tests.agents.rules.runs import Scripted, gated
from tests.conftest import only_begin

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
        assert counts == [len(benchmark.starts), 40, 12, 1]

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
        assert [each.name for each in ss.ladder()][:10] == [
            ss.ARRANGED, ss.FOLLOWED, ss.SERIES, ss.TRIPLES, ss.COLUMNS,
            ss.SIX_COLUMNS, ss.MODULES, ss.SIX_MODULES, ss.EVENT, ss.EACH,
        ]  # fmt: skip
        (first, *_) = ss.stream_scenarios("flow")
        for method in ss.ladder():
            config = first.config(method)
            assert len(config.chosen_orientations) == (6 if "six" in method.name else 4)
            assert config.stream_task.gate == ("gate" in method.arguments)

    def test_no_more_come_than_the_entrance_takes(self) -> None:
        event = named("flow", ss.EVENT)
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


@pytest.mark.parametrize("name", [ss.EVENT, ss.ARRANGED])
def test_what_comes_leaves_in_the_long_run(name) -> None:
    """To the parcel, as whole gaps count: every replication delivers what was offered."""
    found = offer(named("flow", name), 3000.0)
    assert (found.share_correct, found.rates) == (1.0, pytest.approx(3000.0, rel=0.12))
    assert (found.throughput, found.jams) == (pytest.approx(3000.0, rel=0.03), 0)


def test_every_method_meets_the_same_stream() -> None:
    """A third of it is to go straight on: so many are right with all axes at 90 deg."""
    event = named("flow", ss.EVENT)
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
    assert (jammed.jams, jammed.throughput) == (4, 0.0)


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


FAST = slope("flow", "S, 2 m/s, sides", replications=2)


def test_zones_are_as_long_as_lets_most_parcels_in(monkeypatch) -> None:
    known = {4: 3000.0, 5: 3500.0, 6: 3400.0, 7: 3300.0}
    tried = []

    def library(_: object, groups: Any, **__: float) -> Any:
        tried.append(groups.columns)
        right = np.array([groups.columns in known])
        return SimpleNamespace(correct=right, gaps=np.zeros(1), signature=right, groups=groups)

    monkeypatch.setattr(ss, "make_library", library)
    monkeypatch.setattr(ss, "predict_rate", lambda made, *_: known[made.groups.columns])
    # The best does not do without touches.
    monkeypatch.setattr(
        ss, "make_scheduler", lambda _, groups: groups if groups.columns != 5 else None
    )
    method = named("flow", ss.ARRANGED)
    assert method.controller(FAST.config(method), 0) == ColumnGroups(6, 1, exclusive=True)
    assert tried == [4, 5, 6, 7]


def test_a_method_that_cannot_sort_has_no_capacity(monkeypatch) -> None:
    monkeypatch.setattr(ss, "make_scheduler", lambda *_: None)
    found = measured(sc.ScenarioJob(FAST, named("flow", ss.MODULES), 0))
    assert (found.constant("actuators"), found.is_sustained) == (0, False)
    assert np.isnan(found.constant("best"))


def test_a_rung_is_measured_with_its_hardware() -> None:
    found = measured(sc.ScenarioJob(FAST, named("flow", ss.ARRANGED), 0))
    assert (found.constant("actuators"), found.constant("modules")) == (
        1,
        4 * found.constant("columns"),
    )
    assert found.constant("offered") == found.constant("bound")  # all that the entrance takes
    assert 0.9 < found.throughput / found.constant("best") < 1.1
    assert 0.3 < found.turns < 2.0  # the same exit may come twice


def test_the_scheduler_is_the_one_that_delivers_more(monkeypatch) -> None:
    late = gated(duration=12.0).replace(actuators=sg.Actuators(axis_speed=20.0, stuck_share=0.01))
    offered = [("slow", 3), ("prompt", 5)]
    monkeypatch.setattr(ss, "find_plain", lambda *_: offered.pop(0))
    monkeypatch.setattr(ss, "make_model_library", lambda *_: None)
    assert ss.make_best_scheduler(late, 0) == "prompt"


FIXED = rules("slow")[0]
BENCHMARK = start_benchmark("slow")
EVERYTHING_EXACT = sc.Change().preset


def true_of(change: sc.Change, method: Method = FIXED) -> EnvConfig:
    return sc.situation(method, start_benchmark(method.task), change).true


@pytest.mark.parametrize("task", ONE_PARCEL)
def test_no_change_is_as_trained(task) -> None:
    method = next(each for each in all_methods(task) if each.most is None)
    benchmark = start_benchmark(task)
    assumed, true = sc.situation(method, benchmark, sc.FACTORS[sc.TRAINED].change(sc.TRAINED))
    assert assumed == true
    config = method.config(benchmark.task, EVERYTHING_EXACT)
    for name in ("sensors", "control_period", "zone", "actuators", "randomisation", "actions"):
        assert getattr(true, name) == getattr(config, name)
    assert (true.chosen_line, true.task.periods) == (config.chosen_line, config.task.periods)
    assert true.task_name == task


def test_friction_is_unknown_and_axes_turn_by_90_deg_in_the_time_said() -> None:
    assumed, true = sc.situation(FIXED, BENCHMARK, sc.Change(drag=1.2, rolling=0.5))
    line = true.chosen_line
    assert (line.mu_max, line.mu_min, line.mu_support) == pytest.approx((0.6, 0.005, 0.0025))
    assert (assumed.chosen_line.mu_max, assumed.chosen_line.mu_min) == (0.5, 0.01)
    change = sc.FACTORS["axis"].change
    for asked in (25, 200):
        speed = true_of(change(asked)).actuators.axis_speed
        assert 0.5 * math.pi / speed == pytest.approx(1e-3 * asked)
    assert true_of(change(0)) == true_of(sc.Change())
    for period in (0.02, 0.06, 0.12):  # an episode may last as long whatever the period
        config = true_of(sc.Change(control_period=period))
        assert config.control_period == period
        assert period * config.task.periods == pytest.approx(0.04 * 100, abs=0.5 * period)


@pytest.mark.parametrize(("columns", "longer"), [(8, 1.0), (16, 1.0), (24, 1.5)])
def test_a_zone_has_as_many_columns_behind_it_and_an_episode_may_last_longer(
    columns, longer
) -> None:
    assumed, true = sc.situation(FIXED, BENCHMARK, sc.Change(zone_columns=columns))
    assert assumed == true
    line = true.chosen_line
    assert isinstance(line, Line)
    assert true.action_kind.columns == line.zone_columns == columns
    assert line.columns - line.zone_columns == Line().columns - Line().zone_columns
    assert true.task.periods == longer * Slow.periods


@pytest.mark.parametrize("task", ONE_PARCEL)
def test_entries_are_aside_and_turned_by_just_so_much(task) -> None:
    poses = []
    for change in (sc.Change(), sc.Change(offset=0.03, turn=0.1)):
        true = true_of(change, rules(task)[0])
        env = SmartSurfaceVectorEnv(64, task=true.task, actions=true.actions, line=true.line)
        poses.append(env.reset(seed=1)[1]["pose"])
    off = poses[1] - poses[0]
    np.testing.assert_allclose(np.abs(off[:, 1]), 0.03, atol=1e-12)
    np.testing.assert_allclose(off[:, 2], off[:, 1] / 0.3, atol=1e-12)
    np.testing.assert_allclose(off[:, 0], 0.0, atol=1e-12)
    assert 0.25 < np.mean(off[:, 1] > 0.0) < 0.75


def test_modules_that_share_weights_run_on_any_zone() -> None:
    modules = named("sort", "PPO per module")
    for columns in (8, 20):
        assumed, true = sc.situation(
            modules, start_benchmark("sort"), sc.Change(zone_columns=columns)
        )
        starts = [{"speed": 1.5, "parcel": "S", "side": side} for side in (1, -1)]
        assert run_episodes(modules.controller(assumed, 0), true, starts, 0).success.all()


def test_loads_lie_off_centre_in_every_direction_and_boxes_are_drawn_as_ever() -> None:
    parcels = sc.FACTORS["load"].change(5).preset.parcels
    offsets = np.array([parcel.com_offset for parcel in parcels])
    np.testing.assert_allclose(np.hypot(*offsets.T), 0.05)
    np.testing.assert_allclose(offsets.sum(axis=0), 0.0, atol=1e-12)
    half = len(parcels) // 2
    assert {parcel.rear for parcel in parcels[:half]} == {0.125}
    assert {parcel.rear for parcel in parcels[half:]} == {0.225}


@pytest.mark.parametrize("factor", sc.FACTORS.values(), ids=sc.FACTORS)
def test_each_level_makes_an_environment_and_the_trained_one_changes_nothing(factor) -> None:
    assert set(factor.shown) <= set(factor.swept)
    assert list(factor.levels) == sorted(factor.levels) or isinstance(factor.levels[0], str)
    for task in ONE_PARCEL:
        if factor.of_lines and task in ("track", "park"):  # on fields
            continue
        for level in (factor.levels[0], factor.levels[-1]):
            config = true_of(factor.change(level), rules(task)[0])
            assert config.observation_space().shape
    if factor.trained is not None:
        assert factor.trained in factor.levels
        trained, task = true_of(factor.change(factor.trained)), Slow()
        assert set(trained.task.parcels) == set(task.parcels)  # some more often than once
        assert replace(trained, task=task) == replace(true_of(sc.Change()), task=task)


def test_other_starts_make_other_results_and_slow_methods_run_on_fewer() -> None:
    planner = named("slow", "planner")
    counts = [
        sc.ChangedScenario("slow", "exact", sc.Extent(level_starts=starts), "lab", "lab").episodes(
            method
        )
        for method, starts in ((planner, 240), (planner, 5), (FIXED, 240))
    ]
    assert counts == [40, 1, 240]


def test_the_planner_sees_the_truth() -> None:
    """By observation it takes squares of 0.5 m, partly on supports, to brake as boxes do."""
    planner = named("stop", "planner")
    at = sc.ChangedScenario("stop", "exact", sc.Extent(level_starts=18), "square", 0.5)
    found = measured(sc.ScenarioJob(at, planner, 0))
    assert found.success.tolist() == [[True] * 3]
    metric = start_benchmark("stop").task.metrics[0]
    assert np.median(found.metric(metric)) < 1e-3  # [m]


@pytest.mark.parametrize("task", ONE_PARCEL)
def test_methods_that_run_on_any_parcel(task) -> None:
    jobs = sc.make_jobs(sc.changed_scenarios(task, sc.WHOLE), all_methods(task))
    assert len({job.key for job in jobs}) == len(jobs)
    tried: dict[str, set[str]] = {}
    for job in jobs:
        assert isinstance(job.scenario, sc.ChangedScenario)
        tried.setdefault(job.method.name, set()).add(job.scenario.factor)
    assert not tried.keys() & set(sc.LEFT_OUT)
    agents = set() if task == "park" else {"PPO", "DQN"}  # no agent is shipped for Park
    assert {"fixed layout", sc.PLANNER} | agents <= tried.keys()
    wanted = set(sc.FACTORS) - ({"zone"} if task in ("track", "park") else set())
    for name, factors in tried.items():
        assert factors == (set(sc.PLANNED) if name == sc.PLANNER else wanted)


@pytest.mark.usefixtures("uncompiled")
def test_shapes_of_the_lab() -> None:
    bases = (Rectangle(0.2, 0.2), Rectangle(0.2, 0.3), Disc(0.2))
    assert [*map(sc.name_shape, bases)] == ["square", "rectangle", "disc"]
    assert set(sc.lab_shapes("sort", 64)) == set(sc.SHAPES)


def test_rows_name_the_shapes_of_the_lab(monkeypatch) -> None:
    with monkeypatch.context() as patch:  # they are kept, and drawing them needs no kernel
        patch.setattr(BaseBatch, "_compile", lambda _: only_begin)
        shapes = list(sc.lab_shapes("slow", 6))
    at = sc.ChangedScenario("slow", "lab", sc.Extent(level_starts=6), "lab", "lab")
    rows = sc.ScenarioJob(at, shipped("slow")[0], 0)()
    assert [row["shape"] for row in rows] == shapes
