"""A run on a node of a cluster: it works in a folder of its own there, and what it writes comes
back to the run's folder, which need not be seen by the nodes.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from surface_gym.sharing import Tell
from surface_gym.whole_files import SUFFIX, replacing

from .checkpoint import FILE as CHECKPOINT
from .config import TrainConfig
from .legs import Learned, News
from .start import start


@dataclass(frozen=True)
class Elsewhere:
    """A run as it is handed over: with what its folder holds at that moment, so that it goes on
    from its last checkpoint where a node has died.
    """

    config: TrainConfig
    folder: Path

    def __call__(self, tell: Tell) -> Learned:
        return _train(self.config, files_of(self.folder), tell)

    def __reduce__(self) -> tuple[Any, ...]:
        return partial, (_train, self.config, files_of(self.folder))


def files_of(folder: Path) -> dict[str, bytes]:
    """What a folder's files hold, by their names in it."""
    return {name: (folder / name).read_bytes() for name in _stamps(folder)}


def put_files(files: dict[str, bytes], folder: Path) -> None:
    """Write files, each whole or not at all; the checkpoint last, since the others go with it."""
    for name in sorted(files, key=lambda name: name == CHECKPOINT):
        with replacing(folder / name) as part:
            part.write_bytes(files[name])


def _train(config: TrainConfig, files: dict[str, bytes], tell: Tell) -> Learned:
    with TemporaryDirectory() as name:
        folder = Path(name)
        put_files(files, folder)
        sent = _stamps(folder)

        def changed() -> dict[str, bytes]:
            nonlocal sent
            before, sent = sent, _stamps(folder)
            return {
                name: (folder / name).read_bytes()
                for name, stamp in sent.items()
                if before.get(name) != stamp
            }

        learned = start(
            config, folder, lambda steps, success: tell(News(steps, success, changed()))
        )
        tell(News(learned.steps, None, changed()))
        return learned


def _stamps(folder: Path) -> dict[str, tuple[int, int]]:
    """When each file was written, and its size."""
    return {
        file.relative_to(folder).as_posix(): (file.stat().st_mtime_ns, file.stat().st_size)
        for file in sorted(folder.rglob("*"))
        if file.is_file() and file.suffix != SUFFIX
    }
