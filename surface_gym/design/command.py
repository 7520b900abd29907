"""`python -m surface_gym.design`."""

import sys
from collections.abc import Callable, Sequence
from time import perf_counter

import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table as Screen

from surface_gym.design.pictures import DPI
from surface_gym.design.question_of_control import AskControl
from surface_gym.design.questions import (
    Answer,
    AskColumns,
    AskFriction,
    AskLayout,
    AskMap,
    AskSensitivity,
    AskSpeed,
    AskTilt,
    Question,
)
from surface_gym.design.tables import Table, text_of, write_csv
from surface_gym.design.telling import MASS, sentence
from surface_gym.sharing import WorkFailed

QUESTIONS: dict[str, Callable[..., Question]] = {
    "columns": AskColumns,
    "speed": AskSpeed,
    "tilt": AskTilt,
    "friction": AskFriction,
    "map": AskMap,
    "sensitivity": AskSensitivity,
    "layout": AskLayout,
    "control": AskControl,
}
STOPPED = 130  # status of a command that Ctrl-C ends


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command; an error ends it with one line and status 2."""
    question = tyro.extras.subcommand_cli_from_dict(
        QUESTIONS,
        prog="python -m surface_gym.design",
        description="Which surface do I need, for a parcel of my own?",
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    try:
        ask(question)
    except (ValueError, OSError, ImportError, WorkFailed) as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        kept = question.checkpoint is not None and question.checkpoint.exists()
        print("stopped; --resume goes on" if kept else "stopped", file=sys.stderr)
        raise SystemExit(STOPPED) from None


def ask(question: Question) -> None:
    """Answer a question: a sentence and tables on screen, CSV files and a picture in its folder.

    Raises:
        ValueError: a flag that is not allowed.
        OSError: a file that cannot be written.
    """
    question.case()  # what is not allowed is better known before there is a folder
    question.out.mkdir(parents=True, exist_ok=True)
    started = perf_counter()
    answer = _worked_out(question)
    took = perf_counter() - started
    paths = [write_csv(table, question.out) for table in answer.tables if table.written]
    paths.append(question.out / f"{answer.name}.png")
    answer.draw().savefig(paths[-1], dpi=DPI)
    console = Console()
    console.print(escape(sentence(answer.told)), highlight=False, soft_wrap=True)
    if question.mass is not None and question.inertia is None:
        console.print(escape(MASS), highlight=False, soft_wrap=True)
    console.print()
    for table in answer.tables:
        if table.shown:
            console.print(_screen(table))
    console.print(
        f"{took:.1f} s; written:", *map(str, paths), sep="\n", highlight=False, soft_wrap=True
    )


def _worked_out(question: Question) -> Answer:
    """The answer, with a bar in a terminal while it is worked on."""
    console = Console(stderr=True)
    bars = (TextColumn("working it out"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(
        *bars, console=console, transient=True, disable=not console.is_terminal
    ) as progress:
        bar = progress.add_task("", total=None)

        def advance(done: int, total: int) -> None:
            progress.update(bar, completed=done, total=total)

        return question.answer(advance)


def _screen(table: Table) -> Screen:
    screen = Screen(
        title=escape(table.title),
        title_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
    )
    for k, name in enumerate(table.header):
        words = any(isinstance(row[k], str) for row in table.rows)
        screen.add_column(escape(name), justify="left" if words else "right")
    for row in table.rows:
        screen.add_row(*(escape(text_of(cell)) for cell in row))
    return screen
