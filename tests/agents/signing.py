"""A policy's files that were changed, as if they had been written so."""

import json
from hashlib import sha256
from pathlib import Path

import yaml

from surface_gym.agents.library import CARD, WEIGHTS


def sign(folder: Path) -> None:
    """Give the card the digest that its fields and the weights have now."""
    fields = yaml.safe_load((folder / CARD).read_text())
    fields.pop("digest", None)
    content = json.dumps(fields, sort_keys=True).encode() + (folder / WEIGHTS).read_bytes()
    fields["digest"] = sha256(content).hexdigest()
    (folder / CARD).write_text(yaml.safe_dump(fields))
