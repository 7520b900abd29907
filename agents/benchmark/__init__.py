"""The benchmark of policies: a policy in a process of its own, with bounded time and memory."""

import json
from pathlib import Path

VERSION = 1  # of the protocol
FILE = Path(__file__).parent / f"protocol-{VERSION}.json"
TASKS: tuple[str, ...] = tuple(json.loads(FILE.read_text())["digests"])
