"""What a batch of flows is made with: its functions, its rules and the sizes of its memory."""

import math

import numpy as np

from surface_gym.core.batch import actuation_of, sensor_functions_of, surface_rules_of
from surface_gym.core.kernel import EnvParams
from surface_gym.flow.features import FEATURES
from surface_gym.flow.kernel import FlowFunctions
from surface_gym.flow.memory import GOALS, MEMORIES, OUTCOMES, FlowRules
from surface_gym.flow.obeying import part_of_module, part_of_owner, told_angle, told_choice
from surface_gym.flow.rewards import PARCEL_TERMS
from surface_gym.flow.settings import FlowSettings
from surface_gym.parcel import Parcel
from surface_gym.state import Sizes


def rear_of(parcel: Parcel, theta: float) -> float:
    """[m] from the rearmost point of the base, turned by theta, to its frame's origin."""
    outline = parcel.base.outline
    return -float((math.cos(theta) * outline[:, 0] - math.sin(theta) * outline[:, 1]).min())


def stream_functions(settings: FlowSettings) -> FlowFunctions:
    """What the kernel of an environment is built from."""
    kind = settings.action_kind
    begin, update, read = sensor_functions_of(settings.sensors)
    return FlowFunctions(
        label=f"Flow-{type(settings.sensors).__name__}-{settings.actions}",
        begin_sensor=begin,
        update_sensor=update,
        read_sensor=read,
        watches=settings.sensors.watches,
        part_of=part_of_module if settings.actions == "modules" else part_of_owner,
        told=told_angle if kind.continuous else told_choice,
        actuation=actuation_of(kind.continuous, settings.actuators.axis_speed != math.inf),
    )


def rules_of(settings: FlowSettings) -> EnvParams:
    """Those of its surfaces."""
    return surface_rules_of(settings, len(FEATURES), len(FEATURES), len(OUTCOMES))


def flow_rules_of(settings: FlowSettings) -> FlowRules:
    """Those of its flows."""
    return FlowRules(
        exits=np.array(settings.exits.table),
        entry_gap=settings.entry_gap,
        rotors_end=settings.rotors_end,
        ahead=settings.ahead,
        duration=settings.duration,
        patience=settings.patience,
        gated=settings.gate,
        sides=settings.sides,
    )


def sizes_of(settings: FlowSettings, lanes: int) -> Sizes:
    """Of the memory of so many surfaces and their parcels."""
    plant, kind = settings.chosen_plant, settings.action_kind
    return Sizes(
        num_envs=lanes,
        max_parcels=settings.rows,
        rows=plant.rows,
        columns=plant.columns,
        command=settings.flow_actions.size,
        choices=kind.choices,
        observation=len(FEATURES),
        terms=len(PARCEL_TERMS),
        goals=GOALS,
        memories=MEMORIES,
        metrics=0,
        sensor_state=settings.sensors.sensor_size,
        path=False,
        noise=settings.draws > 0,
        turning=settings.actuators.axis_speed != math.inf,
        stiffness=settings.randomisation.stiffness > 0.0,
    )
