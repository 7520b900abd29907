"""The tables and figures of Bianchi et al. (2023), reproduced: `python -m surface_gym.paper`.

`surface_gym.paper.reproduction.reproduce()` computes all of them for use in Python.
"""
