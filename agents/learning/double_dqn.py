"""DQN with double Q: one network chooses the next action, its slow copy says what it is worth.

With one network for both, the largest of its errors is taken for the truth, and it diverges late.
van Hasselt, Guez and Silver, Deep Reinforcement Learning with Double Q-learning, AAAI 2016.
"""

import numpy as np
import torch
from stable_baselines3 import DQN
from torch.nn.functional import smooth_l1_loss
from torch.nn.utils import clip_grad_norm_


class DoubleDQN(DQN):
    """Stable-Baselines3's DQN with the double estimate as the target."""

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """Take gradient steps on batches of what is remembered."""
        assert self.replay_buffer is not None
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        losses = []
        for _ in range(gradient_steps):
            batch = self.replay_buffer.sample(batch_size, env=self._vec_normalize_env)
            discount = self.gamma if batch.discounts is None else batch.discounts
            with torch.no_grad():
                chosen = self.q_net(batch.next_observations).argmax(dim=1, keepdim=True)
                worth = self.q_net_target(batch.next_observations).gather(1, chosen)
                target = batch.rewards + (1.0 - batch.dones) * discount * worth
            value = self.q_net(batch.observations).gather(1, batch.actions.long())
            loss = smooth_l1_loss(value, target)
            losses.append(loss.detach())
            self.policy.optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
            self.policy.optimizer.step()
        self._n_updates += gradient_steps
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/loss", float(np.mean(torch.stack(losses).numpy())))


def cut_memory(model: DoubleDQN) -> None:
    """Say of what was remembered last that its episodes went on unseen: what comes next belongs to
    others, and no return over several steps may reach into it.
    """
    buffer = model.replay_buffer
    assert buffer is not None
    last = buffer.pos - 1
    buffer.timeouts[last] = np.logical_or(buffer.timeouts[last], buffer.dones[last] == 0.0)
