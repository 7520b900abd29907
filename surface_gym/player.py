"""Replays: one self-contained HTML file plays one or several recordings at the same time."""

import base64
import hashlib
import html
import re
from importlib.resources import files
from os import PathLike
from string import Template
from typing import Any

from surface_gym import checks
from surface_gym.files import replacing
from surface_gym.recording import Recording

MOST = 8  # recordings side by side
SCRIPTS = (  # in order of dependency
    "palette.js", "marks.js", "view.js", "draw.js", "recording.js", "gestures.js", "elements.js",
    "panel.js", "player.js",
)  # fmt: skip
_WIDTH, _CONTROLS = 48.0, 12.0  # [rem] width of a notebook's pictures, and height of the controls
_IMPORT = re.compile(r'^import \{[^}]*\} from "\./[a-z]+\.js";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export ", re.MULTILINE)


class Replay:
    """A page that replays recordings. It can be saved as a file, or shown in a notebook.

    Args:
        recordings: recordings by title. They play side by side at the same time.
    """

    def __init__(self, recordings: dict[str, Recording]) -> None:
        self.recordings = recordings

    def html(self) -> str:
        """Return the self-contained page."""
        page = files("surface_gym.web") / "page"
        read = {name: (page / name).read_text("utf-8") for name in (*SCRIPTS, "replay.css")}
        style = read["replay.css"]
        script = "\n".join(_EXPORT.sub("", _IMPORT.sub("", read[name])) for name in SCRIPTS)
        data = "\n".join(
            f'<script type="text/plain" class="recording" data-name="{html.escape(name)}">'
            f"{base64.b64encode(each.encode()).decode()}</script>"
            for name, each in self.recordings.items()
        )
        return Template((page / "replay.html").read_text("utf-8")).substitute(
            title=html.escape(" / ".join(self.recordings)),
            style=style,
            script=script,
            style_hash=_hash(style),
            script_hash=_hash(script),
            data=data,
        )

    def save(self, path: str | PathLike[str]) -> None:
        """Write the page to a file ending in .html; an existing file is replaced."""
        with replacing(checks.path("path", path, ".html")) as part:
            part.write_text(self.html(), encoding="utf-8")

    def _repr_html_(self) -> str:
        """Show the page in a notebook, in a frame of suitable height."""
        pictures = sum(_WIDTH / _aspect(each) + 2.0 for each in self.recordings.values())
        return frame_page(" / ".join(self.recordings), self.html(), _CONTROLS + pictures)


def replay(*runs: Any, **named: Any) -> Replay:
    """Make a page that replays one to eight runs with slow motion, zoom and forces.

    Args:
        runs: recordings, trajectories, or environments wrapped in `RecordReplay`.
        named: more runs. The argument's name is the run's title.

    >>> import surface_gym as sg
    >>> box = sg.Parcel(sg.Rectangle(0.25, 0.25), mass=10.0)
    >>> run = sg.simulate(sg.layouts.sorting(), box, (0.125, 1.0, 0.0), (1.5, 0.0, 0.0))
    >>> len(sg.replay(run).html()) < 200_000
    True
    """
    recordings: dict[str, Recording] = {}
    for place, run in enumerate(runs):
        recording = _record(f"runs[{place}]", run)
        name, number = recording.title, 1
        while name in recordings or name in named:
            number += 1
            name = f"{recording.title} {number}"
        recordings[name] = recording
    recordings |= {name: _record(name, run) for name, run in named.items()}
    if not 1 <= len(recordings) <= MOST:
        raise ValueError(f"runs must be 1 to {MOST}, got {len(recordings)}")
    return Replay(recordings)


def frame_page(title: str, page: str, height: float = 40.0) -> str:
    """Return HTML of a frame that shows `page`, the page of a replay.

    The replay's page and the page around the frame cannot access each other.

    Args:
        height: [rem] height of the frame, at most 48.
    """
    return (
        f'<iframe title="Replay: {html.escape(title)}" sandbox="allow-scripts" loading="lazy" '
        f'style="width:100%;height:{min(height, 48.0):.0f}rem;border:0" '
        f'srcdoc="{html.escape(page)}"></iframe>'
    )


def _aspect(recording: Recording) -> float:
    """Compute the ratio of width to height of a recording's picture."""
    rows, columns = recording.rotor.shape
    whole = (0.0, 0.0, columns * recording.pitch[0], rows * recording.pitch[1])
    left, low, right, high = recording.view or whole
    return (right - left) / (high - low)


def _record(name: str, run: Any) -> Recording:
    """Return the recording of `run`, which is a recording, a trajectory or an environment."""
    wrapped = run
    while wrapped is not None:
        found = wrapped if isinstance(wrapped, Recording) else getattr(wrapped, "recording", None)
        if isinstance(found, Recording):
            return found
        wrapped = getattr(wrapped, "env", None)
    raise ValueError(
        f"{name} must be a Recording, a Trajectory or an environment wrapped in "
        f"surface_gym.RecordReplay before its episode, got {type(run).__name__}"
    )


def _hash(text: str) -> str:
    """Compute the hash of a script or style. A page's security policy lists the allowed hashes."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
