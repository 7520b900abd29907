"""What differs from episode to episode: bounds and laws of each draw."""

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

import surface_gym as sg
from surface_gym.randomisation import RandomDraw, Randomisation
from surface_gym.tasks.start import Start
from tests.environments import PARCELS, assert_same, bare, batch_with, steps

COUNT = 2000
SHAPE = (20, 30)
LOOSE = 1e-3  # a law is doubted below this p-value; the seeds are fixed

BOX = sg.Parcel(sg.Rectangle(0.4, 0.2), mass=8.0)


SPREADS = {
    "friction": 0.3, "rolling": 0.9, "mass": 0.5, "size": 0.2, "com_offset": 0.2,
    "stiffness": 0.5, "lateral": 0.02, "heading": 0.1,
}  # fmt: skip


def draws(parcel: sg.Parcel = BOX, count: int = COUNT, **spreads: float) -> list[RandomDraw]:
    rng = np.random.default_rng(0)
    randomisation = Randomisation(**spreads)
    return [randomisation.draw(rng, parcel, SHAPE) for _ in range(count)]


def assert_uniform(values: Any, low: float, high: float) -> None:
    values = np.array(values)
    assert values.min() >= low
    assert values.max() <= high
    assert stats.kstest(values, stats.uniform(low, high - low).cdf).pvalue > LOOSE


def assert_normal(values: Any, mean: float, spread: float) -> None:
    assert stats.kstest(np.array(values), stats.norm(mean, spread).cdf).pvalue > LOOSE


class TestLaws:
    def test_nothing_varies_by_default(self):
        rng = np.random.default_rng(0)
        drawn = Randomisation().draw(rng, BOX, SHAPE)
        assert drawn == RandomDraw(BOX, 0.0, 0.0, (1.0, 1.0, 1.0), None)
        assert rng.bit_generator.state == np.random.default_rng(0).bit_generator.state

    def test_friction_and_rolling_of_rotors_and_of_supports_each_on_its_own(self):
        drawn = draws(friction=0.2, rolling=0.5)
        factors = np.array([each.friction for each in drawn]).T
        for values, spread in zip(factors, (0.2, 0.5, 0.5), strict=True):
            assert_uniform(values, 1.0 - spread, 1.0 + spread)
        assert np.abs(np.corrcoef(factors) - np.eye(3)).max() < 0.1
        assert all(each.parcel == BOX and each.stiffness is None for each in drawn)

    def test_mass_varies_how_hard_the_parcel_is_to_turn(self):
        parcels = [each.parcel for each in draws(mass=0.3)]
        assert_uniform([parcel.mass for parcel in parcels], 8.0 * 0.7, 8.0 * 1.3)
        for parcel in parcels:
            assert parcel.moment_of_inertia == pytest.approx(BOX.moment_of_inertia)
            assert parcel.base == BOX.base
            assert parcel.com_offset == (0.0, 0.0)

    def test_size_scales_the_base_and_what_lies_on_it(self):
        heavy = sg.Parcel(BOX.base, mass=8.0, com_offset=(0.04, -0.02), inertia=0.5)
        parcels = [each.parcel for each in draws(heavy, size=0.25)]
        lengths = np.array([parcel.base.length for parcel in parcels])
        assert_uniform(lengths, 0.3, 0.5)
        for parcel, factor in zip(parcels, lengths / 0.4, strict=True):
            assert parcel.base.width == pytest.approx(0.2 * factor)
            assert parcel.mass == 8.0
            assert parcel.com_offset == pytest.approx((0.04 * factor, -0.02 * factor))
            assert parcel.moment_of_inertia == pytest.approx(0.5 * factor**2)

    @pytest.mark.parametrize("name", PARCELS)
    def test_size_keeps_the_shape_of_any_base(self, name):
        parcel = PARCELS[name]
        for each in draws(parcel, count=20, size=0.2):
            base = each.parcel.base
            factor = base.reach / parcel.base.reach
            assert 0.8 <= factor <= 1.2
            np.testing.assert_allclose(base.outline, factor * parcel.base.outline)
            assert base.gyration == pytest.approx(factor**2 * parcel.base.gyration)

    def test_centre_of_mass(self):
        x, y = np.array([each.parcel.com_offset for each in draws(com_offset=0.3)]).T
        assert_uniform(x, -0.3 * 0.2, 0.3 * 0.2)
        assert_uniform(y, -0.3 * 0.1, 0.3 * 0.1)
        assert abs(np.corrcoef(x, y)[0, 1]) < 0.1

    @pytest.mark.parametrize("name", PARCELS)
    @pytest.mark.parametrize("share", [0.3, 0.9])
    def test_centre_of_mass_stays_over_any_base(self, name, share):
        for each in draws(PARCELS[name], count=200, com_offset=share, size=0.1):
            parcel = each.parcel
            assert parcel.base.functions(*parcel.centre_of_mass).max() <= 0.0

    def test_stiffness_is_log_normal_element_by_element_and_entries_are_normal(self):
        drawn = np.array([each.stiffness for each in draws(count=20, stiffness=0.4)])
        assert drawn.shape == (20, *SHAPE)
        assert_normal(np.log(drawn).ravel(), 0.0, 0.4)
        assert len(np.unique(drawn)) == drawn.size
        drawn = draws(lateral=0.02, heading=0.1)
        assert_normal([each.aside for each in drawn], 0.0, 0.02)
        assert_normal([each.turned for each in drawn], 0.0, 0.1)

    def test_what_is_drawn_is_added_to_the_start(self):
        start = Start(BOX, (0.3, 1.0, 0.1), (1.0, 0.2, 0.3), (1.0,))
        batch = batch_with(start, randomisation=Randomisation(lateral=0.02, heading=0.1))
        drawn = Randomisation(lateral=0.02, heading=0.1).draw(np.random.default_rng(0), BOX, SHAPE)
        x, y, theta = batch.view(0).truth[:3]
        assert (x, y, theta) == (0.3, 1.0 + drawn.aside, 0.1 + drawn.turned)
        assert tuple(batch.view(0).truth[3:]) == pytest.approx((1.0, 0.2, 0.3))

    @pytest.mark.parametrize("name", SPREADS)
    def test_bad_spreads_are_named(self, name):
        most = {"mass": 0.999, "size": 0.999, "stiffness": 2.1, "lateral": 1e9, "heading": 3.2}
        for spread in (-0.1, most.get(name, 1.0), math.nan, math.inf, True, "0.1", None):
            with pytest.raises(ValueError, match=f"^{name} must"):
                Randomisation(**{name: spread})


class TestInTheEnvironment:
    @pytest.mark.parametrize("name", SPREADS)
    def test_each_changes_what_happens_and_the_seed_fixes_it(self, name):
        varied = Randomisation(**{name: SPREADS[name]})
        runs = [
            list(steps(bare(actions="quadrants", **settings), seed=4))
            for settings in ({}, {"randomisation": varied}, {"randomisation": varied})
        ]
        plain, first, second = runs
        assert_same(tuple(first), tuple(second))
        last = min(len(plain), len(first)) - 1
        assert (plain[last][4]["pose"] != first[last][4]["pose"]).any()

    def test_rolling_scales_the_loss_on_the_conveyor(self):
        varies = Randomisation(rolling=0.5)
        envs = sg.SmartSurfaceVectorEnv(200, actions="halves", randomisation=varies)
        start = envs.reset(seed=0, options={"speed": 1.0, "parcel": "S"})[1]["velocity"][:, 0]
        for _ in range(3):
            info = envs.step(np.full(200, 15))[4]
        losses = (start - info["velocity"][:, 0]) / info["time"]
        assert min(losses) > 0.5 * 0.005 * 9.81
        assert max(losses) < 1.5 * 0.01 * 9.81
        assert np.std(losses) > 0.1 * np.mean(losses)

    def test_any_parcel_may_be_varied(self):
        varies = Randomisation(com_offset=0.8, size=0.1, mass=0.5, heading=1.0)
        envs = sg.SmartSurfaceVectorEnv(20, actions="halves", randomisation=varies)
        for parcel in PARCELS.values():
            envs.reset(seed=0, options={"parcel": parcel})
            assert np.isfinite(envs.step(np.zeros(20, dtype=int))[0]).all()


class TestLateral:
    def test_a_start_beside_the_surface_is_drawn_again(self):
        varies = Randomisation(lateral=0.3)
        rng = np.random.default_rng(0)
        aside = [varies.draw_entry(rng, BOX, (-0.1, 0.2))[1] for _ in range(200)]
        rng = np.random.default_rng(0)
        anywhere = [varies.draw_entry(rng, BOX)[1] for _ in range(2000)]
        assert aside == [each for each in anywhere if -0.1 <= each <= 0.2][:200]

    def test_it_is_the_centre_of_mass_that_counts(self):
        off_centre = sg.Parcel(sg.Rectangle(0.3, 0.3), com_offset=(0.0, 0.05))
        varies, rng = Randomisation(lateral=0.3), np.random.default_rng(0)
        aside = [varies.draw_entry(rng, off_centre, (-0.1, 0.2))[1] for _ in range(200)]
        assert -0.05 <= min(aside) < -0.04
        assert 0.14 < max(aside) <= 0.15

    def test_too_little_room_is_told(self):
        rng = np.random.default_rng(0)
        with pytest.raises(ValueError, match=r"^lateral must leave a parcel over the surface"):
            Randomisation(lateral=0.3).draw_entry(rng, BOX, (0.1, 0.05))

    def test_every_environment_starts_on_the_surface_or_it_is_too_narrow(self):
        line, varies = sg.lines.Line(rows=8, line_y=0.4), Randomisation(lateral=0.2, heading=1.0)
        envs = sg.SmartSurfaceVectorEnv(300, randomisation=varies, line=line)
        aside = envs.reset(seed=0)[1]["pose"][:, 1] - line.line_y
        assert 0.35 < np.abs(aside).max() <= 0.4
        with pytest.raises(ValueError, match=r"^lateral must be at most a quarter of .*, 0\.2 m"):
            sg.SmartSurfaceEnv(randomisation=Randomisation(lateral=0.21), line=line)


def test_the_smallest_parcel_must_be_one():
    small = sg.tasks.Sort(parcels=(sg.Parcel(sg.Rectangle(0.001, 0.2)),))
    with pytest.raises(ValueError, match=r"^size must leave room .*, got 0\.95: length"):
        sg.SmartSurfaceEnv(small, randomisation=Randomisation(size=0.95))
