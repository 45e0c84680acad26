"""A table as data: what it says, apart from HTML and LaTeX; and how its numbers are written."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from ahnn_plugins.report.score_samples import Ratio, Sample

Tone = Literal["", "best", "quiet", "words"]
NONE = "–"
"""What is not there."""
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Cell(NamedTuple):
    """A cell.

    Attributes:
        text: its content.
        tone: `best` of its column, `quiet` for what others say, `words` for a text and no number.
        note: number of the footnote from 1 on; 0 is none.
    """

    text: str
    tone: Tone = ""
    note: int = 0


class Head(NamedTuple):
    """A heading over some columns."""

    text: str
    span: int = 1


class Line(NamedTuple):
    """A row: its heading and its cells; or, without cells, a heading of the rows that follow."""

    name: str
    cells: tuple[Cell, ...] = ()


class Grid(NamedTuple):
    """A table.

    Attributes:
        name: of its file and its anchor.
        title: one line.
        caption: what the numbers are.
        heads: rows of headings, the first of each over the headings of the rows.
        lines: rows.
        notes: footnotes.
    """

    name: str
    title: str
    caption: str
    heads: tuple[tuple[Head, ...], ...]
    lines: tuple[Line, ...]
    notes: tuple[str, ...] = ()

    @property
    def columns(self) -> int:
        """Number of columns."""
        return sum(head.span for head in self.heads[0])


def shown(value: float | None, digits: int = 3, least: int = -3) -> str:
    """Return a number in a few significant digits; what is lost is `lost`, what is not there a dash.

    Args:
        value: the number.
        digits: significant ones.
        least: smallest power of ten that is written without an exponent.
    """
    if value is None:
        return NONE
    if not math.isfinite(value):
        return "lost"
    if value == 0:
        return "0"
    text = f"{value:.{digits - 1}e}"
    exponent = int(text.split("e")[1])
    if least <= exponent < 5:
        return f"{float(text):.{max(0, digits - 1 - exponent)}f}"
    return _powered(text)


def as_printed(value: float) -> str:
    """Return a number with all digits that it was given, up to six."""
    return _powered(f"{value:.6g}")


def _powered(text: str) -> str:
    mantissa, e, exponent = text.partition("e")
    return mantissa + (f"×10{str(int(exponent)).translate(SUPERSCRIPT)}" if e else "")


def mean_and_spread(sample: Sample, scale: float = 1.0) -> str:
    """Return `mean ± standard deviation` of a sample in a unit, the mean alone of a single run."""
    if not sample.values:
        return NONE
    lost = sum(not math.isfinite(value) for value in sample.values)
    if lost:
        return f"lost in {lost} of {len(sample.values)}"
    mean = shown(sample.mean / scale)
    least = -3 if "×" in mean else -7  # both in one notation
    return mean if sample.spread is None else f"{mean} ± {shown(sample.spread / scale, 2, least)}"


def interval(ratio: Ratio) -> str:
    """Return a ratio with the limits of its confidence interval in brackets."""
    if math.isnan(ratio.value):
        return NONE
    if math.isinf(ratio.value):
        return "∞"
    known = ratio.low > 0 and ratio.high < math.inf
    return shown(ratio.value) + (f" [{shown(ratio.low)}, {shown(ratio.high)}]" if known else "")
