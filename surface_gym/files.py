"""Files that are written whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SUFFIX = ".part"  # of a file that is being written


@contextmanager
def replacing(file: Path) -> Iterator[Path]:
    """Yield a path to write, which takes the place of `file` at the end.

    If the block raises an error, `file` stays as it was.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(file.name + SUFFIX)
    yield part
    os.replace(part, file)
