"""What a design is for: a parcel, how it comes, what is asked, and what is not known of it."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks
from surface_gym.design.line import DesignLine, line_for
from surface_gym.design.purposes import Purpose, Sort
from surface_gym.design.runs import STEP, Runs, make_runs
from surface_gym.parcel import Parcel
from surface_gym.randomisation import RandomDraw, Randomisation

Booleans = NDArray[np.bool_]
Numbers = NDArray[np.float64]

WORST = 0.05  # share of the draws that may do worse than what is said of the worst

# What is not known, in the groups that answers are told for: names of `Unknown`'s fields.
GROUPS = {
    "friction": ("friction", "rolling"),
    "load": ("com_offset", "mass"),
    "unevenness": ("stiffness",),
    "entry": ("lateral", "heading", "speed", "tilt"),
}
TOGETHER = "together"


@dataclass(frozen=True)
class Unknown(Randomisation):
    """Spreads of what is not known when the surface is designed. Friction, load and unevenness vary
    by default; 0.35 stands for supports uneven by about 1 micrometre (docs/validation.md).
    """

    friction: float = 0.2  # [-] mu_max times uniform(1 - friction, 1 + friction)
    rolling: float = 0.2  # [-] mu_min and mu_support, each times uniform(1 - rolling, 1 + rolling)
    com_offset: float = 0.1  # [-] centre of mass, within this share of half the base's extent
    stiffness: float = 0.35  # [-] log-normal spread of each element's
    speed: float = 0.0  # [m/s] normal spread of the entry speed
    tilt: float = 0.0  # [rad] normal spread of the surface's tilt

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.size:
            raise ValueError(f"size must be 0, got {self.size!r}: a map goes over sizes")
        checks.not_negative("speed", self.speed, 20.0)
        checks.not_negative("tilt", self.tilt, math.pi / 4)

    def only(self, group: str) -> "Unknown":
        """The same with nothing unknown but a group of `GROUPS`; `TOGETHER` is all of them."""
        if group == TOGETHER:
            return self
        names = GROUPS[checks.one_of("group", group, (*GROUPS, TOGETHER))]
        return replace(NOTHING, **{name: getattr(self, name) for name in names})

    @property
    def groups(self) -> tuple[str, ...]:
        """Those in which something varies, and `TOGETHER`."""
        varying = tuple(group for group in GROUPS if self.only(group) != NOTHING)
        return (*varying, TOGETHER) if varying else ()


MOST_DRAWS = 1_000_000  # of what is not known: a run each
NOTHING = Unknown(friction=0.0, rolling=0.0, com_offset=0.0, stiffness=0.0)


@dataclass(frozen=True)
class Case:
    """What a design is for.

    Raises:
        ValueError: a field that is not allowed, or a parcel that nothing moves.
    """

    parcel: Parcel
    purpose: Purpose = field(default_factory=Sort)
    speed: float = 1.0  # [m/s] at which it enters, along the line
    tilt: float = 0.0  # [rad] of the surface, downhill towards +x
    unknown: Unknown = field(default_factory=Unknown)
    draws: int = 100  # of what is not known
    seed: int = 0  # of the draws
    pitch: float | tuple[float, float] = 0.1  # [m] between neighbours: one, or in x and in y
    mu_max: float = 0.5  # [-] friction along a rotor's axis
    mu_min: float = 0.01  # [-] friction across it
    mu_support: float = 0.005  # [-] friction of a support
    step: float = STEP  # [s] of a run

    def __post_init__(self) -> None:
        if not isinstance(self.parcel, Parcel):
            raise ValueError(f"parcel must be a Parcel, got {self.parcel!r}")
        if not isinstance(self.purpose, Purpose):
            raise ValueError(f"purpose must be a Purpose, got {self.purpose!r}")
        if not isinstance(self.unknown, Unknown):
            raise ValueError(f"unknown must be an Unknown, got {self.unknown!r}")
        checks.within("speed", self.speed, 0.0, 20.0)
        if not 0.0 <= checks.number("tilt", self.tilt) < math.pi / 4:
            raise ValueError(f"tilt must be from 0 to below pi/4 (45 deg), got {self.tilt!r}")
        if self.speed == 0.0 and self.tilt == 0.0:
            raise ValueError("speed must be greater than 0 on a level surface, got 0.0")
        checks.integer("draws", self.draws, least=1, most=MOST_DRAWS)
        checks.integer("seed", self.seed, least=0)
        checks.within("step", self.step, 1e-5, 0.02)

    def line(self, columns: int, rows: int | None = None) -> DesignLine:
        """The line with so many columns in its zone; `rows` None: by the parcel's width."""
        return line_for(
            self.parcel, columns, rows, self.pitch, self.mu_max, self.mu_min, self.mu_support
        )

    def at(self, speed: float) -> "Case":
        """The same at another entry speed [m/s]."""
        return replace(self, speed=speed)


@dataclass(frozen=True, eq=False)
class Draws:
    """What is not known, drawn: the same draws wherever a case is tried."""

    parcels: tuple[Parcel, ...]  # (draws,)
    stiffness: Numbers | None  # (draws, rows, columns) [-]; None: all elements alike
    friction: Numbers  # (draws, 3) [-] factors of mu_max, mu_min and mu_support
    aside: Numbers  # (draws,) [m]
    turned: Numbers  # (draws,) [rad]
    faster: Numbers  # (draws,) [m/s] than asked
    steeper: Numbers  # (draws,) [rad]

    def __len__(self) -> int:
        return len(self.parcels)

    def runs(self, speed: float, tilt: float, columns: int, layout: int = 0) -> Runs:
        """A run a draw, over a layout; `columns` -1: the zone has no end."""
        every = np.arange(len(self))
        return make_runs(
            speed=np.maximum(0.0, speed + self.faster),
            tilt=tilt + self.steeper,
            layout=layout,
            ground=every if self.stiffness is not None else 0,
            parcel=every if len(set(self.parcels)) > 1 else 0,
            friction=self.friction,
            aside=self.aside,
            turned=self.turned,
            columns=columns,
        )


def draw(unknown: Unknown, parcel: Parcel, line: DesignLine, count: int, seed: int) -> Draws:
    """Draw what is not known: draw k comes from a generator of its own, of `seed` and k.

    So a draw does not depend on how many there are; on a longer line it is another.
    """
    drawn: list[RandomDraw] = []
    extra: list[tuple[float, float]] = []
    for k in range(count):
        rng = np.random.default_rng((seed, k))
        drawn.append(unknown.draw(rng, parcel, line.shape))
        extra.append(tuple(rng.standard_normal(2).tolist()))
    faster, steeper = np.array(extra).T
    grounds = [each.stiffness for each in drawn if each.stiffness is not None]
    return Draws(
        parcels=tuple(each.parcel for each in drawn),
        stiffness=np.stack(grounds) if grounds else None,
        friction=np.array([each.friction for each in drawn]),
        aside=np.array([each.aside for each in drawn]),
        turned=np.array([each.turned for each in drawn]),
        faster=unknown.speed * faster,
        steeper=unknown.tilt * steeper,
    )


def enough(share: ArrayLike) -> Booleans:
    """Of shares of the draws that succeed: whether all but `WORST` of them do."""
    return np.asarray(share) >= 1.0 - WORST - 1e-9
