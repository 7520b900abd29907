"""What carries jobs out, one at a time each, and the words between it and who hands them out."""

import pickle
import traceback
from collections.abc import Callable, Iterator
from typing import Any, Protocol, TypeVar

Tell = Callable[[Any], None]
Result_co = TypeVar("Result_co", covariant=True)

TOLD, DONE, FAILED, LOST = "told", "done", "failed", "lost"
POLL = 0.2  # [s] that a crew listens for at most

Word = tuple[str, Any]  # kind, and what was told, the result, the error, or how it was lost
Heard = tuple[int, str, Any]  # place of the job, and its word


class WorkFailed(Exception):
    """Work that could not be carried out, whatever the job is."""


class Job(Protocol[Result_co]):
    """What is handed out."""

    def __call__(self, tell: Tell, /) -> Result_co:
        """Do it, telling now and then how far it is."""


class Crew(Protocol):
    """Processes that carry jobs out."""

    @property
    def free(self) -> int:
        """Jobs it can be handed now."""

    @property
    def running(self) -> int:
        """Jobs it has been handed that are not over."""

    def hand(self, place: int, job: Job[Any]) -> None:
        """Hand a job over."""

    def listen(self) -> Iterator[Heard]:
        """What is heard of the jobs, those over included; waits for it a while."""

    def interrupt(self) -> None:
        """Interrupt what is running, as Ctrl-C would."""

    def close(self) -> None:
        """End what is still running, and the processes."""


class Remote(Exception):
    """Where in another process an error was raised."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


def attempt(job: Job[Any], tell: Tell) -> Word:
    """Do a job in the process it was handed to; its last word."""
    try:
        return DONE, job(tell)
    except BaseException as error:
        return FAILED, (_portable(error), traceback.format_exc())


def as_raised(word: Word) -> Word:
    """A last word as it is passed on: an error that says where it was raised."""
    kind, value = word
    if kind != FAILED:
        return word
    error, where = value
    error.__cause__ = Remote(where)
    return kind, error


def _portable(error: BaseException) -> BaseException:
    """The error, or its words where it cannot be sent to another process."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error
