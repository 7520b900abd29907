"""Parcels on one surface, stepped together."""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike

import surface_gym as sg
from surface_gym.compiler.jit import compiled
from surface_gym.parcel import make_bodies
from surface_gym.physics import collision, contact_solver
from surface_gym.physics.collision import ContactMaterial, World, make_world_scratch
from surface_gym.physics.types import OMEGA, THETA, VX, Array, X
from surface_gym.simulation import start_state

G = 9.81  # [m/s^2]
step_together = compiled(contact_solver.step_world.py_func)
forget_together = compiled(collision.invalidate_world.py_func)


def supports(mu: float, tilt: float = 0.0) -> sg.Surface:
    """4 m x 3 m of supports alone."""
    shape = (30, 40)
    return sg.Surface(np.zeros(shape), np.zeros(shape, dtype=bool), mu_support=mu, tilt=tilt)


def quarter_turned(surface: sg.Surface) -> sg.Surface:
    """The surface turned by 90 deg about the origin, its slope with it."""
    stiffness = surface.stiffness
    return dataclasses.replace(
        surface,
        axis=surface.axis.T[:, ::-1] + math.pi / 2,
        rotor=surface.rotor.T[:, ::-1],
        stiffness=None if stiffness is None else stiffness.T[:, ::-1],
        origin=(-surface.y[-1], surface.x[0]),
        tilt_direction=surface.tilt_direction + math.pi / 2,
    )


def ice() -> sg.Surface:
    """Supports without friction."""
    return supports(0.0)


class Meeting:
    """Parcels with their states, as step after step leaves them."""

    def __init__(
        self,
        surface: sg.Surface,
        parcels: list[sg.Parcel],
        poses: ArrayLike,
        velocities: ArrayLike | None = None,
        restitution: float = 0.0,
        side_friction: float = 0.3,
    ) -> None:
        count = len(parcels)
        pose = np.asarray(poses, dtype=np.float64)
        velocity = np.zeros((count, 3)) if velocities is None else np.asarray(velocities) * 1.0
        self.grid = surface.grid
        self.masses = np.array([parcel.mass for parcel in parcels])
        self.inertias = np.array([parcel.moment_of_inertia for parcel in parcels])
        self.world = World(
            np.stack([start_state(*each) for each in zip(parcels, pose, velocity, strict=True)]),
            np.ones(count, dtype=np.bool_),
            np.arange(count),
            make_bodies(parcels),
        )
        self.touching = ContactMaterial(float(restitution), float(side_friction))
        self.scratch = make_world_scratch(count)

    def step(self, dt: float) -> list[tuple[int, int, float]]:
        """Who pushed whom with what impulse [N s]."""
        arguments = (self.grid, self.world, self.touching, self.scratch, dt)
        pushed = step_together(*arguments)
        pairs = self.scratch.pair[:pushed].tolist()
        return [(*pair, each) for pair, each in zip(pairs, self.scratch.impulse, strict=False)]

    def forget(self) -> None:
        forget_together(self.scratch)

    @property
    def place(self) -> Array:
        """(parcels, 3) [m, m, rad] of the centres of mass."""
        return self.world.state[:, X : THETA + 1]

    @property
    def velocity(self) -> Array:
        """(parcels, 3) [m/s, m/s, rad/s]."""
        return self.world.state[:, VX : OMEGA + 1]

    @property
    def energy(self) -> float:
        """[J] of motion."""
        vx, vy, omega = self.velocity.T
        return float(0.5 * self.masses @ (vx**2 + vy**2) + 0.5 * self.inertias @ omega**2)

    @property
    def momentum(self) -> Array:
        """(3,) [N s, N s, N m s] linear, and angular about the origin."""
        x, y, _ = self.place.T
        vx, vy, omega = self.velocity.T
        angular = self.masses @ (x * vy - y * vx) + self.inertias @ omega
        return np.array([self.masses @ vx, self.masses @ vy, angular])
