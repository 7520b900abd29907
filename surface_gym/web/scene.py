"""Scenes: descriptions of runs, as JSON or in a page's address.

A page and Python get the same result from a scene. `page/scene.js` reads and writes the same JSON,
and documents its fields.
"""

import base64
import json
import zlib
from collections.abc import Sequence
from dataclasses import InitVar, dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.parcel import Disc, Parcel, Polygon, Rectangle, make_bodies
from surface_gym.physics import rollout, types as ph
from surface_gym.physics.collision import ContactMaterial, World, make_world_scratch
from surface_gym.registration import SHIPPED
from surface_gym.simulation import Encounter, Touches, make_trajectory, run_stretch, start_state
from surface_gym.surface import Surface
from surface_gym.web.table import PARCELS

VERSION = 1
MARK = "1."  # prefix of a packed scene in an address
MOST = 2_000_000  # [bytes] maximum size of a scene as JSON
MODULES = 6000  # maximum modules of a table in a page
LONGEST = 60.0  # [s] maximum duration of a run in a page
PAGE = "playground.html"


@dataclass(frozen=True)
class ThrownParcel:
    """A parcel with its pose, velocity and time of entry."""

    parcel: Parcel
    pose: tuple[float, float, float]  # [m, m, rad] of the base's frame
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m/s, m/s, rad/s]
    step: int = 0  # step at which it enters; 0: the start


@dataclass(frozen=True, eq=False)
class TableScene:
    """A surface with parcels. The surface may change during the run.

    A page shows up to 24 parcels on up to 6000 modules for up to 60 s. The surface must have
    uniform friction and stiffness.

    >>> import surface_gym as sg
    >>> surface = sg.layouts.sorting()
    >>> box = ThrownParcel(sg.layouts.box("S"), (0.125, 1.0, 0.0), (1.5, 0.0, 0.0))
    >>> scene = TableScene(surface, (box,), duration=1.0)
    >>> scene.run().trajectories[0].pose[-1].round(2)
    array([ 0.97,  0.49, -0.23])
    >>> scene.url()[:18]
    'playground.html#1.'
    """

    surface: Surface
    parcels: tuple[ThrownParcel, ...] = ()
    duration: float = 20.0  # [s], a multiple of dt
    dt: float = 0.005  # [s] time step
    restitution: float = 0.0  # [-] restitution between parcels
    side_friction: float = 0.3  # [-]
    changes: tuple[tuple[int, Surface], ...] = ()  # step of the change, and the new surface

    @property
    def steps(self) -> int:
        """Number of steps of a run."""
        return round(self.duration / self.dt)

    def run(self) -> Encounter:
        """Run the scene as a page does. A parcel's trajectory begins when the parcel enters."""
        thrown, steps, dt = self.parcels, self.steps, self.dt
        if not thrown:
            raise ValueError("parcels must be at least one, got none")
        parcels = [each.parcel for each in thrown]
        start = np.stack(
            [start_state(t.parcel, np.array(t.pose), np.array(t.velocity)) for t in thrown]
        )
        count = len(thrown)
        world = World(
            start.copy(), np.zeros(count, dtype=np.bool_), np.arange(count), make_bodies(parcels)
        )
        scratch, room = make_world_scratch(count), 1024 + count * count
        records = rollout.Records(
            np.zeros((steps + 1, count, ph.STATE_SIZE)),
            np.zeros((steps + 1, count), dtype=np.int64),
            np.zeros(room, dtype=np.int64), np.zeros((room, 2), dtype=np.int64), np.zeros(room),
        )  # fmt: skip
        touching = ContactMaterial(float(self.restitution), float(self.side_friction))
        surface, touches = self.surface, 0
        events = sorted({0, steps, *(t.step for t in thrown), *(step for step, _ in self.changes)})
        for first, last in zip(events, [*events[1:], steps], strict=True):
            surface = dict(self.changes).get(first, surface)
            for k, each in enumerate(thrown):
                if each.step == first:
                    world.present[k] = True
                    world.state[k] = start[k]
            scratch.marks[:, ph.SPANS] = -1  # the surface under the parcels may have changed
            records, touches = run_stretch(
                surface.grid, world, touching, scratch, records, first + 1, last, touches, dt
            )
        time = dt * np.arange(steps + 1, dtype=np.float64)
        for k, each in enumerate(thrown):
            records.state[: each.step + 1, k] = start[k]
            records.report[: each.step + 1, k] = 0
        trajectories = tuple(
            make_trajectory(
                self.surface, each.parcel, time[each.step :], dt,
                records.state[each.step :, k], records.report[each.step :, k],
            )
            for k, each in enumerate(thrown)
        )  # fmt: skip
        pushes = slice(0, touches)
        pushed = Touches(time[records.step[pushes]], records.pair[pushes], records.impulse[pushes])
        return Encounter(trajectories, pushed)

    def to_json(self) -> str:
        """Write the scene as a line of JSON."""
        return json.dumps(self._fields(), separators=(",", ":"))

    @classmethod
    def from_json(cls, text: str) -> "TableScene":
        """Read a scene from JSON, which `to_json` or the page wrote.

        Raises:
            ValueError: the text is not a valid scene.
        """
        try:
            return _read(json.loads(text))
        except (KeyError, TypeError, IndexError, AttributeError, json.JSONDecodeError) as error:
            raise ValueError(
                f"text must be the scene of a table: {type(error).__name__}: {error}"
            ) from None

    def url(self, page: str = PAGE) -> str:
        """Make the address at which a page shows the scene."""
        return f"{page}#{pack(self.to_json())}"

    @classmethod
    def from_url(cls, url: str) -> "TableScene":
        """Read the scene from a page's address."""
        return cls.from_json(unpack(url.partition("#")[2]))

    def _fields(self) -> dict[str, Any]:
        surface = self.surface
        self._check()
        changes, before = [], surface
        for step, after in self.changes:
            changes.append({"step": step, **_difference(before, after)})
            before = after
        return {
            "version": VERSION, "task": "table", "rows": surface.rows, "columns": surface.columns,
            "pitch": [surface.pitch_x, surface.pitch_y], "origin": list(surface.origin),
            "axis": _packed(surface.axis.ravel().tolist()),
            "rotor": _packed(surface.rotor.astype(int).ravel().tolist()),
            "friction": _friction(surface), "tilt": surface.tilt,
            "tilt_direction": surface.tilt_direction,
            "sides": [self.restitution, self.side_friction],
            "dt": self.dt, "duration": self.duration,
            "parcels": [_parcel_fields(each) for each in self.parcels], "changes": changes,
        }  # fmt: skip

    def _check(self) -> None:
        """Raise a ValueError for scenes that a page cannot show."""
        if len(self.parcels) > PARCELS:
            raise ValueError(
                f"parcels must be at most {PARCELS} in a page, got {len(self.parcels)}"
            )
        if self.surface.axis.size > MODULES:
            raise ValueError(
                f"surface must have at most {MODULES} modules in a page, "
                f"got {self.surface.axis.size}"
            )
        checks.positive("duration", self.duration, self.dt, LONGEST)
        for surface in (self.surface, *(each for _, each in self.changes)):
            if surface.stiffness is not None or np.ptp(surface.friction, axis=(0, 1)).any():
                raise ValueError(
                    "surface must have one friction and one stiffness in a page, got others"
                )


@dataclass(frozen=True)
class TaskScene:
    """A start of a task, and the commands of the run that begins there. A page shows this run."""

    task: str  # name of the task
    seed: int = 0
    agent: str = "you"  # acting agent; "you": the commands
    stuck: tuple[tuple[int, int], ...] = ()  # row and column of stuck modules
    late: int = 0  # delay of axes in control periods
    # a control period, and the modules and the orientations that they turn to in it
    commands: tuple[tuple[int, tuple[tuple[int, int], ...]], ...] = ()
    camera: bool = False  # whether a camera senses the parcels; otherwise sensors are exact
    modules: str = "idle"  # kind of the modules

    tasks: InitVar[Sequence[str]] = tuple(SHIPPED)  # tasks of the page

    def __post_init__(self, tasks: Sequence[str]) -> None:
        checks.one_of("task", self.task, tuple(tasks))
        checks.integer("seed", self.seed, least=0)

    def to_json(self) -> str:
        """Write the scene as a line of JSON."""
        return json.dumps({"version": VERSION, **vars(self)}, separators=(",", ":"))

    def url(self, page: str = PAGE) -> str:
        """Make the address at which a page shows the scene."""
        return f"{page}#{pack(self.to_json())}"


def pack(text: str) -> str:
    """Compress the JSON of a scene to a short text for an address."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    data = packer.compress(text.encode()) + packer.flush()
    return MARK + base64.urlsafe_b64encode(data).decode().rstrip("=")


def unpack(fragment: str) -> str:
    """Return the text that `pack` has packed into `fragment`, the part of an address after #.

    Raise a ValueError if `fragment` is damaged.
    """
    if not fragment.startswith(MARK):
        raise ValueError(f"url must hold a scene after #, which begins with {MARK}, got none")
    coded = fragment.removeprefix(MARK)
    try:
        data = base64.b64decode(coded + "=" * (-len(coded) % 4), "-_", validate=True)
        unpacker = zlib.decompressobj(-zlib.MAX_WBITS)
        text = unpacker.decompress(data, MOST)
        whole = unpacker.eof
    except (ValueError, zlib.error):
        whole = False
    if not whole:
        raise ValueError("url must hold a whole scene, got one that is cut short or damaged")
    return text.decode()


def _packed(values: Sequence[Any]) -> list[list[Any]]:
    return [[value, len(list(run))] for value, run in groupby(values)]


def _unpacked(runs: Any) -> list[Any]:
    return [value for value, many in runs for _ in range(checks.integer("many", many, 1, MODULES))]


def _friction(surface: Surface) -> list[float]:
    found: list[float] = surface.friction[0, 0].tolist()
    return found


def _difference(before: Surface, after: Surface) -> dict[str, Any]:
    """Return the fields of JSON that describe how the surface `after` differs from `before`."""
    fixed = ("rotor", "pitch", "origin")
    if any(np.any(getattr(before, name) != getattr(after, name)) for name in fixed):
        raise ValueError("changes must leave rotors, pitch and origin as they are, got others")
    turned = np.flatnonzero(before.axis != after.axis)
    found: dict[str, Any] = {}
    if len(turned):
        found["axis"] = [[k, after.axis.ravel()[k].item()] for k in turned.tolist()]
    for name in ("tilt", "tilt_direction"):
        if getattr(before, name) != getattr(after, name):
            found[name] = getattr(after, name)
    if _friction(before) != _friction(after):
        found["friction"] = _friction(after)
    return found


def _parcel_fields(thrown: ThrownParcel) -> dict[str, Any]:
    parcel, base = thrown.parcel, thrown.parcel.base
    if parcel.inertia is not None:
        raise ValueError(f"inertia must be None for a page, got {parcel.inertia!r}")
    if isinstance(base, Rectangle):
        shape: dict[str, Any] = {"rectangle": [base.length, base.width]}
    elif isinstance(base, Disc):
        shape = {"disc": base.radius}
    elif isinstance(base, Polygon):
        shape = {"polygon": base.vertices.tolist()}
    else:
        raise ValueError(f"base must be a Rectangle, a Disc or a Polygon for a page, got {base!r}")
    return {
        "base": shape, "mass": parcel.mass, "com_height": parcel.com_height,
        "com_offset": list(parcel.com_offset), "pose": list(thrown.pose),
        "velocity": list(thrown.velocity), "step": thrown.step,
    }  # fmt: skip


def _read(fields: dict[str, Any]) -> TableScene:
    checks.one_of("version", fields["version"], (VERSION,))
    checks.one_of("task", fields["task"], ("table",))
    rows = checks.integer("rows", fields["rows"], 1, MODULES)
    columns = checks.integer("columns", fields["columns"], 1, MODULES)
    mu_max, mu_min, mu_support = fields["friction"]
    surface = Surface(
        axis=np.array(_unpacked(fields["axis"]), dtype=np.float64).reshape(rows, columns),
        rotor=np.array(_unpacked(fields["rotor"]), dtype=bool).reshape(rows, columns),
        pitch=tuple(fields["pitch"]),
        origin=tuple(fields["origin"]),
        mu_max=mu_max, mu_min=mu_min, mu_support=mu_support,
        tilt=fields["tilt"],
        tilt_direction=fields["tilt_direction"],
    )  # fmt: skip
    changes, before = [], surface
    for change in fields["changes"]:
        before = _changed(before, change)
        changes.append((checks.integer("step", change["step"], least=0), before))
    restitution, side_friction = fields["sides"]
    return TableScene(
        surface, tuple(map(_read_parcel, fields["parcels"])), fields["duration"], fields["dt"],
        restitution, side_friction, tuple(changes),
    )  # fmt: skip


def _changed(before: Surface, change: dict[str, Any]) -> Surface:
    """Apply a change, made by `_difference`, to the surface `before`; return the new surface."""
    axis = before.axis.copy()
    for module, angle in change.get("axis", ()):
        axis.ravel()[module] = angle
    given: dict[str, Any] = {n: change[n] for n in ("tilt", "tilt_direction") if n in change}
    if "friction" in change:
        given |= zip(("mu_max", "mu_min", "mu_support"), change["friction"], strict=True)
    return replace(before, axis=axis, **given)


def _read_parcel(fields: dict[str, Any]) -> ThrownParcel:
    base = fields["base"]
    if "rectangle" in base:
        shape: Any = Rectangle(*base["rectangle"])
    elif "disc" in base:
        shape = Disc(base["disc"])
    else:
        shape = Polygon(base["polygon"])
    offset = tuple(fields.get("com_offset", (0.0, 0.0)))
    parcel = Parcel(shape, fields["mass"], fields.get("com_height", 0.1), com_offset=offset)
    return ThrownParcel(
        parcel, tuple(fields["pose"]), tuple(fields["velocity"]), fields.get("step", 0)
    )
