"""TorchRL's PPO on the native vector env of Sort.

pip install -r examples/learners/torchrl.txt -e ".[agents]"
python examples/learners/torchrl_sort.py
"""

import gymnasium as gym
import numpy as np
import torch
from fresh_starts import Act, run, success
from gymnasium.vector import AutoresetMode
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Categorical
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper
from torchrl.modules import ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

NUM_ENVS, ROLLOUT, BATCH, EPOCHS, RATE = 64, 64 * 64, 1024, 5, 1e-3


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Make a network with two hidden layers of 64 units."""
    hidden = nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh()
    return nn.Sequential(*hidden, nn.Linear(64, outputs))


def learn(steps: int, seed: int) -> Act:
    """Train for `steps` control periods; return the policy. The learning rate falls to 0."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)  # the networks are small
    mode = AutoresetMode.DISABLED  # TorchRL resets ended environments itself
    envs = gym.make_vec("SmartSurface/Sort-v0", NUM_ENVS, actions="halves", autoreset_mode=mode)
    env = GymWrapper(envs, categorical_action_encoding=True)
    env.set_seed(seed)
    odds = network(15, 16)
    logits = TensorDictModule(odds, ["observation"], ["logits"])
    actor = ProbabilisticActor(
        logits, ["logits"], distribution_class=Categorical, return_log_prob=True
    )
    critic = ValueOperator(network(15, 1), in_keys=["observation"])
    gains = GAE(gamma=0.99, lmbda=0.95, value_network=critic)
    losses = ClipPPOLoss(
        actor, critic, entropy_coeff=0.005, loss_critic_type="l2", normalize_advantage=True
    )
    adam = torch.optim.Adam(losses.parameters(), RATE, eps=1e-5)
    turns = -(-steps // ROLLOUT)
    collector = Collector(
        env, actor, frames_per_batch=ROLLOUT, total_frames=turns * ROLLOUT,
        auto_register_policy_transforms=False,
    )  # fmt: skip
    for turn, rollout in enumerate(collector):
        adam.param_groups[0]["lr"] = RATE * (1 - turn / turns)
        with torch.no_grad():
            flat = gains(rollout).reshape(-1)
        orders = [torch.randperm(ROLLOUT) for _ in range(EPOCHS)]
        for rows in torch.cat(orders).view(-1, BATCH):
            terms = losses(flat[rows])
            loss = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
            adam.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(losses.parameters(), 0.5)
            adam.step()
        if turn % 25 == 0:
            mean = rollout["next", "reward"].sum() / rollout["next", "done"].sum()
            print(f"{(turn + 1) * ROLLOUT:8} periods: return {mean:.2f}, loss {loss:.3f}")
    collector.shutdown()
    return lambda seen: np.asarray(odds(torch.from_numpy(seen)).argmax(dim=1))


def main() -> None:
    """Train, and run the policy with its most likely actions on fresh starts."""
    run(learn, success, 2_500_000, "torchrl", "tensordict")


if __name__ == "__main__":
    main()
