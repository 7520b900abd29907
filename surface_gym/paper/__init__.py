"""The tables and figures of Bianchi et al. (2023), reproduced: `python -m surface_gym.paper`."""

from surface_gym.paper.comparison import Cell, Table
from surface_gym.paper.integration import CONVERGED, PAPER_STEP, Integration
from surface_gym.paper.reproduction import Reproduction, reproduce

__all__ = [
    "CONVERGED",
    "PAPER_STEP",
    "Cell",
    "Integration",
    "Reproduction",
    "Table",
    "reproduce",
]
