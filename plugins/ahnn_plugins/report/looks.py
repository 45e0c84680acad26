"""Appearance of series in all renderers: colour, dash, width and symbol, by role and slot.

Colours are from Okabe & Ito. The first 30 models of a report have distinct combinations of colour and dash;
the first five are distinguishable by dash alone.
"""

from __future__ import annotations

from typing import NamedTuple

from ahnn.evaluation.style import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION
from ahnn_plugins.report.drawing import Kind, Series

INK = "ink"
"""Text colour, which depends on the background of the figure."""
COLOURS = (VERMILLION, GREEN, ORANGE, PURPLE, SKY)
DASHES = ("solid", "dash", "dashdot", "longdash", "dot", "longdashdot")
SYMBOLS = {"model": "circle", "filter": "square", "floor": "line", "paper": "x"}
"""Symbols of dots, by role."""
OPACITY = 0.18
"""Opacity of bands."""
SMALL = ("measurement", "seed")
"""Roles of small dots."""


class Look(NamedTuple):
    """Colour (or `INK`), dash, width of the line in points, and symbol."""

    colour: str
    dash: str = "solid"
    width: float = 1.6
    symbol: str = "circle"


FIXED = {
    "truth": Look(INK, "dash", 1.0),
    "track": Look(INK, width=0.7),
    "floor": Look(BLUE, "longdashdot", 1.5, SYMBOLS["floor"]),
    "paper": Look(INK, symbol=SYMBOLS["paper"]),
    "measurement": Look(INK),
}


def look(series: Series) -> Look:
    """Return the appearance of a series."""
    if series.role in FIXED:
        return FIXED[series.role]
    colours = (*COLOURS, BLUE) if series.role == "term" else COLOURS
    turn, place = divmod(series.slot, len(colours))
    dash = DASHES[(place + turn) % len(DASHES)]
    return Look(colours[place], dash, symbol=SYMBOLS.get(series.role, "circle"))


def is_dots(series: Series, kind: Kind) -> bool:
    """Return whether a series is drawn as dots instead of a line."""
    return kind == "dots" or series.role == "measurement"
