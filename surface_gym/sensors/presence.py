"""Presence: each module's own on/off sensor, and an observer that makes a pose of the pattern."""

import math
from dataclasses import dataclass, field

import numpy as np

from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.contacts import EDGE_TOLERANCE
from surface_gym.dynamics.types import OMEGA, THETA, VX, VY, Array, Body, Grid, Scratch, X, Y
from surface_gym.lanes.memory import (
    COM_HEIGHT,
    GRAVITY_ALONG,
    GRAVITY_NORMAL,
    GYRATION,
    RADIUS,
    Geometry,
    Lanes,
)
from surface_gym.sensors.entry import ENTRY_SIZE, Entry, enter
from surface_gym.sensors.observer import LAST, correct, measure, predict, spread
from surface_gym.sensors.outline import covered_columns, outside
from surface_gym.sensors.sensor import Sensing

PRESENCE = 2

(EVERY, DROP, MU_MAX, MU_MIN, MU_SUPPORT, ACCELERATION, TURN_ACCELERATION, TOLERANCE, ENTRY) = range(9)
# Columns of `Lanes.filter` after the observer's: the pose at the last sample, and its step.
SAMPLED, STEP = LAST, LAST + 3


@dataclass(frozen=True)
class Presence:
    sample_rate: float = 200.0
    drop: float = 0.0
    mu_max: float = 0.5
    mu_min: float = 0.01
    mu_support: float = 0.005
    acceleration_density: float = 0.1
    turn_density: float = 5.0
    tolerance: float = 0.001
    entry: Entry = field(default_factory=Entry)

    def sample_steps(self, dt: float) -> int:
        return round(1.0 / (self.sample_rate * dt))

    def sensing(self, dt: float) -> Sensing:
        settings = np.zeros(ENTRY + ENTRY_SIZE)
        settings[:ENTRY] = (self.sample_steps(dt), self.drop, self.mu_max, self.mu_min, self.mu_support,
            self.acceleration_density, self.turn_density, self.tolerance)
        settings[ENTRY:] = self.entry.settings
        return Sensing(PRESENCE, settings)

    def draws(self, dt: float, steps: int) -> int:
        return math.ceil(steps / self.sample_steps(dt))


@inlined
def begin(settings: Array, lanes: Lanes, lane: int) -> None:
    kept = lanes.filter[lane]
    enter(settings, ENTRY, lanes, lane, kept)
    kept[6] = 0.0
    kept[7] = 0.0
    spread(kept, settings, ENTRY)
    kept[SAMPLED] = lanes.truth[lane, 0]
    kept[SAMPLED + 1] = lanes.truth[lane, 1]
    kept[SAMPLED + 2] = lanes.truth[lane, 2]
    kept[STEP] = 0.0


@inlined
def _switch(lanes: Lanes, lane: int, x: float, y: float, now: bool, interval: float, noise_scale: float, tolerance: float) -> None:
    """A module at (x, y) switched within the last `interval`, on average `lead` ago."""
    kept = lanes.filter[lane]
    lead = 0.5 * interval
    theta = kept[THETA] - lead * kept[OMEGA]
    dx = x - kept[X] + lead * kept[VX]
    dy = y - kept[Y] + lead * kept[VY]
    # velocity of the module relative to the base, positive along outward normal when leaving
    way = -1.0 if now else 1.0
    ux = way * (-kept[VX] + kept[OMEGA] * dy)
    uy = way * (-kept[VY] - kept[OMEGA] * dx)
    distance, nx, ny = outside(lanes, lane, dx, dy, math.cos(theta), math.sin(theta), ux, uy)
    lever = nx * dy - ny * dx
    speed = nx * kept[VX] + ny * kept[VY] - lever * kept[OMEGA]
    noise = noise_scale * (speed * speed * interval * interval / 12.0 + tolerance * tolerance)
    variance = measure(kept, -nx, -ny, lever, lead)
    if GATE > 0.0 and distance * distance > GATE * (variance + noise):
        noise = distance * distance / GATE - variance
    total = 1.0 / (variance + noise)
    correct(kept, -distance * total, total)


@inlined
def _contradict(lanes: Lanes, lane: int, x: float, y: float, covered: bool, tolerance: float) -> None:
    kept = lanes.filter[lane]
    theta = kept[THETA]
    dx = x - kept[X]
    dy = y - kept[Y]
    distance, nx, ny = outside(lanes, lane, dx, dy, math.cos(theta), math.sin(theta), 0.0, 0.0)
    wrong = distance if covered else -distance
    if wrong <= tolerance:
        return
    lever = nx * dy - ny * dx
    variance = measure(kept, -nx, -ny, lever, 0.0)
    if MODE == 0:
        total = 1.0 / (variance + tolerance * tolerance)
        correct(kept, -distance * total, total)
    elif MODE == 1:
        total = 1.0 / (2.0 * variance + tolerance * tolerance)
        correct(kept, -distance * total, total)
    elif MODE == 2:
        s = math.sqrt(variance)
        a = max(-5.0,-wrong / s)
        cdf = 0.5 * math.erfc(-a / math.sqrt(2.0))
        ratio = math.exp(-0.5 * a * a) / math.sqrt(2.0 * math.pi) / cdf
        shift = -wrong - s * ratio + wrong
        shrink = ratio * (a + ratio)
        sign = 1.0 if covered else -1.0
        correct(kept, sign * (-s * ratio) / variance, shrink / variance)
    elif MODE == 3:
        total = 1.0 / (variance + tolerance * tolerance)
        correct(kept, -distance * total, 0.0)
import os

GATE = float(os.environ.get("GATE", "0"))
INFLATE = int(os.environ.get("INFLATE", "1"))
MODE = int(os.environ.get("MODE", "0"))


@inlined
def look(settings: Array, lanes: Lanes, lane: int, geometry: Geometry, scratch: Scratch, dt: float) -> None:
    kept = lanes.filter[lane]
    grid = Grid(
        lanes.axis[lane], lanes.rotor[lane], lanes.stiffness[lane], geometry.x0, geometry.y0, geometry.pitch,
        settings[MU_MAX], settings[MU_MIN], settings[MU_SUPPORT],
        lanes.surface[lane, GRAVITY_ALONG], lanes.surface[lane, GRAVITY_NORMAL],
    )
    body = Body(lanes.edges[lane], lanes.body[lane, RADIUS], 0.0, 0.0, lanes.body[lane, COM_HEIGHT], lanes.body[lane, GYRATION])
    predict(grid, body, kept, scratch, dt, settings[ACCELERATION], settings[TURN_ACCELERATION])
    step = lanes.steps[lane]
    if step % int(settings[EVERY]) != 0:
        return
    row = lanes.noise_row[lane]
    lanes.noise_row[lane] = row + 1
    if lanes.noise[lane, row, 3] < settings[DROP]:
        return
    interval = dt * (step - kept[STEP])
    truth = lanes.truth[lane]
    was_x, was_y, was_theta = kept[SAMPLED], kept[SAMPLED+1], kept[SAMPLED+2]
    reach = lanes.body[lane, RADIUS] + EDGE_TOLERANCE
    per_pitch = 1.0 / geometry.pitch
    low = math.ceil((min(truth[1], was_y, kept[Y]) - reach - geometry.y0) * per_pitch)
    high = math.floor((max(truth[1], was_y, kept[Y]) + reach - geometry.y0) * per_pitch)
    first_row = max(0, int(low))
    last_row = min(lanes.rotor.shape[1] - 1, int(high))
    cosine, sine = math.cos(truth[2]), math.sin(truth[2])
    was_cosine, was_sine = math.cos(was_theta), math.sin(was_theta)
    events = 0
    for r in range(first_row, last_row + 1):
        first, last = covered_columns(lanes, lane, geometry, r, truth[0], truth[1], cosine, sine)
        was_first, was_last = covered_columns(lanes, lane, geometry, r, was_x, was_y, was_cosine, was_sine)
        for c in range(min(first, was_first), max(last, was_last) + 1):
            if lanes.rotor[lane, r, c] and (first <= c <= last) != (was_first <= c <= was_last):
                events += 1
    if events > 0:
        for r in range(first_row, last_row + 1):
            y = geometry.y0 + geometry.pitch * r
            first, last = covered_columns(lanes, lane, geometry, r, truth[0], truth[1], cosine, sine)
            was_first, was_last = covered_columns(lanes, lane, geometry, r, was_x, was_y, was_cosine, was_sine)
            for c in range(min(first, was_first), max(last, was_last) + 1):
                now = first <= c <= last
                if lanes.rotor[lane, r, c] and now != (was_first <= c <= was_last):
                    _switch(lanes, lane, geometry.x0 + geometry.pitch * c, y, now, interval, events if INFLATE else 1.0, settings[TOLERANCE])
    mcosine, msine = math.cos(kept[THETA]), math.sin(kept[THETA])
    for r in range(first_row, last_row + 1):
        y = geometry.y0 + geometry.pitch * r
        first, last = covered_columns(lanes, lane, geometry, r, truth[0], truth[1], cosine, sine)
        m_first, m_last = covered_columns(lanes, lane, geometry, r, kept[X], kept[Y], mcosine, msine)
        for c in range(min(first, m_first), max(last, m_last) + 1):
            now = first <= c <= last
            if lanes.rotor[lane, r, c] and now != (m_first <= c <= m_last):
                _contradict(lanes, lane, geometry.x0 + geometry.pitch * c, y, now, settings[TOLERANCE])
    kept[SAMPLED] = truth[0]
    kept[SAMPLED + 1] = truth[1]
    kept[SAMPLED + 2] = truth[2]
    kept[STEP] = step


@inlined
def estimate(lanes: Lanes, lane: int) -> None:
    for k in range(6):
        lanes.sensed[lane, k] = lanes.filter[lane, k]
