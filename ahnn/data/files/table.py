"""A file as columns of numbers, each of them with the place that it came from."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple, NoReturn

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

    def refuse(self, expected: str, received: str, remedy: str = "") -> NoReturn:
        """Say what is wrong here; raises UserError."""
        row = f", row {self.row}" if self.row else ""
        column = f", column {self.column}" if self.column else ""
        message = f"{self.file}{row}{column}: expected {expected}; received {received}"
        raise UserError(f"{message}. {remedy}" if remedy else message) from None


class Header(NamedTuple):
    """Names of columns, and the unit behind each name, None where there is none."""

    names: tuple[str, ...]
    units: tuple[str | None, ...]


class Lines(NamedTuple):
    """A text of separated values.

    Attributes:
        header: names and units of its columns.
        place: of the header.
        rows: numbers of the lines, from 1, each with its cells.
    """

    header: Header
    place: Place
    rows: list[tuple[int, list[str]]]


def read_csv(text: str, file: str) -> Lines:
    """Return the cells of comma, semicolon or tab separated values; lines that begin with # are left out.

    Raises:
        UserError: no header, a name that occurs twice, or a row of another length.
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
    rows = [(row, cells) for (row, _), cells in zip(lines[1:], cells_of(lines[1:], delimiter), strict=True)]
    for row, cells in rows:
        if len(cells) != len(header.names):
            Place(file, row).refuse(f"{len(header.names)} cells, as in the header", f"{len(cells)}")
    return Lines(header, place, rows)


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
