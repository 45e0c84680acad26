"""How a series looks in every renderer: colour, dash, width and symbol, from its role and its slot.

Colours are those of Okabe & Ito; no two models of a report share colour and dash before the 31st, so that
curves are told apart without colour too.
"""

from __future__ import annotations

from typing import NamedTuple

from ahnn.evaluation.style import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION
from ahnn_plugins.report.drawing import Kind, Series

INK = "ink"
"""The colour of text, which depends on what the figure lies on."""
COLOURS = (VERMILLION, GREEN, ORANGE, PURPLE, SKY)
DASHES = ("solid", "dash", "dashdot", "longdash", "dot", "longdashdot")
SYMBOLS = {"model": "circle", "filter": "square", "floor": "line", "paper": "x"}
"""Of dots, by role."""
OPACITY = 0.18
"""Of bands."""


class Look(NamedTuple):
    """Colour (or `INK`), dash, width of the line in points, and symbol."""

    colour: str
    dash: str = "solid"
    width: float = 1.6
    symbol: str = "circle"


FIXED = {
    "truth": Look(INK, "dash", 1.0),
    "floor": Look(BLUE, "longdashdot", 1.5, SYMBOLS["floor"]),
    "paper": Look(INK, symbol=SYMBOLS["paper"]),
    "measurement": Look(INK),
}


def look(series: Series) -> Look:
    """Return how a series looks."""
    if series.role in FIXED:
        return FIXED[series.role]
    colours = (*COLOURS, BLUE) if series.role == "term" else COLOURS
    turn, place = divmod(series.slot, len(colours))
    dash = DASHES[(place + turn) % len(DASHES)]
    return Look(colours[place], dash, symbol=SYMBOLS.get(series.role, "circle"))


def is_dots(series: Series, kind: Kind) -> bool:
    """Return whether a series is drawn as dots and not as a line."""
    return kind == "bars" or series.role == "measurement"
