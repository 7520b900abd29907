"""A batch of flows without its kernel: its memory, and the episodes that are drawn into it."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from surface_gym.core.batch import surfaces_of
from surface_gym.core.resets import Placement, draw_noise, place_parcel
from surface_gym.flow.arrivals import Arrivals
from surface_gym.flow.making import flow_rules_of, rear_of, rules_of, sizes_of
from surface_gym.flow.memory import (
    NEVER,
    NOBODY,
    ON_ITS_WAY,
    OUTCOMES,
    Flows,
    make_flows,
    with_room,
)
from surface_gym.flow.pool import BodyPool
from surface_gym.flow.rewards import TERMS
from surface_gym.flow.settings import FlowSettings
from surface_gym.flow.stream import Stream
from surface_gym.parcel import Parcel
from surface_gym.physics.step import com_states
from surface_gym.physics.types import GRAVITY, Array, Integers
from surface_gym.state import (
    GRAVITY_ALONG,
    GRAVITY_NORMAL,
    RUNNING,
    STARTING,
    BodyTable,
    ParcelState,
    SurfaceState,
    make_parcels,
)

OPTIONS = ("stream",)  # what `reset(options=...)` may fix


class FlowEpisodes:
    """Surfaces of one environment, each with a stream of parcels of its own that is to come.

    Args:
        settings: of the environment.
        lanes: number of surfaces.
    """

    outcomes: tuple[str, ...] = OUTCOMES
    options: tuple[str, ...] = OPTIONS

    def __init__(self, settings: FlowSettings, lanes: int) -> None:
        self.settings = settings
        self.places = settings.places
        self.rows = settings.rows  # of each surface in the parcels' memory
        self._draws = settings.draws
        self.rules = rules_of(settings)
        self.flow_rules = flow_rules_of(settings)
        sizes = sizes_of(settings, lanes)
        self.surfaces: SurfaceState = surfaces_of(settings, sizes)
        self.surfaces.conditions[:, :3] = 1.0
        self.surfaces.conditions[:, GRAVITY_NORMAL] = GRAVITY * math.cos(settings.tilt)
        self.surfaces.conditions[:, GRAVITY_ALONG] = GRAVITY * math.sin(settings.tilt)
        self.parcels: ParcelState = make_parcels(sizes)
        self._pool = BodyPool(self._placement, settings.stream.kinds[0])
        obeys = self._pool.bodies.obeys
        if settings.actuators.stuck_share > 0.0:
            obeys = np.repeat(obeys, lanes, axis=0)
        shape = (sizes.rows, sizes.columns)
        self.streams: Flows = make_flows(lanes, self.rows, shape, len(TERMS), obeys)
        self._rows: list[list[int]] = [[] for _ in range(lanes)]  # of the pool that a lane uses
        self._generators: list[np.random.Generator | None] = [None] * lanes

    @property
    def bodies(self) -> BodyTable:
        """The bodies of all parcels, and what of the surface is the same for all of them."""
        return self._pool.bodies

    def seed(self, lane: int, generator: np.random.Generator) -> None:
        """Draw a lane's streams from a generator."""
        self._generators[lane] = generator

    def is_seeded(self, lane: int) -> bool:
        """Whether a lane has a generator."""
        return self._generators[lane] is not None

    def check(self, options: Sequence[dict[str, Any]]) -> None:
        """Raise what `start` would for options of as many lanes, and draw nothing."""
        for each in options:
            stream = each.get("stream", self.settings.stream)
            if not isinstance(stream, Stream):
                raise ValueError(f"stream must be a Stream, got {stream!r}")
            self.settings.check_stream(stream)

    def place(self, chosen: Integers, options: Sequence[dict[str, Any]] = ()) -> None:
        """Draw an episode for each of the chosen lanes (count,), from its generator: the surface,
        the stream, the parcels, the stuck modules and the sensors' noise, in that order.
        """
        given = options if options else [{}] * len(chosen)
        for lane, option in zip(chosen.tolist(), given, strict=True):
            rng = self._generator(lane)
            self._draw_surface(lane, rng)
            stream = option.get("stream", self.settings.stream)
            arrivals = stream.draw(rng, self.settings.duration, self.settings.exits)
            self._write(lane, arrivals, rng)
            share = self.settings.actuators.stuck_share
            if share > 0.0:
                working = rng.random(self.streams.told.shape[1:]) >= share
                self.streams.obeys[lane] = self.bodies.obeys[0] & working
            if self._draws:
                for place in range(self.rows):
                    draw_noise(self.parcels, lane * self.rows + place, rng)

    def _draw_surface(self, lane: int, rng: np.random.Generator) -> None:
        varies = self.settings.randomisation
        self.surfaces.conditions[lane, :3] = varies.draw_friction(rng)
        stiffness = varies.draw_stiffness(rng, self.streams.told.shape[1:])
        if stiffness is not None:
            self.surfaces.stiffness[lane] = stiffness

    def _write(self, lane: int, arrivals: Arrivals, rng: np.random.Generator) -> None:
        """What is to come on a lane, and nothing on it yet."""
        count = len(arrivals)
        self.streams = flows = with_room(self.streams, count)
        flows.time[lane, :count] = arrivals.time
        flows.exit[lane, :count] = arrivals.exit
        flows.arrivals[lane] = count
        site, flows.start[lane, :count] = self._entries(lane, arrivals, rng)
        flows.site[lane, :count] = site
        for name, value in (
            ("entered", np.nan), ("left", np.nan), ("taken", ON_ITS_WAY), ("touches", 0),
            ("number", NOBODY), ("present", False), ("touched_at", NEVER), ("coming", 0),
            ("due", 0), ("clock", 0.0), ("steps", 0), ("still", 0.0), ("waited", 0.0),
            ("tally", 0), ("outcome", STARTING),
        ):  # fmt: skip
            getattr(flows, name)[lane] = value
        row = lane * self.rows
        self.parcels.outcome[row : row + self.rows] = RUNNING

    def _entries(
        self, lane: int, arrivals: Arrivals, rng: np.random.Generator
    ) -> tuple[Integers, Array]:
        """Sites (arrivals,) and states (arrivals, STATE_SIZE) in which parcels enter: the rear at
        the line's edge, on its middle, but for what varies.
        """
        varies, count = self.settings.randomisation, len(arrivals)
        entry = self.settings.chosen_plant.line_y
        _, _, low, high = self.settings.chosen_plant.extent
        room = (low - entry, high - entry)
        self._pool.give_back(self._rows[lane])
        self._rows[lane] = []
        if varies.varies_parcels or varies.lateral or varies.heading:
            drawn = [
                varies.draw_entry(rng, arrivals.kinds[kind], room)
                for kind in arrivals.parcel.tolist()
            ]
            parcels = [parcel for parcel, _, _ in drawn]
            aside = np.array([aside for _, aside, _ in drawn])
            turned = np.array([turned for _, _, turned in drawn])
            site = np.array([self._pool.take(parcel) for parcel in parcels], dtype=np.int64)
            self._rows[lane] = site.tolist()
            rear = np.array([rear_of(parcel, theta) for parcel, _, theta in drawn])
            centre = np.array([parcel.centre_of_mass for parcel in parcels]).reshape(-1, 2)
        else:
            rows = [self._pool.take(kind) for kind in arrivals.kinds]
            self._rows[lane] = rows
            site = np.array(rows, dtype=np.int64)[arrivals.parcel]
            aside = turned = np.zeros(count)
            rear = np.array([kind.rear for kind in arrivals.kinds])[arrivals.parcel]
            centre = np.array([kind.centre_of_mass for kind in arrivals.kinds])[arrivals.parcel]
        pose = np.stack([self.settings.entry_x + rear, entry + aside, turned], axis=-1)
        velocity = np.zeros((count, 3))
        velocity[:, 0] = arrivals.speed
        return site, com_states(centre, pose, velocity)

    def _placement(self, parcel: Parcel) -> Placement:
        settings = self.settings
        return place_parcel(parcel, settings.chosen_plant, None, tuple(settings.actuators.stuck))

    def _generator(self, lane: int) -> np.random.Generator:
        generator = self._generators[lane]
        assert generator is not None
        return generator
