"""Machines: their messages, logs of them, and the surface that a log tells of."""
