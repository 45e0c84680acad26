"""Number formats, and tables as data, independent of HTML and LaTeX."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from ahnn_plugins.report.score_samples import Ratio, Sample

Tone = Literal["", "best", "quiet", "words"]
NONE = "–"
"""Text of a missing value."""
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Cell(NamedTuple):
    """Table cell.

    Attributes:
        text: text of the cell.
        tone: `best` in its column, `quiet` for values from other sources, `words` for text.
        note: footnote number from 1; 0: no footnote.
    """

    text: str
    tone: Tone = ""
    note: int = 0


class Head(NamedTuple):
    """Heading over columns."""

    text: str
    span: int = 1


class Line(NamedTuple):
    """Row with a heading and cells or, without cells, a heading for the following rows."""

    name: str
    cells: tuple[Cell, ...] = ()


class Grid(NamedTuple):
    """Table.

    Attributes:
        name: name of its file and its anchor.
        title: one-line title.
        caption: description of the numbers.
        heads: rows of headings, the first of each above the row headings.
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
    """Format a number with few significant digits; `lost` if not finite, a dash if missing.

    Args:
        value: number to format.
        digits: number of significant digits.
        least: smallest power of ten written without an exponent.
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
    """Format a number with its given digits, up to six."""
    return _powered(f"{value:.6g}")


def _powered(text: str) -> str:
    mantissa, e, exponent = text.partition("e")
    return mantissa + (f"×10{str(int(exponent)).translate(SUPERSCRIPT)}" if e else "")


def mean_and_spread(sample: Sample, scale: float = 1.0) -> str:
    """Format `mean ± standard deviation` of a sample in a unit, or only the mean of a single run."""
    if not sample.values:
        return NONE
    lost = sum(not math.isfinite(value) for value in sample.values)
    if lost:
        return f"lost in {lost} of {len(sample.values)}" if len(sample.values) > 1 else "lost"
    mean = shown(sample.mean / scale)
    least = -3 if "×" in mean else -7  # the same notation for both
    return mean if sample.spread is None else f"{mean} ± {shown(sample.spread / scale, 2, least)}"


def interval(ratio: Ratio) -> str:
    """Format a ratio with its confidence interval in brackets."""
    if math.isnan(ratio.value):
        return NONE
    if math.isinf(ratio.value):
        return "∞"
    known = ratio.low > 0 and ratio.high < math.inf
    return shown(ratio.value) + (f" [{shown(ratio.low)}, {shown(ratio.high)}]" if known else "")
