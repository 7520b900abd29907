"""Schedules of streams: maneuvers of parcels, moments of entry, bounds on what a line carries."""
