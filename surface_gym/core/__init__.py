"""Parcels on surfaces, many at once: what both faces of the environment drive."""
