"""Schedules of streams: maneuvers of parcels, times of entry, and bounds on throughput."""
