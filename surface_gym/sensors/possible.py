"""What a parcel can do: bounds on an estimate, whatever its model and its corrections say."""

import math

from surface_gym.dynamics.compiled import lane_function
from surface_gym.dynamics.types import GYRATION, OMEGA, RADIUS, THETA, VX, VY, Array, X, Y
from surface_gym.lanes.lane import Lane
from surface_gym.lanes.memory import GRAVITY_ALONG
from surface_gym.sensors.observer import COVARIANCE, SIZE

SURE = 3.0  # standard deviations of an entry that count
# [-] of the energy that a load over the centroid has at most: over one off centre the centroid is
# faster than the load, and parcels push each other.
MARGIN = 4.0
# No parcel of any task is faster, and every observation has room for as much.
FASTEST = 9.0  # [m/s]
FASTEST_TURN = 100.0  # [rad/s]
MOST_TURN = 32.0 * math.pi  # [rad] of theta; whole turns beyond are not counted


@lane_function
def most_energy(lane: Lane) -> float:
    """[m^2/s^2] vx^2 + vy^2 + (gyration radius x omega)^2 that a parcel may have at most.

    Modules brake and do not push, so that it is what the entry, which `lane.kept` holds, and the
    way down the whole surface give.
    """
    kept = lane.kept
    energy = 2.0 * abs(lane.surface[GRAVITY_ALONG]) * lane.elements.pitch_x * lane.rotor.shape[1]
    for k in range(3, SIZE):
        fastest = abs(kept[k]) + SURE * math.sqrt(kept[COVARIANCE + (SIZE + 1) * k])
        energy += fastest * fastest * (lane.body[GYRATION] if k == OMEGA else 1.0)
    return min(MARGIN * energy, FASTEST * FASTEST)


@lane_function
def keep_possible(lane: Lane, energy: float) -> None:
    """Bring the estimate in `lane.kept` back over the surface, and slow it down to an energy
    [m^2/s^2], where it is beyond.
    """
    kept = lane.kept
    rows, columns = lane.rotor.shape
    elements, reach = lane.elements, lane.body[RADIUS]
    left, low = elements.x0 - 0.5 * elements.pitch_x, elements.y0 - 0.5 * elements.pitch_y
    _keep_within(kept, X, left - reach, left + elements.pitch_x * columns + reach)
    _keep_within(kept, Y, low - reach, low + elements.pitch_y * rows + reach)
    if abs(kept[THETA]) > MOST_TURN:
        kept[THETA] -= 2.0 * math.pi * math.floor(kept[THETA] / (2.0 * math.pi))
    turning = lane.body[GYRATION] * kept[OMEGA] * kept[OMEGA]
    has = kept[VX] * kept[VX] + kept[VY] * kept[VY] + turning
    if has > energy:
        slower = math.sqrt(energy / has)
        for k in range(3, SIZE):
            kept[k] *= slower
    _keep_within(kept, OMEGA, -FASTEST_TURN, FASTEST_TURN)


@lane_function
def _keep_within(kept: Array, k: int, low: float, high: float) -> None:
    """Bring a coordinate back into [low, high]."""
    if kept[k] < low:
        kept[k] = low
    elif kept[k] > high:
        kept[k] = high
