"""How many processes to share work among."""

import os


def usable_cores() -> int:
    """Cores this process may run on, as far as the system tells."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
