"""A file as columns of numbers, each of them with the place that it came from."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from ahnn.errors import UserError

HEADER = re.compile(r"\s*(?P<name>[^\[\]()]*?)\s*([\[(](?P<unit>[^\[\]()]*)[\])])?\s*")
MISSING = {"", "nan", "na"}


class Place(NamedTuple):
    """Where in a file something stands.

    Attributes:
        file: its name.
        row: number of the line, from 1; 0 is the file as a whole.
        column: name of the column, or "".
    """

    file: str
    row: int = 0
    column: str = ""

    def __str__(self) -> str:
        row = f", row {self.row}" if self.row else ""
        return f"{self.file}{row}" + (f", column {self.column}" if self.column else "")

    def refuse(self, expected: str, received: str, remedy: str = "") -> NoReturn:
        """Say what is wrong here; raises Fault."""
        raise Fault(self, expected, received, remedy) from None


class Fault(UserError):
    """What is wrong at a place of a file.

    Attributes:
        place: where.
        expected, received: what should be there, and what is.
        remedy: what to do, "" where that is plain.
    """

    def __init__(self, place: Place, expected: str, received: str, remedy: str = "") -> None:
        message = f"{place}: expected {expected}; received {received}"
        super().__init__(f"{message}. {remedy}" if remedy else message)
        self.place, self.expected, self.received, self.remedy = place, expected, received, remedy


Note = Callable[[Fault], None]
"""What a reader does with a fault that it could pass over: a training refuses, a doctor writes it down."""


def refuse(fault: Fault) -> None:
    """Raise a fault."""
    raise fault from None


class Header(NamedTuple):
    """Names of columns, and the unit behind each name, None where there is none."""

    names: tuple[str, ...]
    units: tuple[str | None, ...]


class Sheet(NamedTuple):
    """A file of columns.

    Attributes:
        header: names and units of the columns.
        place: of the header.
        rows: (T,) numbers of the lines, or of the records, from 1.
        columns: the T cells of each, texts or numbers.
    """

    header: Header
    place: Place
    rows: NDArray[np.int64]
    columns: list[Sequence[str] | NDArray[np.float64]]


def read_csv(text: str, file: str, note: Note = refuse) -> Sheet:
    """Return the cells of comma, semicolon or tab separated values; lines that begin with # are left out.

    Args:
        text: of the file.
        file: its name, for messages.
        note: of a row of another length, which is then left out.

    Raises:
        UserError: no header, a name that occurs twice, or what `note` raises.
    """
    lines = [
        (row, line)
        for row, line in enumerate(io.StringIO(text), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        Place(file).refuse("a header and a row for each sample", "no line")
    first = lines[0][1]
    delimiter = max(",;\t", key=first.count)
    place = Place(file, lines[0][0])
    header = header_of(next(csv.reader([first], delimiter=delimiter)), place)
    width, rows, whole = len(header.names), [], []
    for (row, _), cells in zip(lines[1:], cells_of(lines[1:], delimiter), strict=True):
        if len(cells) == width:
            rows.append(row)
            whole.append(cells)
        else:
            note(Fault(Place(file, row), f"{width} cells, as in the header", f"{len(cells)}"))
    columns: list[Any] = list(zip(*whole, strict=True)) if whole else [()] * width
    return Sheet(header, place, np.array(rows, dtype=np.int64), columns)


def cells_of(lines: Sequence[tuple[int, str]], delimiter: str) -> Iterator[list[str]]:
    """Yield the cells of each line; a quoted cell ends with its line."""
    for _, line in lines:
        yield [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]


def header_of(cells: Sequence[str], place: Place) -> Header:
    """Return names and units of columns such as `x`, `x [km]` or `vx (km/s)`.

    Raises:
        UserError: an empty name, a name that occurs twice, or a number in its place.
    """
    names, units = [], []
    for cell in cells:
        found = HEADER.fullmatch(cell)
        name = found["name"] if found else ""
        if found is None or not name or is_number(name):
            place.refuse("names of columns such as 't [s], x [km]' in the first row", repr(cell))
        if name in names:
            place._replace(column=name).refuse("a name for each column", "it twice")
        names.append(name)
        units.append(found["unit"])
    return Header(tuple(names), tuple(units))


def is_number(text: str) -> bool:
    """Return whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def number(cell: str, place: Place) -> float:
    """Return the number in a cell, NaN where it is empty.

    Raises:
        UserError: text, or infinity.
    """
    if cell.lower() in MISSING:
        return math.nan
    try:
        value = float(cell.replace("_", "?"))  # Python reads 1_000 as a number, nobody else does
    except ValueError:
        place.refuse("a number", repr(cell), "An empty cell is a missing one")
    if math.isinf(value):
        place.refuse("a finite number", repr(cell), "An empty cell is a missing one")
    return value
