"""What a run is made of as named arrays, and a run made of such."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.parcel import Base, Disc, Parcel, Polygon, Rectangle
from surface_gym.physics.types import STATE_SIZE, Array, check_capacity
from surface_gym.record.repeating import Run
from surface_gym.surface import Surface

Parts = dict[str, NDArray[Any]]

SURFACE = ("axis", "rotor", "pitch", "origin", "mu_max", "mu_min", "mu_support", "tilt")
PARCEL = ("mass", "com_height", "com_offset")
RUN = ("dt", "method", "normal_forces", "states")
MAY_BE_NONE = ("stiffness", "inertia")  # absent then
ALL = (*SURFACE, *PARCEL, *RUN, "base", "base_lengths")

# A base's name and its lengths [m]: length and width, radius, or vertices (vertices, 2).
BASES: dict[str, Callable[[Array], Base]] = {
    "rectangle": lambda lengths: Rectangle(*lengths.tolist()),
    "disc": lambda lengths: Disc(*lengths.tolist()),
    "polygon": lambda lengths: Polygon(lengths),
}


def run_parts(run: Run) -> Parts:
    """The arrays that `run_of` makes the same run of.

    Raises:
        ValueError: the run's base, parcel or surface is of a class of one's own, which arrays do
            not hold.
    """
    surface, parcel = run.surface, run.parcel
    for name, part, kind in (("surface", surface, Surface), ("parcel", parcel, Parcel)):
        if type(part) is not kind:
            raise ValueError(
                f"{name} must be a {kind.__name__} and no class of one's own to be saved as .npz, "
                f"got a {type(part).__name__}; a .csv holds the motion alone"
            )
    base, lengths = _base_parts(parcel.base)
    parts = {name: np.asarray(getattr(surface, name)) for name in SURFACE}
    parts |= {name: np.asarray(getattr(parcel, name)) for name in PARCEL}
    parts |= {name: np.asarray(getattr(run, name)) for name in RUN}
    parts |= {"base": np.asarray(base), "base_lengths": lengths}
    if surface.stiffness is not None:
        parts["stiffness"] = surface.stiffness
    if parcel.inertia is not None:
        parts["inertia"] = np.asarray(parcel.inertia)
    return parts


def run_of(parts: Parts, rows: int) -> Run | None:
    """The run that arrays describe; None where they hold nothing of one.

    Args:
        parts: by name.
        rows: of the trajectory.

    Raises:
        ValueError: some are missing, or hold what is not allowed.
    """
    missing = [name for name in ALL if name not in parts]
    if len(missing) == len(ALL):
        return None
    if missing:
        raise ValueError(f"it lacks {', '.join(missing)}")
    plain = {name: _plain(parts[name]) for name in (*ALL, *MAY_BE_NONE) if name in parts}
    surface = Surface(**{name: plain[name] for name in SURFACE}, stiffness=plain.get("stiffness"))
    lengths = checks.array("base_lengths", plain["base_lengths"], parts["base_lengths"].shape)
    make_base = BASES[checks.one_of("base", plain["base"], BASES)]
    try:
        base = make_base(lengths)
    except TypeError:
        raise ValueError(
            f"base_lengths must be those of a {plain['base']}, got {lengths}"
        ) from None
    parcel = Parcel(base, **{name: plain[name] for name in PARCEL}, inertia=plain.get("inertia"))
    check_capacity(
        len(parcel.body.edges),
        parcel.body.radius,
        (surface.pitch_x, surface.pitch_y),
        (surface.columns, surface.rows),
    )
    return Run(
        surface,
        parcel,
        checks.positive("dt", plain["dt"]),
        checks.one_of("method", plain["method"], ("implicit", "explicit")),
        checks.one_of("normal_forces", plain["normal_forces"], ("dual", "osqp", "scipy")),
        check_rows("states", parts["states"], (rows, STATE_SIZE)),
    )


def check_rows(name: str, value: NDArray[Any], shape: tuple[int | None, ...]) -> Array:
    """Numbers as they are, finite float64 of a shape (None: any length), or an error."""
    if value.dtype != np.float64:
        raise ValueError(f"{name} must be of float64, got {value.dtype}")
    return checks.array(name, value, shape).copy()


def _plain(part: NDArray[Any]) -> Any:
    """A number or text as Python has it; an array as it is."""
    return part.item() if part.ndim == 0 else part


def _base_parts(base: Base) -> tuple[str, Array]:
    if type(base) is Rectangle:
        return "rectangle", np.array([base.length, base.width])
    if type(base) is Disc:
        return "disc", np.array([base.radius])
    if type(base) is Polygon:
        return "polygon", base.vertices
    raise ValueError(
        f"base must be a Rectangle, a Disc or a Polygon to be saved as .npz, got {base!r}; "
        "a .csv holds the motion alone"
    )
