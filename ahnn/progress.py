"""Progress bars on standard error that disappear when done."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

T = TypeVar("T")


def progress_bar(*columns: TextColumn) -> Progress:
    """Return a transient progress bar with description, fraction done, time left and further columns.

    It is silent where standard error is not a terminal.
    """
    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        *columns,
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


def track(items: Iterable[T], description: str, total: int) -> Iterator[T]:
    """Yield the items and show their count out of `total` in a progress bar."""
    with progress_bar() as bar:
        yield from bar.track(items, total=total, description=description)
