"""Planners: search through the simulator for plans and for layouts."""
