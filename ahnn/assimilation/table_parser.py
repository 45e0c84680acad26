"""Parsing of lines or columns into readings, by columns if possible, otherwise by rows.

`Layout` defines the meaning of a row. Nearly all rows consist of plain numbers and are converted column by
column; unusual rows are passed to `Layout`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.assimilation.cells import BadLine, is_missing
from ahnn.assimilation.instrument_reading import Reading
from ahnn.assimilation.line_parser import RESERVED, SD, SENSOR, TIME, Layout
from ahnn.assimilation.reading_table import Array, Places, ReadingTable
from ahnn.assimilation.unit_mistakes import ELEVATION
from ahnn.data.files.table import is_number
from ahnn.errors import UserError

Column = Sequence[Any] | Array
"""The K cells of a column, as strings or numbers."""
Mask = NDArray[np.bool_]
FEW = 4
"""Minimum number of lines for which parsing by columns is faster than by rows."""


class ParsedLines(NamedTuple):
    """Readings with their line numbers, and errors of other lines by line number."""

    lines: list[int]
    table: ReadingTable
    bad: dict[int, str]


class TableParser:
    """Parser of readings into the columns of all sensors.

    Args:
        layout: line format of the stream.
        columns: names of the W values of all sensors.
    """

    def __init__(self, layout: Layout, columns: tuple[str, ...]) -> None:
        self.layout, self.columns = layout, columns
        self.sensors = [*layout.sensors]
        self.seen = np.array([[name in one.columns for name in columns] for one in layout.sensors.values()])
        own = [dict(zip(one.columns, one.deviations or (), strict=False)) for one in layout.sensors.values()]
        self.own = np.array([[sds.get(name, math.nan) for name in columns] for sds in own])

    def of_lines(self, lines: list[int], texts: list[str]) -> ParsedLines:
        """Parse lines of text, without empty lines and comments."""
        if self.layout.names is None:
            return self._joined(lines, None, self._singly(lines, texts))
        columns, whole = self._split(texts)
        singly: tuple[list[Any], dict[int, str]] = [], {}
        if len(whole) < len(texts):
            others = sorted({*range(len(texts))}.difference(whole))
            singly = self._singly([lines[k] for k in others], [texts[k] for k in others])
            lines = [lines[k] for k in whole]
        return self._of_columns(lines, columns, singly)

    def readings(self, texts: list[str]) -> list[Reading | None]:
        """Parse lines of one object; None for few or unusual lines, which are left to `Layout.reading`."""
        layout, found = self.layout, list[Reading | None]([None] * len(texts))
        steep = any(name.endswith(ELEVATION) for name in self.columns)
        few = len(texts) < FEW
        if few or layout.names is None or layout.controls or (steep and not layout.levelled):
            return found
        columns, whole = self._split(texts)
        try:
            plain, table = self._at_once(columns, len(whole))
        except UserError:
            return found
        times = table.times.tolist()
        for number, (name, sensor) in enumerate(layout.sensors.items()):
            own = [self.columns.index(column) for column in sensor.columns]
            rows = np.flatnonzero(plain & (table.sensors == number))
            values, deviations = (part[rows][:, own] for part in (table.values, table.deviations))
            given = np.logical_not(np.isnan(deviations).all(1)).tolist()
            parts = zip(rows.tolist(), values.tolist(), deviations.tolist(), given, strict=True)
            for k, row, sds, has in parts:
                found[whole[k]] = Reading(times[k], tuple(row), name, tuple(sds) if has else None)
        return found

    def _split(self, texts: list[str]) -> tuple[dict[str, Column], list[int]]:
        """Return the columns of lines with a cell for each name and no quotes, and the lines' indices."""
        names, mark = self.layout.names, self.layout.delimiter
        assert names is not None
        cells = [text.split(mark) for text in texts]
        width, quoted = len(names), any('"' in text for text in texts)
        whole = [k for k, row in enumerate(cells) if len(row) == width and not (quoted and '"' in texts[k])]
        rows = cells if len(whole) == len(cells) else [cells[k] for k in whole]
        columns: list[Column] = [*zip(*rows, strict=True)] if rows else [()] * width
        return dict(zip(names, columns, strict=True)), whole

    def of_columns(self, lines: list[int], columns: dict[str, Column]) -> ParsedLines:
        """Parse named columns of strings or numbers."""
        return self._of_columns(lines, columns, ([], {}))

    def _of_columns(
        self, lines: list[int], columns: dict[str, Column], singly: tuple[list[Any], dict[int, str]]
    ) -> ParsedLines:
        """Parse columns, and unusual rows individually."""
        plain, table = self._at_once(columns, len(lines))
        if not plain.all():
            others = np.flatnonzero(~plain).tolist()
            rows = [{name: _cell(column[k]) for name, column in columns.items()} for k in others]
            found, bad = self._rows([lines[k] for k in others], rows)
            singly = [*singly[0], *found], {**singly[1], **bad}
            kept = np.flatnonzero(plain)
            lines = [lines[k] for k in kept.tolist()]
            objects = [table.objects[k] for k in kept.tolist()]
            table = _rebuilt(objects, table, kept)
        return self._joined(lines, table, singly)

    def _at_once(self, columns: dict[str, Column], count: int) -> tuple[Mask, ReadingTable]:
        """Convert columns to readings, and return the mask of plain rows, (K,) bool."""
        layout, plain = self.layout, np.ones(count, dtype=bool)
        times = self._times(next(columns[key] for key in TIME if key in columns), plain)
        objects = [""] * count
        if layout.objects:
            objects = [str(cell).strip() for cell in columns[layout.objects]]
            plain &= [not is_missing(name) and RESERVED.isdisjoint(name) for name in objects]
        sensors = self._sensors(columns, count)
        plain &= sensors >= 0
        shape = (count, len(self.columns))
        values, deviations = np.full(shape, math.nan), np.full(shape, math.nan)
        for prefix, whole in (("", values), (SD, deviations)):
            for k, name in enumerate(self.columns):
                if (key := prefix + name) in columns:
                    whole[:, k] = self._numbers(columns[key], plain, layout.scales.get(key, 1.0))
        steep = [k for k, name in enumerate(self.columns) if name.endswith(ELEVATION)]
        plain &= ~(np.abs(values[:, steep]) > math.pi / 2).any(1)
        if len(self.sensors) > 1:
            foreign = ~self.seen[sensors]
            plain &= ~(foreign & ~(np.isnan(values) & np.isnan(deviations))).any(1)
        self._complete(sensors, values, deviations, plain)
        return plain, ReadingTable(objects, times, sensors, values, deviations)

    def _times(self, column: Column, plain: Mask) -> Array:
        """Convert the times of rows; rows without a time are not plain. Raises UserError like the clock."""
        clock = self.layout.clock
        if clock is None or (_is_numeric(column) and not clock.dated):
            times = self._numbers(column, plain, 1.0 if clock is None else clock.scale)
        else:
            known = dict[Any, float]()  # objects are often measured at the same times
            for cell in dict.fromkeys(column.tolist() if isinstance(column, np.ndarray) else column):
                try:
                    known[cell] = clock.time(cell.strip() if isinstance(cell, str) else cell)
                except BadLine:
                    known[cell] = math.nan
            times = np.array([known[cell] for cell in column], dtype=np.float64)
        plain &= np.isfinite(times)
        return times

    def _complete(self, sensors: Places, values: Array, deviations: Array, plain: Mask) -> None:
        """Fill in standard deviations as `Layout` does; rows with unknown deviations are not plain."""
        own, seen = self.own[sensors], self.seen[sensors]
        bare = np.isnan(deviations).all(1) & ~np.any(np.isnan(own) & seen, axis=1)
        filled = np.where(np.isnan(deviations), own, deviations)
        filled = np.where(np.isnan(filled) & np.isnan(values), 1.0, filled)
        plain &= bare | ~np.any(seen & ~(filled > 0.0), axis=1)
        deviations[:] = np.where(seen & ~bare[:, None], filled, math.nan)

    def _sensors(self, columns: dict[str, Column], count: int) -> Places:
        """Return sensor indices, -1 for an unknown name, or for no name if there are several sensors."""
        if SENSOR not in columns:
            return np.full(count, 0 if len(self.sensors) == 1 else -1)
        known = {name: k for k, name in enumerate(self.sensors)}
        cells = [str(cell).strip() for cell in columns[SENSOR]]
        only = {"": 0} if len(self.sensors) == 1 else {}
        return np.array([(known | only).get(cell, -1) for cell in cells], dtype=np.int64)

    def _numbers(self, column: Column, plain: Mask, scale: float) -> Array:
        """Convert a column to numbers, NaN where missing; rows with other content are not plain."""
        if isinstance(column, np.ndarray):
            found = column.astype(np.float64)
        else:
            try:
                found = np.array(list(map(float, column)))
            except (ValueError, TypeError):
                found = np.array([_number(cell, k, plain) for k, cell in enumerate(column)])
            if "_" in "".join(map(str, column)):
                plain &= ["_" not in str(cell) for cell in column]
        with np.errstate(over="ignore"):
            found = found * scale
        plain &= ~np.isinf(found)
        return found

    def _singly(self, lines: list[int], texts: list[str]) -> tuple[list[Any], dict[int, str]]:
        """Parse lines individually, and collect the errors of invalid ones."""
        rows, bad = [], dict[int, str]()
        for line, text in zip(lines, texts, strict=True):
            try:
                rows.append((line, self.layout.row(text)))
            except BadLine as error:
                bad[line] = str(error)
        found, others = self._rows([line for line, _ in rows], [row for _, row in rows])
        return found, bad | others

    def _rows(self, lines: list[int], rows: list[dict[str, Any]]) -> tuple[list[Any], dict[int, str]]:
        """Parse rows individually, and collect the errors of invalid ones."""
        found, bad = list[tuple[int, str, Reading]](), dict[int, str]()
        for line, row in zip(lines, rows, strict=True):
            try:
                found.append((line, self.layout.object_of(row), self.layout.reading_of(row)))
            except BadLine as error:
                bad[line] = str(error)
        return found, bad

    def _joined(
        self, lines: list[int], table: ReadingTable | None, singly: tuple[list[Any], dict[int, str]]
    ) -> ParsedLines:
        """Merge readings in the order of their lines."""
        found, bad = singly
        if not found and table is not None:
            return ParsedLines(lines, table, bad)
        own = [line for line, _, _ in found]
        parts = self._table([(name, reading) for _, name, reading in found])
        if table is None:
            return ParsedLines(own, parts, bad)
        order = np.argsort([*lines, *own], kind="stable")
        objects = [*table.objects, *parts.objects]
        both = ReadingTable(
            objects,
            np.concatenate((table.times, parts.times)),
            np.concatenate((table.sensors, parts.sensors)),
            np.concatenate((table.values, parts.values)),
            np.concatenate((table.deviations, parts.deviations)),
        )
        whole = _rebuilt([objects[k] for k in order.tolist()], both, order)
        return ParsedLines([[*lines, *own][k] for k in order.tolist()], whole, bad)

    def _table(self, pairs: list[tuple[str, Reading]]) -> ReadingTable:
        """Combine single readings into a table."""
        shape = (len(pairs), len(self.columns))
        values, deviations = np.full(shape, math.nan), np.full(shape, math.nan)
        sensors = np.full(len(pairs), -1)
        for k, (_, reading) in enumerate(pairs):
            if reading.sensor:
                sensors[k] = self.sensors.index(reading.sensor)
                own = np.flatnonzero(self.seen[sensors[k]])
                order = [self.layout.sensors[reading.sensor].columns.index(self.columns[j]) for j in own]
                values[k, own] = np.array(reading.values)[order]
                if reading.deviations is not None:
                    deviations[k, own] = np.array(reading.deviations)[order]
        times = np.array([reading.time for _, reading in pairs], dtype=np.float64)
        return ReadingTable([name for name, _ in pairs], times, sensors, values, deviations)


def _rebuilt(objects: list[str], table: ReadingTable, chosen: Places) -> ReadingTable:
    """Return selected rows of a table with their object names."""
    _, times, sensors, values, deviations = table
    return ReadingTable(objects, times[chosen], sensors[chosen], values[chosen], deviations[chosen])


def _is_numeric(column: Column) -> bool:
    """Return whether the first non-empty cell is a number."""
    if isinstance(column, np.ndarray):
        return True
    first = next((cell for cell in column if not is_missing(cell)), "")
    return not isinstance(first, str) or is_number(first)


def _number(cell: Any, row: int, plain: Mask) -> float:
    """Convert a cell to a number, NaN where missing; a row with other content is not plain."""
    if is_missing(cell) or (isinstance(cell, str) and is_missing(cell.strip())):
        return math.nan
    try:
        return float(cell)
    except (ValueError, TypeError):
        plain[row] = False
        return math.nan


def _cell(cell: Any) -> Any:
    """Return a cell as a Python number, or as text without surrounding spaces."""
    return cell.strip() if isinstance(cell, str) else cell.item() if isinstance(cell, np.generic) else cell
