"""Schedules of streams: maneuvers of parcels, when each enters, and how many an hour a line carries."""
