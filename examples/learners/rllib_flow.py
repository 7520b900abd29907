"""RLlib's PPO on Flow's agents: parcels that share one network, each acting for itself.

pip install -r examples/learners/rllib.txt -e ".[agents]"
python examples/learners/rllib_flow.py
"""

from functools import partial
from typing import Any

import numpy as np
from fresh_starts import Act, run
from ray.rllib.env.multi_agent_env import MultiAgentEnv
from rllib_sort import ppo, train

from surface_gym.flow.parallel_env import FlowParallelEnv

ROLLOUT = 2000  # control periods: of 8 lines, 250 each
flow = partial(FlowParallelEnv, exits="sides", duration=20.0)  # [s] in which 7 parcels come


class FlowOfAgents(MultiAgentEnv):
    """Flow, divided into episodes for RLlib, which ends an episode when all its agents are gone.

    Agents that come later begin the next episode. A jam costs each parcel a reward of 1.
    """

    def __init__(self, _: Any) -> None:
        self._flow = env = flow()
        self.possible_agents = env.possible_agents
        self.observation_spaces = {a: env.observation_space(a) for a in env.possible_agents}
        self.action_spaces = {a: env.action_space(a) for a in env.possible_agents}
        super().__init__()

    def reset(self, *, seed: Any = None, options: Any = None) -> Any:
        if seed is not None or not self._flow.agents:
            self._seen = self._flow.reset(seed, options)[0]
        self.agents = self._flow.agents
        return {a: self._seen[a] for a in self.agents}, {}

    def step(self, action_dict: Any) -> Any:
        self._seen, paid, *ends, infos = self._flow.step(action_dict)
        self.agents = self._flow.agents
        paid = {a: paid[a] - (infos[a].get("outcome") == "jam") for a in paid}
        over = not set(self.agents) & set(action_dict)
        result: Any = (self._seen, paid, *ends, infos)
        if over:
            result = tuple({a: each[a] for a in action_dict} for each in result)
        result[2]["__all__"], result[3]["__all__"] = over, False
        return result


def learn(steps: int, seed: int) -> Act:
    """Train for `steps` control periods of lines; return the policy of all parcels."""
    config = ppo(steps, ROLLOUT, seed).environment(FlowOfAgents)
    config.multi_agent(policies={"parcel"}, policy_mapping_fn=lambda *_, **__: "parcel")
    config.env_runners(num_env_runners=0, num_envs_per_env_runner=8)
    logits = train(config, steps, ROLLOUT, "parcel")
    return lambda seen: logits(seen).reshape(-1, 2, 4).argmax(dim=2).numpy()


def right_exits(act: Act, episodes: int = 50) -> dict[str, float]:
    """Return the share of parcels that leave by their exit, in fresh episodes."""
    env, right, coming = flow(), 0, 0
    for seed in range(1_000_000, 1_000_000 + episodes):
        seen, _ = env.reset(seed)
        coming += len(env.possible_agents)
        while env.agents:
            said = act(np.array([seen[agent] for agent in env.agents]))
            seen, *_, infos = env.step(dict(zip(env.agents, said, strict=True)))
            right += sum(info.get("outcome") == "correct" for info in infos.values())
    return {"left by their exit": round(right / coming, 3)}


def main() -> None:
    """Train, and run the policy with its most likely actions in fresh episodes."""
    run(learn, right_exits, 300_000, "ray", "pettingzoo")


if __name__ == "__main__":
    main()
