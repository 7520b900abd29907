"""The tables and figures of Bianchi et al. (2023), reproduced: `python -m surface_gym.paper`."""

from surface_gym.paper.comparison import Cell, Found, Table
from surface_gym.paper.integration import COARSE, CONVERGED, Integration
from surface_gym.paper.reproduction import Reproduction, reproduce

__all__ = [
    "COARSE",
    "CONVERGED",
    "Cell",
    "Found",
    "Integration",
    "Reproduction",
    "Table",
    "reproduce",
]
