"""Figures of an episode of a stream."""

from dataclasses import dataclass, fields

import numpy as np

from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.state import TURNS, StreamState


@dataclass(frozen=True)
class FlowStatistics:
    """Figures of one episode, or of its part after a warm-up; nan where nothing happened."""

    delivered: int  # parcels that left the line
    parcels_per_hour: float  # [1/h] that left by their own exit
    missort_rate: float  # [-] of those that left, by another exit or between exits
    touches_per_1000: float  # times that two began to touch, per 1000 parcels delivered
    jams_per_1000: float  # jams per 1000 parcels delivered
    gap_mean: float  # [s] between parcels that leave by the same exit, one after the other
    gap_5: float  # [s] their 5th percentile
    gap_spread: float  # [s] their standard deviation
    time_mean: float  # [s] on the surface
    time_95: float  # [s] its 95th percentile
    waiting_mean: float  # [s] at the entry, of those that have entered
    waiting_most: float  # [s] the longest, of those that wait still too
    turns_per_hour: float  # [1/h] of a module's axis, mean over those that obey: its wear


NAMES = tuple(field.name for field in fields(FlowStatistics))


def compute_statistics(
    streams: StreamState, surface: int, jammed: bool, obeying: int, warm_up: float = 0.0
) -> FlowStatistics:
    """Compute the figures of a surface's episode so far.

    A touch counts half for each of the two, as it leaves; jams and turns are of the whole episode.

    Args:
        streams: their state.
        surface: which.
        jammed: whether the episode ended in a jam.
        obeying: modules that obey.
        warm_up: [s] of the start in which nothing counts: parcels that came or left then.
    """
    count = int(streams.arrivals[surface])
    time, entered, left = (
        values[surface, :count] for values in (streams.time, streams.entered, streams.left)
    )
    taken, asked = streams.taken[surface, :count], streams.exit[surface, :count]
    clock = float(streams.clock[surface])
    counted = clock - warm_up
    gone = left >= warm_up  # false for nan: the parcel is there still
    right = gone & (taken == asked)
    delivered = int(gone.sum())
    gaps = [np.diff(np.sort(left[gone & (taken == exit_)])) for exit_ in np.unique(taken[gone])]
    gap = np.concatenate(gaps) if gaps else np.zeros(0)
    stay = (left - entered)[gone]
    came = (time >= warm_up) & (time <= clock)
    waiting = np.where(np.isnan(entered), clock, entered)[came] - time[came]
    touches = int(streams.touches[surface, :count][gone].sum()) / 2.0
    per_parcel = 1000.0 / delivered if delivered else np.nan
    inside = came & ~np.isnan(entered)
    return FlowStatistics(
        delivered=delivered,
        parcels_per_hour=HOUR * float(right.sum()) / counted if counted > 0.0 else np.nan,
        missort_rate=1.0 - float(right.sum()) / delivered if delivered else np.nan,
        touches_per_1000=touches * per_parcel,
        jams_per_1000=float(jammed) * per_parcel,
        gap_mean=_mean(gap),
        gap_5=_percentile(gap, 5.0),
        gap_spread=float(gap.std()) if gap.size else np.nan,
        time_mean=_mean(stay),
        time_95=_percentile(stay, 95.0),
        waiting_mean=_mean((entered - time)[inside]),
        waiting_most=float(waiting.max()) if waiting.size else np.nan,
        turns_per_hour=(
            HOUR * float(streams.tally[surface, TURNS]) / (obeying * clock)
            if clock > 0.0 and obeying
            else np.nan
        ),
    )


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else np.nan


def _percentile(values: np.ndarray, share: float) -> float:
    return float(np.percentile(values, share)) if values.size else np.nan
