"""Planners that search through the simulator for plans and layouts."""
