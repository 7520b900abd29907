"""Streams of parcels on a line of modules."""
