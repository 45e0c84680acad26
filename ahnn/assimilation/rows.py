"""Estimates as lines of text: CSV under a header, or JSON objects; and the file that can be cut back."""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO, Literal

from ahnn.assimilation.online import Estimate
from ahnn.assimilation.process import Sensor
from ahnn.data.tracks import COVARIANCE, DEVIATION, FIRST, INNOVATION
from ahnn.errors import UserError

Format = Literal["csv", "json"]


class Rows:
    """Estimates as rows under the same names.

    Args:
        components: of the state.
        sensors: by name.
        kind: csv or json.
    """

    def __init__(self, components: tuple[str, ...], sensors: Mapping[str, Sensor], kind: Format) -> None:
        self.kind: Format = kind
        self.lower = [(i, j) for i in range(len(components)) for j in range(i + 1)]
        measured = dict.fromkeys(name for sensor in sensors.values() for name in sensor.columns)
        place = {name: k for k, name in enumerate(measured)}
        self.places = {key: [place[name] for name in sensor.columns] for key, sensor in sensors.items()}
        self.width = len(place)
        self.names = [
            *FIRST,
            *components,
            *(f"{COVARIANCE}{components[i]}_{components[j]}" for i, j in self.lower),
            *(INNOVATION + name for name in measured),
            *(DEVIATION + name for name in measured),
        ]

    def header(self) -> str:
        """Return the first line of a table; JSON objects have none."""
        return ",".join(self.names) + "\n" if self.kind == "csv" else ""

    def row(self, line: int, sensor: str, estimate: Estimate) -> str:
        """Return the line of an estimate."""
        mean, covariance, told = estimate.mean.tolist(), estimate.covariance.tolist(), estimate.innovation
        innovation, deviation = [math.nan] * self.width, [math.nan] * self.width
        assert told is not None
        parts = zip(self.places[sensor], told.residual[0].tolist(), told.deviation[0].tolist(), strict=True)
        for place, residual, sd in parts:
            innovation[place], deviation[place] = residual, sd
        values: list[Any] = [line, estimate.time, sensor, estimate.outcome, estimate.replayed]
        values += [float(told.nis), int(told.measured), *mean]
        values += [covariance[i][j] for i, j in self.lower]
        values += [*innovation, *deviation]
        if self.kind == "csv":
            return ",".join(map(_cell, values)) + "\n"
        plain = (None if isinstance(value, float) and math.isnan(value) else value for value in values)
        return json.dumps(dict(zip(self.names, plain, strict=True))) + "\n"


def _cell(value: Any) -> str:
    return "" if value != value else str(value)


class Output:
    """Where rows go: standard output, or a file that belongs to one process and can be cut back.

    Args:
        path: of the file; `-` is standard output.
        size: bytes of the file that a state knows of, the rest is cut off; None begins a new file.

    Raises:
        UserError: a file that exists where a new one begins, that another process writes, or that is shorter
            than the state knows it.
    """

    def __init__(self, path: str, size: int | None) -> None:
        self.size = size or 0
        self.file: BinaryIO = sys.stdout.buffer if path == "-" else _opened(Path(path), size)

    def write(self, text: str) -> None:
        """Write a line, and hand it to the system at once."""
        content = text.encode()
        self.file.write(content)
        self.file.flush()
        self.size += len(content)

    def close(self) -> None:
        """Close a file; standard output stays open."""
        if self.file is not sys.stdout.buffer:
            self.file.close()

    def sync(self) -> None:
        """Wait until the rows are on the disk."""
        with contextlib.suppress(OSError):  # a pipe has none
            os.fsync(self.file.fileno())


def require_new(path: str) -> None:
    """Refuse to begin where something is already; raises UserError."""
    if path != "-" and Path(path).exists():
        message = (
            f"output: expected a new file; received {path}, which is there. Name another one or remove it"
        )
        raise UserError(message)


def _opened(path: Path, size: int | None) -> BinaryIO:
    if size is None:
        require_new(str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    file = path.open("r+b" if path.exists() else "w+b")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        file.close()
        message = f"output: expected a file of its own; received {path}, which another process writes"
        raise UserError(message) from error
    length = file.seek(0, os.SEEK_END)
    if length < (size or 0):
        file.close()
        message = f"output: expected {path} as it was left, {size} bytes; received {length}. Begin again"
        raise UserError(message)
    file.truncate(size or 0)
    file.seek(size or 0)
    return file
