"""The comparison as one web page that holds its pictures and films, and needs nothing else."""

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template

from surface_gym.conditions import CONDITIONS

from .columns import Column
from .table import Table

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
h1 { font-size: 1.9rem; margin: 0 0 .4rem; }
h2 { font-size: 1.35rem; margin: 3.2rem 0 .3rem; padding-top: 1.6rem;
  border-top: 1px solid #dde1e6; }
p, li { max-width: 46rem; }
.told { color: #5c6672; }
nav a { margin-right: 1rem; color: #21618c; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .86rem; font-variant-numeric: tabular-nums;
  margin: 1rem 0; }
th, td { padding: .32rem .7rem; text-align: right; border-bottom: 1px solid #e6e9ed;
  white-space: nowrap; }
th { color: #5c6672; font-weight: 600; white-space: normal; vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; }
tbody tr:hover { background: #f5f7f9; }
img, video { max-width: 100%; height: auto; margin: .6rem 0; }
figcaption { color: #5c6672; font-size: .86rem; }
figure { margin: 1.2rem 0; }
dl { font-size: .86rem; } dt { font-weight: 600; } dd { margin: 0 0 .4rem 0; color: #5c6672; }
</style>
</head>
<body>
<h1>Who steers the parcel best?</h1>
<p>Fixed layouts, as the study arranges them once beforehand, beside rules, a planner and agents
that turn every axis while the parcel passes. All of them meet the same starts and see only what
the sensors say.</p>
<nav>$contents</nav>
<h2>How it is measured</h2>
<p>Success is given with a 95 % interval over seeds and starts: Wilson's, at the number of
independent starts that would spread the mean as the seeds and the starts together do. All other
figures of a table are those of exact sensors. Conditions:</p>
<dl>$conditions</dl>
$sections
</body>
</html>
""")


def write_page(
    tables: Sequence[Table],
    pictures: dict[str, list[tuple[Path, str]]],
    columns: Mapping[str, Sequence[Column]],
    file: Path,
) -> None:
    """Write the page.

    Args:
        tables: in their order.
        pictures: files of each table's pictures and films, each with what it shows.
        columns: of each table, beside the success rates.
        file: to write.
    """
    text = _PAGE.substitute(
        contents="".join(
            f'<a href="#{escape(table.task)}">{escape(table.task.capitalize())}</a>'
            for table in tables
            if table.task in pictures
        ),
        conditions=_definitions([(each.label, each.meaning) for each in CONDITIONS.values()]),
        sections="\n".join(
            _section(table, pictures.get(table.task, []), columns.get(table.task, ()))
            for table in tables
        ),
    )
    file.write_text(text, encoding="utf-8")


def _section(table: Table, pictures: Sequence[tuple[Path, str]], columns: Sequence[Column]) -> str:
    parts = [
        f'<h2 id="{escape(table.task)}">{escape(table.task.capitalize())}</h2>',
        f'<p class="told">{escape(table.told)}</p>',
        _table(table),
        *(_figure(file, told) for file, told in pictures),
    ]
    if columns:
        meanings = _definitions([(column.label, column.meaning) for column in columns])
        parts.append(
            f"<details><summary>What the columns mean</summary><dl>{meanings}</dl></details>"
        )
    return "\n".join(parts)


def _table(table: Table) -> str:
    header = "".join(f"<th>{escape(name)}</th>" for name in table.header)
    rows = "".join(
        "<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>" for row in table.rows
    )
    whole = f"<table><thead><tr>{header}</tr></thead><tbody>{rows}</tbody></table>"
    return f'<div class="wide">{whole}</div>'


def _figure(file: Path, told: str) -> str:
    data = base64.b64encode(file.read_bytes()).decode()
    if file.suffix == ".mp4":
        shown = (
            f'<video controls loop muted playsinline src="data:video/mp4;base64,{data}"></video>'
        )
    else:
        shown = f'<img alt="{escape(told)}" src="data:image/png;base64,{data}">'
    return f"<figure>{shown}<figcaption>{escape(told)}</figcaption></figure>"


def _definitions(pairs: Sequence[tuple[str, str]]) -> str:
    return "".join(f"<dt>{escape(name)}</dt><dd>{escape(told)}</dd>" for name, told in pairs)
