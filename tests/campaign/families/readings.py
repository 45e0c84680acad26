"""What a reader made of a file, in SI and seconds, and how it is held against what should have become of it."""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ahnn.data.doctor import examine
from ahnn.data.files import Files
from ahnn.data.files.reading import FileReading
from ahnn.errors import UserError

SI = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "ms": 1e-3, "m": 1.0, "km": 1e3, "cm": 1e-2, "1": 1.0,
      "km/s": 1e3, "m/s": 1.0, "km/min": 1e3 / 60, "km/h": 1e3 / 3600, "m/min": 1 / 60, "cm/s": 1e-2, "m/h": 1 / 3600,
      "mm": 1e-3, "mm/s": 1e-3, "km/ms": 1e6, "m/ms": 1e3, "km/d": 1e3 / 86400, "m/d": 1 / 86400}  # fmt: skip
"""Sizes of units: a table of our own, so that what is read can be held against it."""


class Seen(NamedTuple):
    """What was read.

    Attributes:
        times: of all samples, in seconds from the first.
        states: positions in m and velocities in m/s, one row a sample; absent samples are left out.
        about: names, frame and epoch.
        words: messages and findings.
    """

    times: np.ndarray
    states: np.ndarray
    about: str
    words: frozenset[str]


NAMED = re.compile(r"\bids?\b|empty|without a name")
"""What a message says of a sample that no trajectory names."""
Change = tuple[str, Callable, object]
"""Name of a change, what does it to the parts of a file, and what must become of it: `same` numbers, `refused`,
`word` (refused, said, or read as something else), `said` (refused, or said of the id), or a function from times and states to those expected."""


@contextmanager
def heard() -> Iterator[set[str]]:
    """Collect messages and warnings."""
    said: set[str] = set()

    class Ear(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.add(record.getMessage())

    log, ear = logging.getLogger("ahnn"), Ear()
    before = log.level
    log.addHandler(ear)
    log.setLevel(logging.INFO)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield said
        said.update(str(one.message) for one in caught)
    finally:
        log.removeHandler(ear)
        log.setLevel(before)


def trained(path: Path, **options: object) -> Seen:
    """Return what a training reads; raises UserError."""
    with heard() as said:
        files = Files("mine", str(path), **options)  # pyright: ignore[reportArgumentType]
        files.check()
    data, units = files.read(), files.space.units
    there = data.present.numpy() if not files.positions_only else data.states.isfinite().any(-1).numpy()
    times = data.times.numpy()[there] * SI[units.time]
    n = files.space.dof
    factor = np.repeat([SI[units.position], SI[units.velocity]], n)
    about = f"{files.space.components} {files.space.frame} {files.epoch} {len(data.states)}"
    return Seen(times - times.min(), data.states.numpy()[there] * factor, about, frozenset(plain(said, path)))


def checked(path: Path, **options: object) -> Seen:
    """Return what the check reads and says; raises UserError for a fault."""
    found = examine([path], FileReading(**options))  # pyright: ignore[reportArgumentType]
    if found.faults or not found.contents:
        message = f"expected valid data; received {[one.what for one in found.faults][:3]}"
        raise UserError(message)
    (one,) = found.contents
    times = np.concatenate([track.times for track in one.tracks]) * SI[one.units.time]
    values = np.concatenate([track.values for track in one.tracks])
    there = np.isfinite(values).all(1)
    n = len(one.positions)
    factor = np.repeat([SI[one.units.position], SI[one.units.velocity]], [n, values.shape[1] - n])
    about = f"{one.positions} {one.rates} {one.frame} {one.epoch} {len(one.tracks)}"
    times = times[there] - times[there].min(initial=np.inf)
    return Seen(
        times, values[there] * factor, about, frozenset(plain({one.what for one in found.findings}, path))
    )


def nothing(_: dict) -> None:
    """Change nothing."""


READERS = {"training": trained, "check": checked}


def plain(said: set[str], path: Path) -> set[str]:
    """Return messages without the folder of the file, which is another each time."""
    return {text.replace(str(path.parent), "") for text in said}


def held(expected: object, base: Seen, found: Seen) -> None:
    """Assert that a changed file was read as it should be."""
    equal = base.states.shape == found.states.shape and np.array_equal(
        base.states, found.states, equal_nan=True
    )
    equal = equal and np.array_equal(base.times, found.times)
    silent = found.words <= base.words
    if expected == "refused":
        raise AssertionError(f"accepted{' unchanged' * equal}; it says {sorted(found.words - base.words)}")
    if expected == "word":
        assert not (equal and silent and found.about == base.about), "dropped without a word"
    elif expected == "said":
        assert any(NAMED.search(text) for text in found.words - base.words), "read as if it were data"
    elif expected == "same":
        assert equal or not silent, f"other numbers: {differing(base.times, base.states, found)}"
    elif callable(expected):
        times, states = expected(base.times.copy(), base.states.copy())
        close = times.shape == found.times.shape and states.shape == found.states.shape
        close = close and np.allclose(times, found.times, rtol=1e-13, atol=1e-9)
        close = close and np.allclose(states, found.states, rtol=1e-9, atol=1e-6, equal_nan=True)
        assert close, f"not as expected: {differing(times, states, found)}"
    else:
        raise ValueError(expected)


def differing(times: np.ndarray, states: np.ndarray, found: Seen) -> str:
    """Return by how much numbers differ."""
    if states.shape != found.states.shape:
        return f"{states.shape} states, received {found.states.shape}"
    return (
        f"times by {abs(times - found.times).max():.3g} s, states by "
        f"{np.nanmax(abs(states - found.states)):.3g} m"
    )
