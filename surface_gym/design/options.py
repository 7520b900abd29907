"""A case as flags of a command line."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from surface_gym import checks
from surface_gym.cores import usable_cores
from surface_gym.design.case import Case, Unknown
from surface_gym.design.purposes import Purpose, Slow, Sort, Stop, Turn
from surface_gym.design.runs import STEP
from surface_gym.layouts import box
from surface_gym.parcel import Base, Disc, Parcel, Polygon, Rectangle
from surface_gym.sharing import Workers, workers_of

Degrees = Annotated[float, tyro.conf.arg(metavar="DEG")]
Given = Annotated[float | None, tyro.conf.arg(metavar="FLOAT")]
Count = Annotated[int | None, tyro.conf.arg(metavar="INT")]


@dataclass(frozen=True)
class CaseOptions:
    """The parcel, how it comes, what is asked, and what is not known."""

    parcel: Annotated[str | None, tyro.conf.arg(metavar="LxW")] = None
    """A rectangular base, length along the line by width, in m: 0.3x0.4. S and B are the study's
    boxes."""
    disc: Annotated[float | None, tyro.conf.arg(metavar="RADIUS")] = None
    """A round base of this radius [m]."""
    polygon: Annotated[str | None, tyro.conf.arg(metavar="'X,Y X,Y X,Y'")] = None
    """A convex base by its corners [m]: '0,0 0.3,0 0.2,0.25'."""
    mass: Given = None
    """[kg]; cancels out of the motion, but for an inertia that is given."""
    inertia: Given = None
    """[kg m^2] about the vertical through the centre of mass; else of a load spread evenly."""
    com_offset: tuple[float, float] = (0.0, 0.0)
    """[m] of the centre of mass from the base's centroid."""
    com_height: float = 0.1
    """[m] of the centre of mass above the base."""

    purpose: Literal["sort", "slow", "stop", "turn"] = "sort"
    """What the surface is to do with the parcel."""
    side: Literal["right", "left"] = "right"
    """Sort: to this side of the line, as the parcel sees it."""
    ratio: Given = None
    """Slow: to this share of the entry speed or less; 0.5."""
    place: Given = None
    """Stop: with the base's middle so far into the zone [m]; else anywhere on it."""
    angle_deg: Annotated[float | None, tyro.conf.arg(metavar="DEG")] = None
    """Turn: by this angle, anti-clockwise; 30."""
    tolerance: Given = None
    """How far off: the ratio, the place [m] or the angle [deg]."""

    speed: float = 1.0
    """[m/s] at entry."""
    tilt_deg: Degrees = 0.0
    """Of the surface, downhill along the line."""
    pitch: Annotated[str, tyro.conf.arg(metavar="P or PXxPY")] = "0.1"
    """[m] between neighbours: 0.1, or along the line by across 0.1x0.12."""
    mu_max: float = 0.5
    """Friction along a rotor's axis."""
    mu_min: float = 0.01
    """Friction across it."""
    mu_support: float = 0.005
    """Friction of a support."""
    columns: Count = None
    """Columns of the zone; else the fewest that do it in 95 % of the draws."""
    rows: Count = None
    """Rows of rotors; else as many as lie under the parcel."""

    friction: float = Unknown.friction
    """Unknown: mu_max by up to this share."""
    rolling: float = Unknown.rolling
    """Unknown: mu_min and mu_support by up to this share."""
    com_spread: float = Unknown.com_offset
    """Unknown: the centre of mass by up to this share of half the base."""
    mass_spread: float = Unknown.mass
    """Unknown: the mass at its inertia by up to this share."""
    unevenness: float = Unknown.stiffness
    """Unknown: log-normal spread of the elements' stiffness; 0.35 is about 1 micrometre."""
    lateral: float = Unknown.lateral
    """Unknown: normal spread of the place across the line [m]."""
    heading_deg: Degrees = 0.0
    """Unknown: normal spread of the heading."""
    speed_spread: float = Unknown.speed
    """Unknown: normal spread of the entry speed [m/s]."""
    tilt_spread_deg: Degrees = 0.0
    """Unknown: normal spread of the tilt."""
    draws: int = 100
    """Of what is unknown."""
    seed: int = 0
    """Of the draws."""
    step: float = STEP
    """[s] of the simulation."""

    workers: int = field(default_factory=usable_cores)
    """Threads that share the runs; results do not depend on it."""
    cluster: str | None = None
    """Address of a Ray cluster to share them among instead, "auto" for this machine's."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/design")
    """Folder for the tables and the picture."""

    @property
    def crew(self) -> Workers:
        """Who shares the runs.

        Raises:
            ValueError: an address that cannot be used.
        """
        return workers_of(self.cluster, self.workers)

    def case(self) -> Case:
        """The case that is asked for.

        Raises:
            ValueError: a flag that is not allowed, or that does not go with another.
        """
        checks.integer("workers", self.workers, least=1)
        return Case(
            parcel=self._parcel(),
            purpose=self._purpose(),
            speed=self.speed,
            tilt=math.radians(self.tilt_deg),
            unknown=Unknown(
                friction=self.friction,
                rolling=self.rolling,
                com_offset=self.com_spread,
                mass=self.mass_spread,
                stiffness=self.unevenness,
                lateral=self.lateral,
                heading=math.radians(self.heading_deg),
                speed=self.speed_spread,
                tilt=math.radians(self.tilt_spread_deg),
            ),
            draws=self.draws,
            seed=self.seed,
            pitch=_pitch(self.pitch),
            mu_max=self.mu_max,
            mu_min=self.mu_min,
            mu_support=self.mu_support,
            step=self.step,
        )

    def _parcel(self) -> Parcel:
        given = [name for name in ("parcel", "disc", "polygon") if getattr(self, name) is not None]
        if len(given) != 1:
            told = " and ".join(f"--{name}" for name in given) or "none"
            raise ValueError(f"parcel must be one of --parcel, --disc and --polygon, got {told}")
        return Parcel(
            base=self._base(),
            mass=10.0 if self.mass is None else self.mass,
            com_height=self.com_height,
            inertia=self.inertia,
            com_offset=self.com_offset,
        )

    def _base(self) -> Base:
        if self.disc is not None:
            return Disc(self.disc)
        if self.polygon is not None:
            corners = [corner.split(",") for corner in self.polygon.split()]
            if any(len(corner) != 2 for corner in corners):
                raise ValueError(f"polygon must be 'X,Y X,Y X,Y', got {self.polygon!r}")
            return Polygon(
                np.array([[_number("polygon", part) for part in each] for each in corners])
            )
        assert self.parcel is not None
        if self.parcel in ("S", "B"):
            return box(self.parcel).base
        sides = self.parcel.split("x")
        if len(sides) != 2:
            raise ValueError(f"parcel must be LxW as 0.3x0.4, S or B, got {self.parcel!r}")
        return Rectangle(*(_number("parcel", side) for side in sides))

    def _purpose(self) -> Purpose:
        allowed = {"sort": (), "slow": ("ratio",), "stop": ("place",), "turn": ("angle_deg",)}
        for name in ("ratio", "place", "angle_deg"):
            if getattr(self, name) is not None and name not in allowed[self.purpose]:
                raise ValueError(f"{name} must not be given to {self.purpose}")
        if self.purpose == "sort":
            if self.tolerance is not None:
                raise ValueError("tolerance must not be given to sort")
            return Sort(-1 if self.side == "right" else 1)
        if self.purpose == "slow":
            return Slow(0.5 if self.ratio is None else self.ratio, self.tolerance)
        if self.purpose == "stop":
            if self.place is None and self.tolerance is not None:
                raise ValueError("tolerance must be given with --place only, to stop")
            return Stop(self.place, 0.05 if self.tolerance is None else self.tolerance)
        return Turn(
            math.radians(30.0 if self.angle_deg is None else self.angle_deg),
            math.radians(5.0 if self.tolerance is None else self.tolerance),
        )


def _pitch(told: str) -> float | tuple[float, float]:
    parts = [_number("pitch", part) for part in told.split("x")]
    if len(parts) > 2:
        raise ValueError(f"pitch must be one number or two as 0.1x0.12, got {told!r}")
    return parts[0] if len(parts) == 1 else (parts[0], parts[1])


def _number(name: str, told: str) -> float:
    try:
        return float(told)
    except ValueError:
        raise ValueError(f"{name} must be made of numbers, got {told!r} in it") from None
