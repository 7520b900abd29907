"""Kernels in Numba's CUDA simulator beside the CPU's vector env, in a process of its own:
`NUMBA_ENABLE_CUDASIM=1 python -m tests.cuda.simulated` prints, for every case, what differs.
"""

import json
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode

from surface_gym.registration import FLOW
from surface_gym.vector_env import make_device_env
from tests.cuda.cases import CASES, FLOWS, actions_of, id_of

LANES, LIMIT, PERIODS = 3, 5, 12
FLOW_LANES = 2


def differences(name: str, mode: AutoresetMode) -> list[str]:
    """What is not the same to the bit, over some episodes of a task."""
    task, settings = CASES[name]
    given = {"max_episode_steps": LIMIT, "autoreset_mode": mode, **settings}
    cpu = gym.make_vec(id_of(name), num_envs=LANES, **given)
    device = make_device_env(LANES, "cpu", task=task, **given)
    actions = actions_of(cpu, PERIODS)
    found = begun(cpu, device)
    for period, action in enumerate(actions):
        options: dict[str, Any] = {}
        if period == LIMIT + 3:  # one lane, in the middle of its episode
            options = {"reset_mask": np.arange(LANES) == 1, "speed": 0.9}
        elif mode == AutoresetMode.DISABLED and period == LIMIT:
            options = {"reset_mask": np.ones(LANES, dtype=np.bool_)}
        if options:
            of_cpu, of_device = cpu.reset(options=options), device.reset(options=options)
        else:
            of_cpu, of_device = cpu.step(action), device.step(torch.from_numpy(action))
        found += compared(of_cpu, of_device, device.outcomes, f"period {period}")
    device.close()
    return found


def differences_of_flow(name: str, mode: AutoresetMode) -> list[str]:
    """What is not the same to the bit, over two episodes of a flow in which parcels touch."""
    given = {"autoreset_mode": mode, **FLOWS[name]}
    cpu = gym.make_vec(FLOW, num_envs=FLOW_LANES, **given)
    device = make_device_env(FLOW_LANES, "cpu", **given)
    periods = round(1.5 * FLOWS[name]["duration"] / device.settings.control_period)
    found, touches = begun(cpu, device), 0
    for period, action in enumerate(actions_of(cpu, periods)):
        of_cpu, of_device = cpu.step(action), device.step(torch.from_numpy(action))
        for infos in (of_cpu[4], of_cpu[4].get("final_info", {})):
            for more in ("episode_figures", "_episode_figures"):  # that the host works out
                infos.pop(more, None)
        touches = max(touches, int(of_cpu[4]["touches"].max()))
        found += compared(of_cpu, of_device, device.outcomes, f"period {period}")
    return found if touches else [*found, "no parcels touched"]


def begun(cpu: Any, device: Any) -> list[str]:
    """What differs of the first episodes' beginning."""
    seed: dict[str, Any] = {"seed": 3}
    return compared(cpu.reset(**seed), device.reset(**seed), device.outcomes, "reset")


def compared(one: Any, other: Any, outcomes: tuple[str, ...], place: str) -> list[str]:
    """What the CPU gives and the device does not."""
    if isinstance(one, tuple):
        pairs = zip(one, other, strict=True)
        return [
            w for k, pair in enumerate(pairs) for w in compared(*pair, outcomes, f"{place} {k}")
        ]
    if isinstance(one, dict):
        ended = {"final_obs", "final_info", "_final_obs", "_final_info"}
        found = [] if set(one) - ended == set(other) - ended else [f"{place}: other names"]
        for name in set(one) - ended:
            found += compared(one[name], other[name], outcomes, f"{place} {name}")
        return found + of_ended(one, other, outcomes, place)
    if one.dtype == object:
        other = np.array(outcomes, dtype=object)[other.numpy()]
    return [] if np.array_equal(one, other) else [f"{place}: {one} is {other}"]


def of_ended(
    one: dict[str, Any], other: dict[str, Any], outcomes: tuple[str, ...], place: str
) -> list[str]:
    """What differs of the episodes that ended in a step."""
    if "final_obs" not in one:
        any_ended = "_final_obs" in other and bool(other["_final_obs"].any())
        return [f"{place}: episodes ended"] if any_ended else []
    lanes = one["_final_obs"]
    last = np.stack(one["final_obs"][lanes]), other["final_obs"].numpy()[lanes]
    return (
        compared(lanes, other["_final_obs"], outcomes, f"{place} _final_obs")
        + compared(*last, outcomes, f"{place} final_obs")
        + compared(one["final_info"], other["final_info"], outcomes, f"{place} final_info")
    )


def main() -> None:
    """Compare all cases, each in one mode."""
    modes = list(AutoresetMode)
    found = {name: differences(name, modes[k % 3]) for k, name in enumerate(CASES)}
    of_flows = {name: differences_of_flow(name, modes[k]) for k, name in enumerate(FLOWS)}
    print(json.dumps({**found, **of_flows}))


if __name__ == "__main__":
    main()
