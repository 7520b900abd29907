"""Forces of a recording's frame, from the next physics step on copies of the states."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from surface_gym import state as st
from surface_gym.physics import collision, rollout, types as ph, world_forces
from surface_gym.physics.types import Array, Integers

if TYPE_CHECKING:
    from surface_gym.core.batch import BaseBatch


class FrameForces(NamedTuple):
    """Forces on the parcels in one frame."""

    bearer: Integers  # (contacts,) row of each contact's parcel
    # (contacts, 4) row times columns plus column of the element, then [N] normal force, and
    # friction on the parcel in x and y
    contacts: Array
    pair: Integers  # (pushes, 2) rows of parcels that push each other
    pushes: Array  # (pushes, 4) [m] point of action in x and y, and [N] force on the second

    def renumbered(self, places: Integers) -> "FrameForces":
        """Replace each parcel's row by `places[row]`; forces of negative rows are dropped."""
        bearer, pair = places[self.bearer], places[self.pair]
        borne, pushing = bearer >= 0, (pair >= 0).all(axis=1)
        return FrameForces(bearer[borne], self.contacts[borne], pair[pushing], self.pushes[pushing])


def join_frames(frames: Sequence[FrameForces]) -> dict[str, Any]:
    """Concatenate the forces of frames as the fields of a recording."""
    return {
        "first_contact": np.cumsum([0, *(len(each.contacts) for each in frames)]),
        "contacts": np.concatenate([each.contacts for each in frames]),
        "bearer": np.concatenate([each.bearer for each in frames]),
        "first_push": np.cumsum([0, *(len(each.pushes) for each in frames)]),
        "pushes": np.concatenate([np.column_stack([each.pair, each.pushes]) for each in frames]),
    }


class ParcelForces:
    """Forces on the only parcel of an environment."""

    def __init__(self, batch: "BaseBatch", env_index: int) -> None:
        self._batch: Any = batch
        self._index = env_index
        self._scratch = ph.make_scratch()

    def compute(self) -> FrameForces:
        """Compute the forces of the next step."""
        batch, i = self._batch, self._index
        body_row, params = int(batch.parcels.body[i]), batch.params
        grid = st.read_grid.py_func(
            batch.surfaces, batch.bodies, i, body_row, params.elements, params.friction
        )
        body = st.read_body.py_func(batch.bodies, body_row)
        states = np.stack([batch.parcels.state[i]] * 2)
        lengths = np.array([0.0, params.timing.dt])
        steps = rollout.RecordedSteps(states, lengths, 0.5 * lengths, np.zeros(3, dtype=np.int64))
        count = np.zeros(2, dtype=np.int64)
        rollout.count_contacts(grid, body, steps, self._scratch, count)
        total = int(count[1])
        contacts = np.zeros((total, 4))
        if total:
            steps.first[2] = total
            observed = rollout.ContactForces(
                states.copy(), np.zeros((total, 2), dtype=np.int64), np.zeros(total),
                np.zeros((total, 2)),
            )  # fmt: skip
            rollout.support_loads(grid, body, steps, self._scratch, observed)
            rollout.repeat_implicit(grid, body, steps, self._scratch, observed)
            mass = batch.parcel(i).mass
            contacts[:, 0] = observed.element @ (grid.axis.shape[1], 1)
            contacts[:, 1] = mass * observed.normal
            contacts[:, 2:] = mass * observed.force
        return FrameForces(
            np.zeros(total, dtype=np.int64), contacts, np.zeros((0, 2), dtype=np.int64),
            np.zeros((0, 4)),
        )  # fmt: skip


class StreamForces:
    """Forces on the parcels of a stream, by slot: from elements and from each other."""

    def __init__(self, batch: "BaseBatch", env_index: int) -> None:
        self._batch: Any = batch
        self._index = env_index
        self._scratch = collision.make_world_scratch(self._batch.rows)
        self._forces = world_forces.make_world_forces(self._batch.rows)

    def compute(self) -> FrameForces:
        """Compute the forces of the next step."""
        batch, i, rows = self._batch, self._index, self._batch.rows
        bodies, params, forces = batch.bodies, batch.params, self._forces
        grid = st.read_grid.py_func(batch.surfaces, bodies, i, 0, params.elements, params.friction)
        own = slice(i * rows, (i + 1) * rows)
        world = collision.World(
            batch.parcels.state[own].copy(),
            batch.streams.present[i].copy(),
            batch.parcels.body[own],
            ph.Bodies(bodies.body, bodies.edges, bodies.corners),
        )
        self._scratch.marks[:, ph.SPANS] = -1  # the axes have turned
        touching, dt = batch.stream_params.touching, params.timing.dt
        pushes = world_forces.observe_world(grid, world, touching, self._scratch, dt, forces)
        total = int(forces.first[-1])
        element = forces.element[:total] @ (grid.axis.shape[1], 1)
        return FrameForces(
            np.repeat(np.arange(rows), np.diff(forces.first)),
            np.column_stack([element, forces.below[:total]]),
            forces.pair[:pushes].copy(),
            forces.push[:pushes].copy(),
        )
