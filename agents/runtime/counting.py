"""What is counted and measured while the loop runs."""

from collections import Counter
from dataclasses import dataclass, field


@dataclass
class Counts:
    """How often what happened."""

    periods: int = 0  # control periods that were begun
    kept: int = 0  # of them done before the next was due
    missed: int = 0  # of them done later
    skipped: int = 0  # that were not begun, since one before them took so long
    decisions: int = 0  # by the policy
    by_fixed_layout: int = 0  # periods in which the fixed layout stood in
    held: int = 0  # periods with a parcel in which the axes were left as they stood
    unconnected: int = 0  # periods without a device
    sent: int = 0  # axis commands
    out_of_range: int = 0  # axis commands that were refused here, and not sent
    refused: int = 0  # axis commands that the device refused
    strayed: int = 0  # observations beyond their bounds
    frames: int = 0  # that arrived
    frames_unused: int = 0  # of them of no use: of another parcel, or out of order
    watchdog: int = 0  # times that frames stopped for too long
    connected: int = 0  # times that the device was found
    lost: int = 0  # times that it was lost
    attempts: int = 0  # to find it
    unfit: int = 0  # parcels that the surface or the task has no place for
    kills: int = 0  # times that the simulator was killed, as a drill
    parcels: Counter[str] = field(default_factory=Counter)  # by how they left


@dataclass
class Latencies:
    """[s] of every decision that was sent."""

    late: list[float] = field(default_factory=list)  # from when a period is due to its beginning
    sensor: list[float] = field(default_factory=list)  # from the latest frame to the estimate
    filter: list[float] = field(default_factory=list)  # reading, estimating, observing
    policy: list[float] = field(default_factory=list)  # deciding
    send: list[float] = field(default_factory=list)  # from there until the device took the axes
    turn: list[float] = field(default_factory=list)  # until the last axis has turned, as reckoned
    whole: list[float] = field(default_factory=list)  # from the latest frame until there
    work: list[float] = field(default_factory=list)  # of a period, from its beginning to its end
