"""Draws of a study: one process for each, in parallel, and a folder that appears with its score."""

from __future__ import annotations

import contextlib
import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Protocol, TypeVar

from ahnn.contents import read_json
from ahnn.files import claimed, whole_folder

log = logging.getLogger("ahnn")
SIGNALLED = 128
"""Exit codes above this belong to signals."""
SCORE = "score.json"
"""Name of the file of a score, next to the run in the folder of a draw."""


class NumberedDraw(Protocol):
    """One training run of a study."""

    @property
    def folder(self) -> Path:
        """Folder of its run and its score."""
        ...


D = TypeVar("D", bound=NumberedDraw)


def finished(draw: NumberedDraw) -> bool:
    """Return whether the score exists; the folder appears with it."""
    return (draw.folder / SCORE).is_file()


def score(draw: NumberedDraw) -> dict[str, Any]:
    """Return the stored result of a draw."""
    return read_json(draw.folder / SCORE)


def run_missing(plan: Sequence[D], words: Callable[[D], list[str]], jobs: int) -> list[D]:
    """Run the unfinished draws, each in a separate process; return the failed ones.

    Args:
        plan: all draws.
        words: returns the arguments of `python -m` for a draw.
        jobs: processes at a time.
    """
    left = [draw for draw in plan if not finished(draw)]
    children: set[subprocess.Popen[bytes]] = set()

    def start(draw: D) -> bool:
        child = subprocess.Popen(
            [sys.executable, "-m", *words(draw)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env={**os.environ, "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")},
        )
        children.add(child)
        said = child.communicate()[1].decode(errors="replace").strip().splitlines()
        if child.returncode < SIGNALLED:  # stops by signal are reported elsewhere
            log.info("%s", said[-1] if said else f"{draw.folder}: ended without a message")
        return child.returncode == 0

    pool = ThreadPoolExecutor(jobs)
    try:
        done = [*pool.map(start, left)]
    except BaseException:
        for child in children:
            child.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return [draw for draw, well in zip(left, done, strict=True) if not well]


@contextlib.contextmanager
def appearing(folder: Path) -> Iterator[Path]:
    """Yield a folder to write to, which appears under its name when complete; raises Occupied if in use."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with claimed(folder.parent, f".{folder.name}.turn"), whole_folder(folder) as place:
        yield place
