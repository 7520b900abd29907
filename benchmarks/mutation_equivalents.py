"""Mutants that no test can tell from the code, each with the reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Equivalent:
    """A line of a module that may as well be another."""

    module: str  # path from the repository's root
    function: str  # that the line is in
    was: str
    becomes: str
    why: str


EQUIVALENTS = (
    Equivalent(
        "surface_gym/physics/friction.py",
        "",
        "MAX_ITERATIONS = 100",
        "MAX_ITERATIONS = 99",
        "a guard: Newton ends after a few of them",
    ),
    Equivalent(
        "surface_gym/physics/step.py",
        "axis_direction",
        "sine = (place == 2.0) * 1.0 - (place == 6.0) * 1.0",
        "sine = (place == 2.0) / 1.0 - (place == 6.0) * 1.0",
        "over 1 is times 1",
    ),
    Equivalent(
        "surface_gym/physics/contact_solver.py",
        "part",
        "apart = True",
        "apart = False",
        "further sweeps find every pair apart and move nothing",
    ),
    Equivalent(
        "surface_gym/core/resets.py",
        "",
        "NO_EDGE = (0.0, 1.0, 1e9)  # that no point lies beyond, to fill a parcel's edges up",
        "NO_EDGE = ( 1.0, 1.0, 1e9)  # that no point lies beyond, to fill a parcel's edges up",
        "at such a distance an edge of any direction bounds nothing",
    ),
    Equivalent(
        "surface_gym/state.py",
        "reach_along",
        "farthest = -1.0",
        "farthest = - 0.0",
        "corners are about their centroid: one of them reaches beyond 0, or all are a disc's, at 0",
    ),
    Equivalent(
        "surface_gym/sensors/camera.py",
        "look",
        "if lane.sensor_state[place + TAKEN] > 0.0:",
        "if lane.sensor_state[place - TAKEN] > 0.0:",
        "TAKEN is 0",
    ),
    Equivalent(
        "surface_gym/sensors/camera.py",
        "_take",
        "row = lane.noise_row[0]",
        "row = lane.noise_row[ -1]",
        "the array has one number, which is its first and its last",
    ),
    Equivalent(
        "surface_gym/sensors/base.py",
        "enter",
        "lane.sensor_state[3 + k] = lane.truth[3 + k] + velocity_error * lane.noise[row + 1, k]",
        "lane.sensor_state[3 + k] = lane.truth[3 + k] - velocity_error * lane.noise[row + 1, k]",
        "the noise is as likely to be the other way round",
    ),
    Equivalent(
        "agents/vec_env.py",
        "step_wait",
        '"reward_terms": dict(zip(names, self._terms[:, lane].tolist(), strict=True)),',
        '"reward_terms": dict(zip(names, self._terms[:, lane].tolist(), strict=False)),',
        "there are as many sums as names",
    ),
    Equivalent(
        "agents/symmetry.py",
        "mirrored_orientations",
        "if (apart[np.arange(len(angles)), nearest] > SAME).any():",
        "if (apart[np.arange(len(angles)), nearest] >= SAME).any():",
        "angles exactly 1e-6 rad apart: their round-off is on either side of it",
    ),
)
