"""Tables: columns of numbers with their places in a file."""

from __future__ import annotations

import csv
import logging
import math
import re
from collections.abc import Callable, Collection, Sequence
from typing import Any, Literal, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from ahnn.data.files.units import is_unit
from ahnn.errors import UserError

log = logging.getLogger(__name__)
HEADER = re.compile(r"\s*(?P<name>[^\[\]()]*?)\s*([\[(](?P<unit>[^\[\]()]*)[\])])?\s*")
MISSING = {"", "nan", "na"}
EMPTY = "Leave the cell empty if the value is missing"
DECIMAL_COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+([eE][+-]?[0-9]+)?")
POINT = "Replace each decimal comma in the file by a point"

LARGEST = 1e150
"""Magnitude above which squares overflow float64."""
FINITE = f"a finite number up to {LARGEST:g}"


class Place(NamedTuple):
    """Place in a file.

    Attributes:
        file: file name.
        row: line number, from 1; 0 for the entire file.
        column: column name, or "".
    """

    file: str
    row: int = 0
    column: str = ""

    def __str__(self) -> str:
        row = f", row {self.row}" if self.row else ""
        return f"{self.file}{row}" + (f", column {self.column}" if self.column else "")

    def refuse(self, expected: str, received: str, remedy: str = "") -> NoReturn:
        """Raise Fault with a description of the error at this place."""
        raise Fault(self, expected, received, remedy) from None


class Fault(UserError):
    """Error at a place in a file.

    Attributes:
        place: place of the error.
        expected, received: expected and received content.
        remedy: what the user can do, "" if obvious.
    """

    def __init__(self, place: Place, expected: str, received: str, remedy: str = "") -> None:
        message = f"{place}: expected {expected}; received {received}"
        super().__init__(f"{message}. {remedy}" if remedy else message)
        self.place, self.expected, self.received, self.remedy = place, expected, received, remedy


class Remark(NamedTuple):
    """Remark on content that a reader ignores or interprets in a noteworthy way.

    Attributes:
        place: place of the content.
        what: ignored or interpreted content.
        remedy: remedy, "" if none is needed.
        level: warning for possible errors, otherwise note.
    """

    place: Place
    what: str
    remedy: str = ""
    level: Literal["warning", "note"] = "note"


Note = Callable[[Fault | Remark], None]
"""Callback of a reader for faults and remarks: the doctor records them, all other callers use `refuse`."""


def refuse(said: Fault | Remark) -> None:
    """Raise a fault, or log a remark."""
    if isinstance(said, Fault):
        raise said from None
    level = logging.WARNING if said.level == "warning" else logging.INFO
    log.log(level, "%s: %s%s", said.place, said.what, f". {said.remedy}" if said.remedy else "")


class Header(NamedTuple):
    """Column names and units, None where there is no unit."""

    names: tuple[str, ...]
    units: tuple[str | None, ...]


class Sheet(NamedTuple):
    """Table of columns.

    Attributes:
        header: names and units of the columns.
        place: place of the header.
        rows: (T,) line or record numbers, from 1.
        columns: the T cells of each column, texts or numbers.
    """

    header: Header
    place: Place
    rows: NDArray[np.int64]
    columns: list[Sequence[str] | NDArray[np.float64]]


def read_csv(text: str, file: str, note: Note = refuse) -> Sheet:
    """Return the cells of comma, semicolon or tab separated values; lines that begin with # are skipped.

    Args:
        text: text of the file.
        file: file name, for messages.
        note: callback for rows of wrong length, which are then skipped, and for lines that begin with #.

    Raises:
        UserError: no header, a duplicate name, or an error raised by `note`.
    """
    there = [(row, line) for row, line in enumerate(text.split("\n"), 1) if line.strip()]
    lines = [(row, line) for row, line in there if not line.lstrip().startswith("#")]
    if not lines:
        Place(file).refuse("a header and a row for each sample", "no line")
    if (count := len(there) - len(lines)) > 0:
        note(Remark(Place(file), f"{count} {'line' if count == 1 else 'lines'} starting with # skipped"))
    row, first = lines[0]
    delimiter, place = delimiter_of(first), Place(file, row)
    if delimiter not in first and len(first.split()) > 1 and "[" not in first:
        place.refuse("columns separated by commas, semicolons or tabs", repr(first[:60]))
    header = header_of(cells_of(first, delimiter, place), place)
    width, rows, whole = len(header.names), [], []
    for row, line in lines[1:]:
        try:
            cells = cells_of(line, delimiter, Place(file, row))
            if len(cells) != width:
                Place(file, row).refuse(f"{width} cells, as in the header", f"{len(cells)}")
        except Fault as fault:
            note(fault)
        else:
            rows.append(row)
            whole.append(cells)
    columns: list[Any] = list(zip(*whole, strict=True)) if whole else [()] * width
    return Sheet(header, place, np.array(rows, dtype=np.int64), columns)


def delimiter_of(header: str) -> str:
    """Return the delimiter of a table: the most frequent one in its header, outside quotes."""
    return max(",;\t", key=re.sub(r'"[^"]*"', "", header).count)


def cells_of(line: str, delimiter: str, place: Place) -> list[str]:
    """Return the cells of a line, without their quotes; raises Fault for an unterminated quote."""
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    line = re.sub(rf'"[^\S\t]+(?={delimiter}|$)', '"', line)
    try:
        rows = csv.reader([line], delimiter=delimiter, skipinitialspace=True, strict=True)
        return [cell.strip() for cell in next(rows)]
    except csv.Error as error:
        place.refuse("quoted cells that end on the same line", f"{line[:60]!r} ({error})")


def header_of(cells: Sequence[str], place: Place) -> Header:
    """Return names and units of columns such as `x`, `x [km]` or `vx (km/s)`.

    Raises:
        UserError: an empty name, a duplicate name, or a number instead of a name.
    """
    names, units = [], []
    for cell in cells:
        found = HEADER.fullmatch(cell)
        name = found["name"] if found else ""
        if found is None or not name or is_number(name):
            place.refuse("column names such as 't [s], x [km]' in the first row", repr(cell))
        if name in names:
            place._replace(column=name).refuse("a different name for each column", "it twice")
        names.append(name)
        units.append(found["unit"])
    return Header(tuple(names), tuple(units))


def column_of(cell: str, known: Collection[str]) -> tuple[str, str | None]:
    """Return name and unit of a column such as `range [km]`, or `range_km` if the name is known."""
    found = HEADER.fullmatch(cell)
    name, unit = (found["name"], found["unit"]) if found else (cell, None)
    stem = max((one for one in known if name.startswith(f"{one}_")), key=len, default=None)
    if unit is None and name not in known and stem is not None:
        said = name.removeprefix(f"{stem}_").replace("_", "/")
        return (stem, said) if is_unit(said) else (name, None)
    return name, unit


def is_number(text: str) -> bool:
    """Return whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def number(cell: str, place: Place, remedy: str = EMPTY) -> float:
    """Parse the number in a cell, NaN if empty.

    Args:
        cell: text of the number.
        place: place of the cell.
        remedy: remedy for messages.

    Raises:
        UserError: text, or a number beyond `LARGEST`.
    """
    if cell.lower() in MISSING:
        return math.nan
    try:
        value = float(cell.replace("_", "?"))  # Python accepts 1_000 as a number, other programs do not
    except ValueError:
        if DECIMAL_COMMA.fullmatch(cell):
            place.refuse("a number with a decimal point", f"{cell!r}, with a decimal comma", POINT)
        place.refuse("a number", repr(cell), remedy)
    if abs(value) > LARGEST:
        place.refuse(FINITE, repr(cell), remedy)
    return value


def within(cell: str, place: Place, low: float, high: float) -> float:
    """Parse a required number in a cell, from `low` to `high`; raises UserError."""
    value = number(cell, place, "")
    if not low <= value <= high:
        place.refuse(f"a number from {low:.10g} to {high:.10g}", repr(cell))
    return value
