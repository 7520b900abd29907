"""PPO in one file, in CleanRL's style, on the native vector env of Sort; saves cleanrl-SEED.pt.

pip install -e ".[agents]"
python examples/learners/cleanrl_sort.py --seed 0
"""

import gymnasium as gym
import numpy as np
import torch
from fresh_starts import Act, run, success
from gymnasium.vector import AutoresetMode
from torch import Tensor, nn

NUM_ENVS, PERIODS, BATCH, EPOCHS = 64, 64, 1024, 5
GAMMA, LAMBDA, CLIP, ENTROPY, RATE = 0.99, 0.95, 0.2, 0.005, 1e-3


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Make a network with two hidden layers of 64 units."""
    hidden = nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh()
    return nn.Sequential(*hidden, nn.Linear(64, outputs))


def learn(steps: int, seed: int) -> Act:
    """Train for `steps` control periods; return the policy. The learning rate falls to 0."""
    turns = -(-steps // (NUM_ENVS * PERIODS))
    torch.manual_seed(seed)
    torch.set_num_threads(1)  # the networks are small
    mode = AutoresetMode.SAME_STEP  # an ended episode shows its next start at once: no lost step
    env = gym.make_vec("SmartSurface/Sort-v0", NUM_ENVS, actions="halves", autoreset_mode=mode)
    actor, critic = network(15, 16), network(15, 1)
    weights = [*actor.parameters(), *critic.parameters()]
    adam = torch.optim.Adam(weights, RATE, eps=1e-5)
    seen = torch.from_numpy(env.reset(seed=seed)[0])
    for turn in range(turns):
        adam.param_groups[0]["lr"] = RATE * (1 - turn / turns)
        kept: list[tuple[Tensor, ...]] = []
        with torch.no_grad():
            for _ in range(PERIODS):
                odds, value = actor(seen).log_softmax(1), critic(seen)[:, 0]
                action = odds.exp().multinomial(1)
                after_step, paid, terminated, truncated, _ = env.step(action[:, 0].numpy())
                over = torch.from_numpy(terminated | truncated)
                reward = torch.from_numpy(paid).float()
                kept.append((seen, action, odds.gather(1, action), value, reward, over))
                seen = torch.from_numpy(after_step)
            after, gain, gains = critic(seen)[:, 0], torch.zeros(NUM_ENVS), []
            for *_, value, reward, over in reversed(kept):
                gain = reward - value + GAMMA * ~over * (after + LAMBDA * gain)
                gains.append(gain)
                after = value
        all_seen, actions, old, values, rewards, ends = map(torch.cat, zip(*kept, strict=True))
        gained = torch.cat(gains[::-1])
        orders = [torch.randperm(len(gained)) for _ in range(EPOCHS)]
        for some in torch.cat(orders).view(-1, BATCH):
            odds = actor(all_seen[some]).log_softmax(1)
            scaled = (gained[some] - gained[some].mean()) / (gained[some].std() + 1e-8)
            ratio = (odds.gather(1, actions[some]) - old[some])[:, 0].exp()
            surrogate = torch.min(ratio * scaled, ratio.clamp(1 - CLIP, 1 + CLIP) * scaled).mean()
            missed = critic(all_seen[some])[:, 0] - (values + gained)[some]
            entropy = -(odds.exp() * odds).sum(1).mean()
            loss = 0.5 * missed.square().mean() - surrogate - ENTROPY * entropy
            adam.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(weights, 0.5)
            adam.step()
        if turn % 25 == 0:
            mean = rewards.sum() / ends.sum()
            print(f"{(turn + 1) * len(gained):8} periods: return {mean:.2f}, loss {loss:.3f}")
    torch.save(actor.state_dict(), f"cleanrl-{seed}.pt")
    return lambda seen: np.asarray(actor(torch.from_numpy(seen)).argmax(dim=1))


def main() -> None:
    """Train, and run the policy with its most likely actions on fresh starts."""
    run(learn, success, 2_500_000)


if __name__ == "__main__":
    main()
