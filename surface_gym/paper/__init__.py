"""Reproduction of the tables and figures of Bianchi et al. (2023): `python -m surface_gym.paper`.

In Python, use `surface_gym.paper.reproduction.reproduce()`.
"""
