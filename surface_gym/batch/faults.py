"""What a task or a sensor of one's own did wrong, as errors that name it."""

import numpy as np

from surface_gym.lanes.memory import BAD_OBSERVATION, BAD_REWARD, UNKNOWN_OUTCOME, Lanes
from surface_gym.settings import Settings


def not_compiling(settings: Settings, error: Exception) -> ValueError:
    """One of the functions does not compile."""
    return ValueError(f"{_task(settings)} with {_sensor(settings)} does not compile: {error}")


def beyond_arrays(settings: Settings) -> ValueError:
    """One of the functions reads or writes beyond the end of an array."""
    task, sensors = settings.chosen_task, settings.sensors
    return ValueError(
        f"{_task(settings)} and {_sensor(settings)} must keep within their arrays, "
        f"{len(task.features)} features, {len(task.terms)} terms, {len(task.figures)} figures, "
        f"{task.goals} goals, {task.memories} memories, {sensors.kept} kept numbers: "
        f"one index is out of bounds"
    )


def fault_of(settings: Settings, lanes: Lanes, outcomes: tuple[str, ...]) -> ValueError:
    """What a function wrote on the first lane that has a fault."""
    lane = int(np.nonzero(lanes.fault)[0][0])
    task = _task(settings)
    if lanes.fault[lane] == UNKNOWN_OUTCOME:
        return ValueError(
            f"{task}.judge must return RUNNING, SUCCESS or a failure, one of the numbers of "
            f"{outcomes}, got {lanes.outcome[lane]}"
        )
    if lanes.fault[lane] == BAD_REWARD:
        names = settings.chosen_task.terms
        terms = dict(zip(names, lanes.terms[lane].tolist(), strict=True))
        return ValueError(f"{task}.reward must write finite terms, got {terms}")
    assert lanes.fault[lane] == BAD_OBSERVATION
    bad = ~np.isfinite(lanes.observation[lane])
    listed = ", ".join(
        feature.name for feature, wrong in zip(settings.features, bad, strict=True) if wrong
    )
    return ValueError(
        f"{task}.observe, of what {_sensor(settings)} says, must write finite features, "
        f"got others for {listed}"
    )


def _task(settings: Settings) -> str:
    return type(settings.chosen_task).__name__


def _sensor(settings: Settings) -> str:
    return type(settings.sensors).__name__
