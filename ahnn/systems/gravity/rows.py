"""Rows of a gravity field file: coefficients by degree and order, evaluated at an epoch."""

from __future__ import annotations

import datetime
import math
import re
from typing import NamedTuple, NoReturn

from ahnn.errors import UserError

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?", re.ASCII)
WHOLE = re.compile(r"\d{1,6}", re.ASCII)
STATIC, VARIES, CHANGES = "gfc", "gfct", ("trnd", "dot", "acos", "asin")
YEAR = 365.25
"""Days per year in the format."""

Index = tuple[int, int]
"""Degree n and order m."""
Coefficient = tuple[float, float]
"""C and S."""


class CoefficientLine(NamedTuple):
    """Line with its position in the file, for messages.

    Attributes:
        file: file name.
        row: line number from 1; 0 for the entire file.
        words: words of the line.
    """

    file: str
    row: int
    words: list[str]

    def refuse(self, expected: str, received: object) -> NoReturn:
        """Raise UserError with a description of the error in this line."""
        row = f", row {self.row}" if self.row else ""
        message = f"{self.file}{row}: expected {expected}; received {received}"
        raise UserError(message)

    def word(self, column: int) -> str:
        """Return the word in a column."""
        return self.words[column][:60] if column < len(self.words) else "nothing"

    def number(self, column: int, what: str) -> float:
        """Return the number in a column, with an exponent E or D; raises UserError unless it is finite."""
        text = self.word(column)
        value = float(text.upper().replace("D", "E")) if NUMBER.fullmatch(text) else math.nan
        return value if math.isfinite(value) else self.refuse(f"{what} as a finite number", text)

    def whole(self, column: int, what: str) -> int:
        """Return the whole number in a column; raises UserError if there is none."""
        text = self.word(column)
        return int(text) if WHOLE.fullmatch(text) else self.refuse(f"{what} as a whole number", text)

    def coefficient(self) -> Coefficient:
        """Return C and S of the row."""
        return self.number(3, "C"), self.number(4, "S")


def coefficients(lines: list[CoefficientLine], degree: int, epoch: str | None) -> dict[Index, Coefficient]:
    """Return C and S of every row by degree and order.

    Args:
        lines: rows after the header.
        degree: maximum degree of the file.
        epoch: epoch of time-variable coefficients, YYYY-MM-DD.

    Raises:
        UserError: an invalid row.
    """
    rows: dict[Index, CoefficientLine] = {}
    changes: list[tuple[Index, CoefficientLine]] = []
    widths: dict[str, int] = {}
    for line in lines:
        key, pair = line.word(0), _index(line, degree)
        if widths.setdefault(key, len(line.words)) != len(line.words):
            line.refuse(f"{widths[key]} columns, as in the first {key} row", len(line.words))
        if key in CHANGES:
            changes.append((pair, line))
        elif pair in rows:
            line.refuse("each coefficient once", f"n, m = {pair} twice")
        else:
            rows[pair] = line
    found = {pair: line.coefficient() for pair, line in rows.items()}
    years = {pair: _years(line, epoch) for pair, line in rows.items() if line.word(0) == VARIES}
    for pair, line in changes:
        if pair not in years:
            line.refuse(f"a {VARIES} row for the coefficient", f"none for n, m = {pair}")
        factor, (c, s), (more_c, more_s) = _factor(line, years[pair]), found[pair], line.coefficient()
        found[pair] = c + factor * more_c, s + factor * more_s
    return found


def _index(line: CoefficientLine, degree: int) -> Index:
    """Return degree and order of a row."""
    if line.word(0) not in (STATIC, VARIES, *CHANGES):
        line.refuse(f"a row beginning with one of {STATIC}, {VARIES}, {', '.join(CHANGES)}", line.word(0))
    n, m = line.whole(1, "degree n"), line.whole(2, "order m")
    if not m <= n <= degree:
        line.refuse(f"order <= degree <= max_degree {degree}", f"n, m = {(n, m)}")
    return n, m


def _years(line: CoefficientLine, epoch: str | None) -> float:
    """Return the years from the reference epoch of a row, its last column YYYYMMDD, to an epoch."""
    if epoch is None:
        line.refuse("an epoch, YYYY-MM-DD, for coefficients that vary in time", "none")
    try:
        then = datetime.date.fromisoformat(epoch)
    except ValueError:
        line.refuse("an epoch YYYY-MM-DD", epoch)
    text = line.words[-1]
    try:
        since = datetime.datetime.strptime(text if re.fullmatch(r"\d{8}", text) else "", "%Y%m%d").date()
    except ValueError:
        line.refuse("the reference epoch YYYYMMDD in the last column", text[:60])
    return (then - since).days / YEAR


def _factor(line: CoefficientLine, years: float) -> float:
    """Return the time-dependent factor of the coefficients in a row of `CHANGES`."""
    key = line.word(0)
    if key in ("trnd", "dot"):
        return years
    period = line.number(len(line.words) - 1, "the period in years")
    if period <= 0:
        line.refuse("a period > 0 in years", period)
    turns = 2 * math.pi * years / period
    return math.cos(turns) if key == "acos" else math.sin(turns)
