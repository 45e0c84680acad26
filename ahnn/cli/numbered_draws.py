"""Draws of a study: parallel processes, and for each draw a folder that appears when its score exists."""

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
"""Exit codes above this mean termination by a signal."""
REPORT = "draw "
"""Beginning of the line that a process with several draws logs at the end of each draw."""
SCORE = "score.json"
"""Name of the score file, next to the run in the folder of a draw."""


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


def run_missing(
    plan: Sequence[D], words: Callable[[Sequence[D]], list[str]], jobs: int, *, shared: bool = False
) -> list[D]:
    """Run the unfinished draws in separate processes; return the failed ones.

    Args:
        plan: all draws.
        words: function that returns the arguments of `python -m` for the draws of a process.
        jobs: number of simultaneous processes.
        shared: whether a process runs several draws, since starting it takes as long as a draw.
    """
    left = [draw for draw in plan if not finished(draw)]
    parts = [left[k::jobs] for k in range(min(jobs, len(left)))] if shared else [[draw] for draw in left]
    children: set[subprocess.Popen[bytes]] = set()

    def start(part: Sequence[D]) -> bool:
        child = subprocess.Popen(
            [sys.executable, "-m", *words(part)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env={**os.environ, "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")},
        )
        children.add(child)
        said = f"{part[0].folder}: ended without a message"
        assert child.stderr is not None
        with child.stderr as lines:
            for line in lines:
                if text := line.decode(errors="replace").strip():
                    said = text
                if text.startswith(REPORT):
                    log.info("%s", text)
        if child.wait() < SIGNALLED and not said.startswith(
            REPORT
        ):  # termination by a signal is reported elsewhere
            log.info("%s", said)
        return child.returncode == 0

    pool = ThreadPoolExecutor(jobs)
    try:
        done = [*pool.map(start, parts)]
    except BaseException:
        for child in children:
            child.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    ended = [draw for part, well in zip(parts, done, strict=True) if not well for draw in part]
    return [draw for draw in ended if not finished(draw)]


@contextlib.contextmanager
def appearing(folder: Path) -> Iterator[Path]:
    """Yield a folder to write to, which appears under its name when complete; raises Occupied if in use."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with claimed(folder.parent, f".{folder.name}.turn"), whole_folder(folder) as place:
        yield place
