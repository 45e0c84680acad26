"""What an assimilation wrote, read again: as many rows as a picture or an ephemeris takes."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.assimilation.rows import COVARIANCE, DEVIATION, FIRST, INNOVATION
from ahnn.contents import require_regular
from ahnn.data.files import Covariance, Ephemeris, instant, write_oem
from ahnn.errors import UserError
from ahnn.labels import require_velocities
from ahnn.types import Space

Array = NDArray[np.float64]
MOST = 10_000
"""Rows that are kept of an output, evenly spread over it."""


class Record(NamedTuple):
    """Rows of an output, the last one of each time.

    Attributes:
        time: (T,) increasing.
        mean: (T, D).
        covariance: (T, D, D).
        outcome: (T,) words.
        nis, dof: (T,).
        measured: names of the measured numbers.
        innovation, deviation: (T, M), NaN where a number is missing.
    """

    time: Array
    mean: Array
    covariance: Array
    outcome: NDArray[np.str_]
    nis: Array
    dof: Array
    measured: tuple[str, ...]
    innovation: Array
    deviation: Array


def read_record(path: Path, components: tuple[str, ...], most: int = MOST) -> Record:
    """Return at most so many rows of an output, the last one among them, in constant memory.

    Raises:
        UserError: it holds no rows.
    """
    stride = max(1, -(-sum(1 for _ in rows_of(path)) // most))
    kept: dict[float, dict[str, Any]] = {}
    row: dict[str, Any] = {}
    for k, row in enumerate(rows_of(path)):
        if k % stride == 0:
            kept[float(row["time"])] = row
    if not row:
        message = f"output: expected estimates; received none in {path}"
        raise UserError(message)
    kept[float(row["time"])] = row
    rows = [kept[time] for time in sorted(kept)]
    size, measured = (
        len(components),
        tuple(n.removeprefix(INNOVATION) for n in row if n.startswith(INNOVATION)),
    )

    def columns(names: list[str]) -> Array:
        return np.array([[_number(row[name]) for name in names] for row in rows])

    covariance = np.zeros((len(rows), size, size))
    for i in range(size):
        for j in range(i + 1):
            (covariance[:, i, j],) = columns([f"{COVARIANCE}{components[i]}_{components[j]}"]).T
            covariance[:, j, i] = covariance[:, i, j]
    time, nis, dof = columns(["time", "nis", "dof"]).T
    outcome = np.array([row[FIRST[3]] for row in rows])
    told = [columns([prefix + name for name in measured]) for prefix in (INNOVATION, DEVIATION)]
    return Record(time, columns([*components]), covariance, outcome, nis, dof, measured, *told)


def rows_of(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of an output."""
    require_regular(path)
    with path.open(newline="") as file:
        table = file.read(1) != "{"
        file.seek(0)
        yield from csv.DictReader(file) if table else map(json.loads, file)


def _number(cell: Any) -> float:
    return np.nan if cell is None or cell == "" else float(cell)


def write_ephemeris(path: Path, record: Record, space: Space, about: dict[str, str]) -> None:
    """Write the estimates of an orbit with their covariances as an orbit ephemeris message.

    Args:
        path: of the message.
        record: the estimates, in km and, of momenta, km/s times the mass.
        space: what the numbers mean.
        about: `object`, `epoch` of time zero, `frame`, `center` and `time_system`.

    Raises:
        UserError: a space that is no orbit, or an epoch that is none.
    """
    if len(space.components) != 6 or space.units[:3] != ("s", "km", "km/s"):
        message = (
            f"oem: expected an orbit in s, km and km/s; received {space.name} in {', '.join(space.units[:3])}"
        )
        raise UserError(message)
    require_velocities(space, "oem")
    utc = about["time_system"].upper() == "UTC"
    try:
        start = instant(about["epoch"], utc=utc)
    except ValueError as error:
        message = f"oem.epoch: expected {error}; received {about['epoch']!r}"
        raise UserError(message) from error
    scale = np.array([1.0] * 3 + [1.0 / space.inertia] * 3)
    matrices = record.covariance * scale[:, None] * scale
    covariances = tuple(Covariance(float(t), matrix) for t, matrix in zip(record.time, matrices, strict=True))
    words = about["object"], about["object"], about["center"], about["frame"], about["time_system"]
    write_oem(path, [Ephemeris(*words, start, record.time, record.mean * scale, covariances)])
