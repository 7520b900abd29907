"""The page of a comparison: one file with tables, pictures and videos."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template

from surface_gym.config import PRESETS
from surface_gym.player import frame_page
from surface_gym.tasks.benchmark import ResultColumn

from .tables import Table

Pictures = list[tuple[Path, str]]  # files with captions


@dataclass(frozen=True)
class Section:
    """A section of the page: a table, pictures and videos, and explanations of columns."""

    table: Table
    pictures: Pictures
    columns: tuple[ResultColumn, ...] = ()


_PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>surface_gym: the comparison</title>
<style>
:root { color-scheme: light; }
body { font: 16px/1.55 system-ui, sans-serif; color: #212730; background: #fff;
  max-width: 72rem; margin: 0 auto; padding: 2rem 1.2rem 5rem; }
h2 { margin: 3.2rem 0 .3rem; padding-top: 1.6rem; border-top: 1px solid #dde1e6; }
p, li { max-width: 46rem; }
.caption, th, figcaption, dd { color: #5c6672; }
nav a { margin-right: 1rem; color: #21618c; }
.wide { overflow-x: auto; }
table, figcaption, dl { font-size: .86rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: 1rem 0; }
th, td { padding: .32rem .7rem; text-align: right; border-bottom: 1px solid #e6e9ed;
  white-space: nowrap; }
th { white-space: normal; vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; }
img, video { max-width: 100%; height: auto; margin: .6rem 0; }
dt { font-weight: 600; } dd { margin: 0 0 .4rem 0; }
</style>
</head>
<body>
<h1>Which controller steers the parcel best?</h1>
<p>Fixed layouts, as the study arranges them once beforehand, beside rules, a planner and agents
that turn every axis while the parcel passes. All of them meet the same starts and see only what
the sensors say.$note</p>
<nav>$contents</nav>
<h2>How it is measured</h2>
<p>Success is given with a 95 % interval over seeds and starts: Wilson's, at the number of
independent starts that would spread the mean as the seeds and the starts together do. All other
metrics of a table are those of exact sensors. Presets:</p>
<dl>$presets</dl>
$sections
</body>
</html>
""")


def write_page(sections: Sequence[Section], file: Path, note: str = "") -> None:
    """Write the self-contained page with its pictures and videos."""
    text = _PAGE.substitute(
        contents="".join(
            f'<a href="#{escape(each.table.title)}">{escape(each.table.heading)}</a>'
            for each in sections
            if each.pictures
        ),
        note=escape(f" {note}" if note else ""),
        presets=_definitions({each.label: each.meaning for each in PRESETS.values()}),
        sections="\n".join(map(_section, sections)),
    )
    file.write_text(text, encoding="utf-8")


def _section(section: Section) -> str:
    table = section.table
    parts = [
        f'<h2 id="{escape(table.title)}">{escape(table.heading)}</h2>',
        f'<p class="caption">{escape(table.caption)}</p>',
        f'<div class="wide">{table.html()}</div>',
        *(_figure(file, caption) for file, caption in section.pictures),
    ]
    if section.columns:
        meanings = _definitions({column.label: column.meaning for column in section.columns})
        parts.append(
            f"<details><summary>What the columns mean</summary><dl>{meanings}</dl></details>"
        )
    return "\n".join(parts)


def _figure(file: Path, caption: str) -> str:
    data = base64.b64encode(file.read_bytes()).decode()
    if file.suffix == ".mp4":
        shown = (
            f'<video controls loop muted playsinline src="data:video/mp4;base64,{data}"></video>'
        )
        replayed = file.with_suffix(".html")
        if replayed.exists():
            shown += frame_page(caption, replayed.read_text(encoding="utf-8"))
    else:
        shown = f'<img alt="{escape(caption)}" src="data:image/png;base64,{data}">'
    return f"<figure>{shown}<figcaption>{escape(caption)}</figcaption></figure>"


def _definitions(meanings: Mapping[str, str]) -> str:
    return "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in meanings.items())
