"""Output of estimates as CSV or JSON lines, to a file that can be truncated on resumption."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any, BinaryIO, Literal, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ahnn.assimilation.decimal_rows import decimal_rows
from ahnn.assimilation.fixed_lag import numbers_of
from ahnn.assimilation.reading_table import Array
from ahnn.assimilation.row_units import with_row_units
from ahnn.assimilation.stream_clock import StreamClock
from ahnn.assimilation.stream_estimate import Estimate
from ahnn.assimilation.stream_sensor import StreamSensor
from ahnn.data.estimate_table import COVARIANCE, DATED, DEVIATION, FIRST, INNOVATION
from ahnn.data.files.sidecar import Sidecar
from ahnn.errors import UserError
from ahnn.estimation import Innovation
from ahnn.locks import lock

Format = Literal["csv", "json", "parquet"]
Column = list[str] | NDArray[Any]
"""The K strings or numbers of a column."""
TAIL = 1 << 14
"""Number of bytes at the end of an output whose hash is stored in the state."""


class Rows:
    """Formatter of estimates as rows.

    Args:
        components: names of the components of the state.
        sensors: sensors by name.
        kind: csv or json, or, for many objects, parquet.
        said: units and frame, written to a sidecar; None: no sidecar.
        scales: (D,) divisors of the written components; None: no division.
        modes: number of modes of interacting models, whose probabilities are written.
        lag: whether to write smoothed estimates.
        clock: interpretation of times; if time zero has an epoch, epochs are written too.
    """

    def __init__(
        self,
        components: tuple[str, ...],
        sensors: Mapping[str, StreamSensor],
        kind: Format,
        said: Sidecar | None = None,
        *,
        scales: Tensor | None = None,
        modes: int = 0,
        lag: bool = False,
        clock: StreamClock | None = None,
    ) -> None:
        self.kind: Format = kind
        self.clock = None if clock is None or clock.zero is None else clock
        self.smooths = len(components) if lag else 0
        self.scales = torch.ones(len(components), dtype=torch.float64) if scales is None else scales
        self.lower = [(i, j) for i in range(len(components)) for j in range(i + 1)]
        measured = dict.fromkeys(name for sensor in sensors.values() for name in sensor.columns)
        place = {name: k for k, name in enumerate(measured)}
        self.places = {key: [place[name] for name in sensor.columns] for key, sensor in sensors.items()}
        self.width = len(place)
        self.names = [
            *(FIRST if self.clock is None else DATED),
            *components,
            *(f"{COVARIANCE}{components[i]}_{components[j]}" for i, j in self.lower),
            *(INNOVATION + name for name in measured),
            *(DEVIATION + name for name in measured),
            *(f"mode_{k + 1}" for k in range(modes)),
        ]
        if lag:
            self.names += ["lag_time", *(f"lag_{name}" for name in components)]
            self.names += [f"lag_sd_{name}" for name in components]
        self.said = None if said is None else with_row_units(said, components, sensors, self.names)

    def header(self) -> str:
        """Return the first line of a table; empty for JSON."""
        return ",".join(self.names) + "\n" if self.kind == "csv" else ""

    def rows(self, lines: Sequence[int], sensors: Sequence[str], estimates: Sequence[Estimate]) -> str:
        """Return the rows of estimates, given the line and the sensor of each reading."""
        return self.text(self._columns(lines, sensors, estimates))

    def text(self, table: Mapping[str, Column]) -> str:
        """Return the rows of a table of named columns."""
        if self.kind != "csv":
            parts = [column if isinstance(column, list) else column.tolist() for column in table.values()]
            rows = (dict(zip(table, row, strict=True)) for row in zip(*parts, strict=True))
            plain = ({name: None if v != v else v for name, v in row.items()} for row in rows)
            return "".join([json.dumps(row) + "\n" for row in plain])
        texts = list[Iterable[str]]()
        for number, columns in groupby(table.values(), _is_real):
            if number:
                texts.append(decimal_rows(np.stack([np.asarray(column) for column in columns], axis=1)))
                continue
            texts += [column if isinstance(column, list) else map(str, column.tolist()) for column in columns]
        return "".join([",".join(cells) + "\n" for cells in zip(*texts, strict=True)])

    def _columns(
        self, lines: Sequence[int], sensors: Sequence[str], estimates: Sequence[Estimate]
    ) -> dict[str, Column]:
        """Return the columns of estimates by name."""
        innovations = [cast(Innovation, one.innovation) for one in estimates]
        times = np.array([one.time for one in estimates])
        first: list[Column] = [np.array(lines, dtype=np.int64), times, *self.epochs(times)]
        first += [[*sensors], [str(one.outcome) for one in estimates]]
        first += [np.array([one.replayed for one in estimates], dtype=np.int64)]
        first += [np.array([float(one.nis) for one in innovations])]
        first += [np.array([int(one.measured) for one in innovations], dtype=np.int64)]
        wide = np.full((2, len(estimates), self.width), np.nan)
        for name in (names := dict.fromkeys(sensors)):
            every = range(len(sensors))
            own = [*every] if len(names) == 1 else [k for k in every if sensors[k] == name]
            for whole, parts in zip(wide, ("residual", "deviation"), strict=True):
                part = torch.cat([getattr(innovations[k], parts) for k in own]).numpy()
                for place, column in zip(self.places.get(name, ()), part.T, strict=True):
                    whole[own, place] = column
        more = [[*one.modes, *self._smoothed(one)] for one in estimates]
        means = torch.stack([one.mean for one in estimates]).numpy()
        covariances = torch.stack([one.covariance for one in estimates]).numpy()
        numbers = self.numbers(means, covariances, *wide, np.array(more))
        return dict(zip(self.names, [*first, *numbers.T], strict=True))

    def epochs(self, times: Array) -> list[list[str]]:
        """Return the column of epochs of (K,) times; [] if time zero has no epoch."""
        if self.clock is None:
            return []
        known = {time: self.clock.epoch(time) for time in set(times.tolist())}
        return [[known[time] for time in times.tolist()]]

    def numbers(self, means: Array, covariances: Array, *more: Array) -> Array:
        """Return means (K, D), lower triangles of covariances (K, D, D), and more columns, as (K, C)."""
        scales, (rows, columns) = self.scales.numpy(), zip(*self.lower, strict=True)
        triangles = (covariances / np.outer(scales, scales))[:, list(rows), list(columns)]
        return np.concatenate((means / scales, triangles, *more), axis=1)

    def _smoothed(self, estimate: Estimate) -> list[float]:
        """Return the values of the columns for smoothed estimates."""
        return numbers_of(estimate.smoothed, self.scales) if self.smooths else []

    def wrote(self, text: str, line: int, *, begin: bool) -> bool:
        """Return whether a text consists of rows for lines after a given one; the last may be truncated.

        Args:
            text: text of an output.
            line: line number.
            begin: whether the text is the entire output.
        """
        if begin and (head := self.header()):
            if len(text) < len(head):
                return head.startswith(text)
            if not text.startswith(head):
                return False
            text = text.removeprefix(head)
        *whole, cut = text.split("\n")
        numbers = [line, *map(self._number, whole)]
        first, _, others = cut.partition("," if self.kind == "csv" else ": ")
        torn = first == '{"line"' or (not others and '{"line": '.startswith(cut))
        if self.kind == "csv":
            torn = (first.isdigit() or not cut) and others.count(",") <= len(self.names) - 2
        return torn and all(a < b for a, b in pairwise(numbers))

    def _number(self, row: str) -> int:
        """Return the line number of a row, -1 for an invalid row."""
        try:
            if self.kind == "json":
                found = json.loads(row)
                return found["line"] if list(found) == self.names else -1
            cells = row.split(",")
            return int(cells[0]) if len(cells) == len(self.names) else -1
        except (ValueError, TypeError, RecursionError):
            return -1


def _is_real(column: Column) -> bool:
    """Return whether a column consists of floating-point numbers."""
    return isinstance(column, np.ndarray) and column.dtype.kind == "f"


def digest(content: bytes) -> str:
    """Hash the end of an output."""
    return hashlib.blake2b(content, digest_size=16).hexdigest()


class Output:
    """Destination of rows: standard output, or a locked file that can be truncated.

    Args:
        path: path of the file; `-` for standard output.
        rows: formatter of the rows.
        line: number of the last line included in a state; None for a new file.
        size: file size recorded in the state; rows of later lines are truncated.
        tail: hash of the last of those bytes.

    Raises:
        UserError: the file of a new output exists, another process writes it, or it does not match the state.
    """

    def __init__(self, path: str, rows: Rows, line: int | None = None, size: int = 0, tail: str = "") -> None:
        self.size, self._tail = size, b""
        self.file: BinaryIO = sys.stdout.buffer
        if path == "-":
            return
        if line is None:
            require_new(path)
        self.file = _opened(Path(path), new=size == 0)
        if line is not None and (found := self._cut_back(rows, line, tail)):
            self.close()
            message = (
                f"output: expected {path} with {size} unchanged bytes, then rows for later lines; received "
                f"{found}. Start over with a new state and output"
            )
            raise UserError(message)

    @property
    def digest(self) -> str:
        """Hash of the last bytes."""
        return digest(self._tail)

    def _cut_back(self, rows: Rows, line: int, tail: str) -> str:
        """Truncate the file to `size`; return a description of the file if its content is not ours."""
        length = self.file.seek(0, os.SEEK_END)
        if length < self.size:
            return f"{length} bytes"
        head = rows.header().encode()[: self.size]
        self.file.seek(0)
        if self.file.read(len(head)) != head:
            return "a changed file"
        begin = self.file.seek(max(0, self.size - TAIL))
        self._tail, behind = self.file.read(self.size - begin), self.file.read().decode(errors="replace")
        if self.digest != tail or not rows.wrote(behind, line, begin=self.size == 0):
            return "a changed file"
        self.file.truncate(self.size)
        self.file.seek(self.size)
        return ""

    def write(self, text: str) -> None:
        """Write rows and flush them."""
        content = text.encode()
        self.file.write(content)
        self.file.flush()
        self.size += len(content)
        self._tail = (self._tail + content)[-TAIL:]

    def close(self) -> None:
        """Close a file; standard output stays open."""
        if self.file is not sys.stdout.buffer:
            self.file.close()

    def remove(self, path: str) -> None:
        """Remove the output."""
        if path != "-":
            Path(path).unlink(missing_ok=True)

    def sync(self) -> None:
        """Flush the rows to disk."""
        with contextlib.suppress(OSError):  # pipes do not support fsync
            os.fsync(self.file.fileno())


def require_new(path: str) -> None:
    """Raise UserError if the path of a new output exists."""
    if path != "-" and os.path.lexists(path):
        message = (
            f"output: expected a new file; received {path}, which exists. Choose another name, or remove it"
        )
        raise UserError(message)


def _opened(path: Path, *, new: bool) -> BinaryIO:
    """Open and lock a file; raises UserError if another process writes it or an expected file is missing."""
    if not (new or path.exists()):
        message = f"output: expected {path} unchanged; received no file. Start over with a new state"
        raise UserError(message)
    path.parent.mkdir(parents=True, exist_ok=True)
    file = path.open("r+b" if path.exists() else "x+b")
    try:
        lock(file, wait=False)
    except BlockingIOError as error:
        file.close()
        message = f"output: expected a file that no other process writes; received {path}"
        raise UserError(message) from error
    return file
