"""Tables of texts: on screen, as Markdown, and on a page with pictures and videos."""

import base64
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Literal

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table as Screen
from rich.text import Text

from surface_gym.config import PRESETS
from surface_gym.player import frame_page
from surface_gym.tasks.benchmark import ResultColumn

NOTHING = "-"
BOLD = "**"  # on both sides, as in Markdown
BETWEEN, EDGES = 3, 4  # characters between columns, and at the edges of a table


def markdown(
    header: Sequence[str], rows: Iterable[Sequence[str]], others: str = "---", keys: int = 1
) -> str:
    """Return a header and rows as a Markdown table.

    The first `keys` columns are aligned left. `others` is the Markdown code for the alignment of
    all other columns, e.g. "---:" for right-aligned.
    """
    lines = [header, ["---"] * keys + [others] * (len(header) - keys), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def bold(text: str) -> str:
    """Mark a cell as bold."""
    return f"{BOLD}{text}{BOLD}"


def number(value: float | None, form: str, unit: str = "") -> str:
    """Return a number in Python's format `form` with a unit; None and NaN become `NOTHING`."""
    return NOTHING if value is None or math.isnan(value) else format(value, form) + unit


def tabulate(
    title: str, caption: str, rows: Sequence[Mapping[str, str]], keys: int = 1
) -> "list[Table]":
    """Return a list with one table; the list is empty without rows.

    All rows map the same headings to cells. The first `keys` columns name a row.
    """
    if not rows:
        return []
    cells = tuple(tuple(row.values()) for row in rows)
    return [Table(title, caption, tuple(rows[0]), cells, keys)]


@dataclass(frozen=True)
class Table:
    """Texts in rows and columns, with row names in the first columns."""

    title: str
    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    keys: int = 1  # number of columns with row names

    @property
    def heading(self) -> str:
        return self.title[:1].upper() + self.title[1:]

    def markdown(self) -> str:
        text = markdown(self.header, self.rows, "---:", self.keys)
        parts = (f"## {self.heading}", self.caption, text)
        return "\n\n".join(filter(None, parts)) + "\n"

    def html(self) -> str:
        def line(tag: str, texts: Sequence[str]) -> str:
            each = (f"<{tag}>{escape(text)}</{tag}>" for text in texts)
            return re.sub(r"\*\*(.*?)\*\*", r"<b>\1</b>", f"<tr>{''.join(each)}</tr>")

        body = "".join(line("td", row) for row in self.rows)
        return f"<table><thead>{line('th', self.header)}</thead><tbody>{body}</tbody></table>"

    def show(self, console: Console) -> None:
        """Print the table at any width without breaking cells.

        A table that is too wide is split into parts, which repeat the names of the rows. If not
        even one column fits beside the names, each row is printed as a list.
        """
        columns = list(zip(self.header, *self.rows, strict=True))
        # Cells are not wrapped; headings may be wrapped between words.
        widths = [
            max(len(_plain(each)) for each in (*head.split(), *cells)) for head, *cells in columns
        ]
        parts = self._split(widths, console.width)
        console.print(Text(f"\n{self.heading}", style="bold"))
        for part in parts:
            self._show_part(part, widths, console)
        if not parts:
            self._show_list(console)
        console.print(Text(self.caption, style="dim"))

    def _split(self, widths: Sequence[int], room: int) -> list[list[int]]:
        """Split the table into parts. Return each part's columns, or [] if a column does not fit.

        The columns' `widths` and the width `room` of a part are in characters.
        """
        names = list(range(self.keys))
        used_by_names = EDGES - BETWEEN + sum(widths[k] + BETWEEN for k in names)
        parts: list[list[int]] = []
        used = room
        for k in range(self.keys, len(widths)):
            if used_by_names + widths[k] + BETWEEN > room:
                return []
            if used + widths[k] + BETWEEN > room:
                parts.append(names.copy())
                used = used_by_names
            parts[-1].append(k)
            used += widths[k] + BETWEEN
        return parts

    def _show_part(self, part: Sequence[int], widths: Sequence[int], console: Console) -> None:
        screen = Screen(box=SIMPLE)
        for k in part:
            side: Literal["left", "right"] = "right" if k >= self.keys else "left"
            screen.add_column(Text(self.header[k]), justify=side, width=widths[k])
        for row in self.rows:
            screen.add_row(*(_shown(row[k]) for k in part))
        console.print(screen)

    def _show_list(self, console: Console) -> None:
        for row in self.rows:
            console.print(Text("\n" + ", ".join(row[: self.keys])))
            for name, cell in zip(self.header[self.keys :], row[self.keys :], strict=True):
                console.print(Text(f"  {name}: ") + _shown(cell))


def _plain(text: str) -> str:
    return text.removeprefix(BOLD).removesuffix(BOLD)


def _shown(text: str) -> Text:
    plain = _plain(text)
    return Text(plain, style="" if plain == text else "bold")


def write_markdown(tables: Iterable[Table], file: Path, title: str = "") -> None:
    """Write tables to a file, one below the other."""
    file.write_text(title + "\n".join(table.markdown() for table in tables))


Pictures = list[tuple[Path, str]]  # files with captions


@dataclass(frozen=True)
class Section:
    """A section of the page: a table, pictures and videos, and explanations of columns."""

    table: Table
    pictures: Pictures
    columns: tuple[ResultColumn, ...] = ()


def write_page(sections: Sequence[Section], file: Path, note: str = "") -> None:
    """Write the sections as a self-contained page with pictures, videos and a note."""
    page = Template((Path(__file__).parent / "page.html").read_text(encoding="utf-8"))
    text = page.substitute(
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


def show_tables(tables: Iterable[Table], console: Console, note: str) -> None:
    """Print tables and a note."""
    for table in tables:
        table.show(console)
    if note:
        console.print(note)
