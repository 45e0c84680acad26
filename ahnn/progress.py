"""Progress bars on standard error that disappear when done; log lines if it is not a terminal."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

T = TypeVar("T")
SELDOM, OFTEN = 30.0, 10.0
"""Seconds between log lines of a stage, and of a task with a known number of parts."""
log = logging.getLogger("ahnn")
_note: ContextVar[Callable[[str], None] | None] = ContextVar("note", default=None)
_step: ContextVar[str] = ContextVar("step", default="")
_end: ContextVar[float] = ContextVar("end", default=0.0)


def _console() -> Console:
    """Return standard error as a console; quiet unless it is a terminal.

    A disabled bar of Rich before version 14.3 otherwise ends with an empty line.
    """
    console = Console(stderr=True)
    console.quiet = not console.is_terminal
    return console


def progress_bar(*columns: TextColumn) -> Progress:
    """Return a transient progress bar with description, fraction done, time left and further columns.

    It is silent if standard error is not a terminal.
    """
    console = _console()
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        *columns,
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=console.quiet,
    )


@contextmanager
def advancing(description: str, total: int) -> Iterator[Callable[[], None]]:
    """Yield a function to call after each of `total` parts; in a log, a line every ten seconds."""
    with progress_bar() as bar:
        task, began, done = bar.add_task(description, total=total), time.monotonic(), 0
        due = began + OFTEN

        def advance() -> None:
            nonlocal due, done
            done += 1
            bar.advance(task)
            if bar.disable and (now := time.monotonic()) >= due:
                due, left = now + OFTEN, max(total - done, 0) / done * (now - began)
                log.info("%s: %.0f %%, %s left", description, min(100 * done / total, 100), about(left))

        yield advance


def track(items: Iterable[T], description: str, total: int) -> Iterator[T]:
    """Yield the items and show their count out of `total`; see `advancing`."""
    with advancing(description, total) as advance:
        for item in items:
            yield item
            advance()


@contextmanager
def stage(description: str) -> Iterator[None]:
    """Show the notes and elapsed time of a stage of unknown length; in a log, one line every half minute."""
    console = _console()
    columns = TextColumn("{task.description}"), BarColumn(20), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True, disable=console.quiet) as bar:
        task, began = bar.add_task(description, total=None), time.monotonic()
        due = began + SELDOM

        def show(text: str) -> None:
            nonlocal due
            now = time.monotonic()
            left = f", about {_end.get() - now:.0f} s left" if _end.get() > now else ""
            bar.update(task, description=f"{description}: {text}{left}")
            if bar.disable and now >= due:
                due = now + SELDOM
                log.info("%s: %s, %.0f s so far%s", description, text, now - began, left)

        token, end = _note.set(show), _end.set(0.0)
        try:
            yield
        finally:
            _note.reset(token)
            _end.reset(end)


def note(text: str) -> None:
    """Show what the current stage does; without effect outside a stage."""
    if (show := _note.get()) is not None:
        show(_step.get() + text)


def foresee(seconds: float) -> None:
    """Let notes of the current stage state the time left, which is `seconds` now."""
    _end.set(time.monotonic() + seconds)


def about(seconds: float) -> str:
    """Format an estimated duration."""
    return f"about {seconds:.0f} s" if seconds < 120 else f"about {seconds / 60:.1f} min"


def counted(most: int, name: str) -> Iterator[int]:
    """Yield the indices of at most `most` steps; notes then start with the step and its mean time."""
    began = time.monotonic()
    for k in range(most):
        each = f" ({(time.monotonic() - began) / k:.2g} s each)" if k else ""
        token = _step.set(f"{name} {k + 1} of at most {most}{each}, ")
        try:
            yield k
        finally:
            _step.reset(token)
