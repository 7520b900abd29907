"""The benchmark of policies: a policy in a process of its own, with bounded time and memory."""
