"""Pictures that other parts of the project draw: each is made by what made it for the page."""

import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from surface_gym.whole_files import replacing

from .acting import Scene
from .encoding import write_still

ROOT = Path(__file__).parents[2]
SORTED_AT = 20  # control periods since the start of the picture of Sort


@dataclass(frozen=True)
class FromCommand:
    """A picture that a command leaves in the folder it is given by `--out`."""

    command: tuple[str, ...]  # behind `python`, run where README.md is
    leaves: str  # name of the picture in that folder

    def __call__(self, file: Path) -> None:
        """Run the command and keep its picture.

        Raises:
            CalledProcessError: the command failed.
        """
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run(
                [sys.executable, *self.command, "--out", folder],
                cwd=ROOT,
                check=True,
                stdout=subprocess.DEVNULL,
            )
            with replacing(file) as part:
                shutil.copyfile(Path(folder) / self.leaves, part)


def sort_still(file: Path) -> None:
    """The S-box at 0.6 m/s on its way off the line."""
    scene = Scene("SmartSurface/Sort-v0", "sort-ppo", ({"speed": 0.6, "parcel": "S", "side": 1},))
    write_still(scene.pictures()[SORTED_AT], file)


def flow_still(file: Path) -> None:
    """The reservation at work, 12 s since the stream began."""
    from agents.flow import contenders
    from agents.flow.cases import CURVE
    from agents.flow.showing import SHOWN_AT, pictures_of

    named = {each.name: each for each in contenders.contenders()}
    contender = named[contenders.RESERVATION]
    place = round(SHOWN_AT / contender.control_period)
    write_still(next(islice(pictures_of(contender, CURVE, rate=8550.0), place, None)), file)


def trajectories(file: Path) -> None:
    """Ways of sorted parcels under the fixed layout and under PPO."""
    from agents.evaluation import contenders
    from agents.evaluation.cell import play
    from agents.evaluation.report import rivals
    from agents.evaluation.trajectories import draw_trajectories

    both = rivals(contenders.contenders("sort"))
    with replacing(file) as part:
        named = part.with_suffix(".png")
        draw_trajectories(
            {each.name: play(each, each.seeds[0], "exact")[1] for each in both}, named
        )
        named.replace(part)


def alignment(file: Path) -> None:
    """Boxes over rows that push inwards and outwards."""
    from surface_gym.paper.alignment_figure import draw_alignment

    with replacing(file) as part:
        draw_alignment().savefig(part, dpi=160, format="png")


def checkered(file: Path) -> None:
    """What `examples/checkered.py` draws."""
    with tempfile.TemporaryDirectory() as folder:
        example = ROOT / "examples" / "checkered.py"
        subprocess.run(
            [sys.executable, str(example)], cwd=folder, check=True, stdout=subprocess.DEVNULL
        )
        with replacing(file) as part:
            shutil.copyfile(Path(folder) / "checkered.png", part)
