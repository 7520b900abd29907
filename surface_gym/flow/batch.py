"""Batches of streams: many surfaces, each with its own arrivals, stepped by one kernel."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import state as st
from surface_gym.config import EnvConfig
from surface_gym.core.assembly import choose_actuation, compiled_functions
from surface_gym.core.batch import BaseBatch, Infos, Snapshot
from surface_gym.core.resets import FEWEST_EDGES, Placement, draw_noise, place_in, with_body
from surface_gym.flow import claims, kernel, state as fs
from surface_gym.flow.arrivals import Arrivals
from surface_gym.flow.base import StreamTask
from surface_gym.flow.exits import EDGE
from surface_gym.parcel import Parcel
from surface_gym.physics.collision import make_world_scratch
from surface_gym.physics.step import axis_direction, com_states, split_gravity
from surface_gym.physics.types import Array, Integers
from surface_gym.sensors.base import Sensor

_FIRST_ROOM = 16


class BodyPool:
    """The body table of all surfaces; a row is free when no episode uses its parcel."""

    def __init__(self, place: Callable[[Parcel], Placement], any_parcel: Parcel) -> None:
        self._place = place
        common = place(any_parcel)
        self.bodies = st.BodyTable(
            rotor=common.rotor[np.newaxis].copy(),
            obeys=common.obeys[np.newaxis].copy(),
            body=np.zeros((_FIRST_ROOM, common.body.size)),
            edges=np.zeros((_FIRST_ROOM, FEWEST_EDGES, 3)),
            corners=np.zeros((_FIRST_ROOM, FEWEST_EDGES, 2)),
            zone=common.zone[np.newaxis].copy(),
        )
        self._row_of: dict[Parcel, int] = {}
        self._parcel_of: dict[int, Parcel] = {}
        self._users: dict[int, int] = {}
        self._free = list(range(_FIRST_ROOM))[::-1]

    def take(self, parcel: Parcel, users: int = 1) -> int:
        """Return the body table's row of a parcel, and add `users` to the row's count of users."""
        row = self._row_of.get(parcel)
        if row is None:
            placement = self._place(parcel)
            if not self._free:
                self._double()
            row = self._free.pop()
            self.bodies = with_body(self.bodies, row, placement)
            self._row_of[parcel] = row
            self._parcel_of[row] = parcel
            self._users[row] = 0
        self._users[row] += users
        return row

    def give_back(self, rows: Iterable[int]) -> None:
        """Lower a row's user count by 1 per entry of `rows`. Rows without users become free."""
        for row in rows:
            self._users[row] -= 1
            if self._users[row] == 0:
                del self._users[row], self._row_of[self._parcel_of.pop(row)]
                self._free.append(row)

    def parcel(self, row: int) -> Parcel:
        """Return the parcel of a row in use."""
        return self._parcel_of[row]

    def _double(self) -> None:
        table, room = self.bodies, len(self.bodies.body)
        self.bodies = table._replace(
            **{
                name: np.concatenate([getattr(table, name), np.zeros_like(getattr(table, name))])
                for name in ("body", "edges", "corners")
            }
        )
        self._free = list(range(room, 2 * room))[::-1]


def stream_functions(config: EnvConfig) -> kernel.StreamFunctions:
    """Collect the functions of the task, sensor and kind of action for the kernel of streams."""
    task, kind = config.task, config.action_kind
    names = (
        "begin base_distance has_room has_departed exit_taken deliver advance may_jam inform "
        "reward observe observe_neighbour observe_no_neighbour"
    )
    return kernel.StreamFunctions(
        f"{type(task).__name__}-{type(config.sensors).__name__}-{config.actions}",
        **compiled_functions(task, StreamTask, names),
        **compiled_functions(config.sensors, Sensor, "begin update read", "_sensor"),
        watches=config.sensors.watches,
        meters=config.meters,
        weighs=config.weighs,
        part_of=claims.part_of_module if config.actions == "modules" else claims.part_of_owner,
        commanded=claims.commanded_angle if kind.continuous else claims.commanded_choice,
        actuation=choose_actuation(config),
    )


def make_stream_params(config: EnvConfig) -> fs.StreamParams:
    """Collect the parameters common to all streams of a batch."""
    task = config.stream_task
    return fs.StreamParams(
        exits=np.array(config.exits.table), entry_gap=task.entry_gap, rotors_end=config.rotors_end,
        ahead=task.ahead, duration=task.duration, patience=task.patience,
        inlets=len(config.inlets), queue=task.rows - task.max_parcels,
        numbers=np.array(task.numbers(), dtype=np.float64), touching=task.touching,
        waiting_reward=task.waiting_reward, jam_reward=task.jam_reward,
    )  # fmt: skip


def _rear(parcel: Parcel, theta: float) -> float:
    """Return the distance [m] along x from a base's rear to the base's origin, at `theta` [rad]."""
    outline = parcel.base.outline
    return -float((math.cos(theta) * outline[:, 0] - math.sin(theta) * outline[:, 1]).min())


def _place_across(parcel: Parcel, theta: float, aside: float, room: float) -> float:
    """Return y [m] of a parcel's frame, relative to the middle of its inlet.

    The inlet is `room` [m] wide. The position `aside` [-] is -1 at the inlet's right end, 0 in the
    middle, and 1 at the left end.
    """
    outline = parcel.base.outline
    across = math.sin(theta) * outline[:, 0] + math.cos(theta) * outline[:, 1]
    low, high = float(across.min()), float(across.max())
    return aside * max(0.0, 0.5 * (room - high + low)) - 0.5 * (high + low)


def list_figures(task: StreamTask) -> tuple[str, ...]:
    """Return the keys of an episode's statistics in `info`."""
    return tuple(f"episode_{each.name}" for each in fields(task.statistics))


COUNTS = ("entered", "correct", "wrong", "touches", "turns")  # names of the tally's columns


class StreamBatch(BaseBatch):
    """Environments of a task on streams. Arguments and errors are as for `BaseBatch`."""

    task: StreamTask

    def _make_memory(self) -> None:
        config, task, num_envs = self.config, self.config.stream_task, self.num_envs
        self.rows = task.rows
        self.stream_params = make_stream_params(config)
        self.surfaces.conditions[:, :3] = 1.0
        gravity = split_gravity(task.tilt, task.tilt_direction)
        self.surfaces.conditions[:, st.GRAVITY_COLUMNS] = gravity
        self._pool = BodyPool(partial(place_in, config), task.parcels[0])
        obeys = self._pool.bodies.obeys
        if config.actuators.stuck_share > 0.0:
            obeys = np.repeat(obeys, num_envs, axis=0)
        shape = self.surfaces.axis.shape[1:]
        self.streams: fs.StreamState = fs.make_streams(
            num_envs, self.rows, shape, len(task.terms), obeys, len(config.exits),
            task.surface_memories, task.exit_memories, len(task.results),
        )  # fmt: skip
        self.figures = list_figures(task)
        self._no_figures = dict.fromkeys(self.figures, 0.0)  # figures of a running episode
        # used rows of the pool, by surface
        self._used: list[list[int]] = [[] for _ in range(num_envs)]
        self._generators: list[np.random.Generator | None] = [None] * num_envs

    def _make_scratch(self) -> Any:
        return make_world_scratch(self.rows)

    @property
    def bodies(self) -> st.BodyTable:
        return self._pool.bodies

    @property
    def episodes(self) -> fs.StreamState:
        return self.streams

    @property
    def observation(self) -> NDArray[np.float32]:
        return self.parcels.observation.reshape(self.num_envs, self.rows, -1)

    @property
    def _arrays(self) -> tuple[Any, ...]:
        state = (self.surfaces, self.parcels, self.bodies, self.streams)
        return (self.params, self.stream_params, *state)

    def make_kernel(self) -> Any:
        return kernel.make_stream_kernel(stream_functions(self.config))

    def seed(self, env_index: int, generator: np.random.Generator) -> None:
        self._generators[env_index] = generator

    def generator(self, env_index: int) -> np.random.Generator | None:
        return self._generators[env_index]

    def infos(self) -> Infos:
        streams = self.streams
        slots = self.task.max_parcels
        return {
            **self._figures(),
            "time": streams.clock.copy(),
            "parcels": np.where(streams.present, streams.number, fs.NOBODY)[:, :slots],
            **dict(zip(COUNTS, streams.tally.T.copy(), strict=True)),
            "waiting": streams.due - streams.tally[:, fs.ENTERED],
            **({"axes": st.axis_angles(self.surfaces)} if "axes" in self.config.info else {}),
            **(self._energies() if self.config.meters else {}),
            **self._wear.infos(self.surfaces),
        }

    def _energies(self) -> Infos:
        """Sum the parcels' `ENERGIES` (num_envs,). For peak accelerations, take the maximum."""
        each = self.parcels.energy.reshape(self.num_envs, self.rows, -1)
        found = each.sum(axis=1)
        found[:, st.PEAK] = each[:, :, st.PEAK].max(axis=1)
        return dict(zip(st.ENERGIES, found.T.copy(), strict=True))

    def info(self, env_index: int) -> dict[str, Any]:
        if self.config.has_extras:
            return super().info(env_index)
        streams = self.streams  # faster for a single environment than arrays of all
        present, number = streams.present[env_index], streams.number[env_index]
        runs = streams.outcome.item(env_index) == st.RUNNING
        return {
            **(self._no_figures if runs else self._end(env_index)),
            "time": streams.clock.item(env_index),
            "parcels": np.where(present, number, fs.NOBODY)[: self.task.max_parcels],
            **dict(zip(COUNTS, streams.tally[env_index].tolist(), strict=True)),
            "waiting": streams.due.item(env_index) - streams.tally.item(env_index, fs.ENTERED),
        }

    def _figures(self) -> Infos:
        """Return an array (num_envs,) per statistic of ended episodes. Running episodes have 0."""
        figures = np.zeros((len(self.figures), self.num_envs))
        for i in np.nonzero(self.streams.outcome != st.RUNNING)[0].tolist():
            figures[:, i] = list(self._end(i).values())
        return dict(zip(self.figures, figures, strict=True))

    def _sizes(self) -> dict[str, int]:
        task = self.config.stream_task
        return super()._sizes() | {
            "results": len(task.results),
            "numbers": len(task.numbers()),
            "surface memories": task.surface_memories,
            "exit memories": task.exit_memories,
        }

    def _end(self, i: int) -> dict[str, float]:
        """Return the statistics of environment `i`, whose episode has ended, keyed by name."""
        obeys = self.streams.obeys
        obeying = int(obeys[i if len(obeys) > 1 else 0].sum())
        jammed = bool(self.streams.outcome[i] == fs.JAM)
        found = self.task.compute_statistics(self.streams, i, jammed, obeying)
        return dict(zip(self.figures, map(float, vars(found).values()), strict=True))

    def parcel(self, env_index: int, row: int = 0) -> Parcel:
        return self._pool.parcel(int(self.parcels.body[env_index * self.rows + row]))

    def check(self, options: Sequence[dict[str, Any]]) -> None:
        for each in options:
            self.task.check_stream(each.get("stream", self.task.stream), self.config)

    def place_drawn(self, chosen: Integers, options: Sequence[dict[str, Any]] = ()) -> None:
        """Draw an episode for each surface in `chosen` (count,), by the surface's own generator.

        The order of draws is surface, stream, parcels, stuck modules, sensor noise, and the task's
        memory.
        """
        given = options if options else [{}] * len(chosen)
        for i, option in zip(chosen.tolist(), given, strict=True):
            rng = self._generator(i)
            self._draw_surface(i, rng)
            stream = option.get("stream", self.task.stream)
            config = self.config
            arrivals = stream.draw(rng, self.task.duration, config.exits, config.inlets)
            self._write(i, arrivals, rng)
            share = self.config.actuators.stuck_share
            if share > 0.0:
                working = rng.random(self.streams.commanded.shape[1:]) >= share
                self.streams.obeys[i] = self.bodies.obeys[0] & working
            if self._draws:
                # Noise ends at the next parcel's row, so that results do not depend on the queue's
                # length.
                for row in range(self.rows - self.task.queue + 1):
                    draw_noise(self.parcels, i * self.rows + row, rng)
            self.streams.memory[i] = self.task.draw_memory(rng)

    def _draw_surface(self, i: int, rng: np.random.Generator) -> None:
        randomisation = self.config.randomisation
        self.surfaces.conditions[i, :3] = randomisation.draw_friction(rng)
        stiffness = randomisation.draw_stiffness(rng, self.streams.commanded.shape[1:])
        if stiffness is not None:
            self.surfaces.stiffness[i] = stiffness

    def _write(self, i: int, arrivals: Arrivals, rng: np.random.Generator) -> None:
        """Remove the parcels of surface i, and write the `arrivals` of a new episode."""
        count = len(arrivals)
        self.streams = streams = fs.with_room(self.streams, count)
        streams.time[i, :count] = arrivals.time
        streams.exit[i, :count] = arrivals.exit
        streams.inlet[i, :count] = arrivals.inlet
        streams.order[i, :count] = arrivals.number
        streams.arrivals[i] = count
        body, streams.start[i, :count] = self._entries(i, arrivals, rng)
        streams.body[i, :count] = body
        for name, value in (
            ("entered", np.nan), ("departed", np.nan), ("taken", fs.ON_ITS_WAY), ("touches", 0),
            ("number", fs.NOBODY), ("present", False), ("touched_at", fs.NEVER), ("coming", 0),
            ("due", 0), ("clock", 0.0), ("steps", 0), ("still", 0.0), ("waited", 0.0),
            ("tally", 0), ("outcome", st.STARTING), ("past", False), ("correct", False),
            ("results", np.nan), ("final", 0.0), ("next_place", 0), ("exit_memory", 0.0),
            ("pressing", 0.0), ("impulse", 0.0), ("squeeze", 0.0),
        ):  # fmt: skip
            getattr(streams, name)[i] = value
        row = i * self.rows
        self.parcels.outcome[row : row + self.rows] = st.RUNNING

    def _entries(
        self, i: int, arrivals: Arrivals, rng: np.random.Generator
    ) -> tuple[Integers, Array]:
        """Return body-table indices (arrivals,), and states at entry (arrivals, STATE_SIZE).

        At entry, a parcel's rear is at the line's edge. The stream and the randomisation determine
        the other values of the state.
        """
        randomisation, count = self.config.randomisation, len(arrivals)
        entrances = self.config.entrances
        placed = bool(arrivals.aside.any() or arrivals.turned.any() or self.config.inlets != EDGE)
        middle = self.config.chosen_line.line_y
        _, _, low, high = self.config.chosen_line.extent
        room = (low - middle, high - middle)
        self._pool.give_back(self._used[i])
        self._used[i] = []
        if placed or randomisation.varies_parcels or randomisation.lateral or randomisation.heading:
            drawn = [
                randomisation.draw_entry(rng, arrivals.kinds[kind], room)
                for kind in arrivals.parcel.tolist()
            ]
            parcels = [parcel for parcel, _, _ in drawn]
            aside = np.array([aside for _, aside, _ in drawn])
            turned = arrivals.turned + [turned for _, _, turned in drawn]
            if placed:
                widths = np.array([each.width for each in entrances])[arrivals.inlet]
                aside = aside + [
                    _place_across(*each)
                    for each in zip(parcels, turned, arrivals.aside, widths, strict=True)
                ]
            body = np.array([self._pool.take(parcel) for parcel in parcels], dtype=np.int64)
            self._used[i] = body.tolist()
            rear = np.array([_rear(*each) for each in zip(parcels, turned, strict=True)])
            centre = np.array([parcel.centre_of_mass for parcel in parcels]).reshape(-1, 2)
        else:
            rows = [self._pool.take(kind) for kind in arrivals.kinds]
            self._used[i] = rows
            body = np.array(rows, dtype=np.int64)[arrivals.parcel]
            aside = turned = np.zeros(count)
            rear = np.array([kind.rear for kind in arrivals.kinds])[arrivals.parcel]
            centre = np.array([kind.centre_of_mass for kind in arrivals.kinds])[arrivals.parcel]
        pose = np.stack([self.config.entry_x + rear, middle + aside, turned], axis=-1)
        velocity = np.zeros((count, 3))
        velocity[:, 0] = arrivals.speed
        for k, entrance in enumerate(entrances if placed else ()):
            here = arrivals.inlet == k
            way = np.array(axis_direction(entrance.heading))
            across = np.array([-way[1], way[0]])
            place = np.array([entrance.x, entrance.y])
            pose[here, :2] = place + np.outer(rear[here], way) + np.outer(aside[here], across)
            pose[here, 2] += entrance.heading
            velocity[here, :2] = np.outer(arrivals.speed[here], way)
        return body, com_states(centre, pose, velocity)

    def _state(self, axes: bool) -> dict[str, NDArray[Any]]:
        found = super()._state(axes)
        for name, array in self.streams._asdict().items():
            if len(array) == self.num_envs:
                found[f"streams.{name}"] = array
        return found

    def restore(self, snapshot: Snapshot, chosen: Integers | int | None = None) -> None:
        self.streams = fs.with_room(self.streams, snapshot.arrays["streams.time"].shape[1])
        super().restore(snapshot, chosen)

    def _copy_parcels(self, chosen: Integers) -> list[dict[int, tuple[Parcel, int]]]:
        """Return {row of the pool: (parcel, number of users)} of every chosen surface."""
        return [
            {row: (self._pool.parcel(row), users) for row, users in Counter(self._used[i]).items()}
            for i in chosen.tolist()
        ]

    def _put_parcels(self, chosen: Integers, parcels: list[dict[int, tuple[Parcel, int]]]) -> None:
        for k, i in enumerate(chosen.tolist()):
            held = parcels[k if len(parcels) > 1 else 0]
            taken = {old: self._pool.take(*each) for old, each in held.items()}
            self._pool.give_back(self._used[i])
            self._used[i] = [taken[old] for old, (_, users) in held.items() for _ in range(users)]
            first, count = i * self.rows, int(self.streams.arrivals[i])
            here = self.parcels.body[first : first + self.rows]
            for used in (self.streams.body[i, :count], here):
                used[:] = [taken.get(row, 0) for row in used.tolist()]
